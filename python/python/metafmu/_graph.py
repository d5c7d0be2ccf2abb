"""A function as a sequence of steps: the result of the readers of third-party models."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from . import _metafmu
from ._interface import as_bytes, interface
from ._surrogate import Names, Surrogate


class Graph:
    """A graph of steps from input columns to outputs. Each method adds a step and returns the number of its value, a vector. Value 0 is the
    vector of all inputs. ``inputs``: number of input columns.

    >>> graph = metafmu.Graph(2)
    >>> hidden = graph.elementwise(graph.affine(0, [[1.0, 2.0], [3.0, 4.0]], [0.0, 1.0]), "tanh")
    >>> y = graph.affine(hidden, [[0.5, -0.5]])
    >>> surrogate = graph.finish(y, inputs={"a": (0, 1), "b": (0, 1)}, outputs=["y"])

    Derivatives are exact. A chain of dense layers becomes a network, which is evaluated fastest. All methods raise
    :class:`metafmu.Error` for an unknown value and for lengths that do not match.
    """

    FUNCTIONS = tuple(_metafmu.FUNCTIONS)

    def __init__(self, inputs: int):
        self._core = _metafmu.Graph(int(inputs))
        # rows of the inputs that the surrogate was made with
        self.rows = None
        # whether a part of the model that is read computes in single precision
        self.is_single = False
        self._content = hashlib.sha256(str(inputs).encode())

    def width(self, value: int) -> int:
        """Length of a value."""
        return self._core.width(value)

    def _note(self, what, *parts):
        self._content.update(what.encode())
        for part in parts:
            self._content.update(part if isinstance(part, bytes) else repr(part).encode())

    def affine(self, of: int, weight: Any, bias: Any = None) -> int:
        """``W x + b``: ``weight`` has the shape (length of the result, length of ``of``), ``bias`` the length of the result, or is 0.

        Single precision is kept if both arrays have it.
        """
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

    def surrogate(self, of: int, surrogate: Surrogate) -> int:
        """Outputs of a surrogate without states at a value with a number for each of its inputs."""
        self._note("surrogate", of, surrogate.content_digest)
        return self._core.surrogate(of, surrogate._core)

    def elementwise(self, of: int, function: str, *parameters: Any) -> int:
        """Applies a function, one of ``Graph.FUNCTIONS``, to each number. Each parameter is a number, or an array with one for each number
        of the value. Raises :class:`metafmu.Error` for an unknown function, and for the wrong number of parameters."""
        parameters = [np.asarray(parameter, dtype=np.float64) for parameter in parameters]
        if any(parameter.ndim for parameter in parameters):
            width = self.width(of)
            parameters = [np.broadcast_to(parameter.ravel() if parameter.ndim else parameter, (width,)) for parameter in parameters]
        flat = [float(number) for parameter in parameters for number in parameter.ravel()]
        self._note(function, of, flat)
        return self._core.elementwise(of, function, flat)

    def linear(self, of: int, factor: Any = 1.0, offset: Any = 0.0) -> int:
        """``factor * x + offset``, number by number. Both are numbers, or arrays of the value's length."""
        return self.elementwise(of, "linear", factor, offset)

    def combine(self, first: int, second: int, operation: str) -> int:
        """Combines two values number by number. ``operation``: ``"add"``, ``"subtract"``, ``"multiply"``, ``"divide"``, ``"maximum"`` or
        ``"minimum"``. Both have the same length; a value of length 1 is repeated."""
        widths = self.width(first), self.width(second)
        if widths[0] != widths[1] and 1 in widths:
            if widths[0] == 1:
                first = self.columns([(first, 0)] * widths[1])
            else:
                second = self.columns([(second, 0)] * widths[0])
        self._note(operation, first, second)
        return self._core.combine(first, second, operation)

    def choose(self, condition: int, chosen: int, otherwise: int) -> int:
        """Numbers of one value where a condition is positive, else of another one; all three have the same length."""
        self._note("choose", condition, chosen, otherwise)
        return self._core.choose(condition, chosen, otherwise)

    def columns(self, columns: Iterable[tuple[int, int]]) -> int:
        """Numbers of several values, each given by a pair: the value, and the position in it from 0."""
        columns = [[int(value), int(place)] for value, place in columns]
        self._note("columns", columns)
        return self._core.columns(columns)

    def select(self, of: int, places: Iterable[int]) -> int:
        """Some numbers of a value, by position from 0."""
        return self.columns([(of, place) for place in places])

    def concatenate(self, values: Iterable[int]) -> int:
        """Several values one after the other, as one vector."""
        values = list(values)
        if len(values) == 1:
            return values[0]
        return self.columns([(value, place) for value in values for place in range(self.width(value))])

    def constant(self, numbers: Any) -> int:
        """Numbers that depend on no input: a number, or an array of one dimension."""
        numbers = np.atleast_1d(np.asarray(numbers, dtype=np.float64))
        return self.elementwise(self.columns([(0, 0)] * len(numbers)), "linear", np.zeros(len(numbers)), numbers)

    def standardize(self, of: int, epsilon: float) -> int:
        """Subtracts the mean of all numbers of a value and divides by ``sqrt(variance + epsilon)``, as a layer normalization does."""
        self._note("standardize", of, epsilon)
        return self._core.standardize(of, float(epsilon))

    def softmax(self, of: int) -> int:
        """Softmax over all numbers of a value, ``exp(x_i) / sum(exp(x))``."""
        self._note("softmax", of)
        return self._core.softmax(of)

    def distances(self, of: int, centres: Any, lengths: Any = 1.0) -> int:
        """Squared distances from centers, ``sum_j ((x_j - centres[i, j]) / lengths[j])**2``.

        ``centres``: shape (centers, length of ``of``); ``lengths``: a number, or one for each column.
        """
        centres = np.ascontiguousarray(centres, dtype=np.float64)
        lengths = np.broadcast_to(np.asarray(lengths, dtype=np.float64), (self.width(of),)).tolist()
        self._note("distances", of, centres.tobytes(), lengths)
        return self._core.distances(of, centres.tobytes(), lengths)

    def forest(self, of: int, trees: Iterable[Mapping[str, Any]], outputs: int = 1) -> int:
        """Sums of decision trees, a vector of ``outputs`` numbers.

        Each tree is a dict of arrays with a number for each node, the first node being the root:

        - ``column``: position of the number that is compared, negative at a leaf
        - ``number``: threshold; at a leaf the number that is added
        - ``left``, ``right``: next nodes, left if the number is at most the threshold
        - ``output``: position in the result, an integer instead of an array, 0 by default
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

    def evaluate(self, value: int, rows: Any) -> np.ndarray:
        """Numbers of a value at ``rows`` of the inputs, of shape (rows, inputs). The result has the shape (rows, length of the value)."""
        rows = np.ascontiguousarray(rows, dtype=np.float64)
        columns = [[value, place] for place in range(self.width(value))]
        return np.frombuffer(self._core.evaluate(columns, rows.tobytes()), dtype=np.float64).reshape(len(rows), -1)

    def _rounded(self, value):
        """Function of rows, sizes of rounding and a seed: numbers of a value with all values before it rounded at random."""
        columns = [[value, place] for place in range(self.width(value))]

        def at(rows, relative, absolute, seed):
            rows = np.ascontiguousarray(rows, dtype=np.float64)
            return np.frombuffer(self._core.rounded(columns, rows.tobytes(), (relative, absolute), seed)).reshape(len(rows), -1)

        return at

    def _finish(self, value, described, single, producer, names=None):
        """Surrogate with a value as its outputs. ``described``: text and rows of its interface; ``names``: names of the input and output
        columns of a model with states."""
        text, self.rows = described
        places = [[value, place] for place in range(self.width(value))]
        described = places, text, as_bytes(self.rows), self._content.digest(), bool(single), producer
        return Surrogate(self._core.finish(*described) if names is None else self._core.finish_with_states(*described, names))

    def finish(
        self, value: int, *, inputs: Names = None, outputs: Names = None, data: Any = None, name: str = "surrogate", description: str = "", step: float = 0.01,
        stop: float = 1.0, domain: str = "data", producer: str = "", single: bool = False, input_names: Sequence[str] | None = None,
        output_names: Sequence[str] | None = None,
    ) -> Surrogate:
        """Returns the :class:`Surrogate` whose outputs are a value.

        ``inputs``, ``outputs``: names, or dicts of names to units, ranges or dicts with the keys of an interface file. ``data``: rows of
        the inputs, whose ranges are used where ``inputs`` has none. ``domain``: ``"data"`` or ``"ranges"``, as for
        :func:`metafmu.from_torch`. ``single``: compute a network in single precision. ``step``, ``stop``: step and stop time of a
        simulation in seconds, unless the host sets others. ``producer``: tool that made the model, for the model card. ``input_names``,
        ``output_names``: names that the model has for its columns, used and matched as for the readers.

        Raises :class:`metafmu.Error` for inputs without a range, and for the wrong number of names.
        """
        described = interface(
            self.width(0), self.width(value), inputs=inputs, outputs=outputs, data=data, name=name, description=description, step=step, stop=stop, domain=domain,
            input_names=input_names, output_names=output_names,
        )
        return self._finish(value, described, single, producer)
