"""Tensors of one row during the tracing of a model: a value of the graph, and its shape."""

from __future__ import annotations

import numpy as np

from . import _metafmu

Error = _metafmu.Error


class OperationError(Error):
    """An error of an operation of a model, which its message names."""


class Row:
    """A tensor whose elements, row by row, are a value of a graph. The batch is a dimension of length 1."""

    # numpy asks this before it takes a row for a sequence
    __array_priority__ = 1000

    def __init__(self, graph, value, shape):
        self.graph, self.value, self.shape = graph, value, tuple(int(length) for length in shape)

    @property
    def ndim(self):
        return len(self.shape)

    @property
    def size(self):
        return int(np.prod(self.shape, dtype=np.int64))

    def index(self):
        """The places of the elements, in the shape of the tensor: what moves elements is done with it."""
        return np.arange(self.size).reshape(self.shape)

    def take(self, index):
        """The tensor of some elements."""
        index = np.asarray(index)
        places = index.ravel()
        if len(places) == self.size and np.array_equal(places, np.arange(self.size)):
            return Row(self.graph, self.value, index.shape)
        if not len(places):
            raise Error("a tensor without elements, expected at least one")
        return Row(self.graph, self.graph.select(self.value, places), index.shape)

    def broadcast(self, shape):
        return self if self.shape == tuple(shape) else self.take(np.broadcast_to(self.index(), shape))

    def map(self, function, *parameters):
        """A function of each element; parameters are numbers or arrays that broadcast."""
        parameters = [p if np.ndim(p) == 0 else np.broadcast_to(np.asarray(p, dtype=np.float64), self.shape).ravel() for p in parameters]
        return Row(self.graph, self.graph.elementwise(self.value, function, *parameters), self.shape)

    def linear(self, factor=1.0, offset=0.0):
        shape = np.broadcast_shapes(self.shape, np.shape(factor), np.shape(offset))
        return self.broadcast(shape).map("linear", factor, offset)

    def affine(self, weight, bias=None):
        """`W x + b` of the last dimension, `weight` of shape (outputs, inputs)."""
        weight = np.asarray(weight)
        outputs, inputs = weight.shape
        if self.shape[-1] != inputs:
            raise Error(f"a weight for {inputs} columns and a tensor with {self.shape[-1]}: expected as many")
        return self._each(inputs, outputs, lambda value: self.graph.affine(value, weight, bias))

    def _each(self, inputs, outputs, step):
        """Does something with each vector of the last dimension."""
        count = self.size // inputs
        if count == 1:
            value = step(self.value)
        else:
            parts = [self.graph.select(self.value, range(place * inputs, (place + 1) * inputs)) for place in range(count)]
            value = self.graph.concatenate([step(part) for part in parts])
        return Row(self.graph, value, self.shape[:-1] + (outputs,))

    def matrix(self, weight, shape):
        """A linear function of all elements: `weight` of shape (outputs, elements)."""
        return Row(self.graph, self.graph.affine(self.value, weight), shape)

    def standardize(self, dimensions, epsilon):
        """Minus the mean over the last dimensions, over the root of the variance."""
        length = int(np.prod(self.shape[self.ndim - dimensions :], dtype=np.int64))
        flat = Row(self.graph, self.value, (self.size // length, length))
        return Row(self.graph, flat._each(length, length, lambda value: self.graph.standardize(value, epsilon)).value, self.shape)

    def softmax(self, axis):
        moved = np.moveaxis(self.index(), axis, -1)
        row = self.take(moved)
        done = row._each(row.shape[-1], row.shape[-1], self.graph.softmax)
        return done.take(np.moveaxis(done.index(), -1, axis))

    def reduce(self, axes, keep, mean=False):
        """Sums or means over some dimensions."""
        axes = tuple(range(self.ndim)) if axes is None else tuple(np.atleast_1d(axes))
        basis = np.eye(self.size).reshape((self.size,) + self.shape)
        along = tuple(axis % self.ndim + 1 for axis in axes)
        sums = (basis.mean if mean else basis.sum)(axis=along, keepdims=bool(keep))
        return self.matrix(sums.reshape(self.size, -1).T, sums.shape[1:])


def is_row(x):
    return isinstance(x, Row)


def constant(graph, array):
    array = np.asarray(array, dtype=np.float64)
    return Row(graph, graph.constant(array.ravel()), array.shape)


def binary(operation, a, b):
    """Two tensors element by element, of which at least one is a row: add, subtract, multiply, divide, maximum, minimum, power."""
    if is_row(a) and is_row(b):
        if operation == "power":
            # of positive bases
            return binary("multiply", a.map("log"), b).map("exp")
        shape = np.broadcast_shapes(a.shape, b.shape)
        a, b = a.broadcast(shape), b.broadcast(shape)
        return Row(a.graph, a.graph.combine(a.value, b.value, operation), shape)
    other = b if is_row(a) else a
    if other is None:
        raise Error("None, expected a tensor or a number")
    number = np.asarray(other, dtype=np.float64)
    row, first = (a, True) if is_row(a) else (b, False)
    if operation == "add":
        return row.linear(1.0, number)
    if operation == "subtract":
        return row.linear(1.0, -number) if first else row.linear(-1.0, number)
    if operation == "multiply":
        return row.linear(number)
    if operation == "divide":
        return row.linear(1.0 / number) if first else row.map("reciprocal").linear(number)
    if operation == "power":
        if first:
            if number.size == 1 and float(number.ravel()[0]) == 0.5:
                return row.map("power", 0.5)
            shape = np.broadcast_shapes(row.shape, number.shape)
            return row.broadcast(shape).map("power", number)
        return row.linear(np.log(number)).map("exp")
    other = constant(row.graph, np.broadcast_to(number, np.broadcast_shapes(row.shape, number.shape)))
    return binary(operation, row, other)


def compared(name, first, second):
    """gt, ge, lt or le of two tensors, of which at least one is a row: 1 where it is true, else 0."""
    # a >= b unless b > a
    if name in ("gt", "le"):
        above = binary("subtract", first, second).map("positive")
    else:
        above = binary("subtract", second, first).map("positive")
    return above.linear(-1.0, 1.0) if name in ("ge", "le") else above


def choose(mask, chosen, otherwise):
    """Elements of one or the other tensor, by a mask from :func:`compared`; elements that are not chosen may be NaN."""
    graph = mask.graph
    parts = [mask, *(part if is_row(part) else constant(graph, part) for part in (chosen, otherwise))]
    shape = np.broadcast_shapes(*(part.shape for part in parts))
    return Row(graph, graph.choose(*(part.broadcast(shape).value for part in parts)), shape)


def extreme(row, axes, operation, keep=False):
    """The largest or smallest number along some dimensions."""
    axes = tuple(range(row.ndim)) if axes is None else tuple(axis % row.ndim for axis in np.atleast_1d(axes))
    kept = [axis for axis in range(row.ndim) if axis not in axes]
    index = row.index().transpose(*kept, *axes).reshape(*(row.shape[axis] for axis in kept), -1)
    result = row.take(index[..., 0])
    for place in range(1, index.shape[-1]):
        result = binary(operation, result, row.take(index[..., place]))
    if keep:
        result = result.take(result.index().reshape([1 if axis in axes else length for axis, length in enumerate(row.shape)]))
    return result


def concatenate(parts, axis, stack=False):
    """Tensors as one, along a dimension; arrays may be among them."""
    graph = next(part.graph for part in parts if is_row(part))
    parts = [part if is_row(part) else constant(graph, part) for part in parts]
    offsets = np.cumsum([0] + [part.size for part in parts[:-1]])
    index = [part.index() + offset for part, offset in zip(parts, offsets)]
    index = np.stack(index, axis) if stack else np.concatenate(index, axis)
    value = graph.concatenate([part.value for part in parts])
    return Row(graph, value, (sum(part.size for part in parts),)).take(index)


def outputs_of(result):
    """The value of a model's result: a row, or several of them, also by name."""
    if is_row(result):
        return result.graph, result.value
    if isinstance(result, dict):
        result = list(result.values())
    if isinstance(result, (tuple, list)) and result and all(is_row(part) for part in result):
        graph = result[0].graph
        return graph, graph.concatenate([part.value for part in result])
    raise Error(f"the result is {type(result).__name__}, expected a tensor that depends on the inputs, or several")


def names_of(results):
    """Names of the columns of a model's result: those of a dict, else `output`, or `output0` and so on of several."""
    if is_row(results):
        results = {"output": results}
    elif not isinstance(results, dict):
        results = {f"output{place}": part for place, part in enumerate(results)} if len(results) > 1 else {"output": results[0]}
    return [column for name, part in results.items() for column in columns_of(str(name), part.size)]


def columns_of_arguments(arguments, sizes, are_known=True):
    """Names of the columns of arguments, and the names that a model knows: the same ones, but None for a single argument with several
    columns, whose name does not identify them."""
    names = [column for name, size in zip(arguments, sizes) for column in columns_of(name, size)]
    return names, names if are_known and (len(sizes) > 1 or sizes[0] == 1) else None


def columns_of(name, count):
    """Names of the columns of an input or output, as those of ONNX models."""
    return [name] if count == 1 else [f"{name}[{place}]" for place in range(count)]


# functions of one number that are made of others


def compose(row, name):
    """A function composed of others; None if it is unknown."""
    made = {
        "sqrt": lambda: row.map("power", 0.5),
        "rsqrt": lambda: row.map("power", -0.5),
        "square": lambda: row.map("power", 2.0),
        "neg": lambda: row.linear(-1.0),
        "tan": lambda: binary("divide", row.map("sin"), row.map("cos")),
        "sinh": lambda: binary("subtract", row.map("exp"), row.linear(-1.0).map("exp")).linear(0.5),
        "cosh": lambda: binary("add", row.map("exp"), row.linear(-1.0).map("exp")).linear(0.5),
        "log1p": lambda: row.linear(1.0, 1.0).map("log"),
        "expm1": lambda: row.map("exp").linear(1.0, -1.0),
        "log2": lambda: row.map("log").linear(1.0 / np.log(2.0)),
        "log10": lambda: row.map("log").linear(1.0 / np.log(10.0)),
        "exp2": lambda: row.linear(np.log(2.0)).map("exp"),
        "erfc": lambda: row.map("erf").linear(-1.0, 1.0),
        "log_sigmoid": lambda: row.linear(-1.0).map("softplus").linear(-1.0),
        "selu": lambda: row.map("elu", 1.6732632423543772).linear(1.0507009873554805),
        "relu6": lambda: row.map("clip", 0.0, 6.0),
        # of Keras and PyTorch: relu6(x + 3) / 6
        "hard_sigmoid": lambda: row.linear(1.0, 3.0).map("clip", 0.0, 6.0).linear(1.0 / 6.0),
        "hard_swish": lambda: binary("multiply", row, compose(row, "hard_sigmoid")),
        "mish": lambda: binary("multiply", row, row.map("softplus").map("tanh")),
        "tanhshrink": lambda: binary("subtract", row, row.map("tanh")),
    }.get(name)
    if made is not None:
        return made()
    return row.map(name) if name in row.graph.FUNCTIONS else None
