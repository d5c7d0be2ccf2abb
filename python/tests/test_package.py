"""Surrogates, studies, the estimator, and the command, from Python."""

import importlib.metadata
import json
import os
import pickle
import re
import subprocess
import sys
import threading
import warnings
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from conftest import differences, flow_and_temp

import metafmu
from metafmu._program import program

STUDY = """
name = "pendulum"
source = { system = "single-pendulum", constants = { m = 0.3, g = 9.81, theta0 = 1.5, c = 0.1, thetad0 = 0.0 } }
time = { stop = 0.5, step = 0.05 }
parameters.L = { min = 0.1, max = 0.2, unit = "m" }
outputs.theta = { unit = "rad" }
sampling = { method = "mesh", levels = 9, test_runs = 4 }
network = { hidden = [16, 16] }
training = { epochs = 200, batch = 16, learning_rate = 0.01 }
"""


@pytest.fixture
def surrogate(rows):
    graph = metafmu.Graph(3)
    hidden = graph.elementwise(graph.affine(0, np.ones((4, 3)) / 3, np.arange(4.0)), "tanh")
    return graph.finish(graph.affine(hidden, [[1.0, -1.0, 0.5, 2.0]]), inputs={"a": "m", "b": (0, 2), "c": {"min": -3, "max": 3, "unit": "s"}}, data=rows[0])


def test_the_package_has_licenses_and_no_folder_of_its_builder():
    files = importlib.metadata.files("metafmu")
    texts = {file.name: file.read_text() for file in files if "licenses" in file.parts}
    assert sorted(texts) == ["LICENSE-APACHE", "LICENSE-MIT", "THIRD-PARTY.txt"]
    assert all(f"\n{package}" in texts["THIRD-PARTY.txt"] for package in ("pyo3 ", "parquet ", "zip ", "The Rust standard library, "))
    [library] = [file for file in files if file.name.startswith("_metafmu.") and file.suffix in (".so", ".pyd")]
    content = library.locate().read_bytes()
    cargo = os.environ.get("CARGO_HOME", Path.home() / ".cargo")
    folders = [str(cargo), str(Path(__file__).parents[2])]
    assert [folder for folder in folders if folder.encode() in content] == []
    [bill] = [file.read_text(encoding="utf-8") for file in files if "sboms" in file.parts]
    assert "pkg:cargo/pyo3@" in bill and "path+file" not in bill
    assert [folder for folder in folders if folder in bill] == []


def test_a_surrogate_is_saved_loaded_and_pickled(surrogate, rows, tmp_path):
    surrogate.save(tmp_path / "model.safetensors")
    [fmu] = surrogate.export(tmp_path, fmi="2")
    assert fmu == tmp_path / "surrogate.fmu"
    for again in (metafmu.Surrogate.load(tmp_path / "model.safetensors"), metafmu.Surrogate.load(fmu), pickle.loads(pickle.dumps(surrogate))):
        assert again == surrogate and again.content_digest == surrogate.content_digest
        assert np.array_equal(again.predict(rows[0]), surrogate.predict(rows[0]))
    assert [(item.name, item.unit) for item in surrogate.inputs] == [("a", "m"), ("b", ""), ("c", "s")]
    assert (surrogate.inputs[1].min, surrogate.inputs[1].max, surrogate.inputs[2].start) == (0.0, 2.0, 0.0)
    y = np.tanh(rows[0].mean(axis=1)[:, None] + np.arange(4.0)) @ [1.0, -1.0, 0.5, 2.0]
    assert np.abs(surrogate.predict(rows[0])[:, 0] - y).max() < 1e-13
    assert np.abs(surrogate.jacobian(rows[0]) - differences(surrogate.predict, rows[0])).max() < 1e-8


def test_an_onnx_model_of_a_surrogate_gives_the_same(surrogate, rows, tmp_path):
    runtime = pytest.importorskip("onnxruntime")
    surrogate.to_onnx(tmp_path / "x.onnx")
    session = runtime.InferenceSession(tmp_path / "x.onnx")
    [given] = session.get_inputs()
    kind = np.float64 if "double" in given.type else np.float32
    [found] = session.run(None, {given.name: rows[0].astype(kind)})
    assert np.abs(found - surrogate.predict(rows[0])).max() < (1e-12 if kind is np.float64 else 1e-5)


def test_what_is_no_number_gives_none_and_is_nowhere(surrogate):
    point = [[0.0, np.nan, 1.0], [0.0, 1.0, 1.0]]
    for values in (surrogate.predict(point)[:, 0], surrogate.domain_distance(point), surrogate.jacobian(point).sum(axis=(1, 2))):
        assert np.isnan(values).tolist() == [True, False]
    assert surrogate.in_domain(point).tolist() == [False, True]


def test_the_domain_is_where_the_data_are():
    random = np.random.default_rng(5)
    x = random.uniform(-1, 1, (400, 1))
    data = np.hstack([x, x**3 + random.normal(scale=0.01, size=x.shape)])
    make = lambda **options: (graph := metafmu.Graph(2)).finish(graph.affine(0, [[1.0, 1.0]]), data=data, **options)
    surrogate = make()
    assert surrogate.in_domain(data).all() and not surrogate.domain_distance(data).any()
    assert surrogate.in_domain([[0.5, 0.125], [0.5, -0.5]]).tolist() == [True, False]
    assert 0.05 < surrogate.domain_distance([[0.5, -0.5]])[0] < 0.5 < surrogate.domain_distance([[2.0, 0.0]])[0]
    assert make(domain="ranges").in_domain([[0.5, -0.5]]).all()
    with pytest.raises(metafmu.Error, match='"data" or "ranges"'):
        make(domain="box")


