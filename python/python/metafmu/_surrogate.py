"""Surrogates: evaluation, derivatives, model files and export."""

from __future__ import annotations

import json
import math
import os
import sys
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Optional, Union

import numpy as np

from . import _metafmu

# hosts add up step sizes and convert units; in an FMU it is the same
_TOLERANCE = 1e-9
# columns of tables of runs, which no variable need have
_OF_TABLES = {"run", "time"}


@dataclass(frozen=True)
class Variable:
    """An input or output of a :class:`Surrogate`.

    - ``name``, ``unit``, ``description``: as in the FMU; the unit is ``""`` if none is known
    - ``min``, ``max``: range that the model was made for, in the unit
    - ``start``: value of an input unless the host sets one, None for outputs
    """

    name: str
    unit: str
    min: float
    max: float
    start: float | None = None
    description: str = ""


# names of variables, or units, ranges or keys of an interface by name
Names = Union[str, Sequence[Union[str, Variable]], Mapping[str, Any], None]
# by the name of a model's input: the output that is its next value, or a dict with the keys of docs/import.md
States = Optional[Mapping[str, Any]]


def rows_of(x, names, what="X"):
    """Rows of an array-like, or of a DataFrame or dict with columns of these names, as an array of doubles of shape (rows, columns).

    Raises :class:`metafmu.Error` if they do not fit.
    """
    columns = columns_by_name(x, what)
    if columns is not None:
        refuse_missing(what, "column", names, columns)
        x = stacked(columns, names, what)
    x = numbers_of(x, what)
    if x.ndim == 1 and len(names) > 1:
        hint = f"expected rows of {len(names)} columns: for a single row, {what}[None, :]"
        raise _metafmu.Error(f"{what} has the shape {x.shape}, {hint}")
    if x.ndim == 1:
        x = x[:, None]
    if x.ndim != 2 or x.shape[1] != len(names):
        raise _metafmu.Error(f"{what} has the shape {x.shape}, expected (rows, {len(names)}): {', '.join(names[:20])}")
    return np.ascontiguousarray(x)


def columns_by_name(x, what):
    """Columns of a DataFrame or dict by name; None for anything else. Raises :class:`metafmu.Error` if two have the same name."""
    if not is_frame(x) and not isinstance(x, Mapping):
        return None
    keys = list(x.columns) if is_frame(x) else list(x)
    names = [str(key) for key in keys]
    if twice := [name for place, name in enumerate(names) if name in names[:place]]:
        raise _metafmu.Error(f"{what}: found the column `{twice[0]}` twice, expected each name once")
    return {name: x[key] for name, key in zip(names, keys)}


def stacked(columns, names, what, count=None):
    """Columns of these names as an array of doubles of shape (rows, columns); a number is the value of all rows.

    ``count``: number of rows, that of the longest column if None. Raises :class:`metafmu.Error` if they have different lengths.
    """
    values = [numbers_of(columns[name], f"{what}: `{name}`") for name in names]
    lengths = {value.shape for value in values if value.ndim}
    if count is None and (len(lengths) > 1 or any(len(shape) != 1 for shape in lengths)):
        shapes = ", ".join(f"`{name}` {value.shape}" for name, value in zip(names, values))
        raise _metafmu.Error(f"{what}: {shapes}, expected as many numbers of each")
    if count is not None and (wrong := [f"`{name}` {value.shape}" for name, value in zip(names, values) if value.shape not in ((), (1,), (count,))]):
        raise _metafmu.Error(f"{what}: {wrong[0]}, expected a number or {count}, one for each time")
    if count is None:
        count = next((shape[0] for shape in lengths), 1)
    return np.column_stack([np.broadcast_to(value, (count,)) for value in values]) if values else np.empty((count, 0))


def refuse_missing(what, kind, wanted, known):
    """Raises :class:`metafmu.Error` with all wanted names that are not known, each with the closest known one that nothing wants."""
    if problem := _metafmu.missing(kind, list(wanted), [str(name) for name in known]):
        raise _metafmu.Error(f"{what}: {problem}")


