"""`metafmu import` of models with states: recurrent cells beside ONNX Runtime in a loop, neural differential equations beside scipy."""

import fmpy
import numpy as np
import onnx
import onnxruntime
import pandas as pd
import pytest
from conftest import fmu_of, metafmu
from fmpy import simulate_fmu
from fmpy.validation import validate_fmu
from graphs import DOUBLE, FLOAT, integers, model, node, reals
from onnx import numpy_helper
from onnx.reference import ReferenceEvaluator
from scipy.integrate import solve_ivp

SAMPLES, SAMPLE_TIME = 1000, 0.01
TOLERANCE = {np.float32: 1e-6, np.float64: 1e-12}
INPUTS = 3
HIDDEN = 4
GATES = {"LSTM": 4, "GRU": 3, "RNN": 1}

CELLS = {
    "lstm": ("LSTM", {}, {}),
    "lstm-peepholes": ("LSTM", {}, {"p": (1, 3 * HIDDEN)}),
    "lstm-coupled": ("LSTM", {"input_forget": 1}, {}),
    "lstm-functions": ("LSTM", {"activations": ["HardSigmoid", "Softsign", "ScaledTanh"], "activation_alpha": [0.25, 1.5], "activation_beta": [0.5, 0.75]}, {}),
    "gru": ("GRU", {}, {}),
    "gru-linear-before-reset": ("GRU", {"linear_before_reset": 1}, {}),
    "gru-functions": ("GRU", {"activations": ["Sigmoid", "LeakyRelu"], "activation_alpha": [0.125]}, {}),
    "rnn": ("RNN", {}, {}),
    "rnn-relu": ("RNN", {"activations": ["Relu"]}, {}),
}
# what the definition of ONNX in numpy has; ONNX Runtime has no cells in double precision
DOUBLE_CELLS = ["lstm", "lstm-peepholes", "gru", "gru-linear-before-reset", "rnn"]


def cell(name, of=np.float32, explicit=True, sequence=None):
    """A cell and a layer: inputs x, h0, c0 and outputs y, h1, c1, or x and y alone; the sequence stands before the batch."""
    operator, attributes, more = CELLS[name]
    # independent of the tests that ran before
    random = np.random.default_rng(list(name.encode()))
    drawn = lambda *shape: random.uniform(-1.0, 1.0, shape).astype(of)
    gates, kind = GATES[operator], FLOAT if of == np.float32 else DOUBLE
    constants = {
        "w": drawn(1, gates * HIDDEN, INPUTS), "r": 0.4 * drawn(1, gates * HIDDEN, HIDDEN), "b": drawn(1, 2 * gates * HIDDEN),
        "v": drawn(HIDDEN, 2), "s": integers(-1, HIDDEN), **{key: drawn(*shape) for key, shape in more.items()},
    }
    is_lstm = operator == "LSTM"
    states = ["h0", "c0"] if is_lstm else ["h0"]
    given = " ".join(states) if explicit else " ".join("-" for _ in states)
    text = f"x w r b - {given}" + (" p" if more else "")
    made = "Y h1 c1" if is_lstm else "Y h1"
    nodes = [node(operator, text, made, hidden_size=HIDDEN, **attributes), node("Reshape", "Y s", "last"), node("MatMul", "last v", "y")]
    inputs = [("x", ["n" if sequence is None else sequence, 1, INPUTS])]
    outputs = [("y", None)]
    if explicit:
        inputs = [("x", [1, 1, INPUTS])] + [(state, [1, 1, HIDDEN]) for state in states]
        outputs += [(state.replace("0", "1"), None) for state in states]
    return model(nodes, constants, inputs=inputs, outputs=outputs, kind=kind)


def session_of(graph):
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    return onnxruntime.InferenceSession(graph.SerializeToString(), options)


def signal(of=np.float32):
    times = np.arange(SAMPLES) * SAMPLE_TIME
    return np.stack([np.sin(3.0 * times), np.sign(np.sin(1.7 * times)), np.random.default_rng(5).uniform(-1, 1, SAMPLES)], axis=1).astype(of)