@pytest.mark.filterwarnings("error:.*onnxruntime")
def test_an_onnx_model_of_a_step_has_states(tmp_path):
    """A cell whose state goes in and out, and a differential equation: fmpy gives what numpy computes."""
    onnx = pytest.importorskip("onnx")
    helper, numpy_helper, double = onnx.helper, onnx.numpy_helper, onnx.TensorProto.DOUBLE
    random = np.random.default_rng(2)
    weights = {"W": random.normal(size=(1, 4)), "U": random.normal(size=(4, 4)) / 3, "V": random.normal(size=(4, 1))}
    nodes = [("MatMul", ["x", "W"], "a"), ("MatMul", ["h", "U"], "b"), ("Add", ["a", "b"], "s"), ("Tanh", ["s"], "h1"), ("MatMul", ["h1", "V"], "y")]
    tensor = lambda name, width: helper.make_tensor_value_info(name, double, [1, width])
    graph = helper.make_graph([helper.make_node(kind, given, [made]) for kind, given, made in nodes], "cell", [tensor("x", 1), tensor("h", 4)],
                              [tensor("y", 1), tensor("h1", 4)], [numpy_helper.from_array(value, name) for name, value in weights.items()])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    cell = metafmu.from_onnx(model, inputs={"x": (-1, 1)}, states={"h": "h1"}, sample=0.1)
    assert [item.name for item in cell.outputs] == ["y"] and cell.name == "model"
    [fmu] = cell.export(tmp_path / "cell.fmu")
    assert metafmu.validate(fmu)
    fmpy = pytest.importorskip("fmpy")
    found = fmpy.simulate_fmu(str(fmu), start_values={"x": 0.5}, stop_time=1.0, output_interval=0.1)["y"]
    h = np.zeros((1, 4))
    for k in range(1, 11):
        h = np.tanh(0.5 * weights["W"] + h @ weights["U"])
        assert abs(found[k] - (h @ weights["V"]).item()) < 1e-12
    found = cell.simulate(0.1 * np.arange(11), np.full(11, 0.5), {"y_start": 0.25})
    assert found.shape == (11, 1) and found[0, 0] == 0.25 and abs(found[-1, 0] - (h @ weights["V"]).item()) < 1e-12
    flow = metafmu.from_onnx(model, inputs={"x": (-1, 1)}, outputs={"y": {"column": "y"}}, states={"h": {"derivative": "h1"}}, solver_step=0.01)
    [fmu] = flow.export(tmp_path / "flow.fmu", fmi="3")
    assert metafmu.validate(fmu)
    scipy = pytest.importorskip("scipy.integrate")
    rates = lambda time, h: np.tanh(0.5 * weights["W"][0] + h @ weights["U"])
    expected = scipy.solve_ivp(rates, (0, 1), np.zeros(4), rtol=1e-11, atol=1e-12).y[:, -1]
    time = np.linspace(0.0, 1.0, 11)
    assert abs(flow.simulate(time, {"x": 0.5})[-1, 0] - (rates(0, expected) @ weights["V"]).item()) < 1e-7
    for kind in ("CoSimulation", "ModelExchange"):
        found = fmpy.simulate_fmu(str(fmu), fmi_type=kind, start_values={"x": 0.5}, stop_time=1.0, output_interval=0.1, relative_tolerance=1e-9)["y"]
        assert abs(found[-1] - (rates(0, expected) @ weights["V"]).item()) < 1e-7, kind
    for states, message in [
        ({"h": "h9"}, "h9"),
        ("h", "states: 'h', expected a dict"),
        ({"h": 5}, "state `h`: 5, expected the output"),
        ({"h": {"next": "h1", "kind": 1}}, "state `h`: unknown key `kind`, expected one of column, next"),
        ({"h": {"next": "h1", "start": [1, 2]}}, r"state `h`: start: \[1, 2\], expected a finite number"),
    ]:
        with pytest.raises(metafmu.Error, match=message):
            metafmu.from_onnx(model, inputs={"x": (-1, 1)}, states=states, sample=0.1)
    with pytest.raises(metafmu.Error, match=r"1 inputs \(x\), the model has 5: x, h\[0\], h\[1\], h\[2\], h\[3\]"):
        metafmu.from_onnx(model, inputs=["x"], data=np.zeros((2, 5)))
    with pytest.raises(metafmu.Error, match="sample: nan, expected a finite number"):
        metafmu.from_onnx(model, inputs={"x": (-1, 1)}, states={"h": "h1"}, sample=float("nan"))
    with pytest.raises(metafmu.Error, match="input `x`: max: inf, expected a finite number"):
        metafmu.from_onnx(model, inputs={"x": (-1, float("inf"))}, states={"h": "h1"}, sample=0.1)
    with pytest.raises(metafmu.Error, match="has states"):
        cell.predict([[0.5]])
    for wrong, message in [
        ((time,), "no inputs, expected a column for each of x"),
        ((time, {"u": time}), "inputs: no column `x`, expected it among u"),
        ((time, {"x": time[:3]}), r"inputs: `x` \(3,\), expected a number or 11"),
        (("now", time), "time: could not convert .*'now', expected real numbers"),
        ((time, time, [1.0]), "parameters: .*expected a dict"),
        ((time, time, {"y_start": "high"}), "parameter `y_start`: could not convert .*'high', expected real numbers"),
        ((time, time[:3]), "inputs has 3 rows, expected 11"),
        ((time[::-1], time), "expected ascending numbers"),
        ((time, time * np.nan), "not finite"),
        ((time, time, {"start": 1.0}), "parameters: no parameter `start`, expected it among y_start"),
        ((time, time, {"y_start": np.inf}), "`y_start`: inf, expected a finite number"),
    ]:
        with pytest.raises(metafmu.Error, match=message):
            cell.simulate(*wrong)


def test_a_differential_equation_alone_shows_its_states():
    onnx = pytest.importorskip("onnx")
    helper, double = onnx.helper, onnx.TensorProto.DOUBLE
    tensor = lambda name: helper.make_tensor_value_info(name, double, [1, 2])
    graph = helper.make_graph([helper.make_node("Mul", ["x", "k"], ["dx"])], "decay", [tensor("x")], [tensor("dx")], [helper.make_tensor("k", double, [2], [-1.0, -2.0])])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    decay = metafmu.from_onnx(model, states={"x": {"derivative": "dx", "start": 1.0}})
    assert [item.name for item in decay.outputs] == ["x[0]", "x[1]"]
    assert np.abs(decay.simulate([0.0, 0.5, 2.0], parameters={"x[1]_start": 3.0}) - [[1.0, 3.0], *([np.exp(-t), 3 * np.exp(-2 * t)] for t in (0.5, 2.0))]).max() < 1e-8


