"""Columns that surrogates match by name: none is invented, and none is ignored silently."""

import re
from pathlib import Path

import numpy as np
import pytest

import metafmu

pandas = pytest.importorskip("pandas")
onnx = pytest.importorskip("onnx")

ROOT = Path(__file__).resolve().parents[2]
TIME = 0.1 * np.arange(11)


def model(inputs, nodes, outputs):
    helper, double = onnx.helper, onnx.TensorProto.DOUBLE
    values = lambda names: [helper.make_tensor_value_info(name, double, [1, 1]) for name in names]
    nodes = [helper.make_node(kind, given, [made]) for kind, given, made in nodes]
    graph = helper.make_graph(nodes, "model", values(inputs), values(outputs))
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


def component(**options):
    """An input `u`, a parameter `k`, a state `x`, from which k (u - x) follows."""
    made = model(["x", "u", "k"], [("Sub", ["u", "x"], "d"), ("Mul", ["k", "d"], "y")], ["y"])
    inputs = {"u": (-2, 2), "k": {"causality": "parameter", "min": 0.0, "max": 3.0, "start": 1.0}}
    return metafmu.from_onnx(made, inputs=inputs, **options)


@pytest.fixture(scope="module")
def flow():
    return component(states={"x": {"derivative": "y", "start": 1.0}}, solver_step=0.01)


@pytest.fixture(scope="module")
def steps():
    return component(states={"x": {"next": "y", "start": 1.0}}, sample=0.1)


@pytest.fixture(scope="module")
def product():
    return metafmu.from_onnx(model(["a", "b"], [("Mul", ["a", "b"], "y")], ["y"]), inputs={"a": (-2, 2), "b": (-3, 3)})


def frame(**columns):
    return pandas.DataFrame({"u": np.sin(TIME), **columns})


def test_constant_columns_of_a_simulation_are_parameters(flow):
    expected = flow.simulate(TIME, np.sin(TIME), {"k": 2.0, "x_start": 0.5})
    assert not np.array_equal(expected, flow.simulate(TIME, np.sin(TIME)))
    given = {"k": 2.0, "x_start": 0.5, "time": TIME}
    for inputs in (frame(**given), {"u": np.sin(TIME), **given}):
        assert np.array_equal(flow.simulate(TIME, inputs), expected)
    # equal values contradict nothing
    assert np.array_equal(flow.simulate(TIME, frame(**given), {"k": 2.0}), expected)


@pytest.mark.parametrize(
    "columns,parameters,message",
    [
        ({"x": 0.0, "mass": 1.0}, {}, "inputs: found columns of outputs, `x`, which the simulation computes: leave them out; no variable `mass`, expected it among u, k, x_start, time"),
        ({"K": 2.0}, {}, "inputs: no variable `K`, expected it among u, k, x_start, time; did you mean `k`?"),
        ({"k": TIME}, {}, "inputs: found the values 0, 0.1, 0.2, ... of the parameter `k`, expected one finite value in a run"),
        ({"k": 2.0}, {"k": 1.0}, "parameter `k`: found 1 in `parameters` and 2 in `inputs`, expected one value"),
        ({"time": TIME + 0.1}, {}, "inputs: `time` is 0.1 s in row 0, expected 0 s, that of the argument `time`"),
    ],
)
def test_columns_that_a_simulation_does_not_use_are_errors(flow, columns, parameters, message):
    with pytest.raises(metafmu.Error, match=f"^{re.escape(message)}$"):
        flow.simulate(TIME, frame(**columns), parameters)


def test_missing_columns_and_outputs_are_one_error(flow):
    message = "inputs: found columns of outputs, `x`, which the simulation computes: leave them out; no column `u`, expected it among U, x; did you mean `U`?"
    with pytest.raises(metafmu.Error, match=f"^{re.escape(message)}$"):
        flow.simulate(TIME, {"U": TIME, "x": TIME})


