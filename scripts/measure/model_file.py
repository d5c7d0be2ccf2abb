"""Evaluates model files in numpy, by the specification in fmu-template/runtime/src/format.rs alone."""

import json

import numpy as np
from safetensors import safe_open
from scipy.special import eval_legendre, expit

# functions of x and their parameters p, by their codes
ELEMENTWISE = {
    0: lambda x, p: np.tanh(x),
    1: lambda x, p: expit(x),
    2: lambda x, p: np.maximum(x, 0),
    3: lambda x, p: x / 2 * (1 + np.tanh(np.sqrt(2 / np.pi) * (x + 0.044715 * x**3))),
    4: lambda x, p: x * expit(x),
    5: lambda x, p: np.sin(x),
    6: lambda x, p: x,
    32: lambda x, p: p[0] * x + p[1],
    50: lambda x, p: np.exp(-x / 2),
}
COMBINATIONS = [np.add, np.subtract, np.multiply, np.divide, np.maximum, np.minimum]
LEAF = 2**32 - 1


def load(path):
    """The metadata of a model file, and its tensors by name, with floating-point ones in double precision."""
    with safe_open(path, "numpy") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}
        metadata = json.loads(file.metadata()["metafmu"])
    return metadata, {name: tensor.astype(float) if tensor.dtype.kind == "f" else tensor for name, tensor in tensors.items()}


def evaluate(tensors, x, prefix="graph."):
    """Outputs of a graph, shape [rows, outputs], at columns x, shape [rows, columns]."""
    values = [x]
    for number, codes in enumerate(tensors[f"{prefix}steps"]):
        values.append(step(tensors, f"{prefix}{number}.", *codes, values))
    return values[-1]


def step(tensors, name, kind, code, a, b, values):
    """Value of a step, whose tensors begin with a name."""
    of, x = lambda what: tensors[name + what], values[a]
    match kind:
        case 0:
            return x @ of("weight").T + of("bias")
        case 1:
            # of each function, or of each function and number
            return ELEMENTWISE[code](x, of("parameters").reshape(2, -1) if f"{name}parameters" in tensors else None)
        case 2:
            return COMBINATIONS[code](x, values[b])
        case 3:
            return np.stack([values[value][:, place] for value, place in of("columns")], axis=1)
        case 6:
            return (((x[:, None] - of("centres")) / of("lengths")) ** 2).sum(axis=2)
        case 7:
            return forest(*(of(f"forest.{what}") for what in ("column", "number", "below", "root", "output")), x, code)
        case 9:
            return eval_legendre(of("degrees"), x[:, None]).prod(axis=2)
        case 10:
            return (x - of("mean")) / of("scale")
        case 11:
            return of("mean") + of("scale") * x
        case 12:
            return evaluate(tensors, x, f"{name}function.")
        case 13:
            return interpolated(tensors, name, x, code)
    raise ValueError(f"{name}: a step of kind {kind}, which is not evaluated here")


def forest(column, number, below, roots, outputs, x, width):
    """Sum of the leaves that each row reaches, down every tree."""
    y, rows = np.zeros((len(x), width)), np.arange(len(x))
    for root, output in zip(roots, outputs):
        node = np.full(len(x), root)
        while (inner := column[node] != LEAF).any():
            at = node[inner]
            node[inner] = below[at, (x[rows[inner], column[at]] > number[at]).astype(int)]
        y[:, output] += number[node]
    return y


def interpolated(tensors, name, x, time):
    """Linear in time between the networks of the instants around it, and constant outside them."""
    instants, others = tensors[f"{name}instants"], np.delete(x, time, axis=1)
    t = np.clip(x[:, time], instants[0], instants[-1])
    left = np.clip(np.searchsorted(instants, t, "right") - 1, 0, len(instants) - 2)
    weight = ((t - instants[left]) / np.diff(instants)[left])[:, None]
    of_functions, parts = f"{name}functions.", []
    at = lambda instant: {key: tensor[instant] for key, tensor in tensors.items() if key.startswith(of_functions)}
    for k in np.unique(left):
        before, after = (evaluate(at(side), others[left == k], of_functions) for side in (k, k + 1))
        parts.append((1 - weight[left == k]) * before + weight[left == k] * after)
    # back in the order of the rows
    return np.concatenate(parts)[np.argsort(np.argsort(left, kind="stable"), kind="stable")]


def network(tensors, prefix="graph."):
    """Scaling of the inputs of a network, its layers, and the scaling of its outputs: mean and scale, weight and bias."""
    kinds = tensors[f"{prefix}steps"][:, 0]
    pairs = lambda kind, *names: [tuple(tensors[f"{prefix}{number}.{name}"] for name in names) for number in np.flatnonzero(kinds == kind)]
    [inputs], [outputs] = pairs(10, "mean", "scale"), pairs(11, "mean", "scale")
    return inputs, pairs(0, "weight", "bias"), outputs