def looped(graph, x, of):
    """Outputs of the cell step by step: of ONNX Runtime in single precision, of the definition in numpy in double."""
    runner = session_of(graph) if of == np.float32 else ReferenceEvaluator(graph)
    names = [value.name for value in graph.graph.output]
    states = {value.name: np.zeros((1, 1, HIDDEN), of) for value in graph.graph.input if value.name != "x"}
    found = []
    for row in x:
        results = dict(zip(names, runner.run(None, {"x": row[None, None], **states})))
        found.append(np.ravel(results["y"]))
        states = {name: np.asarray(results[name.replace("0", "1")], of) for name in states}
    return np.array(found)


def rounding(graph, x, expected):
    """Rounding error accumulated in ONNX Runtime's loop in single precision, relative to the range, against the definition in double
    precision with the same weights."""
    double = onnx.ModelProto()
    double.CopyFrom(graph)
    for constant in double.graph.initializer:
        array = numpy_helper.to_array(constant)
        if array.dtype == np.float32:
            constant.CopyFrom(numpy_helper.from_array(array.astype(float), constant.name))
    for value in [*double.graph.input, *double.graph.output]:
        value.type.tensor_type.elem_type = DOUBLE
    exact = looped(double, x.astype(float), np.float64)
    return (np.abs(exact - expected) / np.ptp(exact, axis=0)).max()


def table_of(folder, x, y):
    """A run: the outputs of a sample are there when the next one comes."""
    rows = len(x) + 1
    data = {"time": np.arange(rows) * SAMPLE_TIME}
    for k in range(INPUTS):
        data["abc"[k]] = np.append(x[:, k], 0.0)
    for k in range(y.shape[1]):
        data[f"y{k}"] = np.insert(y[:, k], 0, 0.0)
    pd.DataFrame(data).to_csv(folder / "run.csv", index=False, float_format="%.17g")
    return folder / "run.csv"


ENDS = "min = -1.0\nmax = 1.0\n"


def interface(states="", outputs='[outputs.y0]\ncolumn = "y[0]"\n[outputs.y1]\ncolumn = "y[1]"\n', time=f"sample = {SAMPLE_TIME}", inputs=None):
    inputs = inputs or "".join(f'[inputs.{name}]\ncolumn = "x[{k}]"\n{ENDS}' for k, name in enumerate("abc"))
    return f'name = "cell"\n[time]\n{time}\n{inputs}{states}{outputs}'


H0 = '[states.h]\ncolumn = "h0"\nnext = "h1"\nstart = 0.0\n'
C0 = '[states.m]\ncolumn = "c0"\nnext = "c1"\nstart = 0.0\n'


def imported(folder, graph, text, *more):
    (folder / "cell.onnx").write_bytes(graph.SerializeToString())
    (folder / "interface.toml").write_text(text)
    return metafmu("import", "cell.onnx", "--interface", "interface.toml", "--out", "cell.safetensors", *more, cwd=folder)


@pytest.mark.parametrize("name, of", [(name, np.float32) for name in CELLS] + [(name, np.float64) for name in DOUBLE_CELLS])
def test_a_thousand_samples_of_a_cell_are_those_of_a_loop(tmp_path, name, of):
    graph, x = cell(name, of), signal(of)
    expected = looped(graph, x, of)
    assert np.ptp(expected, axis=0).min() > 0.05
    states = H0 + (C0 if CELLS[name][0] == "LSTM" else "")
    tolerance = TOLERANCE[of]
    if of == np.float32 and name in DOUBLE_CELLS:
        # weights are drawn, and some loops amplify what is rounded
        tolerance += rounding(graph, x, expected)
        assert tolerance < 1e-4
    run = imported(tmp_path, graph, interface(states), "--check", table_of(tmp_path, x, expected), "--tolerance", str(tolerance))
    assert "y1: largest difference" in run.stdout
    metafmu("predict", "cell.safetensors", "run.csv", "--out", "out.csv", cwd=tmp_path)
    found = pd.read_csv(tmp_path / "out.csv")[["y0", "y1"]].to_numpy()[1:]
    assert np.all(np.abs(found - expected) <= tolerance * np.ptp(expected, axis=0))


