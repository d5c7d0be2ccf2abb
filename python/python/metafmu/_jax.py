"""Functions of JAX, by their jaxpr: networks of Flax, Equinox or by hand."""

from __future__ import annotations

import inspect
from typing import Any, Callable

import numpy as np

from . import _metafmu
from ._graph import Graph
from ._needed import needed
from ._comparison import DOUBLE, Precision
from ._reader import ReaderOptions, surrogate_of
from ._rows import OperationError, Row, binary, choose, columns_of_arguments, compared, compose, concatenate, extreme, is_row
from ._surrogate import Names, States, Surrogate

Error = _metafmu.Error


def from_jax(
    model: Callable[..., Any], inputs: Names = None, outputs: Names = None, data: Any = None, *, example: Any, params: Any = None, states: States = None,
    sample: float | None = None, solver_step: float | None = None, name: str | None = None, description: str = "", step: float | None = None, stop: float = 1.0, domain: str = "data",
) -> Surrogate:
    """Returns the :class:`Surrogate` of a function of JAX.

    ``model(x)``, or ``model(params, x)`` if there are ``params``. ``example``: an array like ``x``, which is a single row of shape (n,) or
    a batch of shape (rows, n), or a tuple of arrays if there are several arguments. The other arguments are those of
    :func:`metafmu.from_torch`.

    >>> f = lambda params, x: jax.nn.tanh(x @ params["w"]) @ params["v"]
    >>> metafmu.from_jax(f, data=X, outputs=["y"], example=X[:1], params=params).export("f.fmu")

    The right-hand side of a differential equation has its states and inputs as arguments. A time among them has a value:

    >>> flow = lambda t, x, u: A @ x + B @ u
    >>> metafmu.from_jax(flow, inputs={"t": {"value": 0.0}, "u": (-2, 2)}, states={"x": {"derivative": "output"}}, example=(0.0, x, u))

    Raises :class:`metafmu.Error` with the unknown primitive.
    """
    jax = needed("jax", "from_jax")

    options = ReaderOptions(inputs, outputs, data, states, sample, solver_step, name, description, step, stop, domain)
    given = example if isinstance(example, tuple) else (example,)
    examples = [part if hasattr(part, "dtype") else np.asarray(part) for part in given]
    # a time is a number
    if wrong := [part for part in examples if part.ndim > 2 or part.ndim == 0 and len(examples) == 1]:
        raise Error(f"an example of the shape {wrong[0].shape}, expected (n,) or (rows, n)")
    examples = [part[:1] if part.ndim == 2 else part for part in examples]
    of_x = model if params is None else lambda *x: model(params, *x)
    title = name or getattr(model, "__name__", "function")
    try:
        closed, shape = jax.make_jaxpr(of_x, return_shape=True)(*examples)
    except Exception as error:
        raise Error(f"`{title}` cannot be followed by JAX: {type(error).__name__}: {error}; expected a function of arrays like the example") from error
    sizes = [int(np.prod(part.shape)) for part in examples]
    graph = Graph(sum(sizes))
    places = np.split(np.arange(sum(sizes)), np.cumsum(sizes[:-1]))
    rows = [Row(graph, 0, (sum(sizes),)).take(of.reshape(part.shape)) for of, part in zip(places, examples)]
    results = _follow(closed.jaxpr, closed.consts, rows)
    # what JAX makes of the examples: numbers of Python and numpy may lose precision
    kinds = {str(part.dtype) for part in (*closed.in_avals, *closed.out_avals, *map(np.asarray, closed.consts)) if "float" in str(part.dtype)}
    single = "float64" not in kinds
    precision = max(map(Precision.of, kinds), default=DOUBLE)

    def of_rows(rows):
        parts = np.split(rows, np.cumsum(sizes[:-1]), axis=1)
        if any(part.ndim < 2 for part in examples):
            one = lambda *x: jax.tree.leaves(of_x(*(part.reshape(like.shape) for part, like in zip(x, examples))))
            return [np.concatenate([np.ravel(part) for part in one(*row)]) for row in zip(*parts)]
        return np.concatenate([np.asarray(part).reshape(len(rows), -1) for part in jax.tree.leaves(of_x(*parts))], axis=1)

    def predict(rows):
        # in precision that matrices of small numbers have not everywhere
        with jax.default_matmul_precision("highest"):
            return of_rows(np.asarray(rows, dtype=np.float32 if single else np.float64))

    arguments = [name for name in inspect.signature(model).parameters][0 if params is None else 1 :]
    is_named = len(arguments) == len(examples)
    arguments = arguments if is_named else [f"x{place}" for place in range(len(examples))]
    # JAX has the entries of a dict in the order of their keys
    made = dict(zip(sorted(shape), results)) if isinstance(shape, dict) and len(shape) == len(results) else results if len(results) > 1 else results[0]
    columns = columns_of_arguments(arguments, sizes, is_named)
    return surrogate_of(graph, made, options, title, what=f"`{title}`", predict=predict, precision=precision, columns=columns, producer="JAX", single=single)


