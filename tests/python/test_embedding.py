"""examples/embedding: the slider crank's surrogate moves a load, in fmpy, in a Rust program and as SSP in two hosts."""

import io
import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, metafmu
from fmpy.ssp.simulation import simulate_ssp
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from test_hosts import run, run_fmutool, run_python_host

sys.path.insert(0, str(ROOT / "examples" / "embedding"))
import build
import master

STOP, STEP = 5.0, 1e-3
# start values of the FMUs: middles of the study's ranges, and those of load/modelDescription.xml
TAU, RADIUS, RATIO = 1.5, 2.0, 3.0
MASS, STIFFNESS, DAMPING = 10.0, 4000.0, 40.0
COLUMNS = ["time", "xB", "xBdd", "displacement", "force"]


@dataclass
class System:
    slider_crank: Path
    load: Path
    ssp: Path
    table: np.ndarray
    metrics: dict


@pytest.fixture(scope="module")
def system(tmp_path_factory):
    """A small surrogate, the load, their SSP, and what the fmpy script makes of them."""
    folder = tmp_path_factory.mktemp("embedding")
    study = (ROOT / "examples" / "slider-crank.toml").read_text()
    for line, smaller in [
        ("runs = 1331", "runs = 343"),
        ("test_runs = 200", "test_runs = 50"),
        ("hidden = [64, 64, 64, 64, 64, 64]", "hidden = [64, 64]"),
        ("epochs = 60", "epochs = 30"),
    ]:
        assert line in study
        study = study.replace(line, smaller)
    (folder / "slider-crank.toml").write_text(study)
    metafmu("build", folder / "slider-crank.toml", "--out", folder)
    slider_crank, load, ssp = (folder / name for name in ["slider-crank.fmu", "load.fmu", "system.ssp"])
    build.build_load(load)
    structure = ROOT / "examples" / "embedding" / "SystemStructure.ssd"
    build.build_ssp(structure, ssp, {"slider-crank.fmu": slider_crank, "load.fmu": load})
    table = master.simulate(slider_crank, load, STOP, STEP)
    return System(slider_crank, load, ssp, table, json.loads((folder / "metrics.json").read_text())["outputs"])


def exact_acceleration(times):
    """xBdd of the slider crank, from its position by differentiation with complex steps and then central differences."""

    def velocity(t):
        t = t + 1e-30j
        theta = t / TAU - np.sin(TAU * t) / TAU**2
        position = RADIUS * np.cos(theta) + np.sqrt((RATIO * RADIUS) ** 2 - (RADIUS * np.sin(theta)) ** 2)
        return position.imag / 1e-30

    h = 1e-5
    return (velocity(times + h) - velocity(times - h)) / (2 * h)


def exact_load(times):
    """Displacement and force of the load under the exact acceleration, by scipy."""

    def derivative(t, state):
        return [state[1], -(STIFFNESS * state[0] + DAMPING * state[1]) / MASS - exact_acceleration(t)]

    solution = solve_ivp(derivative, (0, STOP), [0, 0], "DOP853", times, rtol=1e-10, atol=1e-12, max_step=0.05)
    return solution.y[0], STIFFNESS * solution.y[0] + DAMPING * solution.y[1]


def gains():
    """Greatest displacement and force per greatest acceleration: integrals of the magnitudes of the impulse responses."""
    omega, decay = np.sqrt(STIFFNESS / MASS), DAMPING / (2 * MASS)
    damped = np.sqrt(omega**2 - decay**2)
    times = np.linspace(0, 20 / decay, 400_001)
    displacement = np.exp(-decay * times) * np.sin(damped * times) / damped
    velocity = np.gradient(displacement, times)
    responses = [displacement, STIFFNESS * displacement + DAMPING * velocity]
    return [np.trapezoid(np.abs(response), times) for response in responses]


def test_the_load_is_a_valid_fmu(system):
    assert validate_fmu(system.load) == []
    assert run_fmutool(system.load).returncode == 0
    assert metafmu("validate", system.load).stdout.splitlines()[-1] == "no problems found"


def test_the_load_is_solved_right_for_the_acceleration_it_gets(system):
    """Against the matrix exponential, which is exact for an acceleration that is constant in each step."""
    matrix = np.zeros((3, 3))
    matrix[:2] = [[0, 1, 0], [-STIFFNESS / MASS, -DAMPING / MASS, -1]]
    transition = expm(matrix * STEP)
    state, displacements = np.zeros(2), [0.0]
    for acceleration in system.table[:-1, 2]:
        state = transition[:2] @ [*state, acceleration]
        displacements.append(state[0])
    largest = np.max(np.abs(displacements))
    # Runge-Kutta of order 4 at omega h = 0.02
    np.testing.assert_allclose(system.table[:, 3], displacements, rtol=0, atol=1e-6 * largest)


def test_the_load_moves_as_under_the_exact_slider_within_the_error_of_the_surrogate(system):
    times, position, acceleration, *response = system.table.T
    exact = exact_acceleration(times)
    surrogate_error = np.max(np.abs(acceleration - exact))
    assert surrogate_error <= system.metrics["xBdd"]["max_abs_error"]
    # the acceleration is held for a step: the coupling's error
    held_error = STEP * np.max(np.abs(np.gradient(exact, times)))
    for values, solution, gain in zip(response, exact_load(times), gains()):
        assert np.max(np.abs(values - solution)) <= gain * (surrogate_error + held_error)
        # the bound has to be worth something
        assert gain * (surrogate_error + held_error) < 0.5 * np.max(np.abs(solution))


def test_the_rust_program_computes_what_the_fmpy_script_does(system):
    program = ROOT / "target" / "release" / "examples" / "embed_load"
    assert program.exists(), "run `cargo build --examples` first"
    result = run([program, system.slider_crank, system.load])
    assert result.stdout.splitlines()[0] == ",".join(COLUMNS)
    table = np.loadtxt(io.StringIO(result.stdout), delimiter=",", skiprows=1)
    # the same calls of the same binaries
    np.testing.assert_array_equal(table, system.table)


def test_ecospy_runs_the_ssp_as_the_fmpy_script_does(system):
    names = ["slider_crank::xB", "slider_crank::xBdd", "load::displacement", "load::force"]
    request = {"ssp": str(system.ssp), "outputs": names, "step": STEP, "steps": round(STOP / STEP)}
    table = run_python_host("ecospy-ssp", request)
    # it adds up 5000 time steps
    largest = np.max(np.abs(system.table), axis=0)
    np.testing.assert_allclose(table / largest, system.table / largest, rtol=0, atol=1e-11)


def test_fmpy_runs_the_ssp_as_the_fmpy_script_does(system):
    result = simulate_ssp(str(system.ssp), stop_time=STOP, step_size=STEP)
    # a row carries the time at which its step begins, and the values at its end
    rows = slice(round(STOP / STEP))
    columns = ["slider_crank.xB", "slider_crank.xBdd", "load.displacement", "load.force"]
    table = np.column_stack([result[column][rows] for column in columns])
    expected = system.table[1:, 1:]
    np.testing.assert_allclose(table[:, :2], expected[:, :2], rtol=1e-11, atol=1e-11)
    # its first step gives the load no acceleration, which is as good as a push by that of the start time
    push = abs(system.table[0, 2]) * STEP
    omega = np.sqrt(STIFFNESS / MASS)
    assert np.max(np.abs(table[:, 2] - expected[:, 2])) <= 1.01 * push / omega
    assert np.max(np.abs(table[:, 3] - expected[:, 3])) <= 1.01 * push * (STIFFNESS / omega + DAMPING)