@pytest.mark.parametrize("name", ["lstm", "gru", "rnn"])
def test_a_cell_that_begins_with_zeros_is_a_state_of_the_model(tmp_path, name):
    """Beside ONNX Runtime with the whole sequence at once."""
    graph, x = cell(name, explicit=False), signal()
    expected = session_of(graph).run(None, {"x": x[:, None]})[0]
    run = imported(tmp_path, graph, interface(), "--check", table_of(tmp_path, x, expected), "--tolerance", "1e-6")
    assert "y1: largest difference" in run.stdout
    # the samples have another order than that of the check
    (tmp_path / "cell.safetensors").unlink()
    wrong = table_of(tmp_path, x, expected[::-1])
    run = metafmu("import", "cell.onnx", "--interface", "interface.toml", "--check", wrong, "--out", "cell.safetensors", cwd=tmp_path, check=False)
    assert run.returncode == 1 and "not what was expected" in run.stdout and not (tmp_path / "cell.safetensors").exists()


def test_windows_of_past_samples_are_states(tmp_path):
    """A model that has the last samples of inputs and outputs as inputs, and moves them on, beside ONNX Runtime in a loop."""
    random = np.random.default_rng(8)
    drawn = lambda *shape: random.uniform(-0.5, 0.5, shape).astype(np.float32)
    constants = {
        "one": integers(1), "zero": integers(0), "end": integers(9), "flat": integers(1, -1), "w": drawn(4 * INPUTS + INPUTS + 2 * 2, 6), "v": drawn(6, 2),
    }
    nodes = [
        node("Reshape", "U flat", "pastU"), node("Reshape", "X flat", "pastX"), node("Concat", "pastU x pastX", "all", axis=1),
        node("MatMul", "all w", "a"), node("Tanh", "a", "t"), node("MatMul", "t v", "y"),
        node("Slice", "U one end zero", "laterU"), node("Concat", "laterU x", "U1", axis=0),
        node("Slice", "X one end zero", "laterX"), node("Concat", "laterX y", "X1", axis=0),
    ]
    inputs = [("U", [4, INPUTS]), ("X", [2, 2]), ("x", [1, INPUTS])]
    graph = model(nodes, constants, inputs=inputs, outputs=[("y", [1, 2]), ("U1", [4, INPUTS]), ("X1", [2, 2])])
    session, x = session_of(graph), signal()
    states, expected = {"U": np.zeros((4, INPUTS), np.float32), "X": np.zeros((2, 2), np.float32)}, []
    for row in x:
        y, later_u, later_x = session.run(None, {"x": row[None], **states})
        expected.append(y.ravel())
        states = {"U": later_u, "X": later_x}
    expected = np.array(expected)
    assert np.ptp(expected, axis=0).min() > 0.05
    (tmp_path / "cell.onnx").write_bytes(graph.SerializeToString())
    metafmu("import", "cell.onnx", "--new", "starter.toml", cwd=tmp_path)
    starter = (tmp_path / "starter.toml").read_text()
    assert '[states.U]\ncolumn = "U"\nnext = "U1"' in starter and '[states.X]\ncolumn = "X"\nnext = "X1"' in starter, starter
    windows = '[states.U]\ncolumn = "U"\nnext = "U1"\nstart = 0.0\n[states.X]\ncolumn = "X"\nnext = "X1"\nstart = 0.0\n'
    run = imported(tmp_path, graph, interface(windows), "--check", table_of(tmp_path, x, expected), "--tolerance", "1e-6")
    assert "y1: largest difference" in run.stdout


