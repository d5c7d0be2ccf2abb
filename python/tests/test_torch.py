"""Modules of PyTorch: the FMU predicts what the module does, and its derivatives are autograd's."""

import copy

import numpy as np
import pytest
from conftest import differences, flow_and_temp

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

class InPlace(nn.Module):
    """Operations in place, after which the tensor that they change is used again."""

    def __init__(self):
        super().__init__()
        self.first, self.relu, self.second = nn.Linear(3, 8), nn.ReLU(inplace=True), nn.Linear(8, 2)

    def forward(self, x):
        y = self.first(x)
        z = self.second(self.relu(y)) + y[:, 2:4]
        shifted, bent = 2.0 * x, 3.0 * x
        shifted.mul_(0.5).add_(1.0)
        F.relu(bent, True)
        return z + shifted[:, :2] + bent[:, 1:]


class Choices(nn.Module):
    """Comparisons, thresholds and extremes."""

    def __init__(self):
        super().__init__()
        self.layer, self.group, self.rms = nn.Linear(3, 8), nn.GroupNorm(2, 8), nn.RMSNorm(8)
        self.gate = nn.Sequential(nn.GLU(), nn.Softplus(beta=3.0, threshold=2.0))

    def forward(self, x):
        y = self.rms(self.group(self.layer(x)))
        y = torch.where(y > 0.1, y, -0.2 * y) * (y[:, :1] <= 1.0)
        y = torch.cat([self.gate(y), y.clamp_min(-0.1)[:, :2], y.amax(1, keepdim=True)], 1)
        return y * torch.tensor([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7], dtype=x.dtype)


class Logarithms(nn.Module):
    """Logarithms of sums of exponentials far below the smallest number."""

    def __init__(self):
        super().__init__()
        self.layer = nn.Linear(3, 5)

    def forward(self, x):
        y = 1000.0 * self.layer(x)
        return torch.cat([F.log_softmax(y, 1), torch.logsumexp(y, 1, keepdim=True), y.logsumexp(-1)[:, None]], 1)


