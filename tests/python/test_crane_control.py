"""The crane's surrogate in use: with PythonFMU's controller in fmpy, a Rust program and, as SSP, two hosts; design study."""

import io
import re
import sys
from dataclasses import dataclass
from pathlib import Path

import casadi
import numpy as np
import pytest
from conftest import ROOT, metafmu
from fmpy import extract, read_model_description
from fmpy.ssp.simulation import simulate_ssp
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp
from test_dynamics import build
from test_hosts import run, run_python_host

sys.path[:0] = [str(ROOT / "examples" / folder) for folder in ("embedding", "fmu-source")]
import crane_control
from make_fmus import activated
from master import Component

EXAMPLES = ROOT / "target" / "release" / "examples"
STEPS = round(crane_control.STOP / crane_control.STEP)


@dataclass
class System:
    crane: Path
    folder: Path
    table: np.ndarray
    errors: list


def read_table(text):
    return np.loadtxt(io.StringIO(text), delimiter=",", skiprows=1)


@pytest.fixture(scope="module")
def system(tmp_path_factory):
    """Results of the fmpy script for a crane: the controller, the SSP, a table, and the errors that it reports."""
    folder = tmp_path_factory.mktemp("crane-control")
    crane = build(folder / "crane").fmu(2)
    result = run([sys.executable, ROOT / "examples" / "embedding" / "crane_control.py", crane, folder])
    assert result.stdout.splitlines()[0] == ",".join(crane_control.COLUMNS)
    errors = [float(error) for error in re.findall(r"off by at most (\S+),", result.stderr)]
    return System(crane, folder, read_table(result.stdout), errors)


def rust_program(name):
    assert (EXAMPLES / name).exists(), "run `cargo build --release --examples` first"
    return EXAMPLES / name


def test_the_controller_is_a_valid_fmu(system):
    assert validate_fmu(system.folder / "controller.fmu") == []


def test_the_surrogate_moves_under_the_controller_as_the_crane_does(system):
    expected = crane_control.solve(*crane_control.start_values(system.crane))
    errors = np.max(np.abs(system.table - expected), axis=0)[1:]
    assert np.all(errors < [1e-8, 1e-8, 1e-7]), errors
    np.testing.assert_allclose(errors, system.errors, rtol=0.06)
    # the load swings at the start, and rests at the target in the end
    assert np.all(np.abs(system.table[0, 1:3] - [0.0, 0.3]) < 1e-12)
    assert np.all(np.abs(system.table[-50:, 1:3] - [2.0, 0.0]) < 0.01)


def test_the_rust_program_computes_what_the_fmpy_script_does(system):
    command = [rust_program("crane_control"), system.crane, system.folder / "controller.fmu"]
    table = read_table(run(command, env=activated()).stdout)
    # the same calls of the same binaries
    np.testing.assert_array_equal(table, system.table)


def test_ecospy_runs_the_ssp_as_the_fmpy_script_does(system):
    names = ["crane::x", "crane::theta", "controller::force"]
    request = {"ssp": str(system.folder / "crane.ssp"), "outputs": names, "step": crane_control.STEP, "steps": STEPS}
    table = run_python_host("ecospy-ssp", request)
    # it adds up the times of its steps
    np.testing.assert_allclose(table, system.table, rtol=0, atol=1e-12 * np.max(np.abs(system.table)))


def test_fmpy_runs_the_ssp_with_nothing_measured_at_the_start(system):
    """Its first step takes all inputs to be 0. A row has the time at which its step begins, and the values at its end."""
    result = simulate_ssp(system.folder / "crane.ssp", stop_time=crane_control.STOP, step_size=crane_control.STEP)
    table = np.column_stack([result[name] for name in ("crane.x", "crane.theta", "controller.force")])[:STEPS]
    measure = lambda index, x, theta: (x, theta) if index > 0 else (0.0, 0.0)
    expected = crane_control.solve(*crane_control.start_values(system.crane), measure)[1:, 1:]
    errors = np.max(np.abs(table - expected), axis=0)
    assert np.all(errors < [1e-8, 1e-8, 1e-7]), errors
    # which is not what the other hosts compute
    assert np.max(np.abs(table - system.table[1:, 1:])) > 1


def test_the_design_study_finds_the_peaks_that_scipy_does(system):
    runs = 40
    mechanism = ROOT / "examples" / "dynamics" / "crane.toml"
    result = run([rust_program("peak_sway"), mechanism, system.crane, runs])
    assert result.stdout.splitlines()[0] == "l,m,b,force,peak"
    table = read_table(result.stdout)
    assert table.shape == (runs, 5)
    assert np.all(np.ptp(table, axis=0)[:4] > [0.5, 0.5, 1.0, 4.0])
    for *parameters, force, peak in table[::8]:
        state, angles = np.zeros(4), []
        for start, push in [(0.0, force), (1.0, -force), (2.0, 0.0)]:
            end = start + 1.0 if push else 10.0
            times = np.linspace(start, end, round((end - start) / 0.05) + 1)
            derivative = lambda _, state: crane_control.rates(state, push, parameters)
            states = solve_ivp(derivative, (start, end), state, "DOP853", times, rtol=1e-11, atol=1e-12).y
            state = states[:, -1]
            angles.extend(np.abs(states[1]))
        assert abs(peak - max(angles)) < 1e-7
    # as far as the program itself says it differs from the mechanism
    (off,) = re.findall(r"^surrogate .* (\S+)$", result.stderr, re.MULTILINE)
    assert float(off) < 1e-7