@pytest.mark.parametrize("version", [2, 3])
def test_the_fmu_of_a_cell_in_fmpy(tmp_path, version):
    """A whole run, states that are set again and serialized in the middle of it, and steps that are not samples."""
    graph, x = cell("lstm"), signal()
    expected = looped(graph, x, np.float32)
    scale = np.ptp(expected, axis=0)
    shown = '[outputs.y0]\ncolumn = "y[0]"\n[outputs.y1]\ncolumn = "y[1]"\n[outputs.memory]\ncolumn = "c1[0]"\n'
    single = "".join(f'[states.m{k}]\ncolumn = "c0[{k}]"\nnext = "c1[{k}]"\nstart = 0.0\n' for k in range(HIDDEN))
    imported(tmp_path, graph, interface(H0 + single, shown))
    metafmu("export", "cell.safetensors", "--fmi", str(version), "--out", tmp_path, cwd=tmp_path)
    fmu = fmu_of(tmp_path, "cell", version)
    assert not validate_fmu(str(fmu))
    assert metafmu("validate", fmu).returncode == 0
    description = fmpy.read_model_description(str(fmu))
    names = {variable.name: variable for variable in description.modelVariables}
    # hidden states are no variables; one that is shown has a start
    assert "memory_start" in names and not any(name.startswith(("h", "m0", "m1")) for name in names)
    assert description.modelExchange is None
    times = np.arange(SAMPLES) * SAMPLE_TIME
    held = np.array([tuple(row) for row in np.c_[times, x]], dtype=[(name, float) for name in ["time", *"abc"]])
    result = simulate_fmu(str(fmu), input=held, stop_time=SAMPLES * SAMPLE_TIME, output_interval=SAMPLE_TIME, step_size=SAMPLE_TIME, output=["y0", "y1"])
    found = np.stack([result["y0"], result["y1"]], axis=1)[1:]
    assert len(found) == SAMPLES and np.all(np.abs(found - expected) <= 1e-6 * scale)

    reference = {name: variable.valueReference for name, variable in names.items()}
    instance = fmpy.instantiate_fmu(fmpy.extract(str(fmu)), description, "CoSimulation")
    new = version == 3
    put = instance.setFloat64 if new else instance.setReal
    get = instance.getFloat64 if new else instance.getReal
    if new:
        instance.enterInitializationMode(startTime=0.0)
    else:
        instance.setupExperiment(startTime=0.0)
        instance.enterInitializationMode()
    instance.exitInitializationMode()

    def steps(first, last, parts=1):
        outputs = []
        for k in range(first, last):
            put([reference[name] for name in "abc"], x[k].tolist())
            for part in range(parts):
                instance.doStep((k + part / parts) * SAMPLE_TIME, SAMPLE_TIME / parts)
            outputs.append(get([reference["y0"], reference["y1"]]))
        return np.array(outputs)

    assert np.all(np.abs(steps(0, 100) - expected[:100]) <= 1e-6 * scale)
    state = instance.getFMUState() if new else instance.getFMUstate()
    data = instance.serializeFMUState(state) if new else instance.serializeFMUstate(state)
    first = steps(100, 150)
    (instance.setFMUState if new else instance.setFMUstate)(state)
    assert np.array_equal(steps(100, 150, parts=1), first)
    (instance.freeFMUState if new else instance.freeFMUstate)(state)
    again = instance.deserializeFMUState(data) if new else instance.deSerializeFMUstate(data)
    (instance.setFMUState if new else instance.setFMUstate)(again)
    assert np.all(np.abs(steps(100, 150, parts=4) - first) <= 1e-12)
    assert np.all(np.abs(first - expected[100:150]) <= 1e-6 * scale)
    (instance.freeFMUState if new else instance.freeFMUstate)(again)
    instance.terminate()
    instance.freeInstance()


def right_side():
    """x1' and x2' of a force and both states, a network, and a power as an output."""
    constants = {
        "w": reals(3, 16, of=np.float64), "b": reals(16, of=np.float64), "v": reals(16, 2, of=np.float64),
        "a": np.array([[-0.4, -2.0], [2.0, -0.4]]), "k": reals(2, 1, of=np.float64),
    }
    nodes = [
        node("Concat", "u x", "z", axis=1), node("MatMul", "z w", "m"), node("Add", "m b", "s"), node("Tanh", "s", "t"), node("MatMul", "t v", "n"),
        node("MatMul", "x a", "l"), node("Add", "l n", "dx"), node("MatMul", "n k", "power"),
    ]
    return model(nodes, constants, inputs=[("u", ["n", 1]), ("x", ["n", 2])], outputs=[("dx", None), ("power", None)], kind=DOUBLE)