def test_measured_outputs_belong_in_the_history(steps):
    hint = "leave them out; outputs measured before the first of `time` belong in `history`"
    with pytest.raises(metafmu.Error, match=hint):
        steps.simulate(TIME, frame(x=0.0))
    past = pandas.DataFrame({"u": [0.5, 0.25], "x": [0.1, 0.2], "k": 2.0, "time": [-0.2, -0.1]})
    expected = steps.simulate(TIME, np.sin(TIME), {"k": 2.0}, past[["u", "x"]])
    assert np.array_equal(steps.simulate(TIME, frame(), history=past), expected)
    assert np.array_equal(steps.simulate(TIME, frame(k=2.0), history=past), expected)
    with pytest.raises(metafmu.Error, match="^history: no variable `remark`, expected it among u, x, k, x_start, time$"):
        steps.simulate(TIME, frame(), history=past.assign(remark="measured"))
    with pytest.raises(metafmu.Error, match="^parameter `k`: found 1.5 in `inputs` and 2 in `history`, expected one value$"):
        steps.simulate(TIME, frame(k=1.5), history=past)


def test_inputs_of_a_surrogate_without_inputs_are_refused():
    decay = metafmu.from_onnx(model(["x"], [("Neg", ["x"], "y")], ["y"]), states={"x": {"derivative": "y", "start": 1.0}})
    with pytest.raises(metafmu.Error, match="inputs: found ndarray, expected None: `model` has no inputs"):
        decay.simulate(TIME, np.sin(TIME))
    assert np.array_equal(decay.simulate(TIME, {"x_start": 2.0}), decay.simulate(TIME, parameters={"x_start": 2.0}))


def test_rows_are_arrays_frames_or_dicts_by_name(product):
    a, b = np.linspace(-1, 1, 5), np.linspace(0, 2, 5)
    expected = (a * b)[:, None]
    for rows in (np.column_stack([a, b]), {"b": b, "a": a}, pandas.DataFrame({"b": b, "a": a})):
        assert np.abs(product.predict(rows) - expected).max() < 1e-12
    assert np.abs(product.predict({"a": a, "b": 2.0})[:, 0] - 2.0 * a).max() < 1e-12
    assert product.predict({"a": 1.0, "b": 2.0}).tolist() == [[2.0]]
    assert product.jacobian({"a": 1.0, "b": 2.0}).tolist() == [[[2.0, 1.0]]]
    assert product.in_domain({"a": [0.0, 9.0], "b": 0.0}).tolist() == [True, False]
    assert product.evaluate({"a": a, "b": b}, {"y": a * b})["y"]["max_error"] < 1e-12
    for rows, message in [
        ({"a": a, "B": b}, "X: no column `b`, expected it among a, B; did you mean `B`?"),
        ({"a": a, "b": b[:3]}, "X: `a` (5,), `b` (3,), expected as many numbers of each"),
        (pandas.DataFrame(np.zeros((2, 3)), columns=["a", "b", "a"]), "X: found the column `a` twice, expected each name once"),
    ]:
        with pytest.raises(metafmu.Error, match=f"^{re.escape(message)}$"):
            product.predict(rows)


def test_columns_that_mean_nothing_to_a_surrogate_are_a_warning(product, recwarn):
    known = {"a": [1.0], "b": [2.0], "y": [2.0], "run": ["first"], "time": [0.0]}
    product.predict(known)
    product.evaluate(known, known)
    assert not recwarn
    with pytest.warns(UserWarning, match="^X: found columns that are not used: mass, remark$") as warned:
        product.predict({**known, "mass": [1.0], "remark": [""]})
    assert warned[0].filename == __file__


def test_the_page_on_predictions_holds_in_python(tmp_path, monkeypatch):
    """The block of Python in docs/predict.md, with a surrogate of the names that it uses."""
    made = model(["L", "c", "thetad0", "time"], [("Mul", ["L", "c"], "d"), ("Add", ["thetad0", "time"], "e"), ("Mul", ["d", "e"], "theta")], ["theta"])
    inputs = {"L": (0.1, 0.2), "c": (0, 0.15), "thetad0": (-2, 5), "time": {"causality": "time", "min": 0.0, "max": 2.0}}
    surrogate = metafmu.from_onnx(made, inputs=inputs)
    (tmp_path / "out" / "single-pendulum").mkdir(parents=True)
    surrogate.export(tmp_path / "out" / "single-pendulum" / "single-pendulum.fmu")
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "predict.md").read_text(encoding="utf-8"), re.DOTALL)
    [block] = [block for block in blocks if "metafmu" in block]
    monkeypatch.chdir(tmp_path)
    found = {}
    exec(block, found)
    assert np.array_equal(found["theta"], found["same"]) and found["theta"].shape == (201, 1)
