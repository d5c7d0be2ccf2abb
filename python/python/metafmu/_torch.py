"""Modules of PyTorch, followed by torch.fx: without ONNX, in the precision of their weights."""

from __future__ import annotations

import contextlib
import inspect
import operator
from typing import Any

import numpy as np

from . import _metafmu
from ._graph import Graph
from ._needed import needed
from ._interface import names_in
from ._comparison import Precision
from ._reader import ReaderOptions, surrogate_of
from ._rows import OperationError, Row, binary, choose, columns_of_arguments, compared, compose, concatenate, extreme, is_row
from ._surrogate import Names, States, Surrogate, is_frame, numbers_of

Error = _metafmu.Error


def from_torch(
    model: Any, inputs: Names = None, outputs: Names = None, data: Any = None, *, example: Any = None, states: States = None, sample: float | None = None,
    solver_step: float | None = None, name: str | None = None, description: str = "", step: float | None = None, stop: float = 1.0, domain: str = "data",
) -> Surrogate:
    """Returns the :class:`Surrogate` of a module of PyTorch in evaluation mode, as after `eval()`.

    ``inputs``: names, or a dict of names to units, ranges ``(min, max)`` or dicts with ``min``, ``max``, ``start``, ``unit``, ``causality``
    ("input", "parameter" or "time"). ``outputs``: names, or a dict of names to units. Names that are not given are those of the model.
    ``data``: rows that the model was trained on, an array or a DataFrame, for missing ranges of inputs and for the domain of validity; with
    ``domain="ranges"`` the whole ranges are valid. ``step``, ``stop``: default step and stop time of a simulation. All readers of models
    have these arguments.

    ``example``: a tensor like the input, or a tuple of tensors if there are several inputs or if they have more dimensions than batch and
    columns.

    >>> net = torch.nn.Sequential(torch.nn.Linear(2, 16), torch.nn.Tanh(), torch.nn.Linear(16, 1))
    >>> metafmu.from_torch(net, inputs={"x": (-1, 1), "v": (-2, 2)}, outputs=["force"]).export("force.fmu")

    ``states``, ``sample``, ``solver_step``: see :func:`metafmu.from_onnx`. The model is then the right-hand side of a differential
    equation, or gives the next values of states. Inputs have the names of the arguments of ``forward``; outputs are ``output``, or
    ``output0`` and so on, or the keys of a dict:

    >>> metafmu.from_torch(flow, inputs={"u": (-2, 2)}, states={"x": {"derivative": "output", "start": 0.5}}, example=(x, u)).export("flow.fmu")

    Raises :class:`metafmu.Error` with the operation that is unknown or cannot be traced.
    """
    needed("torch", "from_torch")

    # what torch.compile and DataParallel make of a module
    module = getattr(model, "_orig_mod", getattr(model, "module", model) if type(model).__name__ == "DataParallel" else model)
    if isinstance(module, type) or not callable(module):
        kind = f"the class {module.__name__}" if isinstance(module, type) else type(module).__name__
        raise Error(f"{kind}, expected a module of PyTorch: an instance of torch.nn.Module")
    options = ReaderOptions(inputs, outputs, data, states, sample, solver_step, name, description, step, stop, domain)
    with _evaluated(module):
        return _read(module, example, options)


@contextlib.contextmanager
def _evaluated(module):
    """The module in evaluation mode, as after `eval()`, within the context. It is not copied, as not all modules can be copied."""
    parts = [(part, part.training) for part in module.modules()] if hasattr(module, "modules") else []
    try:
        for part, _ in parts:
            part.training = False
        yield
    finally:
        for part, training in parts:
            part.training = training


