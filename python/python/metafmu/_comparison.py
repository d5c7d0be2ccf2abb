"""Comparison of a surrogate's predictions with those of its source model."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from . import _metafmu

#: Rows of a first comparison, and further ones.
FEW, _MORE = 32, 512
#: Number of random roundings of all values, and how many times their largest effect explains a difference: sums of many products round more often.
_ROUNDINGS, _SAFETY = 4, 8.0


class Precision(NamedTuple):
    """Number type of a model: relative rounding error, smallest positive normal number, and a share of the spread of predictions.

    Differences by rounding are below this share, except in ill-conditioned models: there :func:`compare` measures what rounding does.
    """

    epsilon: float
    smallest: float
    share: float

    @classmethod
    def of(cls, name):
        """By the name of a type in numpy or PyTorch; unknown types get that of float32."""
        known = {
            "float64": cls(2.2e-16, 2.3e-308, 1e-8),
            "float32": SINGLE,
            "float16": cls(9.8e-4, 6.2e-5, 0.03),
            "bfloat16": cls(7.8e-3, 1.2e-38, 0.1),
        }
        return known.get(str(name).rsplit(".", 1)[-1], SINGLE)


SINGLE = Precision(1.2e-7, 1.2e-38, 1e-4)
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


class Readings(NamedTuple):
    """Outputs of a surrogate for rows of the inputs, of shape (rows, outputs), as functions of the rows.

    ``rounded``: outputs with all values of the graph, the inputs among them, rounded at random, as a function of the rows, the relative and
    the absolute size of the rounding, and a seed.
    """

    exact: Callable
    rounded: Callable


def compare(rows, readings, what, predict, precision, advice=_ONNX_MAY_HELP):
    """Raises :class:`metafmu.Error` if a surrogate and its source model ``what`` predict different outputs, by more than rounding in the
    model's precision explains.

    Reasons are a part of the model that was read wrongly, rows that depend on each other, and random predictions. ``predict`` maps rows of
    the inputs to outputs of the model, of shape (rows, outputs).

    ``rows``: known rows, and random points.
    """
    known, drawn = rows
    first = np.concatenate([known, drawn[:FEW]])
    wrong, difference = _different(first, readings, what, predict, precision)
    # some of the known ones may lie on a threshold; whether points that were drawn do is a matter of more of them
    count = wrong[len(known) :].sum()
    if count and len(drawn) > FEW:
        more, _ = _different(drawn[FEW:], readings, what, predict, precision)
        count = count if more.mean() > 0.01 else 0
    if count or wrong.mean() > 0.05:
        raise _metafmu.Error(
            f"{what} was read wrongly: predictions differ by {difference}; a part of it does something else in this version, or with these "
            f"options, or its rows depend on each other, or on chance{advice}"
        )


def _different(rows, readings, what, predict, precision):
    """Mask of the rows that differ, and the size of the clearest difference as text, None if no row differs."""
    try:
        expected = np.asarray(predict(rows), dtype=np.float64).reshape(len(rows), -1)
    except _metafmu.Error:
        raise
    except Exception as error:
        raise _metafmu.Error(f"{what} does not predict rows of inputs: {type(error).__name__}: {error}") from error
    results = readings.exact(rows)
    if expected.shape != results.shape:
        raise _metafmu.Error(f"{what} has {expected.shape[1]} outputs, and what was read of it {results.shape[1]}")
    finite = np.isfinite(expected).all(axis=1)
    if not finite.any():
        raise _metafmu.Error(f"{what} predicts no finite numbers in {len(rows)} rows: the ranges, or `data`, lead where it is not defined")
    some, results = expected[finite], results[finite]
    spread = np.ptp(some, axis=0)
    allowed = np.broadcast_to(32.0 * precision.epsilon * np.abs(some).max(axis=0) + precision.share * spread, some.shape)
    wrong = np.zeros(len(rows), dtype=bool)
    with np.errstate(all="ignore"):
        difference = np.abs(results - some)
        if (difference <= allowed).all():
            return wrong, None
        allowed = allowed + _SAFETY * _rounding(rows[finite], readings, precision)
        exceeds = ~(difference <= allowed)
        wrong[finite] = exceeds.any(axis=1)
        if not exceeds.any():
            return wrong, None
        clear = np.where(exceeds, np.nan_to_num(difference / allowed, nan=np.inf, posinf=np.inf), 0.0)
    row, column = np.unravel_index(np.argmax(clear), clear.shape)
    return wrong, _described(difference[row, column], column, spread[column], np.abs(some[:, column]).max())


def _described(difference, column, spread, largest):
    """Size of a difference as text, relative to the spread of the output if it varies."""
    if not np.isfinite(difference):
        return f"NaN or infinity in output {column + 1}, where the model's are finite"
    if spread > 1e-3 * largest:
        return f"{difference / spread:.1e} of their spread"
    return f"{difference:.1e} in output {column + 1}, which hardly varies"


def _rounding(rows, readings, precision):
    """Largest effect of rounding on each output in each row: infinite where a rounded value has no result."""
    exact = readings.rounded(rows, 0.0, 0.0, 0)
    sizes = precision.epsilon, precision.smallest
    effects = [np.abs(readings.rounded(rows, *sizes, seed) - exact) for seed in range(_ROUNDINGS)]
    # no effect where there is no result without rounding: that is a difference
    return np.where(np.isfinite(exact), np.nan_to_num(np.max(effects, axis=0), nan=np.inf, posinf=np.inf), 0.0)


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