def test_the_motion_continues_with_a_mass_and_a_rope_that_change_in_a_run(system):
    parameters, state = crane_control.start_values(system.crane)
    changed = [parameters[0] + 0.25, parameters[1] - 0.25, parameters[2]]
    crane = Component(system.crane, "crane")
    crane.initialize()
    for time, present in ((0.0, parameters), (0.5, changed)):
        for name, value in zip("lmb", present):
            crane.set(name, value)
        crane.set("force", 2.0)
        for index in range(25):
            crane.slave.doStep(time + 0.02 * index, 0.02)
        state = solve_ivp(lambda _, state: crane_control.rates(state, 2.0, present), (0, 0.5), state, "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
        assert np.abs(np.array(crane.get("x", "theta")) - state[:2]).max() < 1e-7
    crane.close()


@pytest.fixture(scope="module", params=["2", "3"])
def in_casadi(request, system, tmp_path_factory):
    """Rates and outputs of the crane in CasADi with its default options, by states, force and parameters."""
    folder = tmp_path_factory.mktemp("casadi")
    metafmu("export", system.crane, "--fmi", request.param, "--out", folder)
    [fmu] = folder.glob("*.fmu")
    model = casadi.DaeBuilder("crane", str(extract(str(fmu), folder / "extracted")))
    assert model.p() == ["l", "m", "b"] and model.u() == ["force"]
    return model.create("crane", ["x", "u", "p"], ["ode", "y"])


def equations_in_symbols():
    """The crane's equations of motion, and their derivatives with respect to states, force and parameters."""
    x, u, p = casadi.MX.sym("x", 4), casadi.MX.sym("u"), casadi.MX.sym("p", 3)
    (_, theta, v, omega), (length, mass, damping) = casadi.vertsplit(x), casadi.vertsplit(p)
    masses = casadi.blockcat([[crane_control.TROLLEY + mass, mass * length * casadi.cos(theta)], [casadi.cos(theta), length]])
    forces = casadi.vertcat(u - damping * v + mass * length * omega**2 * casadi.sin(theta), -crane_control.GRAVITY * casadi.sin(theta))
    rates = casadi.vertcat(v, omega, casadi.solve(masses, forces))
    return casadi.Function("crane", [x, u, p], [rates, *(casadi.jacobian(rates, of) for of in (x, u, p))])


def test_derivatives_in_casadi_are_those_of_the_equations(in_casadi):
    jacobians = in_casadi.factory("jacobians", in_casadi.name_in(), ["ode", "jac:ode:x", "jac:ode:u", "jac:ode:p"])
    random, exact = np.random.default_rng(3), equations_in_symbols()
    for _ in range(20):
        x, u, p = random.uniform(-1.5, 1.5, 4), random.uniform(-5.0, 5.0), random.uniform([1.0, 0.5, 0.0], [2.0, 1.5, 2.0])
        for found, expected in zip(jacobians(x, u, p), exact(x, u, p), strict=True):
            expected = np.array(expected)
            # of equations that were learned to about 1e-11
            assert np.abs(np.array(found) - expected).max() < 1e-9 * max(1.0, np.abs(expected).max())


def test_the_outputs_in_casadi_are_those_of_the_study(system, in_casadi):
    _, outputs = in_casadi([0.5, 0.2, 0.0, 0.0], 1.0, [1.5, 1.0, 0.5])
    names = [variable.name for variable in read_model_description(system.crane).modelVariables if variable.causality == "output"]
    values = dict(zip(names, np.ravel(outputs), strict=True))
    assert (values["x"], values["theta"]) == (0.5, 0.2) and "in_domain" not in names


def test_a_boolean_output_is_read_in_casadi_and_has_no_slope(system, tmp_path):
    metafmu("export", system.crane, "--ports", "domain", "--out", tmp_path)
    [wired] = tmp_path.glob("*.fmu")
    names = [variable.name for variable in read_model_description(wired).modelVariables if variable.causality == "output"]
    model = casadi.DaeBuilder("wired", str(extract(str(wired), tmp_path / "wired")))
    equations = model.create("equations", ["t", "x", "u", "p"], ["ode", "y"])
    x, u, p = [0.5, 0.2, 0.0, 0.0], 1.0, [1.5, 1.0, 0.5]
    _, outputs = equations(0.0, x, u, p)
    assert dict(zip(names, np.ravel(outputs), strict=True))["in_domain"] == 1.0
    slopes = equations.factory("slopes", equations.name_in(), ["jac:y:x"])(0.0, x, u, p)
    assert not np.array(slopes)[names.index("in_domain")].any()
    _, outside = equations(0.0, [0.5, 0.2, 900.0, 0.0], u, p)
    assert dict(zip(names, np.ravel(outside), strict=True))["in_domain"] == 0.0


def test_a_force_that_casadi_plans_brings_the_load_to_rest(system, tmp_path):
    result = run([sys.executable, ROOT / "examples" / "embedding" / "casadi_crane.py", system.crane, tmp_path])
    ends = [float(value) for value in re.findall(r"in FMPy (\S+)", result.stdout)]
    assert np.abs(np.array(ends) - [1.0, 0.0, 0.0, 0.0]).max() < 1e-5, result.stdout
    assert float(re.search(r"difference of a state: (\S+);", result.stdout)[1]) < 1e-6
    force = np.loadtxt(tmp_path / "force.csv", delimiter=",", skiprows=1)
    assert force.shape == (61, 2) and np.abs(force[:, 1]).max() <= 5.0
    assert (tmp_path / "crane.svg").stat().st_size > 1000