def _read(module, example, options):
    import torch
    import torch.fx

    try:
        traced = torch.fx.symbolic_trace(module)
    except Exception as error:
        raise Error(
            f"{type(module).__name__} cannot be followed by torch.fx: {error}; expected a module without branches that depend on its "
            "inputs, or on their shapes, or export it to ONNX and use from_onnx"
        ) from error
    holders = [node for node in traced.graph.nodes if node.op == "placeholder"]
    holders = [node for place, node in enumerate(holders) if place == 0 or not node.args]
    shapes = _shapes(traced, holders, example, options)
    graph = Graph(sum(int(np.prod(shape)) for shape in shapes))
    parameters, buffers = ([tensor for tensor in of if tensor.is_floating_point()] for of in (traced.parameters(), traced.buffers()))
    tensors = [*parameters, *buffers]
    # what a tensor says of itself
    kind = graph.kind = _kind(parameters or buffers, example)
    given, begin = {}, 0
    for node, shape in zip(holders, shapes):
        size = int(np.prod(shape))
        given[node] = Row(graph, 0, (graph.width(0),)).take(np.arange(begin, begin + size).reshape(shape))
        begin += size
    device = tensors[0].device if tensors else None
    predict = lambda rows: _predicted(module, shapes, torch.tensor(rows, dtype=kind, device=device))
    # hooks compute weights as they are from now on; other errors are reported afterwards
    with contextlib.suppress(Exception):
        predict(np.zeros((1, graph.width(0))))
    made = _follow(traced, given)
    arguments, sizes = [node.target for node in holders], [int(np.prod(shape)) for shape in shapes]
    precision = max((Precision.of(tensor.dtype) for tensor in tensors), default=Precision.of(kind))
    title = type(module).__name__
    return surrogate_of(
        graph, made, options, title, what=title, predict=predict, precision=max(precision, Precision.of(kind)), producer="PyTorch",
        # the argument of Sequential has no name
        columns=columns_of_arguments(arguments, sizes, arguments != ["input"]), single=bool(tensors) and kind != torch.float64,
    )


def _kind(tensors, example):
    """The type of the inputs."""
    import torch

    given = [tensor.dtype for tensor in (example if isinstance(example, (tuple, list)) else [example]) if isinstance(tensor, torch.Tensor)]
    kinds = given or [tensor.dtype for tensor in tensors] or [torch.get_default_dtype()]
    return torch.float64 if torch.float64 in kinds else kinds[0]


def _predicted(module, shapes, rows):
    """Outputs of the module for rows: all at once, or one after the other if it takes only single rows."""
    import torch

    sizes = [int(np.prod(shape)) for shape in shapes]

    def of(rows):
        # a copy, which the module may change
        parts = [part.reshape(len(rows), *shape[1:]) for part, shape in zip(torch.split(rows.clone(), sizes, dim=1), shapes)]
        made = module(*parts)
        made = list(made.values()) if isinstance(made, dict) else made if isinstance(made, (list, tuple)) else [made]
        return torch.cat([part.reshape(len(rows), -1) for part in made if isinstance(part, torch.Tensor)], dim=1)

    with torch.no_grad():
        try:
            found = of(rows)
        except (RuntimeError, IndexError, ValueError):
            found = torch.cat([of(row) for row in rows.split(1)])
    return found.double().cpu().numpy()


def _shapes(traced, holders, example, options):
    """The shape of one row of each input."""
    import torch

    inputs, data = options.inputs, options.data
    if example is not None:
        examples = example if isinstance(example, (tuple, list)) else (example,)
        if len(examples) != len(holders):
            raise Error(f"{len(examples)} examples, the module has {len(holders)} inputs: expected one for each")
        if wrong := [np.shape(tensor) for tensor in examples if len(np.shape(tensor)) < 2]:
            raise Error(f"an example of the shape {tuple(wrong[0])}, expected a batch: (rows, columns)")
        return [(1, *np.shape(tensor)[1:]) for tensor in examples]
    if len(holders) != 1:
        raise Error(f"the module has {len(holders)} inputs ({', '.join(map(str, holders))}): expected example=(...), a tensor for each")
    if options.states:
        raise Error("the number of columns is not known: expected example=x, a tensor like the input")
    # a DataFrame may have further columns, and inputs that are not all of them
    counts = [len(names_in(inputs, "input"))] if inputs is not None else []
    shape = () if data is None else data.shape if is_frame(data) else numbers_of(data, "data").shape
    counts += [shape[1]] if len(shape) > 1 else []
    first = [part.in_features for part in traced.modules() if isinstance(part, torch.nn.Linear)][:1]
    if not counts and not first:
        raise Error("the number of columns is not known: expected inputs=[...], data=X or example=x")
    return [(1, first[0] if first and (not counts or first[0] in counts) else counts[0])]


