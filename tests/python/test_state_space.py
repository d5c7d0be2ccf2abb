"""Surrogates of third-party FMUs for model exchange, with their states and inputs."""

import json
import shutil
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from conftest import METAFMU, ROOT, compiled_from_sources, fmu_of, metafmu
from fmpy import read_model_description, simulate_fmu
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp

sys.path.insert(0, str(ROOT / "examples" / "fmu-source"))
import exchange

STOP, STEP = 5.0, 0.05
ROWS = np.linspace(0.0, STOP, 101)
OSCILLATOR = """name = "oscillator"
structure = "dynamics"
[source]
fmu = "{fmu}"
[time]
stop = 5.0
step = 0.05
[states]
x0 = {{ min = -3.0, max = 3.0, start = [-2.0, 2.0] }}
x1 = {{ min = -6.0, max = 6.0, start = [-1.0, 1.0] }}
[parameters]
mu = {{ min = 0.5, max = 2.0 }}
[outputs]
x0 = {{}}
x1 = {{}}
[sampling]
states = 1000
test_runs = 4
"""
RELAXATION = """name = "relaxation"
structure = "dynamics"
[source]
fmu = "{fmu}"
[time]
stop = 2.0
step = 0.02
[states]
x = {{ min = -2.0, max = 2.0 }}
[inputs]
u = {{ min = -1.0, max = 1.0, bandwidth = 1.0 }}
[parameters]
k = {{ min = 0.5, max = 2.0 }}
[outputs]
x = {{}}
[sampling]
states = 500
test_runs = 4
"""


def write(folder, study, fmu, *changes):
    text = study.format(fmu=fmu)
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    path = folder / "study.toml"
    path.write_text(text)
    return path


def build(folder, model, version, study):
    path = write(folder, study, exchange.build(model, version, folder).name)
    metafmu("build", path, "--out", folder / "out", "--fmi", "both")
    return folder / "out"


@pytest.fixture(scope="module")
def oscillator(tmp_path_factory):
    return build(tmp_path_factory.mktemp("oscillator"), "van_der_pol", 2, OSCILLATOR)


@pytest.fixture(scope="module")
def relaxation(tmp_path_factory):
    return build(tmp_path_factory.mktemp("relaxation"), "dahlquist", 3, RELAXATION)


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("interface", ["CoSimulation", "ModelExchange"])
def test_the_oscillator_moves_as_its_equations_say(oscillator, version, interface):
    fmu = fmu_of(oscillator, "oscillator", version)
    starts = {"mu": 1.3, "x0_start": 1.2, "x1_start": -0.4}
    found = simulate_fmu(
        str(fmu), stop_time=STOP, output_interval=STEP, start_values=starts, fmi_type=interface, relative_tolerance=1e-10
    )
    rates = lambda _, x: [x[1], 1.3 * (1 - x[0] ** 2) * x[1] - x[0]]
    truth = solve_ivp(rates, (0, STOP), [1.2, -0.4], "DOP853", ROWS, rtol=1e-12, atol=1e-12).y
    for name, expected in zip(["x0", "x1"], truth):
        assert np.abs(found[name] - expected).max() < 1e-6, name


def test_a_recorded_signal_drives_the_runs_of_an_fmu(tmp_path):
    times = np.linspace(0.0, 3.0, 31)
    pd.DataFrame({"time": times, "u": 0.3 * times}).to_csv(tmp_path / "ramp.csv", index=False)
    fmu = exchange.build("dahlquist", 3, tmp_path).name
    study = write(tmp_path, RELAXATION, fmu, ("bandwidth = 1.0", 'recording = "ramp.csv"'))
    metafmu("sample", study, "--out", tmp_path / "out")
    table = pd.read_csv(tmp_path / "out" / "test.csv")
    for _, run in table.groupby("run"):
        u, t, k = run["u"].to_numpy(), run["time"].to_numpy(), run["k"].iloc[0]
        assert np.abs(u - u[0] - 0.3 * t).max() < 1e-12 and 0 <= u[0] <= 0.3
        # the same to a further row, by the FMU's equation
        truth = solve_ivp(lambda t, x: -k * x + u[0] + 0.3 * t, (0, 2), [run["x"].iloc[0]], t_eval=t.clip(max=2.0), rtol=1e-11, atol=1e-12).y[0]
        assert np.abs(run["x"] - truth).max() < 1e-6


