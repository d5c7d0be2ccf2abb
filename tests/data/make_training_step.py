"""Writes training_step.json: losses, gradients and a few steps of a small network for every activation, loss, optimizer
and regularization, computed by PyTorch (SOAP: by pytorch_optimizer) in double precision from single-precision parameters and rows.
Run from this folder, after scripts/venv.sh --peers: `../../.peers/bin/python make_training_step.py`."""

import json
from unittest.mock import patch

import torch
from pytorch_optimizer import SOAP

INPUTS, HIDDEN, OUTPUTS, ROWS, STEPS = 3, [5, 4], 2, 7, 3
SIZES = [INPUTS, *HIDDEN, OUTPUTS]
ACTIVATIONS = {
    "tanh": torch.nn.Tanh,
    "sigmoid": torch.nn.Sigmoid,
    "relu": torch.nn.ReLU,
    "gelu": lambda: torch.nn.GELU(approximate="tanh"),
    "silu": torch.nn.SiLU,
    "sine": lambda: Sine(),
    "identity": torch.nn.Identity,
}


class Sine(torch.nn.Module):
    def forward(self, x):
        return torch.sin(x)


class Soap:
    """SOAP of the package pytorch_optimizer on the matrix [W^T; b] of every layer, with three differences.

    - It uses the first gradient only to find eigenvectors. We take a step with it, in the basis of the unit vectors.
    - It begins with the eigenvectors of the first covariance. We begin with unit vectors, and both go on by power iteration.
    - It sorts the eigenvectors by eigenvalue before each power iteration. The paper's algorithm and ours do not.

    The sign of an eigenvector, which depends on the QR decomposition, cancels out of a step.
    """

    def __init__(self, layers, rate, refresh, decay):
        self.layers, self.refresh, self.kept, self.steps = layers, refresh, 1 - rate * decay, 0
        self.matrices = [torch.zeros(layer.in_features + 1, layer.out_features).double() for layer in layers]
        # weights decay before a step, as in AdamW; the package's do after it. It never refreshes by itself
        self.soap = SOAP(self.matrices, rate, betas=(0.95, 0.95), weight_decay=0.0, precondition_frequency=10**9)
        self.soap.param_groups[0]["step"] = 1
        for matrix in self.matrices:
            state = self.soap.state[matrix]
            state["exp_avg"], state["exp_avg_sq"] = torch.zeros_like(matrix), torch.zeros_like(matrix)
            self.soap.init_pre_conditioner(matrix, state, precondition_frequency=10**9)
            state["Q"] = [torch.eye(size).double() for size in matrix.shape]

    def zero_grad(self):
        for layer in self.layers:
            layer.weight.grad = layer.bias.grad = None

    @torch.no_grad()
    def step(self):
        self.steps += 1
        for layer, matrix in zip(self.layers, self.matrices):
            matrix.copy_(torch.vstack([layer.weight.T, layer.bias]) * self.kept)
            matrix.grad = torch.vstack([layer.weight.grad.T, layer.bias.grad])
        self.soap.step()
        for layer, matrix in zip(self.layers, self.matrices):
            layer.weight.copy_(matrix[:-1].T)
            layer.bias.copy_(matrix[-1])
            if self.steps > 1 and (self.steps - 1) % self.refresh == 0:
                state = self.soap.state[matrix]
                with patch.object(torch, "argsort", lambda values, descending: torch.arange(len(values))):
                    state["Q"] = self.soap.get_orthogonal_matrix_qr(state)


def flat(tensors):
    return [value for tensor in tensors for value in tensor.detach().flatten().tolist()]


def optimizer_of(options, network, linear):
    rate, parameters = options["learning_rate"], network.parameters()
    decay, l2 = options.get("weight_decay", 0), options.get("l2", 0)
    match options["optimizer"]:
        case "sgd":
            return torch.optim.SGD(parameters, rate, momentum=options.get("momentum", 0.9), weight_decay=l2)
        case "rmsprop":
            return torch.optim.RMSprop(parameters, rate, momentum=options.get("momentum", 0), weight_decay=l2)
        case "adam":
            return torch.optim.Adam(parameters, rate, weight_decay=l2)
        case "adamw":
            return torch.optim.AdamW(parameters, rate, weight_decay=decay)
        case "soap":
            return Soap(linear, rate, options["refresh"], decay)