def _numbers(x):
    """A constant as numpy has it."""
    import torch

    if isinstance(x, torch.Tensor):
        x = x.detach().cpu()
        return x.to(torch.float32).numpy() if x.dtype in (torch.bfloat16, torch.float16) else x.numpy()
    return x


def _follow(traced, given):
    import torch

    known = dict(given)
    storage = _Storage(traced)
    value = lambda argument: torch.fx.node.map_arg(argument, lambda node: known[node])
    for node in traced.graph.nodes:
        if node.op == "placeholder":
            if node not in known:
                known[node] = node.args[0] if node.args else None
            continue
        if node.op == "get_attr":
            place = traced
            for part in node.target.split("."):
                place = getattr(place, part)
            known[node] = place
            continue
        args, kwargs = value(node.args), value(node.kwargs)
        if node.op == "output":
            return args[0]
        try:
            known[node] = _step(traced, node, args, kwargs)
        except OperationError:
            # of an inner module, whose operation it names
            raise
        except Error as error:
            raise OperationError(f"node `{node.name}` ({_title(traced, node)}): {error}") from None
        except Exception as error:
            raise OperationError(f"node `{node.name}` ({_title(traced, node)}), in a form that is not known: {type(error).__name__}: {error}") from error
        try:
            for changed in storage.changed_by(node):
                known[changed] = known[node]
        except Error as error:
            raise OperationError(f"node `{node.name}` ({_title(traced, node)}): {error}") from None
    raise Error("the module has no output")


class _Storage:
    """Which nodes are the same tensor, and which are views of others: an operation in place changes all of them."""

    def __init__(self, traced):
        self.traced = traced
        self.place = {node: place for place, node in enumerate(traced.graph.nodes)}
        self.same, self.views = {}, {}

    def changed_by(self, node):
        """The nodes that are the same tensor as one that this node changes. Raises if it changes a part of another one that is still used."""
        sources = [part for part in node.all_input_nodes if part.op != "get_attr"]
        source = node.args[0] if node.args and node.args[0] in sources else sources[0] if sources else None
        if node.kwargs.get("out") is not None:
            raise Error("writes into `out`, expected a result")
        if source is None:
            return []
        group = self.same.setdefault(source, [source])
        if _is_in_place(self.traced, node):
            group.append(node)
            self.same[node] = group
            later = lambda other: any(self.place[user] > self.place[node] for user in other.users)
            related = {other for one in group for other in self._related(one)} - set(group)
            if any(map(later, related)):
                raise Error("changes a tensor in place of which a view, or a part, is used afterwards: expected one that makes a new tensor")
            return [other for other in group if other is not node]
        if _may_share(self.traced, node):
            self.views.setdefault(source, set()).add(node)
            self.views.setdefault(node, set()).add(source)
        return []

    def _related(self, node):
        """All views of a tensor, of those that it is a view of, and so on."""
        found, waiting = set(), [node]
        while waiting:
            one = waiting.pop()
            if one not in found:
                found.add(one)
                waiting += [*self.views.get(one, ()), *self.same.get(one, ())]
        return found


def _is_in_place(traced, node):
    if node.op == "call_module":
        return bool(getattr(traced.get_submodule(node.target), "inplace", False))
    if node.op == "call_method":
        return node.target.endswith("_") and not node.target.endswith("__")
    name = getattr(node.target, "__name__", "")
    if node.target.__module__ in ("_operator", "operator"):
        return name in ("iadd", "isub", "imul", "itruediv", "ipow", "imatmul")
    if name.endswith("_") and not name.endswith("__"):
        return True
    try:
        given = inspect.signature(node.target).bind(*node.args, **node.kwargs).arguments
    except (TypeError, ValueError):
        given = node.kwargs
    return bool(given.get("inplace", False))


