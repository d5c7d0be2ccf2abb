"""Comparison of a surrogate's predictions with those of its source model."""

from __future__ import annotations

import json
from typing import NamedTuple

import numpy as np

from . import _metafmu

#: Rows of a first comparison, and further ones.
FEW, _MORE = 32, 512


class Precision(NamedTuple):
    """Relative rounding error of a number type, and largest difference of predictions as a share of their spread.

    Differences by rounding are below this share, even in ill-conditioned models; differences of a model that was read wrongly are above.
    """

    epsilon: float
    share: float

    @classmethod
    def of(cls, name):
        """By the name of a type in numpy or PyTorch; unknown types get that of float32."""
        known = {"float64": cls(2.2e-16, 1e-8), "float32": SINGLE, "float16": cls(9.8e-4, 0.03), "bfloat16": cls(7.8e-3, 0.1)}
        return known.get(str(name).rsplit(".", 1)[-1], SINGLE)


SINGLE = Precision(1.2e-7, 1e-4)
DOUBLE = Precision.of("float64")


def drawn_rows(low, high):
    """Random points in ranges, of shape (rows, inputs), identical in each call."""
    return np.random.default_rng(0).uniform(low, high, (FEW + _MORE, len(low)))


def some_rows(surrogate, rows):
    """Some of the rows that the surrogate was made with, unless they are None, and random points in the ranges of the inputs: two arrays of
    shape (rows, inputs)."""
    low, high = ([getattr(item, side) for item in surrogate.inputs] for side in ("min", "max"))
    rows = np.empty((0, len(low))) if rows is None else rows
    return rows[:: max(1, -(-len(rows) // FEW))], drawn_rows(low, high)


_ONNX_MAY_HELP = "; an export to ONNX and from_onnx may help"


def compare(rows, found, what, predict, precision, advice=_ONNX_MAY_HELP):
    """Raises :class:`metafmu.Error` if a surrogate and its source model ``what`` predict different outputs.

    Reasons are a part of the model that was read wrongly, rows that depend on each other, and random predictions. ``found`` and ``predict``
    map rows of the inputs to outputs of the surrogate and of the model, of shape (rows, outputs).

    ``rows``: known rows, and random points.
    """
    known, drawn = rows
    first = np.concatenate([known, drawn[:FEW]])
    wrong, difference = _different(first, found, what, predict, precision)
    # some of the known ones may lie on a threshold; whether points that were drawn do is a matter of more of them
    count = wrong[len(known) :].sum()
    if count and len(drawn) > FEW:
        more, _ = _different(drawn[FEW:], found, what, predict, precision)
        count = count if more.mean() > 0.01 else 0
    if count or wrong.mean() > 0.05:
        raise _metafmu.Error(
            f"{what} was read wrongly: predictions differ by {difference:.1e} of their spread; a part of it does something else in this version, or with these "
            f"options, or its rows depend on each other, or on chance{advice}"
        )


def _different(rows, found, what, predict, precision):
    """Mask of the rows that differ, and the largest difference."""
    try:
        expected = np.asarray(predict(rows), dtype=np.float64).reshape(len(rows), -1)
    except _metafmu.Error:
        raise
    except Exception as error:
        raise _metafmu.Error(f"{what} does not predict rows of inputs: {type(error).__name__}: {error}") from error
    results = found(rows)
    if expected.shape != results.shape:
        raise _metafmu.Error(f"{what} has {expected.shape[1]} outputs, and what was read of it {results.shape[1]}")
    finite = np.isfinite(expected).all(axis=1)
    if not finite.any():
        raise _metafmu.Error(f"{what} predicts no finite numbers in {len(rows)} rows: the ranges, or `data`, lead where it is not defined")
    some = expected[finite]
    allowed = 32.0 * precision.epsilon * np.abs(some).max(axis=0) + precision.share * np.ptp(some, axis=0)
    with np.errstate(invalid="ignore"):
        difference = np.abs(results[finite] - some)
        wrong = np.zeros(len(rows), dtype=bool)
        wrong[finite] = ~(difference <= allowed).all(axis=1)
    spread = np.maximum(np.ptp(some, axis=0), np.abs(some).max(axis=0) * 1e-3) + np.finfo(np.float64).tiny
    return wrong, np.nanmax(difference / spread, initial=0.0)


def ranges_of(columns, text, rows):
    """Ends of the ranges from which columns of a model with states are drawn: those of the interface, of the data, or around the start."""
    about = json.loads(text)
    low, high = dict.fromkeys(columns, -1.0), dict.fromkeys(columns, 1.0)
    of = lambda column: [name for name in columns if column in (name, name.split("[")[0])]
    taken = set()
    for state in about["states"].values():
        around = max(1.0, 0.1 * abs(state["start"]))
        for name in of(state["column"]):
            low[name], high[name] = state.get("min", state["start"] - around), state.get("max", state["start"] + around)
            taken.add(name)
    left = [name for name in columns if name not in taken]
    variable = 0
    for place, given in enumerate(about["inputs"].values()):
        for name in of(given["column"]) if "column" in given else left[place : place + 1]:
            if "value" in given:
                low[name] = high[name] = given["value"]
                continue
            ends = (rows[:, variable].min(), rows[:, variable].max()) if rows is not None else (-1.0, 1.0)
            low[name], high[name] = given.get("min", ends[0]), given.get("max", ends[1])
        variable += "value" not in given
    return [[side[name] for name in columns] for side in (low, high)]
