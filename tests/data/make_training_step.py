"""Writes training_step.json: losses, gradients and three Adam steps of a small network, computed by PyTorch in double
precision from single-precision parameters and rows. Run from this folder: `pip install torch==2.15.0; python make_training_step.py`."""

import json

import torch

INPUTS, HIDDEN, OUTPUTS, ROWS, RATE, STEPS = 3, [5, 4], 2, 7, 0.01, 3
ACTIVATIONS = {"tanh": torch.nn.Tanh, "sigmoid": torch.nn.Sigmoid, "relu": torch.nn.ReLU}


def flat(tensors):
    return [value for tensor in tensors for value in tensor.detach().flatten().tolist()]


def case(activation):
    torch.manual_seed(7)
    sizes = [INPUTS, *HIDDEN, OUTPUTS]
    modules = []
    for fan_in, fan_out in zip(sizes, sizes[1:]):
        modules += [torch.nn.Linear(fan_in, fan_out), ACTIVATIONS[activation]()]
    network = torch.nn.Sequential(*modules[:-1]).double()
    inputs, targets = torch.randn(ROWS, INPUTS).double(), torch.randn(ROWS, OUTPUTS).double()
    optimizer = torch.optim.Adam(network.parameters(), lr=RATE)
    result = {
        "activation": activation,
        "inputs": flat([inputs]),
        "targets": flat([targets]),
        "parameters": flat(network.parameters()),
        "losses": [],
        "gradients": [],
    }
    for _ in range(STEPS):
        optimizer.zero_grad()
        loss = torch.nn.functional.mse_loss(network(inputs), targets)
        loss.backward()
        result["losses"].append(loss.item())
        result["gradients"].append(flat(parameter.grad for parameter in network.parameters()))
        optimizer.step()
    result["parameters_after"] = flat(network.parameters())
    return result


content = {
    "torch": torch.__version__,
    "sizes": [INPUTS, *HIDDEN, OUTPUTS],
    "rate": RATE,
    "cases": [case(activation) for activation in ACTIVATIONS],
}
with open("training_step.json", "w") as file:
    json.dump(content, file, separators=(",", ":"))
    file.write("\n")