def _may_share(traced, node):
    """Returns True if the result may be the tensor itself, or a view of it."""
    if node.op == "call_module":
        return type(traced.get_submodule(node.target)).__name__ in ("Identity", "Dropout", "Dropout1d", "AlphaDropout", "FeatureAlphaDropout", "Flatten", "Unflatten")
    name = node.target if node.op == "call_method" else getattr(node.target, "__name__", "")
    return name in _MOVES | _SAME | {"getattr"}


def _title(traced, node):
    if node.op == "call_module":
        return type(traced.get_submodule(node.target)).__name__
    return getattr(node.target, "__name__", str(node.target))


def _has_row(x):
    if isinstance(x, (tuple, list)):
        return any(_has_row(part) for part in x)
    return is_row(x)


def _step(traced, node, args, kwargs):
    import torch

    if node.op == "call_module":
        module = traced.get_submodule(node.target)
        return _module(module, *args, **kwargs) if _has_row(args) or _has_row(tuple(kwargs.values())) else module(*args, **kwargs)
    rows = _has_row(args) or _has_row(tuple(kwargs.values()))
    if node.op == "call_method":
        if not rows:
            return getattr(args[0], node.target)(*args[1:], **kwargs)
        return _function(node.target.removesuffix("_"), args, kwargs)
    if not rows:
        return node.target(*args, **kwargs)
    if node.target is getattr:
        if args[1] == "shape":
            return torch.Size(args[0].shape)
        if args[1] in ("T", "mT"):
            return args[0].take(args[0].index().swapaxes(-1, -2))
        if args[1] in ("dtype", "device"):
            return args[0].graph.kind if args[1] == "dtype" else None
        raise Error(f"the attribute {args[1]}, expected shape or T")
    if (node.target.__module__ or "torch").split(".")[0] not in ("torch", "_operator", "operator", "math", "builtins"):
        raise Error(f"a function of {node.target.__module__}, expected one of torch")
    return _function(node.target.__name__.lstrip("_").removesuffix("_"), args, kwargs)


# what only moves elements: done by PyTorch with their places
_MOVES = {
    "reshape", "view", "flatten", "squeeze", "unsqueeze", "transpose", "permute", "getitem", "expand", "expand_as", "repeat", "tile", "roll",
    "flip", "swapaxes", "movedim", "moveaxis", "t", "narrow", "select", "index_select", "contiguous", "clone", "unflatten", "view_as",
    "reshape_as", "broadcast_to", "ravel", "diagonal", "chunk", "split", "unbind", "tensor_split", "hsplit", "vsplit",
}
_SAME = {"dropout", "alpha_dropout", "feature_alpha_dropout", "detach", "float", "double", "to", "type", "type_as", "cpu", "identity", "positive", "pos"}
_BINARY = {
    "add": "add", "iadd": "add", "sub": "subtract", "isub": "subtract", "subtract": "subtract", "mul": "multiply", "imul": "multiply",
    "multiply": "multiply", "div": "divide", "truediv": "divide", "itruediv": "divide", "divide": "divide", "true_divide": "divide",
    "pow": "power", "float_power": "power", "maximum": "maximum", "minimum": "minimum",
}
_COMPARISONS = {
    "gt": "gt", "greater": "gt", "ge": "ge", "greater_equal": "ge", "lt": "lt", "less": "lt", "le": "le", "less_equal": "le",
}
_ONE = {
    "tanh": "tanh", "sigmoid": "sigmoid", "relu": "relu", "silu": "silu", "sin": "sin", "cos": "cos", "exp": "exp", "log": "log",
    "abs": "abs", "absolute": "abs", "reciprocal": "reciprocal", "erf": "erf", "softsign": "softsign", "atan": "atan", "arctan": "atan",
    "sqrt": "sqrt", "rsqrt": "rsqrt", "square": "square", "neg": "neg", "negative": "neg", "tan": "tan", "sinh": "sinh", "cosh": "cosh",
    "log1p": "log1p", "expm1": "expm1", "log2": "log2", "log10": "log10", "exp2": "exp2", "erfc": "erfc", "logsigmoid": "log_sigmoid", "log_sigmoid": "log_sigmoid",
    "selu": "selu", "relu6": "relu6", "hardsigmoid": "hard_sigmoid", "hardswish": "hard_swish", "mish": "mish", "tanhshrink": "tanhshrink",
}


