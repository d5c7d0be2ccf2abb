"""A function as a sequence of steps: the result of the readers of third-party models."""

from __future__ import annotations

import hashlib

import numpy as np

from . import _metafmu
from ._interface import as_bytes, interface
from ._surrogate import Surrogate


class Graph:
    """A graph of some input columns. Each method adds a step and returns the number of its value, a vector. Value 0 is the inputs.

    >>> graph = metafmu.Graph(2)
    >>> hidden = graph.elementwise(graph.affine(0, [[1.0, 2.0], [3.0, 4.0]], [0.0, 1.0]), "tanh")
    >>> y = graph.affine(hidden, [[0.5, -0.5]])
    >>> surrogate = graph.finish(y, inputs={"a": (0, 1), "b": (0, 1)}, outputs=["y"])

    Derivatives are exact. A chain of dense layers becomes a network, which is evaluated fastest.
    """

    FUNCTIONS = tuple(_metafmu.FUNCTIONS)

    def __init__(self, inputs):
        self._core = _metafmu.Graph(int(inputs))
        # rows of the inputs that the surrogate was made with
        self.rows = None
        # whether a part of the model that is read computes in single precision
        self.is_single = False
        self._content = hashlib.sha256(str(inputs).encode())

    def width(self, value):
        """Length of a value."""
        return self._core.width(value)

    def _note(self, what, *parts):
        self._content.update(what.encode())
        for part in parts:
            self._content.update(part if isinstance(part, bytes) else repr(part).encode())

    def affine(self, of, weight, bias=None):
        """``W x + b``, ``weight`` of shape (outputs, inputs); single precision is kept if both arrays have it."""
        weight = np.asarray(weight)
        bias = np.zeros(len(weight), dtype=weight.dtype) if bias is None else np.asarray(bias)
        width = self.width(of)
        if weight.ndim != 2 or weight.shape[1] != width or bias.shape != weight.shape[:1]:
            raise _metafmu.Error(f"a weight of shape {weight.shape} and a bias of shape {bias.shape} for {width} columns")
        single = weight.dtype == np.float32 and bias.dtype == np.float32
        kind = np.float32 if single else np.float64
        weight, bias = (np.ascontiguousarray(array, dtype=kind).tobytes() for array in (weight, bias))
        self._note("affine", of, weight, bias)
        return self._core.affine(of, weight, bias, bool(single))

    def surrogate(self, of, surrogate):
        """Outputs of a surrogate without states at a value with a number for each of its inputs."""
        self._note("surrogate", of, surrogate.content_digest)
        return self._core.surrogate(of, surrogate._core)

    def elementwise(self, of, function, *parameters):
        """Applies a function, one of ``Graph.FUNCTIONS``, to each number. Each parameter is a number, or an array with one for each number
        of the value."""
        parameters = [np.asarray(parameter, dtype=np.float64) for parameter in parameters]
        if any(parameter.ndim for parameter in parameters):
            width = self.width(of)
            parameters = [np.broadcast_to(parameter.ravel() if parameter.ndim else parameter, (width,)) for parameter in parameters]
        flat = [float(number) for parameter in parameters for number in parameter.ravel()]
        self._note(function, of, flat)
        return self._core.elementwise(of, function, flat)

    def linear(self, of, factor=1.0, offset=0.0):
        """``a x + b``, number by number."""
        return self.elementwise(of, "linear", factor, offset)

    def combine(self, first, second, operation):
        """Combines two values number by number: add, subtract, multiply, divide, maximum, minimum. A value of length 1 is repeated."""
        widths = self.width(first), self.width(second)
        if widths[0] != widths[1] and 1 in widths:
            if widths[0] == 1:
                first = self.columns([(first, 0)] * widths[1])
            else:
                second = self.columns([(second, 0)] * widths[0])
        self._note(operation, first, second)
        return self._core.combine(first, second, operation)

    def choose(self, condition, chosen, otherwise):
        """Numbers of one value where a condition is positive, else of another one; all three have the same length."""
        self._note("choose", condition, chosen, otherwise)
        return self._core.choose(condition, chosen, otherwise)

    def columns(self, columns):
        """Numbers of values: pairs of a value and a position in it."""
        columns = [[int(value), int(place)] for value, place in columns]
        self._note("columns", columns)
        return self._core.columns(columns)

    def select(self, of, places):
        """Some numbers of a value, by position."""
        return self.columns([(of, place) for place in places])

    def concatenate(self, values):
        """Several values as one."""
        values = list(values)
        if len(values) == 1:
            return values[0]
        return self.columns([(value, place) for value in values for place in range(self.width(value))])

    def constant(self, numbers):
        """Numbers that depend on no input."""
        numbers = np.atleast_1d(np.asarray(numbers, dtype=np.float64))
        return self.elementwise(self.columns([(0, 0)] * len(numbers)), "linear", np.zeros(len(numbers)), numbers)

    def standardise(self, of, epsilon):
        """Subtracts the mean of all numbers and divides by the square root of their variance plus ``epsilon``."""
        self._note("standardise", of, epsilon)
        return self._core.standardise(of, float(epsilon))

    def softmax(self, of):
        """``exp(x_i) / sum(exp(x))``"""
        self._note("softmax", of)
        return self._core.softmax(of)

    def distances(self, of, centres, lengths=1.0):
        """Squared distances from rows of ``centres``, each column divided by its length."""
        centres = np.ascontiguousarray(centres, dtype=np.float64)
        lengths = np.broadcast_to(np.asarray(lengths, dtype=np.float64), (self.width(of),)).tolist()
        self._note("distances", of, centres.tobytes(), lengths)
        return self._core.distances(of, centres.tobytes(), lengths)

    def forest(self, of, trees, outputs=1):
        """Sums of decision trees.

        ``trees``: dicts of ``left``, ``right``, ``column`` (negative at a leaf), ``number`` (threshold, or what the leaf adds) and
        ``output``; inputs up to the threshold go left.
        """
        columns, numbers, below, roots = [], [], [], []
        for tree in trees:
            first = sum(map(len, columns))
            column, number = np.asarray(tree["column"], dtype=np.int64), np.asarray(tree["number"], dtype=np.float64)
            left, right = np.asarray(tree["left"]), np.asarray(tree["right"])
            leaf = column < 0
            columns.append(np.where(leaf, -1, column))
            numbers.append(number)
            below.append(np.where(leaf[:, None], 0, np.stack([left, right], axis=1) + first))
            roots.append([first, int(tree.get("output", 0))])
        columns, numbers, below = np.concatenate(columns), np.concatenate(numbers), np.concatenate(below)
        self._note("forest", of, columns.tobytes(), numbers.tobytes(), below.tobytes(), roots, outputs)
        return self._core.forest(of, columns.tolist(), numbers.tobytes(), below.tolist(), roots, int(outputs))

    def evaluate(self, value, rows):
        """Numbers of a value at rows of the inputs, of shape (rows, numbers)."""
        rows = np.ascontiguousarray(rows, dtype=np.float64)
        columns = [[value, place] for place in range(self.width(value))]
        return np.frombuffer(self._core.evaluate(columns, rows.tobytes()), dtype=np.float64).reshape(len(rows), -1)

    def _finish(self, value, described, single, producer, names=None):
        """Surrogate with a value as its outputs. ``described``: text and rows of its interface; ``names``: names of the input and output
        columns of a model with states."""
        text, self.rows = described
        places = [[value, place] for place in range(self.width(value))]
        described = places, text, as_bytes(self.rows), self._content.digest(), bool(single), producer
        return Surrogate(self._core.finish(*described) if names is None else self._core.finish_with_states(*described, names))

    def finish(self, value, *, inputs=None, outputs=None, data=None, name="surrogate", description="", step=0.01, stop=1.0, domain="data", producer="",
               single=False, input_names=None, output_names=None):
        """Returns the :class:`Surrogate` whose outputs are a value.

        ``inputs``, ``outputs``: names, or dicts of names to units, ranges or dicts with the keys of an interface file. ``data``: rows of
        the inputs, whose ranges are used where ``inputs`` has none. ``single``: compute a network in single precision. ``step``, ``stop``:
        step and stop time of a simulation, unless the host sets others.
        """
        described = interface(
            self.width(0), self.width(value), inputs=inputs, outputs=outputs, data=data, name=name, description=description, step=step, stop=stop, domain=domain,
            input_names=input_names, output_names=output_names,
        )
        return self._finish(value, described, single, producer)