def test_the_fmu_keeps_states_and_outputs_of_its_source(oscillator):
    for version in (2, 3):
        fmu = fmu_of(oscillator, "oscillator", version)
        assert validate_fmu(str(fmu)) == []
        description = read_model_description(str(fmu))
        names = {variable.name: variable for variable in description.modelVariables}
        assert [names[name].causality for name in ("x0", "x1", "mu")] == ["output", "output", "parameter"]
        # output states keep their names
        assert [names[name].causality for name in ("x0_state", "x1_state")] == ["local", "local"]
        derivatives = [variable for variable in description.modelVariables if variable.derivative is not None]
        assert [variable.derivative.name for variable in derivatives] == ["x0_state", "x1_state"]


def test_the_position_is_recognized_and_one_function_is_learned_exactly(oscillator):
    record = json.loads((oscillator / "training.json").read_text())["state_space"]
    assert (record["functions"], record["exported"], record["products"]) == (1, "dictionary", 5)
    assert record["candidates"][0]["error"] < 1e-12
    metrics = json.loads((oscillator / "metrics.json").read_text())
    assert all(horizon["q90"] < 1e-6 for horizon in metrics["roll_outs"]["horizons"])


def test_an_input_drives_it(relaxation):
    table = pd.read_csv(relaxation / "test.csv")
    run = table[table.run == 2]
    fmu = fmu_of(relaxation, "relaxation", 2)
    first = run.iloc[0]
    starts = {"k": first.k, "x_start": first.x_start}
    for interface in ("CoSimulation", "ModelExchange"):
        csv = relaxation.parent / "input.csv"
        np.savetxt(csv, np.column_stack([run.time, run.u]), "%.17g", ",", header="time,u", comments="")
        arguments = [f"--start={name}={float(value)!r}" for name, value in starts.items()]
        kind = {"CoSimulation": "cs", "ModelExchange": "me"}[interface]
        printed = metafmu(
            "simulate", fmu, "--interface", kind, "--stop-time", 2, "--step-size", 0.02, "--input", csv, *arguments
        ).stdout
        found = np.array([float(line.split(",")[1]) for line in printed.splitlines()[1:]])
        # co-simulation holds inputs during a step
        limit = {"CoSimulation": 0.05, "ModelExchange": 1e-7}[interface]
        assert np.abs(found - run.x).max() < limit, interface


def test_equations_with_events_are_refused(tmp_path):
    for model, version, says in [
        ("ball", 2, "source.fmu: the FMU has 1 event indicators; equations with events cannot be learned"),
        ("stair", 3, "source.fmu: the FMU has no states"),
    ]:
        fmu = exchange.build(model, version, tmp_path)
        path = write(tmp_path, OSCILLATOR, fmu.name)
        result = metafmu("sample", path, check=False)
        assert result.returncode == 2 and says in result.stderr, result.stderr


def test_mistakes_are_told_all_at_once(tmp_path):
    fmu = exchange.build("van_der_pol", 2, tmp_path)
    path = write(
        tmp_path,
        OSCILLATOR,
        fmu.name,
        ("x1 = { min = -6.0", "y1 = { periodic = true, min = -6.0"),
        ("start = [-2.0, 2.0] }", "velocity = [0.0, 1.0] }"),
        ("[parameters]", "[inputs]\nmu = { min = 0.0, max = 1.0 }\n[parameters]"),
        ("states = 1000", "states = 10"),
    )
    result = metafmu("sample", path, check=False)
    for says in [
        "states.x0.velocity: belongs to mechanisms",
        "states.y1.periodic: the range from -6 to 6 is not a turn of 2 pi",
        "sampling.states: 10, expected a number from 100",
    ]:
        assert says in result.stderr, result.stderr
    path = write(tmp_path, OSCILLATOR, fmu.name, ("x1 = { min", "y1 = { min"), ("[parameters]", "[inputs]\nw = {}\n[parameters]"))
    result = metafmu("sample", path, check=False)
    for says in [
        "states.y1: the FMU has no state `y1`",
        "states: without x1: expected every state of the FMU",
        "inputs.w: the FMU has no continuous scalar input `w`",
    ]:
        assert says in result.stderr, result.stderr


