"""Surrogates: what is evaluated, differentiated, saved and exported."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Union

import numpy as np

from . import _metafmu

# hosts add up step sizes and convert units; in an FMU it is the same
_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Variable:
    """An input or output: name, unit, and the range for which the model was made. ``start`` is None for outputs."""

    name: str
    unit: str
    min: float
    max: float
    start: float | None = None
    description: str = ""


# names of variables, or units, ranges or keys of an interface by name
Names = Union[str, Sequence[Union[str, Variable]], Mapping[str, Any], None]


def rows_of(x, names, what="X"):
    """The rows of an array-like or a DataFrame with columns of these names, as an array of doubles of shape (rows, columns).

    Raises :class:`metafmu.Error` if they do not fit.
    """
    if hasattr(x, "columns") and hasattr(x, "__getitem__"):
        known = [str(column) for column in x.columns]
        missing = [name for name in names if name not in known]
        if missing:
            raise _metafmu.Error(f"{what} has no column {', '.join(f'`{name}`' for name in missing)}, it has {', '.join(known)}")
        of_name = dict(zip(known, x.columns))
        x = np.column_stack([np.asarray(x[of_name[name]], dtype=np.float64) for name in names])
    x = np.asarray(x, dtype=np.float64)
    if x.ndim == 1 and len(names) > 1:
        hint = f"expected rows of {len(names)} columns: for a single row, {what}[None, :]"
        raise _metafmu.Error(f"{what} has the shape {x.shape}, {hint}")
    if x.ndim == 1:
        x = x[:, None]
    if x.ndim != 2 or x.shape[1] != len(names):
        raise _metafmu.Error(f"{what} has the shape {x.shape}, expected (rows, {len(names)}): {', '.join(names[:20])}")
    return np.ascontiguousarray(x)


class Surrogate:
    """A model with named inputs and outputs, their units and ranges, which becomes an FMU.

    Made by :func:`metafmu.from_torch`, :func:`metafmu.from_sklearn` and so on, :func:`metafmu.fit`, :meth:`Study.build`, or
    :meth:`Surrogate.load`.

    >>> surrogate = metafmu.Surrogate.load("model.safetensors")
    >>> y = surrogate.predict(X)                                # shape (rows, outputs)
    >>> dy = surrogate.jacobian(X)                              # shape (rows, outputs, inputs)
    >>> surrogate.export("model.fmu", fmi="both")
    """

    def __init__(self, core):
        self._core = core
        self._metadata = json.loads(core.metadata())

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Surrogate:
        """Reads a model file (``.safetensors``), or the model inside an FMU made by metafmu (``.fmu``)."""
        return cls(_metafmu.Surrogate.load(os.fspath(path)))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a model file; its name must end in ``.safetensors`` to be read again."""
        self._core.save(os.fspath(path))

    @property
    def name(self) -> str:
        """The name, also of the FMU's model."""
        return self._metadata["name"]

    @property
    def content_digest(self) -> str:
        """SHA-256 of everything in the model: two surrogates with one digest are the same."""
        return self._metadata["provenance"]["content_digest"]

    @property
    def inputs(self) -> list[Variable]:
        """The inputs, in the order of the columns of ``X``."""
        keys = ("name", "unit", "min", "max", "start", "description")
        return [Variable(**{key: item[key] for key in keys}) for item in self._metadata["inputs"]]

    @property
    def outputs(self) -> list[Variable]:
        """The outputs, in the order of the columns of a prediction."""
        keys = ("name", "unit", "min", "max", "description")
        return [Variable(**{key: item[key] for key in keys}) for item in self._metadata["outputs"]]

    def _rows(self, x):
        self._core.stateless()
        return rows_of(x, [item["name"] for item in self._metadata["inputs"]])

    def predict(self, X: Any) -> np.ndarray:
        """Outputs of shape (rows, outputs), in double precision; all cores work on them.

        ``X``: rows of the inputs, as an array or a DataFrame with a column for each input.
        """
        rows = self._rows(X)
        values = np.frombuffer(self._core.predict(rows.tobytes()), dtype=np.float64)
        return values.reshape(len(rows), len(self._metadata["outputs"]))

    def jacobian(self, X: Any) -> np.ndarray:
        """Derivatives of each output by each input, of shape (rows, outputs, inputs): exact but for rounding."""
        rows = self._rows(X)
        values = np.frombuffer(self._core.jacobian(rows.tobytes()), dtype=np.float64)
        return values.reshape(len(rows), len(self._metadata["outputs"]), rows.shape[1])

    def domain_distance(self, X: Any) -> np.ndarray:
        """How far each row is from the domain of validity, relative to the ranges of the inputs: 0 inside, as the FMU's output of that name."""
        return np.frombuffer(self._core.domain_distance(self._rows(X).tobytes()), dtype=np.float64)

    def in_domain(self, X: Any) -> np.ndarray:
        """Whether each row is in the domain of validity: in the ranges of the inputs and, if the model was made with its training data,
        near some of them."""
        return self.domain_distance(X) <= _TOLERANCE

    def export(
        self, path: str | os.PathLike[str], fmi: str = "2", sources: bool = False, platforms: str | Iterable[str] | None = None
    ) -> list[Path]:
        """Writes FMUs and returns their paths.

        ``path``: the FMU, or a folder for ``NAME.fmu``. ``fmi``: ``"2"``, ``"3"`` or ``"both"``; of both, that of 3.0 is beside the
        other one, with ``-fmi3`` in its name. ``sources``: also C99 source code, for targets without a binary. ``platforms``: tuples
        like ``"x86_64-linux"``, all that the package has unless given.
        """
        path = Path(path)
        if path.is_dir():
            path = path / f"{self.name}.fmu"
        if path.suffix != ".fmu":
            raise _metafmu.Error(f"{path}: expected a file that ends in .fmu, or a folder")
        platforms = [platforms] if isinstance(platforms, str) else list(platforms or [])
        written = self._core.export(path, str(fmi), bool(sources), platforms)
        return [Path(fmu) for fmu in written]

    def to_onnx(self, path: str | os.PathLike[str]) -> None:
        """Writes an ONNX model of the same function, unless it has states."""
        self._core.to_onnx(os.fspath(path))

    def __reduce__(self):
        return _from_bytes, (self._core.to_bytes(),)

    def __eq__(self, other):
        return isinstance(other, Surrogate) and self.content_digest == other.content_digest

    def __hash__(self):
        return hash(self.content_digest)

    def __repr__(self):
        names = lambda items: ", ".join(item["name"] for item in items[:6]) + (", ..." if len(items) > 6 else "")
        return f"Surrogate({self.name!r}: {names(self._metadata['inputs'])} -> {names(self._metadata['outputs'])})"


def _from_bytes(data):
    return Surrogate(_metafmu.Surrogate.from_bytes(data))
