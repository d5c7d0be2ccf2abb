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


def compare(surrogate, data, what, predict, tolerance):
    """Raises :class:`metafmu.Error` if a surrogate predicts something else than the model, ``what``, in some rows: a part of it was read
    wrongly, or its rows depend on each other, or on chance.

    ``predict``: the model's outputs at rows of its inputs, of shape (rows, outputs).
    """
    rows = some_rows(surrogate, data)
    expected, found = np.asarray(predict(rows), dtype=np.float64), surrogate.predict(rows)
    expected = expected.reshape(len(rows), -1)
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
