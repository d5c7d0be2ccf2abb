"""All readers of models have the same signature, and read models with states."""

import inspect
import os
import sys

import numpy as np
import pytest

os.environ.setdefault("KERAS_BACKEND", "jax")

import metafmu

READERS = [metafmu.from_torch, metafmu.from_keras, metafmu.from_jax, metafmu.from_onnx, metafmu.from_sklearn]
OWN = {"from_torch": ["example"], "from_jax": ["example", "params"]}


def test_all_readers_have_the_same_arguments():
    shared = {}
    for reader in READERS:
        parameters = inspect.signature(reader).parameters
        own = OWN.get(reader.__name__, [])
        assert list(parameters) == ["model", "inputs", "outputs", "data", *own, "states", "sample", "solver_step", "name", "description", "step", "stop", "domain"]
        for name, parameter in parameters.items():
            assert parameter.kind == (parameter.POSITIONAL_OR_KEYWORD if name in ("model", "inputs", "outputs", "data") else parameter.KEYWORD_ONLY), name
            if name not in (*own, "model"):
                assert shared.setdefault(name, (parameter.default, parameter.annotation)) == (parameter.default, parameter.annotation), name


# -0.5 x + 0.75 u, whose numbers are exact in single precision


def of_torch():
    torch = pytest.importorskip("torch")

    class Flow(torch.nn.Module):
        def forward(self, x, u):
            return 0.75 * u - 0.5 * x

    return metafmu.from_torch, Flow(), {"example": (torch.zeros(1, 1), torch.zeros(1, 1))}


def of_keras(names=("x", "u")):
    keras = pytest.importorskip("keras")
    inputs = [keras.Input((1,), name=name) for name in names]
    model = keras.Model(inputs, keras.layers.Dense(1)(keras.layers.Concatenate()(inputs)))
    model.set_weights([np.array([[-0.5], [0.75]], np.float32), np.zeros(1, np.float32)])
    return metafmu.from_keras, model, {}


def of_jax():
    jax = pytest.importorskip("jax")
    return metafmu.from_jax, lambda p, x, u: p * u - 0.5 * x, {"example": (jax.numpy.zeros(1), jax.numpy.zeros(1)), "params": 0.75}


def of_onnx():
    helper = pytest.importorskip("onnx").helper
    tensor = lambda name: helper.make_tensor_value_info(name, 1, [1, 1])
    number = lambda name, value: helper.make_tensor(name, 1, [], [value])
    nodes = [helper.make_node(*node) for node in (("Mul", ["x", "a"], ["ax"]), ("Mul", ["u", "b"], ["bu"]), ("Add", ["ax", "bu"], ["output"]))]
    graph = helper.make_graph(nodes, "flow", [tensor("x"), tensor("u")], [tensor("output")], [number("a", -0.5), number("b", 0.75)])
    return metafmu.from_onnx, helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), {}


def linear(x):
    return pytest.importorskip("sklearn.linear_model").LinearRegression().fit(x, np.asarray(x) @ [-0.5, 0.75])


def of_sklearn():
    points = np.random.default_rng(1).uniform(-2, 2, (20, 2))
    return metafmu.from_sklearn, linear(pytest.importorskip("pandas").DataFrame(points, columns=["x", "u"])), {}


MODELS = {"torch": of_torch, "keras": of_keras, "jax": of_jax, "onnx": of_onnx, "sklearn": of_sklearn}


@pytest.mark.parametrize("tool", MODELS)
def test_models_of_all_tools_have_states(tool, tmp_path):
    reader, model, own = MODELS[tool]()
    read = lambda **given: reader(model, **{"inputs": {"u": (-2, 2)}, **own, **given})
    flow = read(states={"x": {"derivative": "output", "start": 1.0}}, solver_step=0.01, name="flow")
    assert ([item.name for item in flow.inputs], [item.name for item in flow.outputs], flow.name) == (["x_start", "u"], ["x"], "flow")
    time = np.linspace(0.0, 4.0, 41)
    assert np.abs(flow.simulate(time, {"u": 1.0})[:, 0] - (1.5 - 0.5 * np.exp(-0.5 * time))).max() < 1e-6
    steps = read(states={"x": {"next": "output", "start": 1.0}}, sample=0.1)
    expected = [1.0]
    for _ in range(10):
        expected.append(0.75 - 0.5 * expected[-1])
    assert np.abs(steps.simulate(0.1 * np.arange(11), {"u": 1.0})[:, 0] - expected).max() < 1e-6
    for surrogate in (flow, steps):
        assert all(metafmu.validate(fmu) for fmu in surrogate.export(tmp_path / f"{tool}.fmu", fmi="both"))
    # an ONNX model may have states inside
    without_states = [({"sample": 0.1}, "sample: 0.1 without `states`, expected both or none")] if tool != "onnx" else []
    for wrong, message in [
        *without_states,
        ({"solver_step": 0.01}, "solver_step.*belongs to states that have a `derivative`"),
        ({"states": {"x": {"derivative": "output"}}, "sample": 0.1}, "sample"),
        ({"states": {"x": "output"}}, "sample"),
        ({"states": {"z": "output"}, "sample": 0.1}, 'state `z`: "z" is no column of the model\'s inputs: x, u'),
        ({"states": "x", "sample": 0.1}, "states: 'x', expected a dict"),
    ]:
        with pytest.raises(metafmu.Error, match=message):
            read(**{"inputs": {"x": (-2, 2), "u": (-2, 2)} if "states" not in wrong else {"u": (-2, 2)}, **wrong})


def test_columns_without_names_have_those_of_their_places():
    points = np.random.default_rng(1).uniform(-2, 2, (20, 2))
    surrogate = metafmu.from_sklearn(linear(points), inputs={"force": (-2, 2)}, states={"speed": {"column": "x[0]", "derivative": "output"}})
    assert ([item.name for item in surrogate.inputs], [item.name for item in surrogate.outputs]) == (["speed_start", "force"], ["x[0]"])
    reader, model, _ = of_keras((None, None))
    surrogate = reader(model, inputs={"input1": (-2, 2)}, states={"input0": {"derivative": "output"}})
    assert [item.name for item in surrogate.inputs] == ["input0_start", "input1"]


def test_a_missing_package_is_named_with_the_command_that_installs_it(monkeypatch):
    for package, read in [("torch", metafmu.from_torch), ("jax", lambda model: metafmu.from_jax(model, example=np.ones(2)))]:
        monkeypatch.setitem(sys.modules, package, None)
        with pytest.raises(ImportError, match=f"from_{package} needs {package}: pip install {package}"):
            read(np.tanh)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ImportError, match="a model of MuJoCo needs mujoco: pip install mujoco"):
        metafmu.mujoco("arm.xml")