def test_new_writes_a_study_that_builds(tmp_path):
    fmu = exchange.build("dahlquist", 2, tmp_path)
    run = lambda *arguments: subprocess.run([METAFMU, *arguments], cwd=tmp_path, check=True, capture_output=True, text=True)
    run("new", "mine", "--fmu", fmu.name, "--structure", "dynamics")
    text = (tmp_path / "mine.toml").read_text()
    assert "u = { min = -1.0, max = 1.0" in text and "k = { min = 0.5, max = 2.0 }" in text
    run("build", "mine.toml")
    record = json.loads((tmp_path / "out" / "mine" / "training.json").read_text())["state_space"]
    assert record["candidates"][0]["error"] < 1e-12


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    """An FMU of PythonFMU3 with friction that is no polynomial, and the surrogate of the example with little training."""
    folder = tmp_path_factory.mktemp("friction")
    source = ROOT / "examples" / "dynamics" / "fmu"
    subprocess.run(
        [sys.executable, "-m", "pythonfmu3", "build", "-f", source / "friction_pendulum.py", "-d", folder],
        check=True,
        capture_output=True,
    )
    text = (source / "friction-pendulum-study.toml").read_text()
    for old, new in [
        ("stop = 10.0", "stop = 2.0"),
        ("step = 0.02", "step = 0.05"),
        ("test_runs = 20", "test_runs = 4"),
        ("epochs = 300", "epochs = 150"),
        ("20000", "4000"),
    ]:
        assert old in text
        text = text.replace(old, new)
    (folder / "study.toml").write_text(text)
    metafmu("build", folder / "study.toml", "--out", folder / "out", "--fmi", "both")
    return folder / "out"


def test_a_network_learns_what_is_no_polynomial(pendulum):
    record = json.loads((pendulum / "training.json").read_text())["state_space"]
    errors = {candidate["name"]: candidate["error"] for candidate in record["candidates"]}
    assert set(errors) == {"dictionary", "network", "dictionary and network"}
    assert record["exported"] == min(errors, key=errors.get) != "dictionary"
    metrics = json.loads((pendulum / "metrics.json").read_text())
    assert metrics["roll_outs"]["horizons"][-1]["median"] < 0.15
    for version in (2, 3):
        assert validate_fmu(str(fmu_of(pendulum, "friction-pendulum", version))) == []


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize(
    "built, name, driver, starts, output",
    [
        ("relaxation", "relaxation", "u", {"k": 1.3, "x_start": -0.8}, "x"),
        ("pendulum", "friction-pendulum", "torque", {"length": 0.9, "angle_start": 0.4}, "height"),
    ],
)
def test_the_sources_compute_what_the_library_does(built, name, driver, starts, output, version, request, tmp_path, monkeypatch):
    folder = request.getfixturevalue(built)
    out = shutil.copytree(folder, tmp_path / "out")
    metafmu("export", folder.parent / "study.toml", "--out", out, "--sources", "--fmi", version)
    packed = str(fmu_of(out, name, version))
    assert validate_fmu(packed) == []
    unpacked = compiled_from_sources(packed, monkeypatch)
    text = (unpacked / "sources" / "model_data.h").read_text()
    assert "states.c has the formula" in text
    signal = np.array([(0.0, 0.5), (1.0, -0.9), (2.0, 0.7)], dtype=[("time", float), (driver, float)])
    # by equal steps, by steps with a tolerance, and by a solver of fmpy whose steps do not depend on rounding
    for interface, tolerance in [("CoSimulation", None), ("CoSimulation", 1e-8), ("ModelExchange", None)]:
        found, expected = (
            simulate_fmu(
                fmu, fmi_type=interface, stop_time=2, step_size=0.01, output_interval=0.02, input=signal, start_values=starts,
                relative_tolerance=tolerance, solver="Euler",
            )
            for fmu in (str(unpacked), packed)
        )
        assert np.ptp(expected[output]) > 0.01
        for column in expected.dtype.names:
            np.testing.assert_allclose(found[column], expected[column], rtol=1e-12, atol=1e-12, err_msg=interface)
