#!/usr/bin/env python3
"""Does a full-batch L-BFGS finish pay? .venv/bin/python scripts/try-lbfgs.py STUDY [--out DIR] [--iterations 60]

Goes on from the network that `metafmu train` wrote, with scipy's L-BFGS in double precision on all training rows, and prints loss and
1 - R² on the test rows before and after, with CPU seconds beside those of the training. Networks with tanh only.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
import pandas as pd
from safetensors import safe_open
from scipy.optimize import minimize


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("study", type=Path)
    parser.add_argument("--out", type=Path, help="folder of the study's results [default: out/NAME]")
    parser.add_argument("--iterations", type=int, default=60)
    options = parser.parse_args()
    folder = options.out or Path("out") / options.study.stem
    with safe_open(next(folder.glob("*.safetensors")), "numpy") as file:
        metadata = json.loads(file.metadata()["metafmu"])
        tensors = {key: file.get_tensor(key).astype(np.float64) for key in file.keys()}
    assert metadata["model"]["outputs"]["activations"][0] == "tanh"
    layers = [(tensors[f"outputs.layers.{i}.weight"], tensors[f"outputs.layers.{i}.bias"]) for i in range(len(tensors) // 2 - 2)]
    data = {name: standardised(folder / f"{name}.csv", metadata, tensors) for name in ("train", "test")}
    start = np.concatenate([part.ravel() for layer in layers for part in layer])

    def unpack(flat):
        unpacked, offset = [], 0
        for weight, bias in layers:
            after = offset + weight.size
            unpacked.append((flat[offset:after].reshape(weight.shape), flat[after : after + bias.size]))
            offset = after + bias.size
        return unpacked

    def loss(flat):
        x, y = data["train"]
        value, gradient = 0.0, np.zeros_like(flat)
        for rows in range(0, len(x), 8192):
            part, slope = loss_and_gradient(unpack(flat), x[rows : rows + 8192], y[rows : rows + 8192])
            value, gradient = value + part, gradient + slope
        return value / y.size, gradient / y.size

    check_gradient(loss, start)
    print(f"before: loss {loss(start)[0]:.4e}, 1 - R² {misfit(unpack(start), data['test'])}", flush=True)
    seconds = time.process_time()
    found = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": options.iterations, "maxcor": 30, "ftol": 0, "gtol": 0})
    seconds = time.process_time() - seconds
    print(f"after {found.nit} iterations, {seconds:.0f} CPU s: loss {found.fun:.4e}, 1 - R² {misfit(unpack(found.x), data['test'])}")


def standardised(path, metadata, tensors):
    table = pd.read_csv(path)
    inputs = table[[column["name"] for column in metadata["inputs"]]].to_numpy()
    outputs = table[[column["name"] for column in metadata["outputs"]]].to_numpy()
    x = (inputs - tensors["outputs.input_mean"]) / tensors["outputs.input_scale"]
    return x, (outputs - tensors["outputs.output_mean"]) / tensors["outputs.output_scale"]


def forward(layers, x):
    activations = [x]
    for index, (weight, bias) in enumerate(layers):
        z = activations[-1] @ weight.T + bias
        activations.append(np.tanh(z) if index < len(layers) - 1 else z)
    return activations


def loss_and_gradient(layers, x, y):
    """Sum of the squared errors, and its gradient."""
    activations = forward(layers, x)
    delta = 2.0 * (activations[-1] - y)
    value, parts = 0.25 * float((delta**2).sum()), []
    for index in range(len(layers) - 1, -1, -1):
        parts.append(np.concatenate([(delta.T @ activations[index]).ravel(), delta.sum(axis=0)]))
        if index:
            delta = (delta @ layers[index][0]) * (1.0 - activations[index] ** 2)
    return value, np.concatenate(parts[::-1])


def check_gradient(loss, start):
    direction = np.random.default_rng(1).standard_normal(start.size)
    step = 1e-6
    difference = (loss(start + step * direction)[0] - loss(start - step * direction)[0]) / (2 * step)
    slope = float(loss(start)[1] @ direction)
    assert abs(difference - slope) < 1e-4 * abs(difference), (difference, slope)


def misfit(layers, rows):
    x, y = rows
    errors = ((forward(layers, x)[-1] - y) ** 2).sum(axis=0) / ((y - y.mean(axis=0)) ** 2).sum(axis=0)
    return ", ".join(f"{error:.2e}" for error in errors)


if __name__ == "__main__":
    main()