def _follow(jaxpr, consts, arguments):
    from jax.extend.core import Literal

    known = dict(zip(jaxpr.constvars, consts)) | dict(zip(jaxpr.invars, arguments))
    read = lambda atom: atom.val if isinstance(atom, Literal) else known[atom]
    for equation in jaxpr.eqns:
        operands = [read(atom) for atom in equation.invars]
        name = equation.primitive.name
        if not any(is_row(part) or isinstance(part, _Mask) for part in operands):
            results = equation.primitive.bind(*operands, **equation.params)
            results = results if equation.primitive.multiple_results else [results]
        else:
            try:
                results = _primitive(equation, name, operands)
            except OperationError:
                # of an inner function, whose operation it names
                raise
            except Error as error:
                raise OperationError(f"primitive `{name}`: {error}") from None
            except Exception as error:
                raise OperationError(f"primitive `{name}`, in a form that is not known: {type(error).__name__}: {error}") from error
        known.update(zip(equation.outvars, results))
    return [read(atom) for atom in jaxpr.outvars]


_BINARY = {"add": "add", "add_any": "add", "sub": "subtract", "mul": "multiply", "div": "divide", "max": "maximum", "min": "minimum", "pow": "power"}
_ONE = {
    "tanh": "tanh", "logistic": "sigmoid", "exp": "exp", "log": "log", "sin": "sin", "cos": "cos", "abs": "abs", "sqrt": "sqrt",
    "rsqrt": "rsqrt", "neg": "neg", "erf": "erf", "erfc": "erfc", "tan": "tan", "sinh": "sinh", "cosh": "cosh", "log1p": "log1p",
    "expm1": "expm1", "atan": "atan", "square": "square", "exp2": "exp2",
}
_MOVES = {"broadcast_in_dim", "reshape", "squeeze", "transpose", "slice", "rev", "expand_dims"}
_SAME = {"convert_element_type", "copy", "copy_p", "stop_gradient", "reduce_precision", "optimization_barrier"}
_CALLS = {"pjit": "jaxpr", "jit": "jaxpr", "custom_jvp_call": "call_jaxpr", "custom_vjp_call": "call_jaxpr", "custom_vjp_call_jaxpr": "fun_jaxpr",
          "closed_call": "call_jaxpr", "core_call": "call_jaxpr", "remat": "jaxpr", "checkpoint": "jaxpr", "remat2": "jaxpr"}
_LINEAR = {"reduce_sum", "cumsum"}