def is_frame(x):
    """Returns True for a DataFrame."""
    return hasattr(x, "columns") and hasattr(x, "__getitem__")


def numbers_of(x, what):
    """An array-like as an array of doubles. Raises :class:`metafmu.Error` if it holds anything but real numbers."""
    try:
        found = np.asarray(x.detach().cpu() if hasattr(x, "detach") else x)
        # of objects, what they are
        found = found.tolist() if found.dtype.kind in "OSU" else found
        kind = np.asarray(found).dtype
        if kind.kind in "cmM":
            raise TypeError(f"{kind}")
        numbers = np.asarray(found, dtype=np.float64)
        return np.ascontiguousarray(numbers).reshape(numbers.shape)
    except (TypeError, ValueError, RuntimeError) as error:
        raise _metafmu.Error(f"{what}: {error}, expected real numbers") from error


def data_rows(data, names, columns):
    """Rows of training data, for variables of these names.

    Columns of a DataFrame are found by the model's names for its columns or by the names of the variables. A DataFrame with other names and
    as many columns is used in its order.
    """
    if not is_frame(data):
        if isinstance(data, Mapping):
            raise _metafmu.Error("data is a dict, expected an array or a DataFrame")
        return rows_of(data, names, "data")
    there = [str(column) for column in data.columns]
    found = [wanted for wanted in (columns, names) if set(wanted) <= set(there)]
    if len(found) == 2 and columns != names:
        raise _metafmu.Error(f"data has the columns {', '.join(columns[:20])} and {', '.join(names[:20])}, expected those of the model or those of `inputs`")
    if found:
        return rows_of(data, found[0], "data")
    for wanted in (columns, names):
        # some of the names: the others are misspelled
        if not set(there).isdisjoint(wanted):
            refuse_missing("data", "column", wanted, there)
    if len(there) == len(names) and set(there).isdisjoint([*columns, *names]):
        for what, wanted in (("the model's columns", columns), ("`inputs`", names)):
            if problem := _metafmu.out_of_order(("`data`", there), (what, wanted)):
                raise _metafmu.Error(problem)
        return rows_of(data, there, "data")
    expected = " or ".join(dict.fromkeys(", ".join(wanted[:20]) for wanted in (columns, names)))
    raise _metafmu.Error(f"data has the columns {', '.join(there[:20])}, expected all of {expected}, or other names for all columns in their order")


