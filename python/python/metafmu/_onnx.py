"""ONNX files."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from . import _metafmu
from ._interface import as_bytes, interface_of_columns
from ._surrogate import Names, Surrogate

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
        try:
            path = Path(os.fspath(model))
            content, folder, title = path.read_bytes(), path.parent, path.stem
        except (OSError, TypeError) as error:
            raise _metafmu.Error(f"{model}: {error}, expected an ONNX file, its bytes, or what onnx.load gives") from error
    columns, results = _metafmu.onnx_columns(content, folder)
    text, rows = interface_of_columns(
        columns, results, inputs=inputs, outputs=outputs, data=data, states=states, sample=sample, step=step, name=name or title, description=description,
        stop=stop, domain=domain, solver_step=solver_step,
    )
    return Surrogate(_metafmu.from_onnx(content, folder, text, as_bytes(rows)))

