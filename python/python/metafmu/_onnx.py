"""ONNX files."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from . import _metafmu
from ._interface import check_keys, interface, number
from ._surrogate import Names, Surrogate

_STATE_KEYS = ("column", "next", "derivative", "start", "min", "max", "unit", "description")


def from_onnx(
    model: Any,
    inputs: Names = None,
    outputs: Names = None,
    data: Any = None,
    *,
    states: Mapping[str, Any] | None = None,
    sample: float | None = None,
    solver_step: float | None = None,
    name: str | None = None,
    description: str = "",
    step: float | None = None,
    stop: float = 1.0,
    domain: str = "data",
) -> Surrogate:
    """The surrogate of an ONNX model: a path, bytes, or what `onnx.load` gives.

    ``inputs``, ``outputs``: as of :func:`metafmu.from_sklearn`, in the order of the model's columns, whose names they have unless given;
    ``data``: rows that it was trained on, for the ranges and the domain of validity.

    >>> metafmu.from_onnx("net.onnx", inputs={"x": (-1, 1)}, outputs=["y"]).export("net.fmu")

    ``states``: inputs of the model that follow from its outputs, each with what is its next value a ``sample`` time (in seconds) later, or a
    dict with the keys of docs/import.md: ``next`` or ``derivative``, ``start``, ``column``, ``min``, ``max``, ``unit``, ``description``.
    What is left are inputs and outputs; if no output is left, the states are. An LSTM that is exported with its states in and out:

    >>> metafmu.from_onnx("cell.onnx", inputs={"torque": (-50, 50)}, states={"h0": "h1", "c0": "c1"}, sample=0.01).export("cell.fmu")

    and a neural ODE, whose FMU is for model exchange, too, with ``solver_step`` as its longest step:

    >>> metafmu.from_onnx("ode.onnx", inputs={"u": (-2, 2)}, states={"x": {"derivative": "dx", "start": 0.5}}).export("ode.fmu")

    Raises :class:`metafmu.Error` with the nodes that do not fit.
    """
    folder, title = None, "model"
    if hasattr(model, "SerializeToString"):
        content = model.SerializeToString()
    elif isinstance(model, (bytes, bytearray, memoryview)):
        content = bytes(model)
    else:
        path = Path(os.fspath(model))
        content, folder, title = path.read_bytes(), path.parent, path.stem
    columns, results = _metafmu.onnx_columns(content, folder)
    if not isinstance(states or {}, Mapping):
        raise _metafmu.Error(f"states: {states!r}, expected a dict: {{\"INPUT\": \"OUTPUT\", ...}}")
    of_states = {name: _state(name, about) for name, about in (states or {}).items()}
    shown = columns
    columns = _without(columns, [about["column"] for about in of_states.values()])
    results = _without(results, [about.get("next", about.get("derivative", "")) for about in of_states.values()])
    if outputs is None and not results and of_states:
        # a model that only tells how its states go on shows them
        outputs = {column: {"column": column} for column in shown if column not in columns}
    text, rows = interface(
        len(columns), len(results), inputs=inputs, outputs=outputs, data=data, name=name or title, description=description,
        step=0.01 if step is None and sample is None else step, stop=stop, domain=domain,
        input_names=None if data is not None and hasattr(data, "columns") else columns, output_names=results, states=of_states, sample=sample,
        solver_step=solver_step, named=True,
    )
    return Surrogate(_metafmu.from_onnx(content, folder, text, rows))


def _state(name, about):
    """The entry of a state, from its next value or a dict."""
    what = f"state `{name}`"
    about = {"next": about} if isinstance(about, str) else about
    if not isinstance(about, Mapping):
        raise _metafmu.Error(f"{what}: {about!r}, expected the output that is its next value, or a dict")
    check_keys(about, _STATE_KEYS, what)
    about = {"column": name, "start": 0.0, **about}
    return about | {key: number(about[key], f"{what}: {key}") for key in ("start", "min", "max") if key in about}


def _without(columns, taken):
    """Columns that are none of those taken, which are columns or stand for all columns of an input or output."""
    return [column for column in columns if column not in taken and column.split("[")[0] not in taken]
