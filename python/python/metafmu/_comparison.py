"""What a surrogate predicts, beside what the model predicts that it was read from."""

from __future__ import annotations

import numpy as np

from . import _metafmu
from ._surrogate import rows_of

_ROWS = 64
#: Largest differences, relative to the largest number of an output. Rounding of each precision is far below, also that of ill-conditioned
#: models, and what was read wrongly is far above.
SINGLE, DOUBLE = 1e-4, 1e-8


def some_rows(surrogate, data):
    """Rows of the data, or points in the ranges of the inputs, of shape (rows, inputs)."""
    names = [item.name for item in surrogate.inputs]
    if data is not None:
        rows = rows_of(data, names, "data")
        return rows[:: -(-len(rows) // _ROWS)]
    low, high = ([getattr(item, side) for item in surrogate.inputs] for side in ("min", "max"))
    return np.random.default_rng(0).uniform(low, high, (_ROWS, len(names)))


def compare(rows, found, what, predict, tolerance):
    """Raises :class:`metafmu.Error` if what was found at rows of the inputs, of shape (rows, outputs), is something else than the model, ``what``,
    predicts: a part of it was read wrongly, or its rows depend on each other, or on chance."""
    expected = np.asarray(predict(rows), dtype=np.float64).reshape(len(rows), -1)
    if expected.shape != found.shape:
        raise _metafmu.Error(f"{what} has {expected.shape[1]} outputs, and what was read of it {found.shape[1]}")
    size = np.abs(np.where(np.isfinite(expected), expected, 0.0)).max(axis=0)
    scale = np.maximum(size, 1e-3 * size.max()) + np.finfo(np.float64).tiny
    with np.errstate(invalid="ignore"):
        difference = np.abs(found - expected) / scale
        is_same = (difference <= tolerance) | (found == expected) | (np.isnan(found) & np.isnan(expected))
    # a few rows may lie on the other side of a threshold, by rounding
    wrong = ~is_same.all(axis=1)
    if wrong.mean() > 0.05:
        largest = np.nanmax(difference[wrong], initial=0.0)
        raise _metafmu.Error(
            f"{what} was read wrongly: predictions differ by {largest:.1e} of the largest one; a part of it does something else in this version, or with these "
            "options, or its rows depend on each other, or on chance; an export to ONNX and from_onnx may help"
        )


def finished(graph, value, what, predict, tolerance, named, about):
    """The surrogate of a graph, after a look at what the model predicts. ``named``: names of the model's columns, those of its inputs and its
    outputs; ``about``: as of :meth:`Graph.finish`, or with states of :meth:`Graph.finish_with_states`."""
    if about.get("states") is None:
        surrogate = graph.finish(value, **about)
        rows = some_rows(surrogate, about["data"])
        compare(rows, surrogate.predict(rows), what, predict, tolerance)
        return surrogate
    # where the states will be is not known
    rows = np.random.default_rng(0).uniform(-1.0, 1.0, (_ROWS, graph.width(0)))
    compare(rows, graph.evaluate(value, rows), what, predict, tolerance)
    return graph.finish_with_states(value, *named, **about)
