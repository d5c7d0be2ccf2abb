"""Arguments of all readers of models, and the surrogate of a graph that they have read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from . import _metafmu
from ._comparison import FEW, Readings, compare, drawn_rows, ranges_of, some_rows
from ._interface import interface, interface_of_columns
from ._rows import names_of, outputs_of
from ._surrogate import Names, States, is_frame


@dataclass
class ReaderOptions:
    """Arguments of all readers."""

    inputs: Names
    outputs: Names
    data: Any
    states: States
    sample: float | None
    solver_step: float | None
    name: str | None
    description: str
    step: float | None
    stop: float
    domain: str

    def __post_init__(self):
        """Takes rows in the place of the inputs' names for the data: converters of other packages have them there."""
        if is_frame(self.inputs) or getattr(self.inputs, "ndim", None) == 2:
            if self.data is not None:
                raise _metafmu.Error("inputs: a table of rows, as `data` is; expected names, or a dict of names to units, ranges or dicts")
            self.inputs, self.data = None, self.inputs

    def of_interface(self, title):
        """Arguments of an interface. ``title``: name of the model, used unless another one is given."""
        step = 0.01 if self.step is None and self.sample is None else self.step
        return {**vars(self), "name": self.name or title, "step": step}


def surrogate_of(graph, made, options, title, *, what, predict, precision, columns, producer, single=False):
    """Surrogate of a graph, whose predictions are compared with those of the model.

    ``made``: result of the model, an argument of :func:`outputs_of`. ``title``, ``what``: name of the model, and its name in errors.
    ``predict``: maps rows to its predictions. ``columns``: names of its input columns, and the names that it has itself or None.
    ``single``: it computes in single precision.
    """
    _, value = outputs_of(made)
    (names, known), results, about = columns, names_of(made), options.of_interface(title)
    if not options.states:
        if options.sample is not None:
            raise _metafmu.Error(f"sample: {options.sample!r} without `states`, expected both or none")
        shape = graph.width(0), graph.width(value)
        described = interface(*shape, **about, input_names=known, output_names=results if isinstance(made, dict) else None)
        surrogate = graph._finish(value, described, single, producer)
        compare(some_rows(surrogate, graph.rows), Readings(surrogate.predict, graph._rounded(value)), what, predict, precision)
        return surrogate
    described = interface_of_columns(names, results, **about)
    drawn = drawn_rows(*ranges_of(names, *described))
    compare((drawn[:0], drawn), Readings(lambda rows: graph.evaluate(value, rows), graph._rounded(value)), what, predict, precision)
    _refuse_frozen_time(graph, value, names, options.inputs, drawn[:FEW])
    return graph._finish(value, described, single, producer, (names, results))


def _refuse_frozen_time(graph, value, columns, inputs, rows):
    """Raises if the time has a value: it would be constant."""
    for place, name in enumerate(columns):
        given = inputs.get(name) if isinstance(inputs, dict) else None
        if name in ("t", "time") and isinstance(given, dict) and "value" in given:
            later = rows.copy()
            later[:, place] += 1.0
            if not np.array_equal(graph.evaluate(value, rows), graph.evaluate(value, later), equal_nan=True):
                raise _metafmu.Error(
                    f"input `{name}` has a value, but what the states follow from depends on it: expected a state whose derivative is 1, or a right side without the time"
                )