def _function(name, args, kwargs):
    """A function or method of PyTorch, of which at least one argument is a row."""
    import torch

    kwargs = {key: value for key, value in kwargs.items() if key not in ("inplace", "out")}
    x = args[0] if args else kwargs.pop("input", None)
    rest = list(args[1:])
    if name == "getitem" and isinstance(x, tuple):
        return x[rest[0]]
    if name in _SAME:
        kinds = [part for part in (*rest, *kwargs.values()) if isinstance(part, torch.dtype)]
        if any(kind not in (torch.float32, torch.float64) for kind in kinds):
            raise Error(f"a conversion of inputs to {kinds[0]}, expected float32 or float64")
        return x
    if name in _COMPARISONS:
        other = rest[0] if rest else kwargs["other"]
        return compared(_COMPARISONS[name], *(part if is_row(part) else _numbers(part) for part in (x, other)))
    if name in _MOVES:
        return _moved(name, x, rest, kwargs)
    if name in ("size", "dim"):
        shape = torch.Size(x.shape)
        return len(shape) if name == "dim" else shape[rest[0]] if rest else shape
    if name in ("radd", "rmul", "rsub", "rtruediv", "rpow", "rdiv"):
        return _function(name[1:], (rest[0], x), kwargs)
    if name in _BINARY:
        other = rest[0] if rest else kwargs.pop("other", kwargs.pop("exponent", None))
        alpha = kwargs.pop("alpha", rest[1] if len(rest) > 1 else 1)
        if kwargs.get("rounding_mode") is not None:
            raise Error("a division that rounds")
        if alpha != 1:
            other = binary("multiply", other, alpha) if is_row(other) else other * alpha
        return binary(_BINARY[name], *(part if is_row(part) else _numbers(part) for part in (x, other)))
    if name in _ONE and not rest and not kwargs:
        return compose(x, _ONE[name])
    known = _FUNCTIONS.get(name)
    if known is None:
        every = sorted({*_MOVES, *_SAME, *_BINARY, *_ONE, *_FUNCTIONS})
        raise Error(f"the function {name} is not known, expected one of {', '.join(every)}; or export it to ONNX and use from_onnx")
    return known(x, *rest, **kwargs)


def _moved(name, x, rest, kwargs):
    import torch

    if not is_row(x):
        raise Error("a choice of elements that depends on the inputs")
    index = torch.from_numpy(np.ascontiguousarray(x.index()))
    if name == "getitem":
        moved = operator.getitem(index, rest[0])
    elif name in ("view_as", "reshape_as", "expand_as"):
        moved = (index.expand if name == "expand_as" else index.reshape)(rest[0].shape)
    elif name == "view":
        moved = index.reshape(*rest, **kwargs)
    else:
        if _has_row(tuple(rest)):
            raise Error("a choice of elements that depends on the inputs")
        moved = getattr(index if hasattr(index, name) else torch, name)(*([] if hasattr(index, name) else [index]), *rest, **kwargs)
    if isinstance(moved, (tuple, list)):
        return tuple(x.take(part.numpy()) for part in moved)
    return x.take(moved.numpy())


def _cat(parts, dim=0, axis=None):
    return concatenate([part if is_row(part) else _numbers(part) for part in parts], dim if axis is None else axis)


def _stack(parts, dim=0):
    return concatenate([part if is_row(part) else _numbers(part) for part in parts], dim, stack=True)


def _linear(x, weight, bias=None):
    weight, bias = _numbers(weight), None if bias is None else _numbers(bias)
    if weight.ndim == 1:
        row = x.affine(weight[None, :], None if bias is None else np.reshape(bias, 1))
        return row.take(row.index()[..., 0])
    return x.affine(weight, bias)


def _matmul(a, b):
    if is_row(a) and is_row(b):
        raise Error("a product of two matrices that both depend on the inputs, expected one that is constant")
    if is_row(a):
        weight = _numbers(b)
        return _linear(a, weight.T if weight.ndim == 2 else weight)
    weight = _numbers(a)
    if b.ndim == 1:
        return b.affine(weight if weight.ndim == 2 else weight[None, :])
    moved = b.take(b.index().swapaxes(-1, -2))
    made = moved.affine(weight)
    return made.take(made.index().swapaxes(-1, -2))