def test_what_was_measured_is_in_the_model_card(surrogate, rows, tmp_path):
    """R², errors and their place, of labels that are off in one row."""
    x = rows[0]
    y = surrogate.predict(x)
    y[17] += 0.5
    assert surrogate.accuracy is None
    found = surrogate.evaluate(x, y[:, 0])["y"]
    assert abs(found["r2"] - (1 - 0.25 / np.sum((y - y.mean()) ** 2))) < 1e-12
    assert abs(found["rmse"] - 0.5 / np.sqrt(len(x))) < 1e-12 and abs(found["max_error"] - 0.5) < 1e-12 and found["worst_row"] == 17
    assert abs(found["relative_max_error"] - 0.5 / np.ptp(y)) < 1e-12
    # what is too large for a number is the worst, and not the best
    assert surrogate.evaluate(x, y * 1e200)["y"]["r2"] < -1e308
    surrogate.evaluate(x, y)
    # two digits after the nines, and at least four
    score = f"{found['r2']:.{max(4, int(-np.log10(1 - found['r2'])) + 2)}f}"
    for source in (surrogate, pickle.loads(pickle.dumps(surrogate))):
        [fmu] = source.export(tmp_path / "x.fmu")
        with zipfile.ZipFile(fmu) as archive:
            card = archive.read("documentation/index.html").decode()
        assert "Measured on 200 rows that were given for it" in card and score in card
    for wrong, message in [((x, y[:3]), "X has 200 rows and y 3"), ((x, y * np.nan), "y has a number that is not finite in row 0"), ((x[:0], y[:0]), "at least one")]:
        with pytest.raises(metafmu.Error, match=message):
            surrogate.evaluate(*wrong)


def test_a_network_that_explains_nothing_is_no_surrogate():
    random = np.random.default_rng(4)
    x = random.uniform(-1, 1, (400, 2))
    with pytest.warns(metafmu.AccuracyWarning, match="a poor surrogate: R² on unseen rows of `noise`"):
        surrogate = metafmu.fit(x, np.column_stack([random.normal(size=400), x[:, 0]]), outputs=["noise", "x"], epochs=50)
    assert surrogate.accuracy["noise"]["r2"] < 0.2 and surrogate.accuracy["x"]["r2"] > 0.9
    with pytest.warns(metafmu.AccuracyWarning):
        # the inputs say nothing
        metafmu.fit(np.ones((6, 1)), [1.0, -1.0, 1.0, -1.0, 1.0, -1.0], epochs=5)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"hidden": "ab"}, "hidden: 'ab', expected a whole number"),
        ({"hidden": (2.5,)}, "hidden: 2.5, expected a whole number"),
        ({"hidden": (10**6, 10**6)}, "hidden"),
        ({"epochs": 2.7}, "epochs: 2.7, expected a whole number"),
        ({"epochs": -1}, "epochs: -1, expected a whole number"),
        ({"batch": None}, "batch: None, expected a whole number"),
        ({"learning_rate": float("nan")}, "learning_rate: nan, expected a finite number"),
        ({"learning_rate": -1.0}, "learning_rate"),
        ({"training": 3}, "training: 3, expected a dict"),
        ({"random_state": "a"}, "random_state: 'a', expected an integer"),
    ],
)
def test_options_of_a_training_are_checked(options, message):
    with pytest.raises(metafmu.Error, match=message):
        metafmu.fit(np.ones((4, 2)), np.arange(4.0), **options)


def test_rows_of_a_training_are_numbers():
    for x, y, message in [([], [], "expected"), (np.ones((3, 1)) * 1j, np.ones(3), "complex"), ([["a"]], [1.0], "X: could not convert string"), ([[1.0]], [[[1.0]]], "y has the shape"),
                          ([[1.0]], ["b"], "y: ")]:
        with pytest.raises(metafmu.Error, match=message):
            metafmu.fit(x, y)


def test_the_interface_of_an_export_is_chosen(surrogate, tmp_path):
    def causalities(**options):
        [fmu] = surrogate.export(tmp_path / "chosen.fmu", **options)
        with zipfile.ZipFile(fmu) as archive:
            variables = ElementTree.fromstring(archive.read("modelDescription.xml")).iter("ScalarVariable")
        return {variable.get("name"): variable.get("causality") for variable in variables}

    usual, wired, plain = causalities(), causalities(ports="domain"), causalities(interface="plain", names="flat")
    assert (usual["in_domain"], usual["domain_policy"]) == ("local", "parameter")
    assert (wired["in_domain"], wired["domain_distance"]) == ("output", "output")
    assert set(usual) - set(plain) == {"domain_policy", "in_domain", "domain_distance"}
    for options, says in (
        ({"ports": ["bounds"]}, "there are no error bounds"),
        ({"ports": ["outputs"]}, "ports: unknown variant `outputs`, expected one of `domain`, `bounds`, `measured`"),
        ({"interface": "none"}, "interface: unknown variant `none`, expected `study` or `plain`"),
    ):
        with pytest.raises(metafmu.Error, match=re.escape(says)):
            surrogate.export(tmp_path / "never.fmu", **options)


def test_exports_have_the_names_that_were_asked_for(surrogate, tmp_path):
    names = lambda **options: [path.name for path in surrogate.export(tmp_path / "x.fmu", **options)]
    assert names(fmi="both") == ["x.fmu", "x-fmi3.fmu"]
    assert names(fmi=3) == ["x.fmu"]
    found = metafmu.validate(tmp_path / "x.fmu")
    assert found, found
    assert names(sources=True) == ["x.fmu"]
    with pytest.raises(metafmu.Error, match='fmi="4", expected "2", "3" or "both"'):
        names(fmi="4")
    with pytest.raises(metafmu.Error, match="not-a-platform"):
        names(platforms=["not-a-platform"])
    # the name of the folder in FMI 2.0
    with pytest.raises(metafmu.Error, match="^platform `linux64` is not known, expected the tuple `x86_64-linux`$"):
        names(platforms=["linux64"])
    with pytest.raises(metafmu.Error, match="platforms: 3, expected"):
        names(platforms=3)
    with pytest.raises(metafmu.Error, match="ends in .fmu"):
        surrogate.export(tmp_path / "x.zip")


