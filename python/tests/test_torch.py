"""Modules of PyTorch: the FMU predicts what the module does, and its derivatives are autograd's."""

import copy

import numpy as np
import pytest
from conftest import differences

import metafmu

torch = pytest.importorskip("torch")
from torch import nn
from torch.nn import functional as F


class Residual(nn.Module):
    def __init__(self):
        super().__init__()
        self.first, self.second, self.last = nn.Linear(3, 16), nn.Linear(16, 16), nn.Linear(16, 2)
        self.norm = nn.LayerNorm(16)

    def forward(self, x):
        h = torch.tanh(self.first(x))
        h = h + F.silu(self.second(self.norm(h)))
        return self.last(h)


class Physics(nn.Module):
    """Features by hand, parts of the row, constants, several branches."""

    def __init__(self):
        super().__init__()
        self.net = nn.Sequential(nn.Linear(5, 8), nn.GELU(), nn.Linear(8, 1))
        self.scale = nn.Parameter(torch.tensor([0.5, 2.0]))
        self.register_buffer("mean", torch.tensor([0.1, 1.0, -0.2]))

    def forward(self, x):
        z = (x - self.mean) / 1.5
        angle, rest = z[:, 0:1], z[:, 1:]
        features = torch.cat([torch.sin(angle), torch.cos(angle), rest * self.scale, angle.square() / 2], dim=1)
        y = self.net(features)
        a, b = torch.split(rest, 1, dim=-1)
        return torch.cat([y * a - 0.3 * b, 1.0 / (2.0 + torch.exp(-y)), torch.stack([a, b], dim=2).flatten(1).mean(dim=1, keepdim=True)], 1)


class Attention(nn.Module):
    """A choice of weights by softmax, reshapes, a constant matrix, in the way of functions."""

    def __init__(self):
        super().__init__()
        self.keys = nn.Parameter(torch.randn(4, 3))
        self.values = nn.Parameter(torch.randn(4, 6))

    def forward(self, x):
        weights = torch.softmax(x @ self.keys.T / 3**0.5, dim=-1)
        y = torch.matmul(weights, self.values).view(x.shape[0], 2, 3)
        return y.transpose(1, 2).reshape(x.size(0), -1).clamp(-0.8, 0.8)[:, ::2] ** 3


ACTIVATIONS = {
    module.__class__.__name__: module
    for module in (
        nn.LeakyReLU(0.1), nn.ELU(0.7), nn.SELU(), nn.CELU(1.3), nn.Softplus(), nn.Softsign(), nn.Hardtanh(), nn.ReLU6(), nn.PReLU(16), nn.Mish(), nn.LogSigmoid(),
        nn.Tanhshrink(), nn.Hardswish(), nn.Hardsigmoid(), nn.Softmax(dim=-1), nn.Threshold(0.1, 0.0), nn.GELU(), nn.LogSoftmax(dim=1),
    )
}


# PyTorch's own derivatives of these have factors in single precision, also for doubles
SINGLE_GRADIENTS = ("CELU", "Hardsigmoid")

MODELS = {
    "sequential-tanh": lambda: nn.Sequential(nn.Linear(3, 32), nn.Tanh(), nn.Linear(32, 32), nn.Tanh(), nn.Linear(32, 1)),
    "sequential-relu": lambda: nn.Sequential(nn.Linear(3, 24), nn.ReLU(), nn.Dropout(0.5), nn.Linear(24, 2)),
    "batch-norm": lambda: nn.Sequential(nn.Linear(3, 16), nn.BatchNorm1d(16), nn.SiLU(), nn.Linear(16, 16), nn.BatchNorm1d(16, affine=False), nn.Sigmoid(), nn.Linear(16, 1)),
    "layer-norm": lambda: nn.Sequential(nn.Linear(3, 16), nn.LayerNorm(16), nn.GELU(approximate="tanh"), nn.Linear(16, 2)),
    **{name: (lambda module: lambda: nn.Sequential(nn.Linear(3, 16), copy.deepcopy(module), nn.Linear(16, 2)))(module) for name, module in ACTIVATIONS.items()},
    "residual": Residual,
    "physics": Physics,
    "attention": Attention,
}


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("name", MODELS)
def test_the_fmu_predicts_what_pytorch_does(name, precision, rows, agrees):
    torch.manual_seed(3)
    module = MODELS[name]()
    with torch.no_grad():
        # statistics that are not those of the beginning
        module.train()(torch.tensor(rows[0], dtype=torch.float32))
    kind = torch.float64 if precision == "double" else torch.float32
    module = module.to(kind).eval()
    x = torch.tensor(rows[0], dtype=kind)
    with torch.no_grad():
        expected = module(x).numpy()
    surrogate = metafmu.from_torch(module, data=rows[0])
    agrees(surrogate, x.numpy(), expected, 1e-12 if precision == "double" else 1e-6)
    some = x[:20]
    if name in SINGLE_GRADIENTS and precision == "double":
        numbers = lambda x: module(torch.tensor(x)).detach().numpy()
        assert np.abs(surrogate.jacobian(some.numpy()) - differences(numbers, some.numpy())).max() < 1e-8
        return
    autograd = torch.stack([torch.autograd.functional.jacobian(lambda row: module(row[None])[0], row) for row in some]).numpy()
    found = surrogate.jacobian(some.numpy())
    assert np.abs(found - autograd).max() <= (1e-11 if precision == "double" else 1e-4) * max(np.abs(autograd).max(), 1.0)


def test_the_module_is_left_as_it_was(rows):
    module = MODELS["batch-norm"]().train()
    before = {name: tensor.clone() for name, tensor in module.state_dict().items()}
    metafmu.from_torch(module, data=rows[0])
    assert module.training and all(torch.equal(tensor, before[name]) for name, tensor in module.state_dict().items())


def test_several_inputs_by_example(rows, agrees):
    class Two(nn.Module):
        def __init__(self):
            super().__init__()
            self.layer = nn.Linear(3, 2)

        def forward(self, a, b):
            return torch.tanh(self.layer(torch.cat([a, b], 1))) * b

    module = Two().double()
    x = torch.tensor(rows[0])
    expected = module(x[:, :2], x[:, 2:]).detach().numpy()
    with pytest.raises(metafmu.Error, match=r"2 inputs \(a, b\): expected example"):
        metafmu.from_torch(module, data=rows[0])
    agrees(metafmu.from_torch(module, data=rows[0], example=(x[:1, :2], x[:1, 2:])), rows[0], expected, 1e-12)


def test_what_cannot_be_followed_is_refused(rows):
    class Branch(nn.Module):
        def forward(self, x):
            return x if x.sum() > 0 else -x

    with pytest.raises(metafmu.Error, match="cannot be followed by torch.fx"):
        metafmu.from_torch(Branch(), data=rows[0])
    with pytest.raises(metafmu.Error, match=r"node .*\(LSTM\).*the module LSTM is not known"):
        metafmu.from_torch(nn.Sequential(nn.LSTM(3, 4)), data=rows[0])

    class Product(nn.Module):
        def forward(self, x):
            return x.T @ x

    with pytest.raises(metafmu.Error, match="both depend on the inputs"):
        metafmu.from_torch(Product(), data=rows[0])
    with pytest.raises(metafmu.Error, match="expected inputs="):
        metafmu.from_torch(Product())
