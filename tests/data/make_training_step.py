"""Writes training_step.json: losses, gradients and a few steps of a small network for every activation, loss, optimizer
and regularisation, computed by PyTorch (SOAP: by numpy) in double precision from single-precision parameters and rows.
Run from this folder: `pip install torch==2.15.0 numpy; python make_training_step.py`."""

import json

import numpy as np
import torch

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
    """Vyas and others, arXiv:2409.11321, algorithm 3, on [W^T; b] of every layer."""

    def __init__(self, layers, rate, refresh, decay=0.0, beta=0.95):
        self.layers, self.rate, self.refresh, self.decay, self.beta, self.steps = layers, rate, refresh, decay, beta, 0
        self.memory = []
        for layer in layers:
            m, n = layer.in_features + 1, layer.out_features
            zeros = [np.zeros(shape) for shape in ((m, m), (n, n), (m, n), (m, n))]
            self.memory.append(dict(zip("LRMV", zeros), U=np.eye(m), W=np.eye(n)))

    def zero_grad(self):
        for layer in self.layers:
            layer.weight.grad = layer.bias.grad = None

    def step(self):
        self.steps += 1
        for layer, s in zip(self.layers, self.memory):
            gradient = np.vstack([layer.weight.grad.numpy().T, layer.bias.grad.numpy()[None]])
            keep, take = self.beta, 1 - self.beta
            s["L"] = keep * s["L"] + take * gradient @ gradient.T
            s["R"] = keep * s["R"] + take * gradient.T @ gradient
            s["M"] = keep * s["M"] + take * gradient
            turned = s["U"].T @ gradient @ s["W"]
            s["V"] = keep * s["V"] + take * turned**2
            correction = 1 - keep**self.steps
            direction = s["U"].T @ s["M"] @ s["W"] / correction / (np.sqrt(s["V"] / correction) + 1e-8)
            step = torch.from_numpy(s["U"] @ direction @ s["W"].T)
            with torch.no_grad():
                for parameter, part in ((layer.weight, step[:-1].T), (layer.bias, step[-1])):
                    parameter.mul_(1 - self.rate * self.decay)
                    parameter.sub_(self.rate * part)
            if self.steps > 1 and (self.steps - 1) % self.refresh == 0:
                s["U"] = np.linalg.qr(s["L"] @ s["U"])[0]
                s["W"] = np.linalg.qr(s["R"] @ s["W"])[0]


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
        # the bias is added after the normalisation
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
    case("normalised", activation="silu", batch_norm=True, optimizer="sgd", tolerance=1e-6),
    # directions in which the gradients hardly vary are known to a few digits only in single precision
    case("soap", optimizer="soap", refresh=2, steps=12, weight_decay=0.1, tolerance=5e-5),
]
content = {"torch": torch.__version__, "sizes": SIZES, "cases": CASES}
with open("training_step.json", "w") as file:
    json.dump(content, file, separators=(",", ":"))
    file.write("\n")