def _addmm(bias, a, b):
    product = _matmul(a, b)
    return binary("add", product, bias if is_row(bias) else _numbers(bias))


def _gelu(x, approximate="none"):
    return x.map("gelu" if approximate == "none" else "gelu_tanh")


def _softplus(x, beta=1.0, threshold=20.0):
    scaled = x.linear(beta) if beta != 1.0 else x
    soft = scaled.map("softplus")
    # above the threshold PyTorch gives the number itself
    return choose(compared("gt", scaled, threshold), x, soft.linear(1.0 / beta) if beta != 1.0 else soft)


def _clamp(x, min=None, max=None, min_val=None, max_val=None):
    low, high = (min if min is not None else min_val), (max if max is not None else max_val)
    if not _has_row((low, high)) and low is not None and high is not None and np.any(_numbers(low) > _numbers(high)):
        raise Error(f"a clamp to {low} and {high}, expected the smaller one first")
    if _has_row((low, high)):
        row = x if low is None else binary("maximum", x, low if is_row(low) else _numbers(low))
        return row if high is None else binary("minimum", row, high if is_row(high) else _numbers(high))
    largest = np.finfo(np.float64).max
    return x.map("clip", -largest if low is None else _numbers(low), largest if high is None else _numbers(high))


def _scaled_elu(x, alpha):
    # x > 0: x, else alpha (exp(x / alpha) - 1)
    return x.linear(1.0 / alpha).map("elu", 1.0).linear(alpha)


def _layer_norm(x, normalized_shape, weight=None, bias=None, eps=1e-5):
    row = x.standardize(len(tuple(normalized_shape)), eps)
    if weight is None and bias is None:
        return row
    return row.linear(1.0 if weight is None else _double(weight), 0.0 if bias is None else _double(bias))


def _double(tensor):
    return np.asarray(_numbers(tensor), dtype=np.float64)


def _batch_norm(x, running_mean, running_var, weight=None, bias=None, training=False, momentum=0.1, eps=1e-5):
    if training or running_mean is None:
        raise Error("a normalization over the batch, expected one by running statistics")
    factor = 1.0 / np.sqrt(_double(running_var) + eps)
    factor = factor if weight is None else factor * _double(weight)
    mean, offset = _double(running_mean), np.broadcast_to(0.0 if bias is None else _double(bias), factor.shape)
    if x.ndim == 3:
        mean, factor, offset = mean[:, None], factor[:, None], offset[:, None]
    # numbers far from zero cancel otherwise
    return x.linear(1.0, -mean).linear(factor, offset)


def _prelu(x, weight):
    weight = _double(weight)
    if weight.size > 1 and x.ndim > 2:
        weight = weight.reshape((-1,) + (1,) * (x.ndim - 2))
    return x.map("leaky_relu", weight if weight.size > 1 else float(weight.ravel()[0]))


def _reduced(mean):
    def reduce(x, dim=None, keepdim=False, dtype=None, axis=None):
        return x.reduce(axis if dim is None else dim, keepdim, mean)

    return reduce


def _norm(x, p=2, dim=None, keepdim=False, dtype=None, ord=None):
    if (p if ord is None else ord) not in (2, 2.0, "fro", None):
        raise Error("a norm of another order, expected 2")
    # the slope of the root is not finite at 0, where that of the norm is none
    return x.map("power", 2.0).reduce(dim, keepdim).map("clip", 1e-200, np.finfo(np.float64).max).map("power", 0.5)


def _softmax(x, dim=None, dtype=None, **_):
    return x.softmax(_softmax_dim(x, dim))


def _log_softmax(x, dim=None, dtype=None, **_):
    # not the logarithm of the softmax, which is 0 where x is far below the largest
    dim = _softmax_dim(x, dim)
    shifted = binary("subtract", x, extreme(x, dim, "maximum", True))
    return binary("subtract", shifted, shifted.map("exp").reduce(dim, True).map("log"))


