"""Discrete-time surrogates of third-party FMUs for co-simulation."""

import json
import os
import re
import subprocess
import sys
import zipfile

import numpy as np
import pandas as pd
import pytest
from conftest import METAFMU, OTHER_THREADS, ROOT, fmu_of, metafmu
from fmpy import read_model_description, simulate_fmu
from scipy.linalg import expm

sys.path.insert(0, str(ROOT / "examples" / "fmu-source"))
import make_fmus

STEP, ROWS = 0.02, 101
POSITIONS = [f"position[{body}]" for body in (1, 2, 3)]
# a row has two communication steps
CHAIN = """name = "chain"
structure = "discrete"
[source]
fmu = "chain.fmu"
step = 0.01
[time]
stop = 2.0
step = 0.02
[inputs]
force = { start = 0.0, bandwidth = 5.0, excitation = ["multisine", "steps", "ramps"] }
[outputs]
"position[1]" = {}
"position[2]" = {}
"position[3]" = {}
[discrete]
model = "linear"
history = 2
[sampling]
runs = 10
test_runs = 4
"""
HYSTERESIS = """name = "hysteresis"
structure = "discrete"
[source]
fmu = "Hysteresis.fmu"
[time]
stop = 0.25
step = 0.00125
[inputs]
force = { min = -150, max = 150, bandwidth = 150.0, excitation = ["random"] }
[parameters]
damping = { min = 5, max = 20 }
[outputs]
position = {}
[discrete]
model = "feedback"
[network]
hidden = [8]
[training]
epochs = 20
[sampling]
runs = 8
test_runs = 3
[accept]
r2 = -inf
"""


def system(stiffness=100.0, damping=1.0):
    """The rates of the chain's positions, velocities and force, which is held."""
    coupling = np.array([[-2.0, 1, 0], [1, -2, 1], [0, 1, -1]])
    matrix = np.zeros((7, 7))
    matrix[:3, 3:6], matrix[3:6, :3], matrix[3:6, 3:6] = np.eye(3), stiffness * coupling, damping * coupling
    matrix[5, 6] = 1.0
    return matrix


def positions(forces, **parameters):
    """At each row, from rest."""
    transition, state, rows = expm(system(**parameters) * STEP), np.zeros(7), []
    for force in forces:
        rows.append(state[:3])
        state[6] = force
        state = transition @ state
    return np.array(rows)