MODELS = {
    "logarithms": Logarithms,
    "in-place": InPlace,
    "choices": Choices,
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


def test_a_differential_equation_has_states(rows, tmp_path):
    """A neural ODE, without ONNX: fmpy and `simulate` give what scipy computes with PyTorch's right side."""
    scipy = pytest.importorskip("scipy.integrate")

    class Flow(nn.Module):
        def __init__(self):
            super().__init__()
            self.net = nn.Sequential(nn.Linear(3, 16), nn.Tanh(), nn.Linear(16, 2))

        def forward(self, x, u):
            return self.net(torch.cat([x, u], -1)) - x @ torch.tensor([[0.4, -2.0], [2.0, 0.4]], dtype=x.dtype)

    torch.manual_seed(1)
    flow = Flow().double()
    example = torch.zeros(1, 2, dtype=torch.float64), torch.zeros(1, 1, dtype=torch.float64)
    states = {"x": {"derivative": "output", "start": 0.5}}
    surrogate = metafmu.from_torch(flow, inputs={"u": (-2, 2)}, states=states, example=example, solver_step=0.01)
    assert [item.name for item in surrogate.outputs] == ["x[0]", "x[1]"]
    time = np.linspace(0.0, 5.0, 251)
    rates = lambda t, x: flow(torch.tensor(x)[None], torch.full((1, 1), 0.8, dtype=torch.float64))[0].detach().numpy()
    expected = scipy.solve_ivp(rates, (0.0, 5.0), [0.5, 0.5], t_eval=time, rtol=1e-11, atol=1e-12).y.T
    assert np.abs(surrogate.simulate(time, {"u": 0.8}) - expected).max() < 1e-8
    fmpy = pytest.importorskip("fmpy")
    for fmu in surrogate.export(tmp_path / "flow.fmu", fmi="both"):
        assert metafmu.validate(fmu)
        result = fmpy.simulate_fmu(str(fmu), start_values={"u": 0.8}, stop_time=5.0, output_interval=0.02)
        assert np.abs(result["x[1]"] - expected[:, 1]).max() < 1e-8
    for wrong, message in [
        ({"states": {"z": {"derivative": "output"}}}, 'state `z`: "z" is no column of the model\'s inputs: x'),
        ({"states": {"x": {"derivative": "y"}}}, '"y" is no column of the model\'s outputs, expected one of .*output'),
        ({"states": states, "example": None}, "expected example="),
    ]:
        with pytest.raises(metafmu.Error, match=message):
            metafmu.from_torch(flow, **{"inputs": {"u": (-2, 2)}, "example": example, **wrong})


def test_a_right_side_in_physical_units_is_compared_where_it_will_be():
    class Arrhenius(nn.Module):
        def __init__(self, hooked):
            super().__init__()
            self.layer = nn.Linear(1, 1)
            if hooked:
                self.layer.register_forward_hook(lambda module, given, made: 100 * made)

        def forward(self, temperature, q):
            # in [-1, 1] it is infinite, and zero
            return torch.relu(temperature - 273) * 0.1 * self.layer(q) - torch.exp(-50 / temperature)

    torch.manual_seed(3)
    options = {
        "inputs": {"q": (1, 2)}, "states": {"temperature": {"derivative": "output", "start": 300.0, "min": 250.0, "max": 400.0}},
        "example": (torch.zeros(1, 1), torch.zeros(1, 1)),
    }
    assert metafmu.from_torch(Arrhenius(False), **options).name == "Arrhenius"
    with pytest.raises(metafmu.Error, match="Arrhenius was read wrongly"):
        metafmu.from_torch(Arrhenius(True), **options)

    class Driven(nn.Module):
        def forward(self, t, x):
            return torch.sin(t) - x

    inputs = {"t": {"value": 0.0}}
    with pytest.raises(metafmu.Error, match="input `t` has a value, but what the states follow from depends on it"):
        metafmu.from_torch(Driven(), inputs=inputs, states={"x": {"derivative": "output"}}, example=(torch.zeros(1, 1), torch.zeros(1, 1)))


@pytest.mark.parametrize("kind", [nn.LSTMCell, nn.GRUCell, nn.RNNCell])
def test_a_cell_goes_on_from_sample_to_sample(kind):
    class Cell(nn.Module):
        def __init__(self):
            super().__init__()
            self.cell, self.head = kind(2, 5), nn.Linear(5, 1)

        def forward(self, u, h, c=None):
            if kind is nn.LSTMCell:
                h, c = self.cell(u, (h, c))
                return {"y": self.head(h), "h1": h, "c1": c}
            h = self.cell(u, h)
            return {"y": self.head(h), "h1": h}

    class Pair(Cell):
        def forward(self, u, h, c):
            return super().forward(u, h, c)

    torch.manual_seed(2)
    cell = (Pair() if kind is nn.LSTMCell else Cell()).double()
    number = 2 if kind is nn.LSTMCell else 1
    zeros = [torch.zeros(1, 5, dtype=torch.float64)] * number
    states = dict(list({"h": "h1", "c": "c1"}.items())[:number])
    example = (torch.zeros(1, 2, dtype=torch.float64), *zeros)
    surrogate = metafmu.from_torch(cell, inputs={"a": (-1, 1), "b": (-1, 1)}, states=states, sample=0.1, example=example)
    signal = np.random.default_rng(3).uniform(-1, 1, (50, 2))
    found = surrogate.simulate(0.1 * np.arange(50), signal)[:, 0]
    made, held = [found[0]], zeros
    for row in signal[:-1]:
        step = cell(torch.tensor(row)[None], *held)
        held = [step["h1"], *([step["c1"]] if number == 2 else [])]
        made.append(step["y"].item())
    assert np.abs(found - made).max() <= 1e-12 * np.ptp(made)
    with pytest.raises(metafmu.Error, match="without its .* hidden tensors"):
        metafmu.from_torch(nn.Sequential(kind(2, 5)), inputs={"a": (-1, 1), "b": (-1, 1)})


def batch_mean(x):
    return x - x.mean(0)


def of_integers(x):
    return x.to(torch.int64).to(torch.float32)


def drawn(x):
    return x + torch.rand(3)


@pytest.mark.parametrize(
    "function, message",
    [
        (batch_mean, "was read wrongly: predictions differ by .* or its rows depend on each other"),
        (drawn, "was read wrongly: predictions differ by .* or on chance"),
        (of_integers, "a conversion of inputs to torch.int64, expected float32 or float64"),
        (lambda x: x.clamp(1, -1), "a clamp to 1 and -1, expected the smaller one first"),
        (lambda x: F.softmax(x.view(-1, 3, 1)), "a softmax of 3 dimensions without `dim`"),
        (lambda x: torch.exp(x, out=x), "out"),
        (lambda x: (x.view(-1).relu_(), x)[1], "changes a tensor in place of which a view"),
    ],
)
def test_what_would_be_read_wrongly_is_refused(function, message, rows):
    class Module(nn.Module):
        def forward(self, x):
            return function(x)

    with pytest.raises(metafmu.Error, match=message):
        metafmu.from_torch(Module(), data=rows[0])


def test_small_outputs_beside_large_ones_and_offsets_are_compared(rows):
    """Each output by its own spread, also of a single row of data."""

    class Scales(nn.Module):
        def forward(self, x):
            return torch.cat([1e6 * x[:, :1], 101325 + 1e-2 * torch.tanh(x - x.mean(0, keepdim=True))], 1).double()

    for data in (rows[0], rows[0][:1]):
        with pytest.raises(metafmu.Error, match="Scales was read wrongly"):
            metafmu.from_torch(Scales().double(), data=data, inputs={"a": (-3, 3), "b": (-3, 3), "c": (-3, 3)}, example=torch.zeros(1, 3, dtype=torch.float64))


@pytest.mark.parametrize("scale", [1e-18, 3e-15, 1e20])
def test_numbers_of_all_sizes_keep_their_digits_in_single_precision(scale, rows, agrees):
    """Charges in coulomb, for instance."""
    module = nn.Sequential(nn.Linear(3, 8), nn.Tanh(), nn.Linear(8, 2))
    with torch.no_grad():
        module[2].weight *= scale
        module[2].bias *= scale
    x = torch.tensor(rows[0], dtype=torch.float32)
    agrees(metafmu.from_torch(module, data=rows[0]), x.numpy(), module(x).detach().numpy(), 1e-6)

    class Inputs(nn.Module):
        def __init__(self):
            super().__init__()
            self.inner = module

        def forward(self, x):
            return self.inner(x / scale) / scale

    x, model = x * scale, Inputs()
    agrees(metafmu.from_torch(model, data=x.numpy(), example=x[:1]), x.numpy(), model(x).detach().numpy(), 1e-6)


def test_precisions_that_are_mixed_or_half_are_read(rows):
    class Mixed(nn.Module):
        def __init__(self):
            super().__init__()
            self.layer = nn.Linear(3, 2)
            self.register_buffer("scale", torch.tensor([2.0, 3.0], dtype=torch.float64))

        def forward(self, x):
            return self.layer(x) * self.scale

    x = torch.tensor(rows[0], dtype=torch.float32)
    for module in (Mixed(), nn.Sequential(nn.Linear(3, 2), nn.Tanh()).bfloat16(), nn.Sequential(nn.Linear(3, 2), nn.Tanh()).half()):
        kind = next(module.parameters()).dtype
        expected = module(x.to(kind)).detach().double().numpy()
        found = metafmu.from_torch(module, data=rows[0]).predict(rows[0])
        assert np.abs(found - expected).max() <= (1e-6 if kind == torch.float32 else 0.05)
    assert metafmu.from_torch(torch.nn.DataParallel(Mixed()), data=rows[0]).name == "Mixed"


def test_hooks_and_classes_are_noticed(rows):
    hooked = nn.Sequential(nn.Linear(3, 4), nn.Linear(4, 1))
    hooked[0].register_forward_hook(lambda module, given, made: 10 * made)
    with pytest.raises(metafmu.Error, match="Sequential was read wrongly"):
        metafmu.from_torch(hooked, data=rows[0])
    for wrong in (nn.Linear, hooked.state_dict()):
        with pytest.raises(metafmu.Error, match="expected a module of PyTorch"):
            metafmu.from_torch(wrong, data=rows[0])


def test_weights_that_are_computed_are_read(rows, agrees):
    """Modules that Python cannot copy."""
    from torch.nn.utils import prune

    module = nn.Sequential(nn.Linear(3, 6), nn.Tanh(), nn.Linear(6, 1)).double()
    prune.l1_unstructured(module[0], "weight", 0.5)
    assert not module[0].weight.is_leaf
    x = torch.tensor(rows[0])
    agrees(metafmu.from_torch(module, data=rows[0]), rows[0], module(x).detach().numpy(), 1e-12)


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


class Named(nn.Module):
    def forward(self, flow, temp):
        return {"heat": 100 * flow + 2 * temp, "left": flow}


class Unnamed(nn.Module):
    def forward(self, x):
        return 100 * x[:, :1] + 2 * x[:, 1:2]


def test_columns_go_by_the_names_of_arguments(goes_by_names):
    frame, y = flow_and_temp()
    column = torch.zeros(1, 1, dtype=torch.float64)
    named = lambda **names: metafmu.from_torch(Named(), example=(column, column), **names)
    goes_by_names(named, lambda rows: np.column_stack([y, rows.flow]), 1e-12, True)
    goes_by_names(lambda **names: metafmu.from_torch(Unnamed(), example=column.expand(1, 2), **names), lambda rows: y, 1e-12, False)
    for outputs in (None, ["left", "heat"], {"left": "m3", "heat": "W"}, {"left": "m3"}):
        assert [item.name for item in named(outputs=outputs, data=frame).outputs] == ["heat", "left"]
    with pytest.raises(metafmu.Error, match="outputs: `left` is of the model, `power` is not"):
        named(outputs=["left", "power"], data=frame)
    # a name that no variable may have
    timed = metafmu.from_torch(lambda flow, temp: {"time": flow, "heat": temp}, example=(column, column), data=frame)
    assert [item.name for item in timed.outputs] == ["y0", "y1"]
    # further columns of the data are no columns of the network
    net = nn.Sequential(nn.Linear(2, 1))
    assert [item.name for item in metafmu.from_torch(net, inputs={"temp": "K", "flow": "m3/s"}, data=frame.assign(y=y)).inputs] == ["flow", "temp"]


def test_columns_of_a_model_with_states_go_by_their_names():
    class Rate(nn.Module):
        def forward(self, x, u, k):
            return -k * x + u

    column = torch.zeros(1, 1, dtype=torch.float64)
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame({"k": [1.0, 4.0], "u": [-2.0, 2.0], "x": [0.0, 1.0]})
    for given in ({"data": frame}, {"data": frame[["k", "u"]]}, {"inputs": {"k": (1, 4), "u": (-2, 2)}}):
        surrogate = metafmu.from_torch(Rate(), states={"x": {"derivative": "output", "start": 1.0}}, example=(column, column, column), **given)
        assert abs(surrogate.simulate(np.linspace(0, 1, 11), {"u": 0.0, "k": 2.0})[-1, 0] - np.exp(-2)) < 1e-6


@pytest.mark.filterwarnings("ignore")
def test_weights_that_hooks_make_are_those_of_now():
    net = nn.Sequential(nn.utils.weight_norm(nn.Linear(3, 8)), nn.Tanh(), nn.Linear(8, 1))
    net.load_state_dict({name: 1.5 * tensor for name, tensor in net.state_dict().items()})
    metafmu.from_torch(net, inputs={"a": (0, 1), "b": (0, 1), "c": (0, 1)})


def test_a_norm_has_a_slope_at_zero():
    class Norms(nn.Module):
        def forward(self, x):
            return torch.stack([torch.norm(x, dim=1), x.norm(dim=1) + F.logsigmoid(x[:, 0])], dim=1)

    surrogate = metafmu.from_torch(Norms(), inputs={"a": (-1, 1), "b": (-1, 1)})
    assert np.array_equal(surrogate.jacobian([[0.0, 0.0]]), [[[0.0, 0.0], [0.5, 0.0]]])


def softplus(x):
    """Not that of PyTorch."""
    return F.softplus(x) + 1e-6


torch.fx.wrap("softplus")


def test_a_name_alone_does_not_make_a_function_one_of_torch():
    with pytest.raises(metafmu.Error, match="a function of test_torch, expected one of torch"):
        metafmu.from_torch(lambda x: softplus(x), inputs={"a": (-1, 1), "b": (-1, 1)})


def test_tensors_are_rows_too():
    surrogate = metafmu.from_torch(nn.Linear(2, 1), inputs={"a": (-1, 1), "b": (-1, 1)})
    assert np.array_equal(surrogate.predict(torch.ones(3, 2, requires_grad=True)), surrogate.predict(np.ones((3, 2))))