def _log_sum_exp(x, dim, keepdim=False):
    largest = extreme(x, dim, "maximum", True)
    total = binary("subtract", x, largest).map("exp").reduce(dim, True).map("log")
    row = binary("add", largest, total)
    return row if keepdim else _moved("squeeze", row, [dim], {})


def _softmax_dim(x, dim):
    # which it is without `dim` depends on their number
    if dim is None and x.ndim != 2:
        raise Error(f"a softmax of {x.ndim} dimensions without `dim`, expected one that says which")
    return 1 if dim is None else dim


def _where(mask, chosen, otherwise):
    if not is_row(mask):
        raise Error("a choice that does not depend on the inputs, expected a comparison")
    return choose(mask, *(part if is_row(part) else _numbers(part) for part in (chosen, otherwise)))


def _glu(x, dim=-1):
    length = x.shape[dim] // 2
    first, second = (x.take(np.take(x.index(), range(begin, begin + length), axis=dim)) for begin in (0, length))
    return binary("multiply", first, second.map("sigmoid"))


def _rms_norm(x, normalized_shape, weight=None, eps=None):
    axes = tuple(range(x.ndim - len(tuple(normalized_shape)), x.ndim))
    if eps is None:
        import torch

        eps = torch.finfo(x.graph.kind).eps
    row = binary("multiply", x, x.map("power", 2.0).reduce(axes, True, mean=True).linear(1.0, eps).map("power", -0.5))
    return row if weight is None else row.linear(_double(weight))


def _group_norm(x, num_groups, weight=None, bias=None, eps=1e-5):
    grouped = x.take(x.index().reshape(x.shape[0], num_groups, -1)).standardize(1, eps)
    row = grouped.take(grouped.index().reshape(x.shape))
    each = lambda tensor: _double(tensor).reshape((-1,) + (1,) * (x.ndim - 2))
    return row.linear(1.0 if weight is None else each(weight), 0.0 if bias is None else each(bias))


def _threshold(x, threshold, value):
    if value != 0:
        raise Error(f"a threshold with the value {value}, expected 0")
    return x.map("thresholded_relu", threshold)


_FUNCTIONS = {
    "cat": _cat, "concat": _cat, "concatenate": _cat, "stack": _stack, "linear": _linear, "matmul": _matmul, "mm": _matmul, "addmm": _addmm,
    "gelu": _gelu, "softplus": _softplus, "clamp": _clamp, "clip": _clamp, "layer_norm": _layer_norm, "batch_norm": _batch_norm,
    "prelu": _prelu, "sum": _reduced(False), "mean": _reduced(True), "norm": _norm, "softmax": _softmax, "threshold": _threshold,
    "where": _where, "glu": _glu, "rms_norm": _rms_norm, "group_norm": _group_norm,
    "clamp_min": lambda x, min: _clamp(x, min=min),
    "clamp_max": lambda x, max: _clamp(x, max=max),
    "amax": lambda x, dim=None, keepdim=False: extreme(x, dim, "maximum", keepdim),
    "amin": lambda x, dim=None, keepdim=False: extreme(x, dim, "minimum", keepdim),
    "leaky_relu": lambda x, negative_slope=0.01: x.map("leaky_relu", negative_slope),
    "elu": lambda x, alpha=1.0: x.map("elu", alpha),
    "celu": lambda x, alpha=1.0: _scaled_elu(x, alpha),
    "hardtanh": lambda x, min_val=-1.0, max_val=1.0: x.map("clip", min_val, max_val),
    "log_softmax": _log_softmax, "logsumexp": _log_sum_exp,
}