def test_missing_columns_are_one_error_with_the_closest_names(surrogate):
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame({"a": [1.0], "B": [1.0], "cc": [1.0]})
    message = "X: no columns `b`, `c`, expected them among a, B, cc; did you mean `B` for `b`?"
    for method in (surrogate.predict, surrogate.jacobian, surrogate.domain_distance, surrogate.in_domain):
        with pytest.raises(metafmu.Error, match=re.escape(message)):
            method(frame)
    # new names are for all columns or none
    with pytest.raises(metafmu.Error, match="inputs: `a` is of the model, `b`, `c` are not; expected all of its names, in any order: a, B, cc, "):
        metafmu.Graph(3).finish(0, inputs=["a", "b", "c"], data=frame)


def test_wrong_input_is_a_value_error_with_a_reason(surrogate, tmp_path):
    assert issubclass(metafmu.Error, ValueError) and metafmu.Error.__module__ == "metafmu"
    with pytest.raises(metafmu.Error, match=r"shape \(2, 2\), expected \(rows, 3\): a, b, c"):
        surrogate.predict(np.ones((2, 2)))
    with pytest.raises(metafmu.Error, match="X: no column `c`, expected it among a, b"):
        surrogate.predict({"a": 1.0, "b": 1.0})
    with pytest.raises(metafmu.Error, match="none.safetensors"):
        metafmu.Surrogate.load(tmp_path / "none.safetensors")
    (tmp_path / "bad.fmu").write_bytes(b"no zip")
    with pytest.raises(metafmu.Error, match="bad.fmu: not an FMU"):
        metafmu.validate(tmp_path / "bad.fmu")
    graph = metafmu.Graph(2)
    for wrong in (lambda: graph.affine(5, [[1.0, 2.0]]), lambda: graph.affine(0, [[1.0]]), lambda: graph.columns([(0, 2)]), lambda: graph.elementwise(0, "nothing"),
                  lambda: graph.elementwise(0, "linear", 1.0), lambda: graph.combine(0, 1, "add"), lambda: graph.finish(0, inputs=["x", "x"], data=np.ones((2, 2)))):
        with pytest.raises(metafmu.Error):
            wrong()
    for about, message in [(5, "input `x0`: 5, expected a unit, a range"), ({"unit": 5}, "input `x0`: unit: 5, expected a text"), ((1, 2, 3), "input `x0`: ")]:
        with pytest.raises(metafmu.Error, match=message):
            graph.finish(0, inputs={"x0": about, "x1": (0, 1)})
    for wrong, message in (({"outputs": []}, "0 outputs .* the model has 2"), ({"outputs": {"y": {"column": "y"}}}, "unknown key `column`")):
        with pytest.raises(metafmu.Error, match=message):
            graph.finish(0, data=np.ones((2, 2)), **wrong)
    with pytest.raises(metafmu.Error, match="forest"):
        looped = {"left": [0], "right": [0], "column": [0], "number": [0.0]}
        graph.finish(graph.forest(0, [looped]), data=np.ones((2, 2)))


def test_a_study_is_built(tmp_path, capfd):
    (tmp_path / "study.toml").write_text(STUDY)
    study = metafmu.Study.load(tmp_path / "study.toml")
    result = study.build(tmp_path / "out", fmi="both")
    assert "trained on" in capfd.readouterr().err
    assert result.accepted, result.verdict
    assert not result.problems and [fmu.name for fmu in result.fmus] == ["pendulum.fmu", "pendulum-fmi3.fmu"]
    assert result.metrics == json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert result.report._repr_html_().startswith("<iframe srcdoc=") and Path(result.report).is_file()
    assert abs(result.surrogate.predict([[0.15, 0.0]])[0, 0] - 1.5) < 0.1
    (tmp_path / "study.toml").write_text(STUDY.replace("levels", "levls"))
    with pytest.raises(metafmu.Error, match=r"study.toml:7: .*levls"):
        metafmu.Study.load(tmp_path / "study.toml")


def test_a_study_of_a_table_without_a_time_is_the_same_fit(tmp_path, capfd):
    x = np.random.default_rng(0).uniform(-1, 1, (40, 2))
    y = np.sin(x[:, 0]) * x[:, 1]
    rows = "".join(f"{a!r},{b!r},{c!r}\n" for (a, b), c in zip(x.tolist(), y.tolist()))
    (tmp_path / "points.csv").write_text("a,b,y\n" + rows)
    text = 'name = "map"\nstructure = "static"\nseed = 0\n[source]\ntable = "points.csv"\n[inputs]\na = {}\nb = {}\n[outputs]\ny = {}\n'
    (tmp_path / "map.toml").write_text(text)
    result = metafmu.Study.load(tmp_path / "map.toml").build(tmp_path / "out", fmi="both")
    assert "fitting to 40 rows" in capfd.readouterr().err
    assert result.accepted and not result.problems and [fmu.name for fmu in result.fmus] == ["map.fmu", "map-fmi3.fmu"]
    assert result.metrics["rows"] == "cross-validated" and result.report._repr_html_().startswith("<iframe srcdoc=")
    fitted = metafmu.fit(x, y, inputs=["a", "b"], outputs=["y"])
    assert fitted.model == result.metrics["static_map"]["exported"]
    assert np.array_equal(fitted.predict(x), result.surrogate.predict(x)) and result.surrogate.in_domain(x).all()
    assert fitted.accuracy["y"]["r2"] == result.metrics["outputs"]["y"]["r2"]


INTERRUPTED = """
import os, signal, threading
import numpy as np
import metafmu

# what runs in the background of a shell ignores it
signal.signal(signal.SIGINT, signal.default_int_handler)
rows = np.random.default_rng(0).normal(size=(20000, 3))
threading.Timer(1.5, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
try:
    metafmu.fit(rows, rows.sum(axis=1), epochs=100000, hidden=(64, 64), training={"schedule": "constant"})
except KeyboardInterrupt:
    print("interrupted")
"""


