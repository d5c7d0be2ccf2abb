"""Models of Keras 3: Sequential and functional ones, of any backend."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from . import _metafmu
from ._graph import Graph
from ._comparison import SINGLE, Precision
from ._reader import ReaderOptions, surrogate_of
from ._rows import Row, binary, columns_of_arguments, compose, concatenate, is_row
from ._surrogate import Names, States, Surrogate

Error = _metafmu.Error


def from_keras(
    model: Any, inputs: Names = None, outputs: Names = None, data: Any = None, *, states: States = None, sample: float | None = None,
    solver_step: float | None = None, name: str | None = None, description: str = "", step: float | None = None, stop: float = 1.0, domain: str = "data",
) -> Surrogate:
    """Returns the :class:`Surrogate` of a built Keras model, in inference mode.

    The arguments are those of :func:`metafmu.from_torch`. A model with ``states`` has the names of `keras.Input` as inputs, or ``input``,
    or ``input0`` and so on. Its outputs are ``output``, or ``output0`` and so on, or the keys of a dict.

    >>> model = keras.Sequential([keras.Input((2,)), keras.layers.Dense(16, "tanh"), keras.layers.Dense(1)])
    >>> metafmu.from_keras(model, data=X, outputs={"force": "N"}).export("force.fmu")

    Raises :class:`metafmu.Error` with the unknown layer.
    """
    options = ReaderOptions(inputs, outputs, data, states, sample, solver_step, name, description, step, stop, domain)
    shapes = [(1, *tensor.shape[1:]) for tensor in _inputs(model)]
    if any(length is None for shape in shapes for length in shape):
        raise Error(f"inputs of the shapes {shapes}, expected numbers for all dimensions but the batch")
    sizes = [int(np.prod(shape)) for shape in shapes]
    graph = Graph(sum(sizes))
    everything, rows, begin = Row(graph, 0, (graph.width(0),)), [], 0
    for shape, size in zip(shapes, sizes):
        rows.append(everything.take(np.arange(begin, begin + size).reshape(shape)))
        begin += size
    made = _model(model, rows)
    weights = model.get_weights()
    # Keras multiplies in single precision, whatever the weights are
    kinds = {str(layer.compute_dtype) for layer in getattr(model, "layers", [])} & {"float16", "bfloat16"}
    precision = max((Precision.of(kind) for kind in kinds), default=SINGLE)
    predict = lambda rows: _predicted(model, shapes, rows, list(made) if isinstance(made, dict) else None)
    return surrogate_of(
        graph, made, options, model.name, what=f"{type(model).__name__} `{model.name}`", predict=predict, precision=precision, producer="Keras",
        columns=_columns(model, sizes), single=bool(weights) and all(weight.dtype != np.float64 for weight in weights),
    )


def _columns(model, sizes):
    """Names of the columns, from the keys that the model takes or from `keras.Input`, and these names again unless Keras made them up."""
    names = [tensor.name for tensor in model.inputs]
    keys = _packed(model, list(range(len(sizes))))
    if isinstance(keys, dict) and all(isinstance(place, int) for place in keys.values()):
        names = [str(key) for key in sorted(keys, key=keys.get)]
    elif any(re.fullmatch(r"(keras_tensor|input_layer|input)(_\d+)?", name) for name in names):
        return columns_of_arguments(["input"] if len(sizes) == 1 else [f"input{place}" for place in range(len(sizes))], sizes, are_known=False)
    return columns_of_arguments(names, sizes)


def _predicted(model, shapes, rows, keys=None):
    """Predictions of the model for rows; ``keys``: keys of a dict that it returns, in their order."""
    sizes = [int(np.prod(shape)) for shape in shapes]
    parts = [part.reshape(len(rows), *shape[1:]) for part, shape in zip(np.split(rows, np.cumsum(sizes[:-1]), axis=1), shapes)]
    given = _packed(model, [part.astype(np.float32) for part in parts])
    made = model.predict(given, verbose=0, batch_size=len(rows))
    made = [made[key] for key in keys] if isinstance(made, dict) else made if isinstance(made, (list, tuple)) else [made]
    return np.concatenate([np.asarray(part).reshape(len(rows), -1) for part in made], axis=1)


def _packed(model, parts):
    """Arrays of all inputs, in the structure that the model takes."""
    import keras

    structure = getattr(getattr(model, "_functional", None) or model, "_inputs_struct", None)
    if structure is None:
        return parts if len(parts) > 1 else parts[0]
    return keras.tree.pack_sequence_as(structure, parts)


def _inputs(model):
    tensors = getattr(model, "inputs", None)
    if not tensors:
        raise Error(f"{type(model).__name__} `{getattr(model, 'name', '?')}` is not built, or a subclass: expected a Sequential or functional "
                    "model that knows its inputs")
    return tensors


def _model(model, rows):
    _inputs(model)
    functional = getattr(model, "_functional", None) or model
    if not hasattr(functional, "_run_through_graph"):
        raise Error(f"{type(model).__name__} is a subclassed model, expected a Sequential or functional one")
    return functional._run_through_graph(rows if len(rows) > 1 else rows[0], lambda operation: lambda *args, **kw: _apply(operation, args, kw))


def _apply(operation, args, kwargs):
    kwargs = {key: value for key, value in kwargs.items() if key not in ("training", "mask")}
    if hasattr(operation, "_run_through_graph") or getattr(operation, "_functional", None) is not None:
        rows = list(args[0]) if isinstance(args[0], (tuple, list)) else [args[0]]
        return _model(operation, rows)
    kind = type(operation).__name__
    known = _LAYERS.get(kind)
    if known is None or not type(operation).__module__.startswith("keras."):
        raise Error(f"the layer {kind} (`{operation.name}`) is not known, expected one of {', '.join(sorted(_LAYERS))}; or export it to ONNX and use from_onnx")
    try:
        return known(operation, *args, **kwargs)
    except Error as error:
        raise Error(f"layer `{operation.name}` ({kind}): {error}") from None
    except Exception as error:
        raise Error(f"layer `{operation.name}` ({kind}), in a form that is not known: {type(error).__name__}: {error}") from error


_ACTIVATIONS = {
    "linear": "identity", "tanh": "tanh", "sigmoid": "sigmoid", "relu": "relu", "silu": "silu", "swish": "silu", "softplus": "softplus",
    "softsign": "softsign", "selu": "selu", "relu6": "relu6", "hard_sigmoid": "hard_sigmoid", "hard_silu": "hard_swish",
    "hard_swish": "hard_swish", "mish": "mish", "exponential": "exp", "log_sigmoid": "log_sigmoid", "tanh_shrink": "tanhshrink",
}


def _activation(function, row):
    if function is None:
        return row
    import keras

    name = getattr(function, "__name__", type(function).__name__)
    # not any function that has its name
    if not any(function is getattr(module, name, None) for module in (keras.activations, keras.ops)):
        name = f"{name} of {getattr(function, '__module__', '?')}"
    if name in _ACTIVATIONS:
        return compose(row, _ACTIVATIONS[name])
    # with the options that Keras has unless told otherwise
    others = {
        "gelu": lambda: row.map("gelu" if function is keras.activations.gelu else "gelu_tanh"),
        "elu": lambda: row.map("elu", 1.0),
        "leaky_relu": lambda: row.map("leaky_relu", 0.2),
        "softmax": lambda: row.softmax(-1),
    }
    if name in others:
        return others[name]()
    raise Error(f"the activation {name} is not known, expected one of {', '.join(sorted([*_ACTIVATIONS, *others]))}")


def _array(tensor):
    return np.asarray(tensor.numpy() if hasattr(tensor, "numpy") else tensor)


def _variable(variable):
    from keras import ops

    return np.asarray(ops.convert_to_numpy(variable))


def _dense(layer, x):
    bias = _variable(layer.bias) if layer.use_bias else None
    return _activation(layer.activation, x.affine(_variable(layer.kernel).T, bias))


def _batch_norm(layer, x):
    if layer.axis not in (-1, x.ndim - 1):
        raise Error(f"axis {layer.axis}, expected the last one")
    double = lambda variable: _variable(variable).astype(np.float64)
    factor = 1.0 / np.sqrt(double(layer.moving_variance) + layer.epsilon)
    factor = factor * double(layer.gamma) if layer.scale else factor
    return x.linear(1.0, -double(layer.moving_mean)).linear(factor, double(layer.beta) if layer.center else 0.0)


def _layer_norm(layer, x):
    axes = layer.axis if isinstance(layer.axis, (tuple, list)) else [layer.axis]
    axes = sorted(axis % x.ndim for axis in axes)
    if axes != list(range(x.ndim - len(axes), x.ndim)) or getattr(layer, "rms_scaling", False):
        raise Error(f"axes {axes}, expected the last ones and no rms_scaling")
    row = x.standardize(len(axes), layer.epsilon)
    factor = _variable(layer.gamma).astype(np.float64) if layer.scale else 1.0
    offset = _variable(layer.beta).astype(np.float64) if layer.center else 0.0
    return row.linear(factor, offset)


def _relu(layer, x):
    slope = float(_array(layer.negative_slope or 0.0))
    if layer.threshold:
        if slope or layer.max_value is not None:
            raise Error("a threshold with a slope or a largest value, expected one of them")
        return x.map("thresholded_relu", float(layer.threshold))
    row = x.map("leaky_relu", slope) if slope else x.map("relu")
    return row if layer.max_value is None else binary("minimum", row, float(layer.max_value))


def _normalization(layer, x):
    mean, variance = _variable(layer.mean).astype(np.float64), _variable(layer.variance).astype(np.float64)
    deviation = np.maximum(np.sqrt(variance), 1e-7)
    if layer.invert:
        return x.linear(deviation, mean)
    return x.linear(1.0, -mean).linear(1.0 / deviation)


def _merge(operation):
    def merge(layer, parts):
        row = parts[0]
        for part in parts[1:]:
            row = binary(operation, row, part)
        return row

    return merge


def _average(layer, parts):
    return _merge("add")(layer, parts).linear(1.0 / len(parts))


def _two(operation):
    def two(layer, a, b):
        return binary(operation, *(part if is_row(part) else _array(part) for part in (a, b)))

    return two


def _softmax(layer, x):
    axis = layer.axis if isinstance(layer.axis, int) else layer.axis[0] if len(layer.axis) == 1 else None
    if axis is None:
        raise Error(f"axis {layer.axis}, expected a single one")
    return x.softmax(axis)


def _same(layer, x):
    return x


def _either(layer, operation, *args):
    """A layer that merges a list, or an operation of two tensors of the same name."""
    return (_two if len(args) == 2 else _merge)(operation)(layer, *args)


_LAYERS = {
    "Dense": _dense,
    "Activation": lambda layer, x: _activation(layer.activation, x),
    "ReLU": _relu,
    "LeakyReLU": lambda layer, x: x.map("leaky_relu", float(layer.negative_slope)),
    "PReLU": lambda layer, x: x.map("leaky_relu", np.broadcast_to(_variable(layer.alpha).astype(np.float64), x.shape)),
    "ELU": lambda layer, x: x.map("elu", float(layer.alpha)),
    "Softmax": _softmax,
    "BatchNormalization": _batch_norm,
    "LayerNormalization": _layer_norm,
    "Flatten": lambda layer, x: x.take(x.index().reshape(1, -1)),
    "Reshape": lambda layer, x: x.take(x.index().reshape(1, *layer.target_shape)),
    "Permute": lambda layer, x: x.take(x.index().transpose(0, *layer.dims)),
    "RepeatVector": lambda layer, x: x.take(np.repeat(x.index()[:, None, :], layer.n, axis=1)),
    "Concatenate": lambda layer, parts, *rest: concatenate(list(parts), layer.axis),
    "Add": lambda layer, *args: _either(layer, "add", *args),
    "Subtract": lambda layer, *args: _either(layer, "subtract", *args),
    "Multiply": lambda layer, *args: _either(layer, "multiply", *args),
    "Maximum": lambda layer, *args: _either(layer, "maximum", *args),
    "Minimum": lambda layer, *args: _either(layer, "minimum", *args),
    "Divide": _two("divide"),
    "TrueDivide": _two("divide"),
    "Power": _two("power"),
    "Negative": lambda layer, x: x.linear(-1.0),
    "GetItem": lambda layer, x, key: x.take(x.index()[key]),
    "Average": _average,
    "Rescaling": lambda layer, x: x.linear(np.asarray(layer.scale, dtype=np.float64), np.asarray(layer.offset, dtype=np.float64)),
    "Normalization": _normalization,
    **{name: _same for name in ("Dropout", "AlphaDropout", "GaussianDropout", "GaussianNoise", "SpatialDropout1D", "ActivityRegularization",
                                "Identity", "InputLayer")},
    **{name: (lambda function: lambda layer, x: compose(x, function))(function) for name, function in (
        ("Tanh", "tanh"), ("Sigmoid", "sigmoid"), ("Relu", "relu"), ("Sin", "sin"), ("Cos", "cos"), ("Exp", "exp"), ("Log", "log"),
        ("Sqrt", "sqrt"), ("Square", "square"), ("Absolute", "abs"), ("Silu", "silu"), ("Softplus", "softplus"))},
}