FLOW = """
name = "flow"
[time]
step = 0.05
stop = 10.0
[inputs.force]
column = "u"
min = -2.0
max = 2.0
[states.angle]
column = "x[0]"
derivative = "dx[0]"
start = 0.5
min = -3.0
max = 3.0
unit = "rad"
[states.speed]
column = "x[1]"
derivative = "dx[1]"
start = -0.25
[outputs.angle]
column = "x[0]"
unit = "rad"
[outputs.power]
column = "power"
"""


@pytest.mark.parametrize("version", [2, 3])
def test_a_neural_differential_equation_is_that_of_scipy(tmp_path, version):
    """The right-hand side is that of ONNX Runtime, in co-simulation and in model exchange."""
    graph = right_side()
    session = session_of(graph)

    def respond(time, x):
        force = np.array([[1.5 if time < 2.0 else -0.5]])
        return [np.ravel(value) for value in session.run(None, {"u": force, "x": np.asarray(x)[None]})]

    times = np.linspace(0.0, 10.0, 201)
    parts = []
    for begin, end, start in [(0.0, 2.0, [0.5, -0.25]), (2.0, 10.0, None)]:
        start = start or parts[-1].y[:, -1]
        held = begin + 1e-9
        inside = times[(times >= begin - 1e-9) & (times <= end + 1e-9)]
        solved = solve_ivp(lambda t, x: respond(max(t, held) if begin else min(t, 1.9), x)[0], (begin, end), start, "DOP853", inside.clip(begin, end), rtol=1e-12, atol=1e-12)
        parts.append(solved)
    expected = np.concatenate([parts[0].y.T, parts[1].y.T[1:]])
    imported(tmp_path, graph, FLOW)
    metafmu("export", "cell.safetensors", "--fmi", str(version), "--out", tmp_path, cwd=tmp_path)
    fmu = fmu_of(tmp_path, "flow", version)
    assert not validate_fmu(str(fmu))
    assert metafmu("validate", fmu).returncode == 0
    force = np.array([(0.0, 1.5), (2.0, 1.5), (2.0, -0.5), (10.0, -0.5)], dtype=[("time", float), ("force", float)])
    scale = np.ptp(expected[:, 0])
    result = simulate_fmu(str(fmu), input=force, stop_time=10.0, output_interval=0.05, step_size=0.05, output=["angle", "power", "speed"])
    assert np.abs(result["angle"] - expected[:, 0]).max() < 1e-7 * scale
    assert np.abs(result["speed"] - expected[:, 1]).max() < 1e-7 * np.ptp(expected[:, 1])
    power = [respond(min(time, 1.9), x)[1][0] if time < 2.0 - 1e-9 else None for time, x in zip(times, expected)]
    assert max(abs(found - power) for found, power in zip(result["power"], power) if power is not None) < 1e-6
    # without a jump, and with another start: model exchange, by the host's solver
    start = {"angle_start": -0.5, "speed_start": 1.0, "force": 1.5}
    solved = solve_ivp(lambda _, x: respond(0.0, x)[0], (0.0, 10.0), [-0.5, 1.0], "DOP853", times, rtol=1e-12, atol=1e-12)
    result = simulate_fmu(str(fmu), fmi_type="ModelExchange", start_values=start, stop_time=10.0, output_interval=0.05, relative_tolerance=1e-10, output=["angle"])
    found = np.interp(times, result["time"], result["angle"])
    assert np.abs(found - solved.y[0]).max() < 1e-4 * scale
    # derivatives at the start, and along the states
    description = fmpy.read_model_description(str(fmu))
    reference = {variable.name: variable.valueReference for variable in description.modelVariables}
    assert {"angle_state", "speed", "der(angle_state)", "der(speed)"} <= set(reference)
    metafmu("predict", "cell.safetensors", "--out", "out.csv", table_of_forces(tmp_path), cwd=tmp_path)
    constant = solve_ivp(lambda _, x: respond(0.0, x)[0], (0.0, 10.0), [0.5, -0.25], "DOP853", times, rtol=1e-12, atol=1e-12)
    assert np.abs(pd.read_csv(tmp_path / "out.csv")["angle"] - constant.y[0]).max() < 1e-7 * scale