def loss_of(options, outputs, targets):
    loss = {
        "mse": torch.nn.functional.mse_loss,
        "mae": torch.nn.functional.l1_loss,
        "huber": lambda *a, **k: torch.nn.functional.huber_loss(*a, delta=options["huber_delta"], **k),
    }[options.get("loss", "mse")](outputs, targets, reduction="none")
    return (loss * torch.tensor(options.get("output_weights", [1.0] * OUTPUTS)).double()).mean()


def case(name, activation="tanh", steps=STEPS, tolerance=2e-7, **options):
    torch.manual_seed(7)
    options = {"learning_rate": 0.01, "optimizer": "adam", **options}
    normalized = options.get("batch_norm", False)
    modules, linear, norms = [], [], []
    for index, (fan_in, fan_out) in enumerate(zip(SIZES, SIZES[1:])):
        hidden = index + 2 < len(SIZES)
        linear.append(torch.nn.Linear(fan_in, fan_out))
        modules.append(linear[-1])
        if hidden and normalized:
            norms.append(torch.nn.BatchNorm1d(fan_out))
            modules.append(norms[-1])
        modules.append(ACTIVATIONS[activation]())
    network = torch.nn.Sequential(*modules[:-1]).double()
    inputs, targets = torch.randn(ROWS, INPUTS).double(), torch.randn(ROWS, OUTPUTS).double()
    parameters = flat(parameter for layer in linear for parameter in (layer.weight, layer.bias))
    with torch.no_grad():
        # the bias is added after the normalization
        for layer, norm in zip(linear, norms):
            norm.bias.copy_(layer.bias)
            layer.bias = None
    optimizer = optimizer_of(options, network, linear)
    result = {"name": name, "activation": activation, "options": options, "tolerance": tolerance}
    result |= {"inputs": flat([inputs]), "targets": flat([targets]), "parameters": parameters, "losses": [], "gradients": []}
    penalty = any(options.get(key, 0) > 0 for key in ("l1", "l2", "clip_norm"))
    for _ in range(steps):
        optimizer.zero_grad()
        loss = loss_of(options, network(inputs), targets)
        loss.backward()
        result["losses"].append(loss.item())
        if not (penalty or normalized):
            result["gradients"].append(flat(parameter.grad for parameter in network.parameters()))
        if options.get("clip_norm", 0) > 0:
            torch.nn.utils.clip_grad_norm_(network.parameters(), options["clip_norm"])
        for parameter in network.parameters():
            parameter.grad += options.get("l1", 0) * parameter.detach().sign()
        optimizer.step()
    after = []
    for index, layer in enumerate(linear):
        if index < len(norms):
            norm = norms[index]
            scale = norm.weight / torch.sqrt(norm.running_var + norm.eps)
            after += [scale[:, None] * layer.weight, norm.bias - scale * norm.running_mean]
        else:
            after += [layer.weight, layer.bias]
    result["parameters_after"] = flat(after)
    return result


CASES = [case(f"adam {activation}", activation) for activation in ACTIVATIONS] + [
    case("mae", loss="mae"),
    case("huber", loss="huber", huber_delta=0.5),
    case("weights of outputs", output_weights=[0.5, 3.0]),
    case("sgd", optimizer="sgd"),
    case("sgd without momentum", optimizer="sgd", momentum=0.0),
    case("rmsprop", optimizer="rmsprop"),
    case("rmsprop with momentum", optimizer="rmsprop", momentum=0.5),
    case("adamw", optimizer="adamw", weight_decay=0.1),
    case("l2", l2=0.1),
    case("l1", l1=0.1),
    case("clipped", optimizer="sgd", clip_norm=0.1),
    case("normalized", activation="silu", batch_norm=True, optimizer="sgd", tolerance=1e-6),
    # directions in which the gradients hardly vary are known to a few digits only in single precision
    case("soap", optimizer="soap", refresh=2, steps=12, weight_decay=0.1, tolerance=5e-5),
    case("soap with few refreshes", optimizer="soap", refresh=10, steps=36, tolerance=5e-5),
]
content = {"torch": torch.__version__, "sizes": SIZES, "cases": CASES}
with open("training_step.json", "w") as file:
    json.dump(content, file, separators=(",", ":"))
    file.write("\n")
