"""ONNX files."""

from __future__ import annotations

import os
from pathlib import Path

from . import _metafmu
from ._interface import interface
from ._surrogate import Surrogate


def from_onnx(model, inputs=None, outputs=None, data=None, *, name=None, description="", step=0.01, stop=1.0):
    """The surrogate of an ONNX model: a path, bytes, or what `onnx.load` gives.

    ``inputs``, ``outputs``: as of :func:`metafmu.from_sklearn`, in the order of the model's columns, whose names they have unless given;
    ``data``: rows that it was trained on, for the ranges.

    >>> metafmu.from_onnx("net.onnx", inputs={"x": (-1, 1)}, outputs=["y"]).export("net.fmu")

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
    text, rows = interface(
        len(columns), len(results), inputs=inputs, outputs=outputs, data=data, name=name or title, description=description, step=step,
        stop=stop, input_names=None if data is not None and hasattr(data, "columns") else columns, output_names=results,
    )
    return Surrogate(_metafmu.from_onnx(content, folder, text, rows))