def chain(folder, *changes):
    folder.mkdir(parents=True, exist_ok=True)
    make_fmus.build_c(ROOT / "examples" / "fmu-source" / "chain" / "chain.c", folder / "chain.fmu")
    text = CHAIN
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    (folder / "chain.toml").write_text(text)
    return folder / "chain.toml"


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Tests write nothing into its folder."""
    folder = tmp_path_factory.mktemp("chain")
    metafmu("build", chain(folder), "--out", folder / "out", "--fmi", "both")
    return folder / "out"


def test_inputs_are_held_over_the_sample_time(built):
    for name, count in [("train", 10), ("test", 4)]:
        table = pd.read_csv(built / f"{name}.csv")
        starts = [f"{position}_start" for position in POSITIONS]
        assert list(table) == ["run", "time", *starts, "force_start", "force", *POSITIONS]
        assert table["run"].nunique() == count and (table["force_start"] == 0).all()
        for _, run in table.groupby("run"):
            assert np.allclose(run["time"], STEP * np.arange(ROWS), rtol=0, atol=1e-12)
            # the chain has an internal integrator
            assert np.abs(run[POSITIONS].to_numpy() - positions(run["force"])).max() < 1e-8
        # runs with equal parameters have different signals
        assert table.groupby("run")["force"].std().nunique() == count
        assert table["force"].between(-20, 20).all()


@pytest.mark.parametrize("version", [2, 3])
def test_the_fmu_goes_on_as_its_source_does(built, version):
    fmu = fmu_of(built, "chain", version)
    description = read_model_description(str(fmu))
    (force,) = [variable for variable in description.modelVariables if variable.name == "force"]
    assert (force.causality, float(force.min), float(force.max), float(force.start), force.unit) == ("input", -20, 20, 0, "N")
    times = STEP * np.arange(ROWS)
    forces = 15 * np.sign(np.sin(7 * times + 0.3))
    # rows that begin a step, so that the host holds the value
    signal = np.array(list(zip(times, forces)), dtype=[("time", float), ("force", float)])
    found = simulate_fmu(str(fmu), stop_time=times[-1], output_interval=STEP, input=signal, output=POSITIONS, fmi_type="CoSimulation")
    truth = positions(forces)
    # fmpy gives the input its value at the beginning of the step; three positions at two samples are six states: the chain is linear in them
    assert np.abs(np.array([found[name] for name in POSITIONS]).T - truth).max() < 1e-5 * np.ptp(truth)


def test_shards_and_other_numbers_of_threads_give_the_same_samples(built, tmp_path):
    study = chain(tmp_path)
    environment = os.environ | OTHER_THREADS
    subprocess.run([METAFMU, "sample", study, "--out", tmp_path / "threads"], check=True, capture_output=True, env=environment)
    for shard in ("2/2", "1/2"):
        metafmu("sample", study, "--out", tmp_path / "shards", "--shard", shard)
    metafmu("sample", study, "--out", tmp_path / "shards", "--merge")
    for name in ("train.csv", "test.csv"):
        expected = (built / name).read_bytes()
        assert (tmp_path / "threads" / name).read_bytes() == expected
        assert (tmp_path / "shards" / name).read_bytes() == expected


def test_the_plan_has_the_number_from_which_the_signals_of_a_run_follow(tmp_path):
    study = chain(tmp_path, ("[outputs]", '[parameters]\n"spring.damping" = { min = 0.5, max = 2.0 }\n[outputs]'))
    lines = metafmu("sample", study, "--dry-run").stdout.splitlines()
    assert lines[0] == "set,run,spring.damping,signals" and len(lines) == 1 + 14
    metafmu("sample", study, "--out", tmp_path / "out")
    table = pd.read_csv(tmp_path / "out" / "test.csv")
    for line, (_, run) in zip(lines[11:], table.groupby("run")):
        damping = float(line.split(",")[2])
        assert (run["spring.damping"] == damping).all()
        assert np.abs(run[POSITIONS].to_numpy() - positions(run["force"], damping=damping)).max() < 1e-8


def test_error_bounds_are_measured_on_runs_of_their_own(tmp_path):
    study = chain(tmp_path, ("[sampling]", "[bounds]\nruns = 20\n[sampling]"))
    metafmu("build", study, "--out", tmp_path / "out")
    tables = {name: pd.read_csv(tmp_path / "out" / f"{name}.csv") for name in ("train", "test", "calibration")}
    # beside 20 runs with the study's signals 23 decays, and one run each of zero input and of either end of the range
    assert {name: table["run"].nunique() for name, table in tables.items()} == {"train": 10, "test": 4, "calibration": 46}
    signals = [tuple(run["force"]) for table in tables.values() for _, run in table.groupby("run")]
    assert len(set(signals)) == 60
    constant = [signal[0] for signal in signals if len(set(signal)) == 1]
    assert len(constant) == 3 and 0 in constant and min(constant) < 0 < max(constant)
    assert sum(len(set(signal)) > 1 and not any(signal[len(signal) // 2 :]) for signal in signals) == 23
    calibration = json.loads((tmp_path / "out" / "metrics.json").read_text())["calibration"]
    assert [kind["kind"] for kind in calibration] == [
        "signals", "zero input", "free decay", "constant at the ends"
    ]  # fmt: skip
    assert all(share >= 0.95 for kind in calibration for share in kind["within"].values()), calibration
    with zipfile.ZipFile(tmp_path / "out" / "chain.fmu") as fmu:
        assert "<td>free decay</td><td class=\"n\">23</td>" in fmu.read("documentation/index.html").decode()
    for _, run in tables["calibration"].groupby("run"):
        assert np.abs(run[POSITIONS].to_numpy() - positions(run["force"])).max() < 1e-8
    description = read_model_description(str(tmp_path / "out" / "chain.fmu"))
    assert "position[1]_bound" in [variable.name for variable in description.modelVariables]


@pytest.fixture(scope="module")
def hysteresis(tmp_path_factory):
    """An FMU of PythonFMU and its surrogate, with little training."""
    folder = tmp_path_factory.mktemp("hysteresis")
    source = ROOT / "examples" / "dynamics" / "bouc-wen"
    make_fmus.build_python(source / "hysteresis.py", folder)
    (folder / "study.toml").write_text(HYSTERESIS)
    command = [METAFMU, "build", "study.toml", "--out", "out"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True, env=make_fmus.activated())
    return folder


def test_runs_of_an_fmu_of_another_tool_are_those_of_the_script_it_is_made_of(hysteresis, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "examples" / "dynamics" / "bouc-wen")
    from hysteresis import Hysteresis

    table = pd.read_csv(hysteresis / "out" / "train.csv")
    assert table["damping"].nunique() == 8
    run = table[table["run"] == 3]
    model = Hysteresis(instance_name="x")
    model.damping = run["damping"].iloc[0]
    for force, position in zip(run["force"], run["position"]):
        assert abs(model.position - position) < 1e-12
        model.force = force
        model.do_step(0.0, 0.00125)
    # every sample follows from those before: the errors are those of simulations over whole runs
    metrics = json.loads((hysteresis / "out" / "metrics.json").read_text())
    assert metrics["outputs"]["position"]["r2"] > 0.9
    names = [v.name for v in read_model_description(str(hysteresis / "out" / "hysteresis.fmu")).modelVariables]
    assert {"damping", "force", "force_start", "position", "position_start"} <= set(names)


def test_inputs_that_stay_at_the_ends_of_their_ranges_leave_the_domain_before_the_error_passes_2_percent_of_the_range(tmp_path, monkeypatch):
    folder = ROOT / "examples" / "dynamics" / "dc-motor"
    make_fmus.build_python(folder / "motor.py", tmp_path)
    study, _, training = (folder / "dc-motor.toml").read_text().partition("[bounds]")
    (tmp_path / "motor.toml").write_text(f"{study}[network]{training.partition('[network]')[2].replace('epochs = 300', 'epochs = 60')}")
    command = [METAFMU, "build", "motor.toml", "--out", "out"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, env=make_fmus.activated())
    monkeypatch.syspath_prepend(folder)
    from motor import Motor

    model = Motor(instance_name="x")
    model.inertia, model.voltage = 0.02, 24.0
    truth = []
    for _ in range(3001):
        truth.append((model.speed, model.torque))
        model.do_step(0.0, 0.01)
    found = simulate_fmu(
        str(tmp_path / "out" / "dc-motor.fmu"), stop_time=30.0, output_interval=0.01, step_size=0.01,
        start_values={"inertia": 0.02, "voltage": 24.0},
        output=["speed", "torque", "in_domain"],
    )  # fmt: skip
    rows = pd.read_csv(tmp_path / "out" / "test.csv")
    errors = np.abs(np.array([found["speed"], found["torque"]]).T - truth) / np.ptp(rows[["speed", "torque"]].to_numpy(), axis=0)
    inside = found["in_domain"].astype(bool)
    # of one past sample the voltage counts as what it has always been: the highest average is outside from the first sample on
    assert errors.max() > 0.05 and errors[inside].max() < 0.02 and inside[0] and not inside[300:].any()
    # runs like those of the training
    metafmu("predict", tmp_path / "out" / "dc-motor.fmu", tmp_path / "out" / "test.csv", "--out", tmp_path / "found.csv")
    assert len(rows) == 3010 and pd.read_csv(tmp_path / "found.csv")["in_domain"].mean() > 0.95


@pytest.mark.parametrize(
    "old, new, message",
    [
        ("force = {", "push = {", "inputs.push: the FMU has no scalar input `push`, expected one of force"),
        ("start = 0.0", "start = 30", "inputs.force.start: 30 is outside the range from -20 to 20"),
        ("start = 0.0", 'unit = "kN"', "inputs.force.unit: `kN`, expected `N`"),
        ("step = 0.01\n", "step = 0.01\nconstants = { force = 1 }\n", "source.constants.force: is one of the inputs"),
        ("step = 0.01\n", "tolerance = 1e-6\n", "source.tolerance: belongs to model exchange"),
        ("step = 0.02", "step = 0.02\nmargin = 0.1", 'time.margin: belongs to the structure "response"'),
        ("runs = 10", 'method = "sobol"\nruns = 10', 'sampling.method: belongs to the structure "response"'),
        ("runs = 10", "runs = 1", "sampling.runs: expected at least 2 runs"),
        ("[outputs]", "[parameters]\nforce = { min = 0, max = 1 }\n[outputs]", "inputs.force: `force` is a parameter or output already"),
    ],
)
def test_mistakes_in_a_study_are_found_with_key_and_line(tmp_path, old, new, message):
    result = metafmu("sample", chain(tmp_path, (old, new)), "--dry-run", check=False)
    assert result.returncode == 2 and re.search(rf"chain\.toml:\d+: {re.escape(message)}", result.stderr), result.stderr


def test_an_fmu_without_inputs_is_refused(tmp_path):
    make_fmus.build_c(ROOT / "examples" / "fmu-source" / "van-der-pol" / "van_der_pol.c", tmp_path / "van_der_pol.fmu")
    run = lambda *arguments: subprocess.run([METAFMU, *arguments], cwd=tmp_path, capture_output=True, text=True)
    result = run("new", "mine", "--fmu", "van_der_pol.fmu", "--structure", "discrete")
    assert result.returncode == 2 and "no real scalar input: nothing drives it" in result.stderr, result.stderr
    result = run("new", "mine", "--system", "single-pendulum", "--structure", "discrete")
    assert result.returncode == 2 and "--fmu" in result.stderr, result.stderr


def test_a_new_study_of_an_fmu_builds(tmp_path):
    chain(tmp_path)
    run = lambda *arguments: subprocess.run([METAFMU, *arguments], cwd=tmp_path, capture_output=True, text=True)
    result = run("new", "mine", "--fmu", "chain.fmu", "--structure", "discrete")
    assert result.returncode == 0, result.stderr
    text = (tmp_path / "mine.toml").read_text()
    # it pulls from the start on, unless somebody says that it did not before
    assert "\nforce = { min = -20.0, max = 20.0, start = 10.0, bandwidth = 5.0, excitation" in text
    assert "# start: what it was before a run, the FMU's own; 0 if the FMU begins at rest without it" in text
    assert '\n"spring.stiffness" = { min = 80.0, max = 120.0 }' in text
    short = text.replace("runs = 30 ", "runs = 4 ").replace("test_runs = 10", "test_runs = 1").replace("epochs = 300", "epochs = 2")
    (tmp_path / "mine.toml").write_text(short + "\n[accept]\nr2 = -inf\n")
    result = run("build", "mine.toml")
    assert "FMI 3.0 co-simulation, " in result.stdout, result.stderr