class Surrogate:
    """A model with named inputs and outputs, their units and ranges, which can be exported as an FMU.

    Created by :func:`metafmu.from_torch`, :func:`metafmu.from_sklearn` and the other readers, :func:`metafmu.fit`, :meth:`Study.build`, or
    :meth:`Surrogate.load`.

    >>> surrogate = metafmu.Surrogate.load("model.safetensors")
    >>> y = surrogate.predict(X)                                # shape (rows, outputs)
    >>> dy = surrogate.jacobian(X)                              # shape (rows, outputs, inputs)
    >>> surrogate.export("model.fmu", fmi="both")
    """

    def __init__(self, core, accuracy=None, fit=None):
        self._core = core
        self._metadata = json.loads(core.metadata())
        # predicted standard deviations follow them
        self._predictions = [item for item in self._metadata["outputs"] if "std_of" not in item]
        # what was measured last, as the model card has it
        self._accuracy = accuracy
        # kind of model and candidates of a fit
        self._fit = fit

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Surrogate:
        """Reads a model file (``.safetensors``), or the model inside an FMU made by metafmu (``.fmu``).

        Raises :class:`metafmu.Error` for a missing or damaged file, and for an FMU that metafmu did not make.
        """
        return cls(_metafmu.Surrogate.load(os.fspath(path)))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a model file, which :meth:`Surrogate.load` reads if its name ends in ``.safetensors``.

        Raises :class:`metafmu.Error` if the file cannot be written.
        """
        self._core.save(os.fspath(path))

    @property
    def name(self) -> str:
        """Name of the surrogate, also of the FMU's model."""
        return self._metadata["name"]

    @property
    def content_digest(self) -> str:
        """SHA-256 of the whole model: surrogates with equal digests are identical."""
        return self._metadata["provenance"]["content_digest"]

    @property
    def inputs(self) -> list[Variable]:
        """The inputs, in the order of the columns of ``X``."""
        keys = ("name", "unit", "min", "max", "start", "description")
        return [Variable(**{key: item[key] for key in keys}) for item in self._metadata["inputs"]]

    @property
    def outputs(self) -> list[Variable]:
        """The outputs, in the order of the columns of a prediction. Predicted standard deviations, which are outputs of the FMU, are not
        among them."""
        keys = ("name", "unit", "min", "max", "description")
        return [Variable(**{key: item[key] for key in keys}) for item in self._predictions]

    def _rows(self, x):
        self._core.stateless()
        return self._used(x, [item["name"] for item in self._metadata["inputs"]], "X")

    def _used(self, x, names, what):
        """Rows of these columns. A warning lists columns of a DataFrame or dict that mean nothing to the surrogate."""
        rows = rows_of(x, names, what)
        known = {item["name"] for item in (*self._metadata["inputs"], *self._metadata["outputs"])} | _OF_TABLES
        if unused := [name for name in columns_by_name(x, what) or () if name not in known]:
            _warn(f"{what}: found columns that are not used: {', '.join(unused[:20])}")
        return rows

    def predict(self, X: Any, return_std: bool = False) -> Any:
        """Predicts outputs of shape (rows, outputs), in double precision, on all cores.

        ``X``: rows of the inputs, as an array, or a DataFrame or dict with a column for each input; a number in a dict is the value of all
        rows. Columns of outputs, ``run`` and ``time`` are ignored, and a warning lists other columns that are not used. ``return_std``: also
        return the predicted standard deviations, of the same shape, of a surrogate fitted with ``std=True``.

        Raises :class:`metafmu.Error` for missing columns and for text or dates among numbers, for surrogates with states (see
        :meth:`Surrogate.simulate`), and with ``return_std`` if the surrogate predicts no standard deviations.
        """
        rows, predictions = self._rows(X), len(self._predictions)
        if return_std and not self.has_std:
            raise _metafmu.Error(f"`{self.name}` has no predicted standard deviation, expected a Gaussian process that was fitted with std=True")
        values = np.frombuffer(self._core.predict(rows.tobytes()), dtype=np.float64)
        values = values.reshape(len(rows), len(self._metadata["outputs"]))
        found = values[:, :predictions]
        return (found, values[:, predictions:]) if return_std else found

    @property
    def has_std(self) -> bool:
        """True if each output has a predicted standard deviation."""
        return len(self._metadata["outputs"]) > len(self._predictions)

    def jacobian(self, X: Any) -> np.ndarray:
        """Derivatives of each output by each input, of shape (rows, outputs, inputs): exact but for rounding.

        They have the unit of the output divided by that of the input. ``X`` and errors: see :meth:`Surrogate.predict`.
        """
        rows = self._rows(X)
        values = np.frombuffer(self._core.jacobian(rows.tobytes()), dtype=np.float64)
        values = values.reshape(len(rows), len(self._metadata["outputs"]), rows.shape[1])
        return values[:, : len(self._predictions)]

    def domain_distance(self, X: Any) -> np.ndarray:
        """Distance of each row from the domain of validity, of shape (rows,), relative to the ranges of the inputs: 0 inside, as the FMU's
        output of the same name. ``X`` and errors: see :meth:`Surrogate.predict`."""
        return np.frombuffer(self._core.domain_distance(self._rows(X).tobytes()), dtype=np.float64)

    def in_domain(self, X: Any) -> np.ndarray:
        """True for each row in the domain of validity, of shape (rows,): in the ranges of the inputs and, if the model was made with its
        training data, near some of them. ``X`` and errors: see :meth:`Surrogate.predict`."""
        return self.domain_distance(X) <= _TOLERANCE

    def evaluate(self, X: Any, y: Any) -> dict[str, dict[str, float | None]]:
        """Measures errors of predictions on given rows. Returns a dict for each output, from which `pandas.DataFrame` makes a table.

        ``X``: rows of the inputs; ``y``: outputs of the original model there, an array, DataFrame or dict. Both must be unseen in training: on
        training rows the figures are too optimistic.

        The keys of the dicts are

        - ``r2``: coefficient of determination, None if ``y`` is constant
        - ``rmse``: root mean square error
        - ``max_error``: largest error
        - ``worst_row``: row of the largest error
        - ``relative_max_error``: largest error as a share of the range of ``y``
        - ``within_two_std``: share of the rows within two predicted standard deviations, if the model predicts them

        ``rmse`` and ``max_error`` have the unit of the output. FMUs that are exported afterwards show the figures in their model card.

        Raises :class:`metafmu.Error` if ``X`` and ``y`` have different numbers of rows, none, or a number that is not finite.

        >>> surrogate.evaluate(X_test, y_test)["force"]["r2"]
        """
        x = self._rows(X)
        y = self._used(y, [item["name"] for item in self._predictions], "y")
        if len(x) != len(y) or not len(x):
            raise _metafmu.Error(f"X has {len(x)} rows and y {len(y)}, expected as many, at least one")
        for what, rows in (("X", x), ("y", y)):
            if not np.isfinite(rows).all():
                row = int(np.argwhere(~np.isfinite(rows))[0, 0])
                raise _metafmu.Error(f"{what} has a number that is not finite in row {row}")
        self._accuracy = json.loads(self._core.evaluate(x.tobytes(), y.tobytes()))
        return self.accuracy or {}

    @property
    def accuracy(self) -> dict[str, dict[str, float | None]] | None:
        """Result of the last :meth:`evaluate`. None if nothing was measured.

        After :func:`metafmu.fit` it is the accuracy on rows that were used neither to fit nor to choose the model or the best epoch. For few
        rows it is that of cross-validation.
        """
        if self._accuracy is None:
            return None
        figures = {}
        for name, of in self._accuracy["outputs"].items():
            figures[name] = {"r2": of["r2"], "rmse": math.sqrt(of["mse"]), "max_error": of["max_abs_error"], "relative_max_error": of.get("relative_max_error")}
            if of.get("within_two_std") is not None:
                figures[name]["within_two_std"] = of["within_two_std"]
            if self._accuracy["rows"] == "given":
                figures[name]["worst_row"] = of["worst_run"]
        return figures

    @property
    def model(self) -> str | None:
        """Kind of model after :func:`metafmu.fit`: ``"network"``, ``"gaussian-process"`` and so on. None for other surrogates, and after
        loading from a file."""
        return self._fit["model"] if self._fit else None

    @property
    def candidates(self) -> list[dict[str, Any]]:
        """Kinds of model that :func:`metafmu.fit` compared, a dict for each. Empty where `model` is None.

        The keys are ``model``, ``one_minus_r2`` (the mean over outputs of 1 - R² on rows that it was not fitted to, or None),
        ``fit_seconds`` (processor seconds of all its fits) and ``note``.
        """
        return [dict(row) for row in self._fit["candidates"]] if self._fit else []

    @property
    def sample_time(self) -> float | None:
        """Time between two samples of a discrete-time surrogate, in seconds; None for other surrogates."""
        return self._core.sample_time()

    def simulate(self, time: Any, inputs: Any = None, parameters: Mapping[str, float] | None = None, history: Any = None) -> np.ndarray:
        """Simulates a surrogate with states from the first of the times on; returns outputs of shape (times, outputs).

        ``time``: ascending, in seconds. ``inputs``: input signals at these times, of shape (times, inputs), or a DataFrame or dict with a
        column for each. They are linear between the times; a discrete-time surrogate holds them from sample to sample. ``parameters``:
        numbers by name, also the ``..._start`` of states; parameters that are not given keep their start values.

        ``history``: measurements before the first of the times, for a discrete-time surrogate. They are rows of inputs and outputs, of
        shape (rows, inputs + outputs), or a DataFrame or dict with a column for each. Rows are :attr:`sample_time` apart, and the last one
        is that long before the first of the times. Measured outputs replace the predicted ones; the result has no rows for them.

        A DataFrame or dict may also have parameters, which are constant, and ``time``, which is checked. Columns that are missing and columns
        that the simulation does not use, such as outputs, are errors that list all of them.

        Raises :class:`metafmu.Error` for surrogates without states, times that do not ascend, unknown or missing names, parameters with two
        values, wrong shapes and numbers that are not finite.

        >>> t = numpy.linspace(0.0, 10.0, 1001)
        >>> y = surrogate.simulate(t, {"torque": numpy.sin(t)}, {"angle_start": 0.5})
        >>> y = surrogate.simulate(t, {"torque": numpy.sin(t)}, history=frame[["torque", "angle"]])
        """
        self._core.stateful()
        time = numbers_of(time, "time")
        if time.ndim != 1 or not len(time) or not np.isfinite(time).all() or not (np.diff(time) > 0.0).all():
            raise _metafmu.Error(f"time has the shape {time.shape}, expected ascending numbers, at least one")
        items = self._metadata["inputs"]
        driven = [item["name"] for item in items if item["role"]["causality"] == "input"]
        constants = {item["name"]: item["start"] for item in items if item["role"]["causality"] != "input"}
        outputs = [item["name"] for item in self._metadata["outputs"]]
        if not isinstance(parameters or {}, Mapping):
            raise _metafmu.Error(f"parameters: {parameters!r}, expected a dict of numbers by name")
        refuse_missing("parameters", "parameter", parameters or {}, constants)
        given = {"parameters": {name: _parameter(name, value) for name, value in (parameters or {}).items()}}
        signals, past = columns_by_name(inputs, "inputs"), columns_by_name(history, "history")
        if signals is not None:
            self._refuse_misfits(signals, driven, "inputs")
        given["inputs"] = _constants(signals or {}, constants, "inputs", len(time))
        if driven and inputs is None:
            raise _metafmu.Error(f"no inputs, expected a column for each of {', '.join(driven)}")
        if not driven and inputs is not None and signals is None:
            raise _metafmu.Error(f"inputs: found {type(inputs).__name__}, expected None: `{self.name}` has no inputs")
        rows = _driving(inputs, driven, len(time)) if driven else np.empty((len(time), 0))
        if "time" in (signals or {}):
            _check_times(signals["time"], time)
        measured = np.empty((0, 0))
        if history is not None:
            if self.sample_time is None:
                raise _metafmu.Error(f"`{self.name}` has no past samples, expected a discrete-time surrogate: `parameters` has the states at the start")
            if past is not None:
                self._refuse_misfits(past, driven + outputs, "history")
            before, earlier = self._past(history, driven + outputs, time[0])
            given["history"] = _constants(past or {}, constants, "history")
            time, rows = np.concatenate([before, time - time[0]]), np.concatenate([earlier[:, : len(driven)], rows])
            measured = np.ascontiguousarray(earlier[:, len(driven) :])
        constants |= _merged(given)
        values = self._core.simulate(time.tobytes(), rows.tobytes(), list(constants.values()), measured.tobytes())
        return np.frombuffer(values, dtype=np.float64).reshape(len(time), len(outputs))[len(measured) :]

    def _refuse_misfits(self, columns, signals, what):
        """Raises :class:`metafmu.Error` with all columns that are missing, or that a simulation does not use.

        ``signals``: names whose values change in time.
        """
        constants = [item["name"] for item in self._metadata["inputs"] if item["role"]["causality"] != "input"]
        outputs = {item["name"] for item in self._metadata["outputs"]}
        used = [*signals, *constants, "time"]
        problems = []
        if computed := [f"`{name}`" for name in columns if name in outputs and name not in used]:
            measured = "" if self.sample_time is None else "; outputs measured before the first of `time` belong in `history`"
            problems.append(f"found columns of outputs, {', '.join(computed[:20])}, which the simulation computes: leave them out{measured}")
        missing = _metafmu.missing("column", list(signals), list(columns))
        # columns of another name are among those that a missing one is expected among
        if missing := missing or _metafmu.missing("variable", [name for name in columns if name not in outputs or name in used], used):
            problems.append(missing)
        if problems:
            raise _metafmu.Error(f"{what}: {'; '.join(problems)}")

    def _past(self, history, names, start):
        """Times before the start, relative to it, and the rows of a history with columns of these names."""
        step = self.sample_time
        columns = columns_by_name(history, "history")
        if columns is not None and "time" in columns:
            past, stamps = np.split(stacked(columns, [*names, "time"], "history"), [len(names)], axis=1)
            stamps = stamps[:, 0]
        else:
            past, stamps = rows_of(history, names, "history"), None
        if not np.isfinite(past).all():
            raise _metafmu.Error(f"history has a number that is not finite in row {int(np.argwhere(~np.isfinite(past))[0, 0])}")
        before = -step * np.arange(len(past), 0, -1.0)
        # the millionth of a sample time by which a communication point may miss a sample
        if stamps is not None and len(wrong := np.flatnonzero(~(np.abs(stamps - start - before) <= 1e-6 * step))):
            row = int(wrong[0])
            expected = f"expected {start + before[row]:.12g} s: rows are {step:.12g} s apart, the last one that long before the first of `time`"
            raise _metafmu.Error(f"history: `time` is {stamps[row]:.12g} s in row {row}, {expected}")
        return before, past

    def export(
        self,
        path: str | os.PathLike[str],
        fmi: str = "2",
        sources: bool = False,
        platforms: str | Iterable[str] | None = None,
        interface: str = "study",
        ports: str | Iterable[str] = (),
        names: str = "study",
    ) -> list[Path]:
        """Writes FMUs and returns their paths.

        ``path``: the FMU, or a folder for ``NAME.fmu``. ``fmi``: ``"2"``, ``"3"`` or ``"both"``; for both, the FMU of FMI 3.0 is in the
        same folder, with ``-fmi3`` in its name. ``sources``: also C99 source code, for targets without a binary. ``platforms``: tuples like
        ``"x86_64-linux"``; by default all that the package has.

        ``interface``: ``"study"``, or ``"plain"`` for an FMU without the variables that metafmu adds. ``ports``: which of these are inputs
        and outputs that hosts can wire, of ``"domain"``, ``"bounds"`` and ``"measured"``; else they are local variables or absent.
        ``names``: ``"study"``, or ``"flat"`` for names without dots and brackets.

        Raises :class:`metafmu.Error` for a name that does not end in ``.fmu``, an unknown version or platform, a port that the FMU cannot
        have, and a file that cannot be written.
        """
        path = Path(path)
        if path.is_dir():
            path = path / f"{self.name}.fmu"
        if path.suffix != ".fmu":
            raise _metafmu.Error(f"{path}: expected a file that ends in .fmu, or a folder")
        platforms = _names(platforms, "platforms", "tuples like \"x86_64-linux\"")
        ports = _names(ports, "ports", "some of \"domain\", \"bounds\" and \"measured\"")
        accuracy = None if self._accuracy is None else json.dumps(self._accuracy)
        written = self._core.export(path, str(fmi), (bool(sources), platforms), (str(interface), ports, str(names)), accuracy)
        return [Path(fmu) for fmu in written]

    def to_onnx(self, path: str | os.PathLike[str]) -> None:
        """Writes an ONNX model of the same function, with an input and an output of shape (rows, columns).

        Raises :class:`metafmu.Error` for surrogates with states, and if the file cannot be written.
        """
        self._core.to_onnx(os.fspath(path))

    def __reduce__(self):
        return _from_bytes, (self._core.to_bytes(), self._accuracy, self._fit)

    def __eq__(self, other):
        return isinstance(other, Surrogate) and self.content_digest == other.content_digest

    def __hash__(self):
        return hash(self.content_digest)

    def __repr__(self):
        names = lambda items: ", ".join(item["name"] for item in items[:6]) + (", ..." if len(items) > 6 else "")
        return f"Surrogate({self.name!r}: {names(self._metadata['inputs'])} -> {names(self._metadata['outputs'])})"