def table_of_forces(folder):
    pd.DataFrame({"time": np.linspace(0.0, 10.0, 201), "force": 1.5}).to_csv(folder / "forces.csv", index=False, float_format="%.17g")
    return folder / "forces.csv"


def test_the_starter_proposes_what_names_say(tmp_path):
    (tmp_path / "cell.onnx").write_bytes(cell("lstm").SerializeToString())
    metafmu("import", "cell.onnx", "--new", "interface.toml", cwd=tmp_path)
    text = (tmp_path / "interface.toml").read_text()
    for expected in ['[states.h0]\ncolumn = "h0"\nnext = "h1"', '[states.c0]\ncolumn = "c0"\nnext = "c1"', "sample = 0.01"]:
        assert expected in text, text
    assert "[inputs.h0" not in text and "[outputs.h1" not in text
    text = text.replace("# min =       # the training range\n# max =\n", ENDS)
    imported(tmp_path, cell("lstm"), text)
    (tmp_path / "cell.onnx").write_bytes(cell("gru", explicit=False).SerializeToString())
    metafmu("import", "cell.onnx", "--new", "implicit.toml", cwd=tmp_path)
    assert "# the model keeps Y.h from one sample to the next" in (tmp_path / "implicit.toml").read_text()
    # a differential equation without inputs shows its states
    for number, derivative in enumerate(("dx", "x_dot", "der(x)")):
        flow = model([node("Mul", "x k", derivative)], {"k": np.array([-1.0, -2.0])}, inputs=[("x", [1, 2])], outputs=[(derivative, [1, 2])], kind=DOUBLE)
        (tmp_path / "flow.onnx").write_bytes(flow.SerializeToString())
        metafmu("import", "flow.onnx", "--new", f"flow{number}.toml", cwd=tmp_path)
        text = (tmp_path / f"flow{number}.toml").read_text()
        assert f'[states.x]\ncolumn = "x"\nderivative = "{derivative}"' in text and "step = 0.01" in text and "[inputs" not in text, text
        imported(tmp_path, flow, text.replace("start = 0.0", "start = 1.0"))
        metafmu("export", "cell.safetensors", "--out", tmp_path, cwd=tmp_path)
        result = simulate_fmu(str(fmu_of(tmp_path, "flow", 2)), stop_time=1.0, output_interval=0.1)
        assert abs(result["x_0"][-1] - np.exp(-1)) < 1e-8 and abs(result["x_1"][-1] - np.exp(-2)) < 1e-8
    # numbers are no names of states
    numbered = model([node("Tanh", "0", "1")], inputs=[("0", [1, 3])], outputs=[("1", [1, 3])])
    (tmp_path / "numbered.onnx").write_bytes(numbered.SerializeToString())
    metafmu("import", "numbered.onnx", "--new", "numbered.toml", cwd=tmp_path)
    text = (tmp_path / "numbered.toml").read_text()
    assert "[states" not in text and text.count("[inputs.") == text.count("[outputs.") == 3


def test_a_model_whose_simulations_all_end_is_refused(tmp_path):
    """x' = x², which is infinite after 1 s."""
    square = model([node("Mul", "x x", "dx")], inputs=[("x", [1, 1])], outputs=[("dx", [1, 1])], kind=DOUBLE)
    (tmp_path / "square.onnx").write_bytes(square.SerializeToString())
    interface = 'name = "square"\n[time]\nstep = 0.01\nstop = STOP\n[states.x]\ncolumn = "x"\nderivative = "dx"\nstart = 1.0\n[outputs.x]\ncolumn = "x"\n'
    for stop, is_refused in (("0.9", False), ("2.0", True)):
        (tmp_path / "i.toml").write_text(interface.replace("STOP", stop))
        run = metafmu("import", "square.onnx", "--interface", "i.toml", cwd=tmp_path, check=False)
        assert (run.returncode != 0) == is_refused, run.stderr
    assert "no simulation stays finite" in run.stderr