@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_ctrl_c_ends_a_training():
    """Runs in a separate process, because other packages install signal handlers."""
    done = subprocess.run([sys.executable, "-c", INTERRUPTED], capture_output=True, text=True, timeout=60)
    assert done.stdout == "interrupted\n", done.stderr


def test_other_threads_go_on_meanwhile():
    rows = np.random.default_rng(0).normal(size=(5000, 3))
    ticks, done = [], threading.Event()

    def tick():
        while not done.wait(0.01):
            ticks.append(None)

    thread = threading.Thread(target=tick)
    thread.start()
    metafmu.fit(rows, rows[:, 0] ** 2, epochs=300, hidden=(64, 64))
    done.set()
    thread.join()
    assert len(ticks) > 5


FORKED = """
import multiprocessing
import numpy as np
import metafmu

x = np.random.default_rng(0).normal(size=(5000, 3))
graph = metafmu.Graph(3)
surrogate = graph.finish(graph.affine(0, np.ones((1, 3))), data=x)

def work(x):
    metafmu.fit(x[:100], x[:100, 0], hidden=(4,), training={"epochs": 3})
    return surrogate.predict(x), surrogate.jacobian(x).sum()

expected = work(x)
with multiprocessing.get_context("fork").Pool(2) as pool:
    for predicted, slopes in pool.map(work, [x, x]):
        assert (predicted == expected[0]).all() and slopes == expected[1]
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked here")
def test_forked_processes_have_threads_of_their_own():
    subprocess.run([sys.executable, "-W", "ignore", "-c", FORKED], check=True, timeout=120)


def test_a_network_is_fitted_to_a_data_frame(agrees):
    pandas = pytest.importorskip("pandas")
    random = np.random.default_rng(7)
    frame = pandas.DataFrame({"x": random.uniform(-1, 1, 2000), "v": random.uniform(-2, 2, 2000)})
    frame["force"] = -3 * frame.x**3 + 0.5 * np.tanh(frame.v)
    surrogate = metafmu.fit(frame[["x", "v"]], frame["force"], inputs={"x": "m", "v": "m/s"}, outputs={"force": "N"}, hidden=(32, 32))
    found = surrogate.predict(frame)
    assert surrogate.accuracy["force"]["r2"] > 0.9999
    assert np.sqrt(np.mean((found[:, 0] - frame.force) ** 2)) < 0.01 * frame.force.std()
    assert (surrogate.inputs[0].unit, surrogate.outputs[0].name) == ("m", "force")
    agrees(surrogate, frame[["x", "v"]].to_numpy(), found, 1e-12)


def test_names_of_a_fit_are_those_of_the_columns_however_they_are_spelled():
    frame, y = flow_and_temp()
    fit = lambda x=frame, y=y, **names: metafmu.fit(x, y, epochs=1, hidden=(4,), **names)
    with pytest.raises(metafmu.Error, match="the order of `inputs` is Temp, FLOW, that of the model's columns flow, temp: by position `Temp` would be `flow`"):
        fit(inputs=["Temp", "FLOW"])
    both = y.to_frame("heat").assign(loss=-y)
    with pytest.raises(metafmu.Error, match="the order of `outputs` is Loss, Heat, that of"):
        fit(y=both, outputs=["Loss", "Heat"])
    with pytest.raises(metafmu.Error, match="inputs.flow: 80 % of the rows of training data are outside of its range from 0 to 0.2, they are from 0.00"):
        fit(inputs={"flow": (0, 0.2), "temp": (300, 400)})
    with pytest.warns(metafmu.AccuracyWarning):
        assert [item.name for item in fit(inputs=["FLOW", "Temp [K]"]).inputs] == ["FLOW", "Temp [K]"]


WITHOUT_SKLEARN = """
import sys
sys.modules["sklearn"] = sys.modules["sklearn.base"] = None
import numpy, pandas, metafmu

x = pandas.DataFrame({"angle": [0.0, 1.0, 2.0], "speed": [1.0, 0.0, 5.0]})
model = metafmu.Regressor(epochs=1, hidden=(2,)).fit(x, [7.0, 1.0, 2.0])
model.predict(x), model.predict(x.to_numpy())
for wrong in (x[["speed", "angle"]], x.rename(columns=str.title)):
    try:
        model.predict(wrong)
    except metafmu.Error as error:
        assert "expected those that it was fitted to, in their order: angle, speed" in str(error), error
    else:
        raise SystemExit(f"{list(wrong.columns)} were taken for angle, speed")