def _names(names, option, expected):
    """One name or several as a list."""
    names = [names] if isinstance(names, str) else names or []
    if not isinstance(names, Iterable):
        raise _metafmu.Error(f"{option}: {names!r}, expected {expected}")
    return [str(name) for name in names]


def _driving(inputs, names, count):
    """Inputs at each time, of shape (times, inputs)."""
    columns = columns_by_name(inputs, "inputs")
    if columns is not None:
        inputs = stacked(columns, names, "inputs", count)
    rows = rows_of(inputs, names, "inputs")
    if len(rows) != count:
        raise _metafmu.Error(f"inputs has {len(rows)} rows, expected {count}, one for each time")
    if not np.isfinite(rows).all():
        raise _metafmu.Error("inputs has numbers that are not finite")
    return rows


def _check_times(column, time):
    """Raises :class:`metafmu.Error` if a column of the inputs has other times than the simulation."""
    found = numbers_of(column, "inputs: `time`")
    if found.shape != time.shape:
        raise _metafmu.Error(f"inputs: `time` {found.shape}, expected {time.shape}, the times of the simulation")
    # a step apart from rounding
    if len(wrong := np.flatnonzero(~(np.abs(found - time) <= _TOLERANCE * np.abs(time).max()))):
        row = int(wrong[0])
        raise _metafmu.Error(f"inputs: `time` is {found[row]:.12g} s in row {row}, expected {time[row]:.12g} s, that of the argument `time`")