def _gates(module, x, h):
    """Sums of weighted inputs and of weighted hidden numbers of a cell, gate by gate."""
    sums = []
    for row, weight, bias in ((x, module.weight_ih, module.bias_ih), (h, module.weight_hh, module.bias_hh)):
        made = _linear(row, weight, bias)
        sums.append([made.take(part) for part in np.split(made.index(), made.shape[-1] // module.hidden_size, axis=-1)])
    return sums


def _hidden(x, given, count):
    if given is None or not all(map(is_row, given)):
        raise Error(f"a cell without its {count} hidden tensors, expected them as inputs of the module")
    return given


def _lstm_cell(module, x, given=None):
    h, c = _hidden(x, given, 2)
    i, f, g, o = (binary("add", a, b) for a, b in zip(*_gates(module, x, h)))
    kept = binary("multiply", f.map("sigmoid"), c)
    c = binary("add", kept, binary("multiply", i.map("sigmoid"), g.map("tanh")))
    return binary("multiply", o.map("sigmoid"), c.map("tanh")), c


def _gru_cell(module, x, h=None):
    (h,) = _hidden(x, (h,), 1)
    (r, z, n), (of_r, of_z, of_n) = _gates(module, x, h)
    r, z = binary("add", r, of_r).map("sigmoid"), binary("add", z, of_z).map("sigmoid")
    n = binary("add", n, binary("multiply", r, of_n)).map("tanh")
    return binary("add", binary("multiply", z.linear(-1.0, 1.0), n), binary("multiply", z, h))


def _rnn_cell(module, x, h=None):
    (h,) = _hidden(x, (h,), 1)
    ((a,), (b,)) = _gates(module, x, h)
    return binary("add", a, b).map(module.nonlinearity)


def _module(module, x, *args, **kwargs):
    """A module of torch.nn."""
    name = type(module).__name__
    if type(module).__module__.split(".")[0] != "torch":
        raise Error(f"{name} is not followed by torch.fx, expected a module of torch.nn or one that is")
    if name in ("Identity", "Dropout", "Dropout1d", "AlphaDropout", "FeatureAlphaDropout"):
        return x
    if name in ("Linear", "NonDynamicallyQuantizableLinear"):
        return _linear(x, module.weight, module.bias)
    if name == "Flatten":
        return _moved("flatten", x, [module.start_dim, module.end_dim], {})
    if name == "Unflatten":
        return _moved("unflatten", x, [module.dim, module.unflattened_size], {})
    if name == "BatchNorm1d":
        return _batch_norm(x, module.running_mean, module.running_var, module.weight, module.bias, eps=module.eps)
    if name == "LayerNorm":
        return _layer_norm(x, module.normalized_shape, module.weight, module.bias, module.eps)
    if name in ("Softmax", "LogSoftmax"):
        return (_softmax if name == "Softmax" else _log_softmax)(x, module.dim)
    cells = {"LSTMCell": _lstm_cell, "GRUCell": _gru_cell, "RNNCell": _rnn_cell}
    if name in cells:
        return cells[name](module, x, *args, **kwargs)
    with_options = {
        "GELU": lambda: _gelu(x, module.approximate),
        "LeakyReLU": lambda: x.map("leaky_relu", module.negative_slope),
        "PReLU": lambda: _prelu(x, module.weight),
        "ELU": lambda: x.map("elu", module.alpha),
        "CELU": lambda: _scaled_elu(x, module.alpha),
        "Softplus": lambda: _softplus(x, module.beta, module.threshold),
        "GLU": lambda: _glu(x, module.dim),
        "GroupNorm": lambda: _group_norm(x, module.num_groups, module.weight, module.bias, module.eps),
        "RMSNorm": lambda: _rms_norm(x, module.normalized_shape, module.weight, module.eps),
        "Hardtanh": lambda: x.map("clip", module.min_val, module.max_val),
        "Threshold": lambda: _threshold(x, module.threshold, module.value),
    }
    if name in with_options:
        return with_options[name]()
    if name.lower() in _ONE:
        return compose(x, _ONE[name.lower()])
    every = ["BatchNorm1d", "Dropout", "Flatten", "Identity", "LayerNorm", "Linear", "LogSoftmax", "Softmax", "Unflatten", *cells, *with_options]
    activations = ["ReLU", "ReLU6", "Tanh", "Sigmoid", "SiLU", "SELU", "Softsign", "Mish", "Hardsigmoid", "Hardswish", "LogSigmoid", "Tanhshrink"]
    raise Error(f"the module {name} is not known, expected one of {', '.join(sorted(every + activations))}; or export it to ONNX and use from_onnx")
