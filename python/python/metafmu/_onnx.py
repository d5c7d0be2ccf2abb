"""ONNX files."""

from __future__ import annotations

import json
import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from . import _metafmu
from ._comparison import DOUBLE, SINGLE, Readings, compare, drawn_rows, ranges_of, some_rows
from ._interface import as_bytes, interface_of_columns
from ._reader import ReaderOptions
from ._surrogate import Names, States, Surrogate


# attributes of operators are in single precision only: here they are the decimal that was meant, in onnxruntime what it was rounded to
_DOUBLE = DOUBLE._replace(share=1e-5)


def from_onnx(
    model: Any, inputs: Names = None, outputs: Names = None, data: Any = None, *, states: States = None, sample: float | None = None,
    solver_step: float | None = None, name: str | None = None, description: str = "", step: float | None = None, stop: float = 1.0, domain: str = "data",
) -> Surrogate:
    """Returns the :class:`Surrogate` of an ONNX model: a path, bytes, or a model loaded by `onnx.load`.

    The arguments are those of :func:`metafmu.from_torch`.

    >>> metafmu.from_onnx("net.onnx", inputs={"x": (-1, 1)}, outputs=["y"]).export("net.fmu")

    ``states``: inputs of the model that follow from its outputs. Each is mapped to the output that is its next value, a ``sample`` time (in
    seconds) later, or to a dict with the keys of docs/import.md. These are ``next`` or ``derivative``, ``start``, ``column``, ``min``,
    ``max``, ``unit``, ``description``. The remaining inputs and outputs are those of the surrogate; if no output remains, the states are
    its outputs. An LSTM exported with its states as inputs and outputs:

    >>> metafmu.from_onnx("cell.onnx", inputs={"torque": (-50, 50)}, states={"h0": "h1", "c0": "c1"}, sample=0.01).export("cell.fmu")

    A neural ODE, whose FMU supports model exchange as well, with ``solver_step`` as its longest step:

    >>> metafmu.from_onnx("ode.onnx", inputs={"u": (-2, 2)}, states={"x": {"derivative": "dx", "start": 0.5}}).export("ode.fmu")

    If onnxruntime is installed, it evaluates the model at some rows of ``data`` and at points in the ranges. Predictions that differ are an
    error.

    Raises :class:`metafmu.Error` with the nodes that are not supported.
    """
    options = ReaderOptions(inputs, outputs, data, states, sample, solver_step, name, description, step, stop, domain)
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
    text, rows = interface_of_columns(columns, results, **options.of_interface(title))
    surrogate = Surrogate(_metafmu.from_onnx(content, folder, text, as_bytes(rows)))
    _compare(surrogate, model if folder is not None else content, (content, folder), (columns, results), text, rows)
    return surrogate


def _compare(surrogate, source, model, names, text, rows):
    """Raises :class:`metafmu.Error` if onnxruntime, where it is installed, computes different outputs.

    ``source``: the model's path or bytes; ``names``: names of its input and output columns.
    """
    try:
        import onnxruntime
    except ImportError:
        return
    columns, results = names
    about = json.loads(text)
    entries = [*about["inputs"].values(), *about["outputs"].values()]
    in_order = not about["states"] and not any("column" in entry or "value" in entry for entry in entries)
    evaluated = lambda x, *rounding: np.frombuffer(_metafmu.onnx_evaluate(*model, x.tobytes(), rounding or None)).reshape(len(x), -1)
    if in_order and (len(surrogate.inputs), len(surrogate.outputs)) == (len(columns), len(results)):
        points, found = some_rows(surrogate, rows), surrogate.predict
    else:
        drawn = drawn_rows(*ranges_of(columns, text, rows))
        points, found = (drawn[:0], drawn), evaluated
    try:
        predict, precision = _by_onnxruntime(onnxruntime, source, len(columns))
        predict(points[1][:1])
    except Exception as error:  # onnxruntime has no base class of errors
        warnings.warn(f"the model was not compared with onnxruntime, which does not run it: {error}", stacklevel=3)
        return
    compare(points, Readings(found, evaluated), "the ONNX model", predict, precision, "")


def _by_onnxruntime(onnxruntime, source, count):
    """Outputs by onnxruntime for rows of ``count`` columns, and the precision of the model."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.log_severity_level = 1, 4
    session = onnxruntime.InferenceSession(os.fspath(source) if not isinstance(source, bytes) else source, options, providers=["CPUExecutionProvider"])
    kinds = {"tensor(float)": np.float32, "tensor(double)": np.float64}
    # of one row: what is free has the length 1
    shapes = [[length if isinstance(length, int) and length > 0 else 1 for length in given.shape] for given in session.get_inputs()]
    ends = np.cumsum([int(np.prod(shape)) for shape in shapes])
    if ends[-1] != count:
        raise ValueError(f"it has {ends[-1]} columns of inputs, expected {count}")

    def of_row(row):
        parts = np.split(row, ends[:-1])
        given = {given.name: part.reshape(shape).astype(kinds[given.type]) for given, part, shape in zip(session.get_inputs(), parts, shapes)}
        return np.concatenate([np.ravel(output).astype(np.float64) for output in session.run(None, given)])

    is_double = all(port.type == "tensor(double)" for port in (*session.get_inputs(), *session.get_outputs()))
    return lambda rows: np.stack([of_row(row) for row in rows]), _DOUBLE if is_double else SINGLE