def test_the_solver_follows_stiff_equations_whose_start_is_an_equilibrium(tmp_path):
    """x' = -a x stays at 0 with any step, and from another start with a short one only."""
    interface = 'name = "decay"\n[time]\nstep = 0.05\nstop = 1.0\n[states.x]\ncolumn = "x"\nderivative = "dx"\nstart = 0.0\n[outputs.x]\ncolumn = "x"\n'
    (tmp_path / "i.toml").write_text(interface)
    for rate in (1e3, 1e5):
        decay = model([node("Mul", "x a", "dx")], {"a": np.array([[-rate]])}, inputs=[("x", [1, 1])], outputs=[("dx", [1, 1])], kind=DOUBLE)
        (tmp_path / "decay.onnx").write_bytes(decay.SerializeToString())
        metafmu("import", "decay.onnx", "--interface", "i.toml", cwd=tmp_path)
        metafmu("export", "decay.safetensors", cwd=tmp_path)
        result = simulate_fmu(str(tmp_path / "decay.fmu"), start_values={"x_start": 1.0}, stop_time=1.0, output_interval=0.05)
        assert np.abs(result["x"] - np.exp(-rate * result["time"])).max() < 1e-9


MISTAKES = {
    "sample": (interface(H0 + C0, time="step = 0.1"), "time.sample: is missing: expected the time between a state and its next value"),
    "start": (interface(H0.replace("start = 0.0\n", "") + C0), "states.h: no `start`, expected its value at the start"),
    "neither": (interface(H0.replace('next = "h1"\n', "") + C0), "states.h: neither `next` nor `derivative`"),
    "both": (interface(H0 + 'derivative = "h1"\n' + C0), "states.h: both `next` and `derivative`, expected one of them"),
    "kinds": (interface(H0 + C0.replace("next", "derivative")), "states.m.derivative: other states have a `next` value"),
    "unknown-input": (interface(H0.replace("h0", "h2") + C0), 'states.h.column: "h2" is no column of the model\'s inputs'),
    "unknown-output": (interface(H0.replace("h1", "h2") + C0), 'states.h.next: "h2" is no column of the model\'s outputs'),
    "twice": (interface(H0 + C0.replace("c1", "h1")), 'states.m.next: "h1[0]" is that of the state `h[0]` already'),
    "taken": (interface(H0 + C0.replace("c0", "h0")), 'states.m.column: "h0[0]" is the column of the state `h[0]` already'),
    "width": (interface(H0.replace('"h1"', '"y"') + C0), 'states.h.next: "y" has 2 columns, but "h0" has 4 columns: expected one for each'),
    "input": (interface(H0 + C0 + '[inputs.d]\ncolumn = "h0[0]"\n' + ENDS), 'inputs.d.column: "h0[0]" is no column of the model\'s inputs'),
    "missing": (interface(H0), "no input for the columns c0[0], c0[1], c0[2]"),
    "solver": (interface(H0 + C0, time=f"sample = {SAMPLE_TIME}\nsolver_step = 0.1"), "time.solver_step: belongs to states that have a `derivative`"),
    "range": (interface(H0 + "min = 0.0\n" + C0), "states.h.min: belongs to a state that has a `derivative`"),
    "time": (interface(H0 + C0).replace("[inputs.a]\n", '[inputs.a]\ncausality = "time"\n'), 'inputs.a.causality: "time", of a model with states'),
    "name": (interface(H0.replace("states.h", "states.a") + C0), "states.a: `a` is an input already"),
    "shown": (interface(H0 + C0, '[outputs.y0]\ncolumn = "h0[1]"\n[outputs.y1]\ncolumn = "h1[1]"\n'), "outputs.y1.column: the state `h[1]` is another output already"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes_of_states(tmp_path, name):
    text, message = MISTAKES[name]
    (tmp_path / "model.onnx").write_bytes(cell("lstm").SerializeToString())
    (tmp_path / "interface.toml").write_text(text)
    run = metafmu("import", "model.onnx", "--interface", "interface.toml", cwd=tmp_path, check=False)
    assert run.returncode == 2 and message in run.stderr, run.stderr
    assert "interface.toml:" in run.stderr


def test_mistakes_are_named_all_at_once(tmp_path):
    (tmp_path / "model.onnx").write_bytes(cell("lstm").SerializeToString())
    (tmp_path / "interface.toml").write_text(interface(H0.replace("start = 0.0\n", "") + C0.replace('next = "c1"\n', ""), time="stop = 1.0"))
    run = metafmu("import", "model.onnx", "--interface", "interface.toml", cwd=tmp_path, check=False)
    for message in ["states.h: no `start`", "states.m: neither", "time.sample: is missing"]:
        assert message in run.stderr, run.stderr


def changed(**attributes):
    operator, inputs = "GRU", "x w r"
    return model(
        [node(operator, inputs, "Y", hidden_size=2, **attributes)],
        {"w": reals(1, 6, 3), "r": reals(1, 6, 2)}, inputs=[("x", [1, 1, 3])], outputs=[("Y", None)],
    )


CELLS_THAT_DO_NOT_FIT = {
    "direction": (changed(direction="reverse"), '`direction` is "reverse", expected "forward": samples come one at a time'),
    "both-directions": (
        model([node("LSTM", "x w r", "Y", hidden_size=2, direction="bidirectional")], {"w": reals(2, 8, 3), "r": reals(2, 8, 2)}, inputs=[("x", [1, 1, 3])], outputs=[("Y", None)]),
        'node 0 (LSTM): attribute `direction` is "bidirectional", expected "forward"',
    ),
    "clip": (changed(clip=1.0), "attribute `clip` is 1, expected none"),
    "functions": (changed(activations=["Sigmoid", "Sine"]), 'attribute `activations`: "Sine", '),
    "sequence": (cell("gru", explicit=False, sequence=7), "a sequence of 7 samples, expected 1 or a dimension that is free"),
    "batch": (
        model([node("RNN", "x w r", "Y", hidden_size=2)], {"w": reals(1, 2, 3), "r": reals(1, 2, 2)}, inputs=[("x", [1, 5, 3])], outputs=[("Y", None)]),
        "a batch of 5, expected 1 or a dimension that is free",
    ),
    "shape": (
        model([node("RNN", "x w r", "Y", hidden_size=2)], {"w": reals(1, 2, 4), "r": reals(1, 2, 2)}, inputs=[("x", [1, 1, 3])], outputs=[("Y", None)]),
        "W has the shape [1, 2, 4], expected [1, 2, 3]",
    ),
}


@pytest.mark.parametrize("name", CELLS_THAT_DO_NOT_FIT)
def test_cells_that_do_not_fit_are_refused(tmp_path, name):
    graph, message = CELLS_THAT_DO_NOT_FIT[name]
    (tmp_path / "model.onnx").write_bytes(graph.SerializeToString())
    run = metafmu("import", "model.onnx", "--new", "interface.toml", cwd=tmp_path, check=False)
    assert run.returncode == 2 and message in run.stderr, run.stderr


def test_a_cell_and_derivatives_do_not_go_together(tmp_path):
    flow = '[states.a]\ncolumn = "x[0]"\nderivative = "y[0]"\nstart = 0.0\n'
    inputs = "".join(f'[inputs.{name}]\ncolumn = "x[{k}]"\n{ENDS}' for k, name in [(1, "b"), (2, "c")])
    text = interface(flow, '[outputs.y1]\ncolumn = "y[1]"\n', "stop = 1.0", inputs)
    (tmp_path / "model.onnx").write_bytes(cell("rnn", explicit=False).SerializeToString())
    (tmp_path / "interface.toml").write_text(text)
    run = metafmu("import", "model.onnx", "--interface", "interface.toml", cwd=tmp_path, check=False)
    assert run.returncode == 2 and "states: have a `derivative`, but `Y.h` of a recurrent cell is discrete-time" in run.stderr, run.stderr


def test_a_model_with_states_is_not_exported_to_onnx(tmp_path):
    imported(tmp_path, cell("rnn"), interface(H0))
    run = metafmu("export", "cell.safetensors", "--onnx", "again.onnx", cwd=tmp_path, check=False)
    assert run.returncode == 2 and "states" in run.stderr, run.stderr
