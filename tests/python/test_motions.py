"""Surrogates with states from tables of motions, in fmpy, against scipy's solutions beyond the rows that were learned from."""

import json
import subprocess
import sys

import numpy as np
import pytest
from conftest import METAFMU, ROOT, fmu_of, metafmu
from fmpy import read_model_description, simulate_fmu
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp

EXAMPLES = ROOT / "examples" / "dynamics" / "mbd-node"
sys.path.insert(0, str(EXAMPLES))
import make_tables

STEP = 0.02
# six runs of a cart that is pushed, with a load on a rope of another length in each
ROPES = [0.8, 0.9, 1.0, 1.1, 1.2, 1.3]
CRANE = f"""name = "crane"
structure = "dynamics"
[source]
table = "crane.csv"
columns = {{ theta = "Angle", w = "Speed of the angle" }}
[time]
stop = 5.98
step = {STEP}
[states]
x = {{ rate = "v", min = -20, max = 20 }}
theta = {{ rate = "w", periodic = true }}
[inputs]
force = {{ min = -10, max = 10 }}
[parameters]
l = {{ min = 0.8, max = 1.3 }}
[outputs]
x = {{}}
theta = {{}}
w = {{}}
[sampling]
test_runs = 1
"""


def crane(state, force, l):
    """The crane of 2 kg with a damping of 0.3, and a load of 1 kg."""
    (_, theta), (v, w) = state[:2], state[2:]
    sine, cosine = np.sin(theta), np.cos(theta)
    a = (force - 0.3 * v + l * w**2 * sine + 9.81 * sine * cosine) / (3 - cosine**2)
    return [v, w, a, -(a * cosine + 9.81 * sine) / l]


def crane_motion(start, l, times, forces):
    """States, with forces that are linear between the times."""
    rates = lambda t, state: crane(state, np.interp(t, times, forces), l)
    return solve_ivp(rates, (0, times[-1]), start, t_eval=times, rtol=1e-11, atol=1e-11, max_step=STEP).y.T


def push(times, seed):
    random = np.random.default_rng(seed)
    return sum(2.5 * np.sin(random.uniform(1, 6) * times + random.uniform(0, 6)) for _ in range(3))


@pytest.fixture(scope="session")
def driven(tmp_path_factory):
    folder = tmp_path_factory.mktemp("crane")
    times = STEP * np.arange(300)
    lines = ["run,time [s],l [m],x [m],Angle [rad],v [m/s],Speed of the angle [rad/s],force [N]"]
    for run, l in enumerate(ROPES):
        forces = push(times, run)
        states = crane_motion([0, 0.3 + 0.1 * run, 0, 0], l, times, forces)
        lines += [",".join(map(repr, map(float, (run, t, l, *state, force)))) for t, state, force in zip(times, states, forces)]
    (folder / "crane.csv").write_text("\n".join(lines) + "\n")
    (folder / "crane.toml").write_text(CRANE)
    metafmu("build", folder / "crane.toml", "--out", folder / "out")
    return folder


def test_the_fmu_of_a_double_pendulum_goes_on_where_its_rows_end(tmp_path):
    make_tables.write(tmp_path)
    (tmp_path / "study.toml").write_text((EXAMPLES / "double-pendulum.toml").read_text())
    metafmu("build", tmp_path / "study.toml", "--out", tmp_path / "out", "--fmi", "both")
    record = json.loads((tmp_path / "out" / "training.json").read_text())
    assert record["train_rows"] == 300 and record["trajectories"]["exported"] == "equations of motion", record
    times, truth = make_tables.motion("double-pendulum")
    for version in (2, 3):
        fmu = fmu_of(tmp_path / "out", "double-pendulum", version)
        assert validate_fmu(fmu) == []
        for kind in ("CoSimulation", "ModelExchange"):
            result = simulate_fmu(
                fmu, fmi_type=kind, output=["theta1", "omega2"], stop_time=4.0, output_interval=times[1], relative_tolerance=1e-9
            )
            found = np.column_stack([result["theta1"], result["omega2"]])[: len(times)]
            assert np.abs(found - truth[:, [0, 3]]).max() < 1e-4, (version, kind)


def test_a_table_with_inputs_and_parameters_gives_a_component_that_answers(driven):
    fmu = fmu_of(driven / "out", "crane", 2)
    names = {variable.name: variable for variable in read_model_description(fmu).modelVariables}
    assert names["force"].causality == "input" and names["l"].causality == "parameter" and "theta_start" in names
    # a start, a rope and a push that no run has
    times = STEP * np.arange(500)
    forces = push(times, 99)
    truth = [[1.0, -0.5, 0.2, 0.4]]
    # fmpy holds inputs in each step
    for force in forces[:-1]:
        truth.append(solve_ivp(lambda t, state: crane(state, force, 1.05), (0, STEP), truth[-1], rtol=1e-10, atol=1e-10).y[:, -1])
    truth = np.array(truth)
    signal = np.array(list(zip(times, forces)), dtype=[("time", float), ("force", float)])
    values = {"l": 1.05, "x_start": 1.0, "theta_start": -0.5, "v_start": 0.2, "w_start": 0.4}
    result = simulate_fmu(
        fmu, fmi_type="CoSimulation", start_values=values, input=signal, output=["x", "theta"], stop_time=times[-1], output_interval=STEP
    )
    found = np.column_stack([result["x"], result["theta"]])[: len(times)]
    assert np.abs(found - truth[:, :2]).max() < 1e-4


def test_a_new_study_of_a_table_builds_as_it_is(tmp_path):
    make_tables.write(tmp_path)
    command = [METAFMU, "new", "masses", "--table", "triple-mass.csv", "--structure", "dynamics"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    text = (tmp_path / "masses.toml").read_text()
    assert 'x2 = { rate = "v2" }' in text and "train_stop = 2.9925" in text
    subprocess.run([METAFMU, "build", "masses.toml"], cwd=tmp_path, check=True, capture_output=True)
    metrics = json.loads((tmp_path / "out" / "masses" / "metrics.json").read_text())
    assert metrics["roll_outs"]["horizons"][-1]["median"] < 1e-4, metrics["roll_outs"]


def test_noise_is_said_and_ends_a_build_with_an_exit_code(tmp_path):
    times, states = make_tables.motion("double-pendulum")
    states = states + np.random.default_rng(1).normal(scale=0.05, size=states.shape)
    lines = [",".join(map(repr, map(float, (t, *state)))) for t, state in zip(times, states)]
    (tmp_path / "double-pendulum.csv").write_text("time,theta1,theta2,omega1,omega2\n" + "\n".join(lines) + "\n")
    (tmp_path / "study.toml").write_text((EXAMPLES / "double-pendulum.toml").read_text())
    subprocess.run([METAFMU, "sample", "study.toml"], cwd=tmp_path, check=True, capture_output=True)
    result = subprocess.run([METAFMU, "train", "study.toml"], cwd=tmp_path, capture_output=True, text=True)
    assert result.returncode == 1 and "too noisy" in result.stderr + result.stdout, result.stderr + result.stdout