def _parameter(name, value):
    given = numbers_of(value, f"parameter `{name}`")
    if given.ndim or not math.isfinite(given):
        raise _metafmu.Error(f"parameter `{name}`: {value}, expected a finite number")
    return float(given)


def _constants(columns, names, what, count=None):
    """Values of the parameters among some columns, which must be constant. ``count``: number of rows, as in :func:`stacked`."""
    found = {}
    for name in names:
        if name in columns and len(values := np.unique(stacked(columns, [name], what, count))):
            if len(values) > 1 or not np.isfinite(values).all():
                shown = ", ".join(f"{value:.12g}" for value in values[:3]) + (", ..." if len(values) > 3 else "")
                raise _metafmu.Error(f"{what}: found the values {shown} of the parameter `{name}`, expected one finite value in a run")
            found[name] = float(values[0])
    return found


def _merged(given):
    """Parameters of several arguments. Raises :class:`metafmu.Error` if one has two values."""
    found = {}
    for what, values in given.items():
        for name, value in values.items():
            earlier = next((other for other in given if name in given[other]), what)
            if given[earlier][name] != value:
                raise _metafmu.Error(f"parameter `{name}`: found {given[earlier][name]:.12g} in `{earlier}` and {value:.12g} in `{what}`, expected one value")
            found[name] = value
    return found


def _warn(message):
    """A warning at the line of the caller of this package."""
    frame, level = sys._getframe(), 1
    while frame.f_back and os.path.dirname(frame.f_code.co_filename) == os.path.dirname(__file__):
        frame, level = frame.f_back, level + 1
    warnings.warn(message, UserWarning, stacklevel=level)


def _from_bytes(data, accuracy=None, fit=None):
    return Surrogate(_metafmu.Surrogate.from_bytes(data), accuracy, fit)