def _primitive(equation, name, operands):
    """The results of an equation of which at least one operand is a row."""
    params, x = equation.params, operands[0]
    if name in _CALLS:
        inner = params[_CALLS[name]]
        return _follow(getattr(inner, "jaxpr", inner), getattr(inner, "consts", ()), operands)
    if any(isinstance(part, _Mask) for part in operands) and name != "select_n":
        if name in _MOVES and x.row is not None:
            return [_Mask(_primitive(equation, name, [x.row])[0])]
        made = _of_masks(name, params, operands)
        if made is None:
            raise Error("of a comparison, expected a choice between two arrays by it, or numbers made of it")
        return [made]
    if name == "convert_element_type" and not np.issubdtype(params["new_dtype"], np.floating):
        raise Error(f"a conversion of inputs to {np.dtype(params['new_dtype'])}, expected numbers that are not rounded")
    if name in _SAME:
        return operands
    if name in ("max", "min") and any(not is_row(part) and np.all(np.asarray(part) == (-np.inf if name == "max" else np.inf)) for part in operands):
        return [next(part for part in operands if is_row(part))]
    if name in _BINARY:
        return [binary(_BINARY[name], *(part if is_row(part) else np.asarray(part) for part in operands))]
    if name in _ONE:
        return [compose(x, _ONE[name])]
    if name == "integer_pow":
        return [x.map("reciprocal") if params["y"] == -1 else x.map("power", float(params["y"]))]
    if name in _MOVES:
        index = equation.primitive.bind(np.asarray(x.index(), dtype=np.int32), **params)
        return [x.take(np.asarray(index))]
    if name == "concatenate":
        return [concatenate([part if is_row(part) else np.asarray(part) for part in operands], params["dimension"])]
    if name == "stack":
        return [concatenate([part if is_row(part) else np.asarray(part) for part in operands], params.get("axis", params.get("dimension", 0)), stack=True)]
    if name in ("reduce_max", "reduce_min"):
        return [extreme(x, params["axes"], "maximum" if name == "reduce_max" else "minimum")]
    if name == "split":
        index = equation.primitive.bind(np.asarray(x.index(), dtype=np.int32), **params)
        return [x.take(np.asarray(part)) for part in index]
    if name == "gather" and is_row(x) and not is_row(operands[1]):
        index = equation.primitive.bind(np.asarray(x.index(), dtype=np.int32), operands[1], **params)
        return [x.take(np.asarray(index))]
    if name == "clamp" and is_row(operands[1]) and not is_row(x) and not is_row(operands[2]):
        return [operands[1].map("clip", np.asarray(x), np.asarray(operands[2]))]
    if name == "dot_general":
        return [_product(equation, operands)]
    if name in _LINEAR:
        return [_of_basis(equation, operands, 0)]
    if name in ("gt", "ge", "lt", "le", "ne"):
        return [_compared(name, *operands)]
    if name == "select_n" and isinstance(x, _Mask) and len(operands) == 3:
        return [x.choose(operands[1], operands[2])]
    every = sorted({*_BINARY, *_ONE, *_MOVES, *_SAME, *_CALLS, *_LINEAR, "integer_pow", "concatenate", "stack", "reduce_max", "reduce_min", "split", "gather", "clamp",
                    "dot_general", "gt", "ge", "lt", "le", "select_n"})
    raise Error(f"not known, or not in this form; expected one of {', '.join(every)}")


def _product(equation, operands):
    if all(map(is_row, operands)):
        ((left, right), batch), (a, b) = equation.params["dimension_numbers"], operands
        if a.size == b.size and len(left) == a.ndim - len(batch[0]) == b.ndim - len(batch[1]) and a.shape == b.shape and left == right:
            return binary("multiply", a, b).reduce(left, False)
        raise Error("a product of two matrices that both depend on the inputs, expected one that is constant")
    return _of_basis(equation, operands, 0 if is_row(operands[0]) else 1)


def _of_basis(equation, operands, place):
    """An operation that is linear in an operand, from its results for each unit vector."""
    import jax

    row = operands[place]
    kind = equation.invars[place].aval.dtype
    basis = np.eye(row.size, dtype=kind).reshape(row.size, *row.shape)
    params = {key: value for key, value in equation.params.items()}
    if "precision" in params:
        params["precision"] = (jax.lax.Precision.HIGHEST,) * 2

    def of(x):
        return equation.primitive.bind(*(x if number == place else part for number, part in enumerate(operands)), **params)

    made = np.asarray(jax.vmap(of)(basis))
    return row.matrix(np.ascontiguousarray(made.reshape(row.size, -1).T), made.shape[1:])


class _Mask:
    """A comparison: the row is 1 where it is true, else 0; None if it is true nowhere."""

    def __init__(self, row):
        self.row = row

    def choose(self, otherwise, chosen):
        return otherwise if self.row is None else choose(self.row, chosen, otherwise)


def _of_masks(name, params, operands):
    """Result of an operation on comparisons: a mask, or numbers; None if the operation is unknown."""
    rows = [part.row if isinstance(part, _Mask) else part for part in operands]
    if name == "convert_element_type":
        # the mask of a comparison that is true nowhere has no numbers
        return None if rows[0] is None else rows[0] if np.issubdtype(params["new_dtype"], np.floating) else _Mask(rows[0])
    if any(row is None for row in rows):
        return None
    if name == "not":
        return _Mask(rows[0].linear(-1.0, 1.0))
    if name in ("and", "or"):
        both = binary("multiply", *rows)
        return _Mask(both if name == "and" else binary("subtract", binary("add", *rows), both))
    return None


def _compared(name, first, second):
    if name == "ne":
        # how a function looks for numbers that are none
        if is_row(first) and is_row(second) and first.value == second.value:
            return _Mask(None)
        raise Error("a comparison for equality")
    return _Mask(compared(name, *(part if is_row(part) else np.asarray(part) for part in (first, second))))