"""


def test_the_estimator_needs_its_columns_in_order_without_scikit_learn_too():
    pytest.importorskip("pandas")
    subprocess.run([sys.executable, "-W", "ignore", "-c", WITHOUT_SKLEARN], check=True)


def test_the_accuracy_of_few_rows_is_that_of_unseen_rows():
    """The mean squared error of fits to 20 noisy rows, averaged over some draws, is that on thousands of unseen rows."""
    told, true = [], []
    for seed in range(4):
        random = np.random.default_rng(seed)
        x = random.uniform(-1, 1, (2020, 2))
        y = x[:, 0] + 0.5 * random.normal(size=2020)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", metafmu.AccuracyWarning)
            surrogate = metafmu.fit(x[:20], y[:20], hidden=(32, 32), epochs=300, random_state=seed)
        told.append(surrogate.accuracy["y"]["rmse"] ** 2)
        true.append(np.mean((surrogate.predict(x[20:])[:, 0] - y[20:]) ** 2))
    assert 0.6 < np.mean(told) / np.mean(true) < 1.7, (told, true)
    assert metafmu.Regressor(epochs=1, hidden=(2,)).fit(x, y).surrogate_.accuracy is None


@pytest.mark.parametrize("rows", [60, 500, 5000])
def test_defaults_are_good_enough_for_few_rows_and_many(rows):
    x = np.random.default_rng(9).uniform(-1, 1, (rows, 2))
    y = x[:, 0] ** 3 + x[:, 1]
    model = metafmu.Regressor().fit(x, y)
    unseen = np.random.default_rng(10).uniform(-0.9, 0.9, (500, 2))
    assert model.score(unseen, unseen[:, 0] ** 3 + unseen[:, 1]) > 0.999


def smooth(x):
    return np.stack([np.sin(2 * x[:, 0]) + np.cos(x[:, 1]), x[:, 0] * x[:, 1]], axis=1)


def relative_rmse(surrogate, x, y):
    return np.sqrt(np.mean((surrogate.predict(x) - y) ** 2, axis=0)) / y.std(axis=0)


def test_a_smooth_function_of_few_rows_is_a_gaussian_process(agrees, tmp_path):
    random = np.random.default_rng(3)
    x, unseen = random.uniform(-1, 1, (60, 2)), random.uniform(-1, 1, (1000, 2))
    surrogate = metafmu.fit(x, smooth(x), outputs=["a", "b"])
    assert surrogate.model == "gaussian-process", surrogate.candidates
    assert [row["model"] for row in surrogate.candidates] == ["polynomial", "gaussian-process", "network"]
    assert all(row["one_minus_r2"] > 0 and row["fit_seconds"] > 0 and row["note"] == "" for row in surrogate.candidates)
    network = metafmu.fit(x, smooth(x), outputs=["a", "b"], model="network")
    assert network.model == "network" and len(network.candidates) == 1
    errors = [relative_rmse(model, unseen, smooth(unseen)) for model in (surrogate, network)]
    assert (10 * errors[0] < errors[1]).all(), errors
    measured = [surrogate.accuracy[name]["rmse"] for name in "ab"] / smooth(x).std(axis=0)
    assert (measured < 10 * errors[0]).all() and (measured > errors[0] / 3).all(), (measured, errors[0])
    agrees(surrogate, unseen[:200], surrogate.predict(unseen[:200]), 1e-9)
    again = pickle.loads(pickle.dumps(surrogate))
    assert (again.model, again.candidates) == (surrogate.model, surrogate.candidates)
    loaded = metafmu.Surrogate.load(surrogate.export(tmp_path / "x.fmu", sources=True)[0])
    assert np.array_equal(loaded.predict(x), surrogate.predict(x)) and loaded.model is None and loaded.candidates == []
    # the same rows and seed make the same model
    assert metafmu.fit(x, smooth(x), outputs=["a", "b"]) == surrogate


def test_a_gaussian_process_is_exported_as_onnx_and_read_in_a_pipeline(agrees, tmp_path):
    pytest.importorskip("sklearn")
    runtime = pytest.importorskip("onnxruntime")
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    x = np.random.default_rng(3).uniform([3, -1], [4, 1], (60, 2))
    # without noise weights are 1e7, and rounding shows in the ninth digit
    y = smooth(x - [3.5, 0])[:, 0] + 1e-3 * np.random.default_rng(4).normal(size=60)
    model = make_pipeline(StandardScaler(), metafmu.Regressor(model="gaussian-process")).fit(x, y)
    surrogate = metafmu.from_sklearn(model, data=x)
    agrees(surrogate, x, model.predict(x), 1e-9)
    surrogate.to_onnx(tmp_path / "x.onnx")
    session = runtime.InferenceSession(tmp_path / "x.onnx")
    [found] = session.run(None, {session.get_inputs()[0].name: x})
    assert np.abs(found[:, 0] - model.predict(x)).max() < 1e-9 * np.ptp(y)


def with_noise(rows=100, seed=5, noise=0.1):
    random = np.random.default_rng(seed)
    x = random.uniform(-1, 1, (rows, 2))
    return x, smooth(x) + noise * random.normal(size=(rows, 2))


def test_a_gaussian_process_predicts_standard_deviations_as_scikit_learn_does(agrees, tmp_path):
    x, y = with_noise()
    surrogate = metafmu.fit(x, y, outputs=["a", "b"], std=True)
    assert surrogate.model == "gaussian-process" and len(surrogate.candidates) == 1 and surrogate.has_std
    unseen, truth = with_noise(2000, seed=6)
    found, std = surrogate.predict(unseen, return_std=True)
    assert found.shape == std.shape == (2000, 2) and np.array_equal(found, surrogate.predict(unseen))
    assert [item.name for item in surrogate.outputs] == ["a", "b"] and surrogate.jacobian(x).shape == (100, 2, 2)
    within = (np.abs(found - truth) <= 2 * std).mean(axis=0)
    assert (0.92 < within).all() and (within < 0.98).all(), within
    measured = surrogate.evaluate(unseen, truth)
    assert [measured[name]["within_two_std"] for name in "ab"] == pytest.approx(within)
    agrees(surrogate, x[:20], surrogate.predict(x[:20]), 1e-9)
    path, *_ = surrogate.export(tmp_path / "x.fmu")
    loaded = metafmu.Surrogate.load(path)
    assert loaded.has_std and np.array_equal(loaded.predict(x, return_std=True)[1], surrogate.predict(x, return_std=True)[1])
    runtime = pytest.importorskip("onnxruntime")
    surrogate.to_onnx(tmp_path / "x.onnx")
    session = runtime.InferenceSession(tmp_path / "x.onnx")
    [values] = session.run(None, {session.get_inputs()[0].name: unseen})
    np.testing.assert_allclose(values, np.hstack([found, std]), rtol=1e-7)


def test_an_estimator_returns_standard_deviations_of_the_shape_of_y(agrees):
    processes = pytest.importorskip("sklearn.gaussian_process")
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    x, y = with_noise()
    unseen = with_noise(500, seed=6)[0]
    model = metafmu.Regressor(std=True).fit(x, y[:, 0])
    found, std = model.predict(unseen, return_std=True)
    assert found.shape == std.shape == model.predict(unseen).shape == (500,)
    kernels = processes.kernels
    kernel = kernels.ConstantKernel() * kernels.RBF([1.0, 1.0]) + kernels.WhiteKernel(1e-2)
    peer = processes.GaussianProcessRegressor(kernel, normalize_y=True, n_restarts_optimizer=2, random_state=0).fit(x, y[:, 0])
    of_peer = peer.predict(unseen, return_std=True)[1]
    # there the mean is 0
    assert np.abs(std / of_peer - 1).max() < 0.05, np.abs(std / of_peer - 1).max()
    both = metafmu.Regressor(std=True).fit(x, y)
    assert [part.shape for part in both.predict(unseen, return_std=True)] == [(500, 2)] * 2 and both.predict(unseen).shape == (500, 2)
    # in a pipeline it is its prediction
    pipeline = make_pipeline(StandardScaler(), metafmu.Regressor(std=True)).fit(x, y)
    surrogate = metafmu.from_sklearn(pipeline, data=x)
    agrees(surrogate, x[:20], pipeline.predict(x[:20]), 1e-9)
    assert not surrogate.has_std


def test_standard_deviations_of_other_models_are_refused():
    x, y = with_noise()
    with pytest.raises(ValueError, match="std: linear has no predicted standard deviation, expected gaussian-process"):
        metafmu.fit(x, y, model="linear", std=True)
    with pytest.raises(ValueError, match="std: network has no predicted standard deviation"):
        metafmu.Regressor(hidden=(4,), std=True).fit(x, y)
    with pytest.raises(ValueError, match="has no predicted standard deviation, expected a Gaussian process that was fitted with std=True"):
        metafmu.Regressor(model="gaussian-process").fit(x, y).predict(x, return_std=True)
    with pytest.raises(ValueError, match="std: 1100 rows, expected 2 to 1000 for a predicted standard deviation"):
        metafmu.fit(np.tile(x, (11, 1)), np.tile(y, (11, 1)), std=True)
    with pytest.raises(ValueError, match="inputs.y_std: is the name of the predicted standard deviation of `y`"):
        metafmu.fit(x, y[:, 0], inputs=["a", "y_std"], outputs=["y"], std=True)


@pytest.mark.filterwarnings("ignore::metafmu.AccuracyWarning")
@pytest.mark.parametrize("rows", [40, 1200])
def test_of_noisy_rows_the_choice_is_about_as_good_as_the_best_candidate(rows):
    random = np.random.default_rng(5)
    x, unseen = random.normal(size=(rows, 3)), random.normal(size=(4000, 3))
    truth = lambda x: (x @ [1.0, -2.0, 0.5])[:, None]
    noisy = lambda x: truth(x) + 0.3 * random.normal(size=(len(x), 1))
    y, of_unseen = noisy(x), noisy(unseen)
    errors = {model: relative_rmse(metafmu.fit(x, y, model=model, random_state=1), unseen, of_unseen)[0] for model in ("auto", "polynomial", "network")}
    if rows <= 1000:
        errors["gaussian-process"] = relative_rmse(metafmu.fit(x, y, model="gaussian-process"), unseen, of_unseen)[0]
    assert errors["auto"] <= 1.1 * min(errors.values()), errors


def test_parameters_of_networks_make_a_network_unless_a_model_is_given(rows):
    x, y = rows
    few = {"hidden": (4,), "epochs": 3}
    kind = lambda **options: metafmu.Regressor(**options).fit(x, y)
    assert kind(**few).model_ == "network"
    auto = kind(model="auto", **few)
    assert len(auto.candidates_) == 3 and auto.model_ == "gaussian-process"
    assert auto.history_["epochs"] == 0 and auto.history_["best_epoch"] is None and auto.history_["train_loss"] == auto.history_["validation_loss"] == []
    assert kind(hidden=[64, 64], model="ridge", validation=0.3, random_state=3).model_ == "ridge"
    wrong = [
        ({"model": "knn"}, "model: `knn`, expected one of auto, network, linear, ridge, .*, gaussian-process"),
        ({"model": 3}, "model: 3, expected None or a text"),
        ({"model": "svr", **few}, 'hidden, epochs: belongs to networks, expected the default with model="svr"'),
    ]
    for options, message in wrong:
        with pytest.raises(metafmu.Error, match=message):
            kind(**options)


@pytest.mark.filterwarnings("ignore::metafmu.AccuracyWarning")
@pytest.mark.parametrize("count", [1, 2, 3, 6])
def test_a_few_rows_are_fitted(count, rows):
    x, y = rows[0][:count], rows[1][:count]
    surrogate = metafmu.fit(x, y)
    assert surrogate.model in [row["model"] for row in surrogate.candidates]
    assert np.isfinite(surrogate.predict(rows[0])).all() and (surrogate.accuracy is None) == (count == 1)


def test_the_estimator_is_one_of_scikit_learn(rows):
    pytest.importorskip("sklearn")
    from sklearn.base import clone
    from sklearn.model_selection import cross_val_score
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    x, y = rows
    model = metafmu.Regressor(hidden=(32,), epochs=300, batch=32)
    assert clone(model).get_params() == model.get_params()
    assert cross_val_score(make_pipeline(StandardScaler(), model), x, y, cv=3).min() > 0.95
    assert np.array_equal(clone(model).fit(x, y).predict(x), model.fit(x, y).predict(x))
    assert model.to_surrogate().name == "surrogate" and len(model.history_["validation_loss"]) == model.history_["epochs"]
    with pytest.raises(metafmu.Error, match="unknown variant `nothing`, expected one of `tanh`"):
        metafmu.Regressor(activation="nothing").fit(x, y)


@pytest.mark.filterwarnings("ignore")
def test_scikit_learns_own_checks_pass():
    checks = pytest.importorskip("sklearn.utils.estimator_checks")
    checks.check_estimator(metafmu.Regressor(hidden=(16,), epochs=100, batch=16))
    checks.check_estimator(metafmu.Regressor(model="gaussian-process"))


def test_the_command_is_installed(tmp_path):
    run = lambda *arguments, **options: subprocess.run([program(), *arguments], capture_output=True, text=True, cwd=tmp_path, **options)
    assert run("--version").stdout.strip() == f"metafmu {metafmu.__version__}"
    wrong = run("build", "none.toml")
    assert wrong.returncode == 2 and wrong.stderr.startswith("error: none.toml")
    assert run("nothing").returncode == 2
    (tmp_path / "study.toml").write_text(STUDY + 'baselines.build = ["ridge"]\n')
    built = run("build", "study.toml", "--json")
    assert built.returncode == 0, built.stderr
    again = subprocess.run([sys.executable, "-m", "metafmu", "validate", "out/pendulum/pendulum.fmu"], cwd=tmp_path, capture_output=True, text=True)
    assert again.returncode == 0, again.stdout + again.stderr


def test_frameworks_are_imported_only_when_they_are_used():
    code = "import metafmu, sys; assert not {'numpy', 'torch', 'sklearn', 'jax', 'keras'} & set(sys.modules); metafmu.Surrogate; assert 'sklearn' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
    assert set(metafmu.__all__) <= set(dir(metafmu))
    assert all(getattr(metafmu, name) is not None for name in metafmu.__all__)


def test_onnx_files_are_read_and_compared_with_onnxruntime(rows, agrees, tmp_path, monkeypatch):
    onnx = pytest.importorskip("onnx")
    weight = np.random.default_rng(8).normal(size=(3, 4)).astype(np.float64)
    graph = onnx.helper.make_graph(
        [onnx.helper.make_node("MatMul", ["x", "w"], ["h"]), onnx.helper.make_node("Tanh", ["h"], ["y"])], "g",
        [onnx.helper.make_tensor_value_info("x", onnx.TensorProto.DOUBLE, ["n", 3])],
        [onnx.helper.make_tensor_value_info("y", onnx.TensorProto.DOUBLE, ["n", 4])], [onnx.numpy_helper.from_array(weight, "w")],
    )
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 17)])
    onnx.save(model, tmp_path / "net.onnx")
    for source in (tmp_path / "net.onnx", (tmp_path / "net.onnx").read_bytes(), model):
        surrogate = metafmu.from_onnx(source, data=rows[0])
    agrees(surrogate, rows[0], np.tanh(rows[0] @ weight), 1e-12)
    assert [item.name for item in surrogate.outputs] == ["y[0]", "y[1]", "y[2]", "y[3]"]
    runtime = pytest.importorskip("onnxruntime")
    other = onnx.load(tmp_path / "net.onnx")
    other.graph.node[1].op_type = "Sin"
    session = runtime.InferenceSession
    monkeypatch.setattr(runtime, "InferenceSession", lambda _, *options, **more: session(other.SerializeToString(), *options, **more))
    with pytest.raises(metafmu.Error, match="the ONNX model was read wrongly: predictions differ by"):
        metafmu.from_onnx(model, data=rows[0])
    monkeypatch.setattr(runtime, "InferenceSession", lambda *_, **__: session(b"nothing"))
    with pytest.warns(UserWarning, match="was not compared with onnxruntime, which does not run it"):
        metafmu.from_onnx(model, data=rows[0])
    with pytest.raises(metafmu.Error, match="not an ONNX model"):
        metafmu.from_onnx(b"nothing", data=rows[0])


def single_onnx(nodes, **numbers):
    """An ONNX model of a column `x` in single precision: operators with their operands, one after the other, to `y`."""
    onnx = pytest.importorskip("onnx")
    helper = onnx.helper
    steps = [helper.make_node(operator, [*operands], ["y" if place == len(nodes) - 1 else f"v{place}"]) for place, (operator, *operands) in enumerate(nodes)]
    tensor = lambda name: helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, ["n", 1])
    constants = [onnx.numpy_helper.from_array(np.array([value], np.float32), name) for name, value in numbers.items()]
    graph = helper.make_graph(steps, "g", [tensor("x")], [tensor("y")], constants)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])


@pytest.mark.parametrize(
    ("nodes", "numbers", "ends"),
    [
        # around -0.2 the sigmoid has few digits in single precision, below -0.25 it is 0
        ([("Mul", "x", "a"), ("Sigmoid", "v0"), ("Log", "v1")], {"a": 80.0}, (-0.3, -0.1)),
        ([("Mul", "x", "a"), ("Sigmoid", "v0"), ("Log", "v1")], {"a": 80.0}, (-1.0, 1.0)),
        # exactly 0 in single precision, 1.5e-8 x in double precision
        ([("Mul", "x", "a"), ("Mul", "v0", "b"), ("Sub", "v1", "x")], {"a": 0.1, "b": 10.0}, (1.0, 2.0)),
        # a difference of large numbers
        ([("Add", "x", "a"), ("Sub", "v0", "a")], {"a": 1e6}, (-1.0, 2.0)),
    ],
)
def test_what_rounding_explains_is_not_read_wrongly(nodes, numbers, ends, monkeypatch):
    runtime = pytest.importorskip("onnxruntime")
    model = single_onnx(nodes, **numbers)
    metafmu.from_onnx(model, inputs={"x": ends})
    # a model that is another one is still refused
    other = single_onnx([*nodes, ("Add", "v%d" % (len(nodes) - 1), "c")], **numbers, c=100.0)
    session = runtime.InferenceSession
    monkeypatch.setattr(runtime, "InferenceSession", lambda _, *options, **more: session(other.SerializeToString(), *options, **more))
    with pytest.raises(metafmu.Error, match="was read wrongly: predictions differ by [^;]{,60};") as error:
        metafmu.from_onnx(model, inputs={"x": ends})
    # no sentinel
    assert not re.search(r"e\+?[23]\d\d", str(error.value)), error.value


def test_columns_go_by_the_names_of_an_onnx_model(goes_by_names, tmp_path):
    onnx = pytest.importorskip("onnx")
    helper, double = onnx.helper, onnx.TensorProto.DOUBLE
    tensor = lambda name: helper.make_tensor_value_info(name, double, [None, 1])
    nodes = [helper.make_node("Concat", ["flow", "temp"], ["x"], axis=1), helper.make_node("MatMul", ["x", "w"], ["heat"])]
    graph = helper.make_graph(nodes, "g", [tensor("flow"), tensor("temp")], [tensor("heat")], [helper.make_tensor("w", double, [2, 1], [100.0, 2.0])])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    frame, y = flow_and_temp()
    goes_by_names(lambda **names: metafmu.from_onnx(model, **names), lambda rows: y, 1e-12, True)
    chosen = metafmu.from_onnx(model, inputs={"hot": {"column": "temp"}, "amount": {"column": "flow"}}, data=frame)
    assert [(item.name, item.max) for item in chosen.inputs] == [("hot", frame.temp.max()), ("amount", frame.flow.max())]
    for missing in (tmp_path / "none.onnx", tmp_path, 3):
        with pytest.raises(metafmu.Error, match="expected an ONNX file"):
            metafmu.from_onnx(missing)
