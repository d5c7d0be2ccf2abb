"""A shaft whose torques are lookup tables of one and two arguments, against scipy's splines and its solution of the equation.

Narrow parts of tables and formulas, against their energy.
"""

import re
import subprocess

import numpy as np
import pytest
import tomllib
from conftest import METAFMU, ROOT, compiled_from_sources, fmu_of, metafmu
from fmpy import simulate_fmu
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline, RectBivariateSpline

MECHANISM = ROOT / "examples" / "dynamics" / "known-forces" / "tables.toml"
STOP = 4.0
ROWS = np.linspace(0.0, STOP, 201)


@pytest.fixture(scope="module")
def shaft(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lookup")
    metafmu("new", "shaft", "--mechanism", MECHANISM, "--structure", "dynamics", cwd=folder)
    subprocess.run([METAFMU, "build", "shaft.toml", "--out", "out", "--fmi", "both"], cwd=folder, check=True, capture_output=True)
    return folder


def torques():
    """Torques of motor, cam and bearing; beyond its knots, the first is linear, the second periodic, the third constant."""
    tables = tomllib.loads(MECHANISM.read_text())["tables"]
    motor, cam, bearing = tables["torque"], tables["cam"], tables["bearing"]
    surface = RectBivariateSpline(motor["x"], motor["y"], motor["values"], kx=3, ky=3, s=0)
    period = CubicSpline(cam["x"], cam["values"], bc_type="periodic")

    def of_motor(speed, throttle):
        at = min(max(speed, motor["x"][0]), motor["x"][-1])
        return surface(at, throttle)[0, 0] + (speed - at) * surface(at, throttle, dx=1)[0, 0]

    return of_motor, period, lambda speed: np.interp(speed, bearing["x"], bearing["values"])


def solution(inertia, lift, throttle, speed):
    of_motor, of_cam, of_bearing = torques()

    def rates(t, state):
        return [state[1], (of_motor(state[1], throttle) - lift * of_cam(state[0]) - of_bearing(state[1])) / inertia]

    return solve_ivp(rates, (0.0, STOP), [0.2, speed], t_eval=ROWS, rtol=1e-12, atol=1e-13, max_step=0.002).y


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("interface", ["CoSimulation", "ModelExchange"])
def test_the_fmu_has_the_tables(shaft, version, interface):
    # the second passes from forward to backward, the third begins beyond the last speed of the tables
    for inertia, lift, throttle, speed in [(0.3, 1.2, 0.6, 5.0), (0.7, 1.5, 0.0, 6.0), (0.5, 0.5, 1.0, 60.0)]:
        values = {"J": inertia, "lift": lift, "throttle": throttle, "shaft.angle_start": 0.2, "shaft.angular_velocity_start": speed}
        options = {"fmi_type": interface, "start_values": values, "stop_time": STOP, "output_interval": ROWS[1], "relative_tolerance": 1e-10}
        found = simulate_fmu(fmu_of(shaft / "out", "shaft", version), output=["angle", "speed"], **options)
        for name, exact in zip(["angle", "speed"], solution(inertia, lift, throttle, speed)):
            error = np.abs(found[name] - exact).max() / np.ptp(exact)
            assert error < (1e-7 if interface == "CoSimulation" else 1e-5), (name, throttle, speed, error)


def test_the_swap_of_the_example_runs(shaft):
    for kind in ["toml", "ssd"]:
        (shaft / f"tables.{kind}").write_text(MECHANISM.with_suffix(f".{kind}").read_text())
    swapped = metafmu("swap", "tables.ssd", "--component", "shaft", "--with", fmu_of(shaft / "out", "shaft", 2), "--step-size", "0.01", cwd=shaft)
    assert "difference" in swapped.stdout, swapped.stdout


SPIKE = """[inputs]
torque = { min = -1, max = 1 }
[tables.spike]
x = [0.5, 0.502, 0.504]
values = [0, 500, 0]
[bodies.rotor]
mass = 1
inertia = 1
[joints]
shaft = { type = "revolute", between = ["ground", "rotor"] }
[actuators]
motor = { coordinate = "shaft.angle", effort = "torque + spike(shaft.angle)" }
[initial]
shaft.angular_velocity = 1
[outputs]
speed = { measure = "shaft.angular_velocity" }
"""


def test_no_step_goes_over_a_narrow_part_of_a_table(tmp_path, monkeypatch):
    (tmp_path / "spike.toml").write_text(SPIKE)
    metafmu("new", "rotor", "--mechanism", "spike.toml", "--structure", "dynamics", cwd=tmp_path)
    metafmu("build", "rotor.toml", "--out", "out", "--sources", cwd=tmp_path)
    packed = fmu_of(tmp_path / "out", "rotor", 2)
    # the spike gives 500 * 0.002 J, whatever the speed
    exact = np.sqrt(1.0 + 2.0 * 500.0 * 0.002)
    start = {"shaft.angle_start": 0.0, "shaft.angular_velocity_start": 1.0, "torque": 0.0}
    for fmu in [packed, compiled_from_sources(packed, monkeypatch)]:
        for step in [0.01, 0.1, 1.0]:
            found = simulate_fmu(fmu, fmi_type="CoSimulation", start_values=start, stop_time=1.0, output_interval=step, output=["speed"])
            assert abs(found["speed"][-1] - exact) < 1e-6, (step, found["speed"][-1])


PULSES = """[parameters]
at = { default = 0.5, min = 0.45, max = 0.55 }
[inputs]
torque = { min = -1, max = 1 }
[bodies.rotor]
mass = 1
inertia = 1
[joints]
shaft = { type = "revolute", between = ["ground", "rotor"] }
[variables]
hat = "500*max(0, 1 - abs(shaft.angle - at)/2e-3)"
bell = "500*exp(-((shaft.angle - 0.8)/1e-3)^2)"
box = "250*(sign(shaft.angle - 1.2) - sign(shaft.angle - 1.202))"
detent = "200*max(0, 1 - abs(mod(shaft.angle, 0.7) - 0.35)/1e-3)"
[actuators]
motor = { coordinate = "shaft.angle", effort = "torque + hat + bell + box + detent" }
[initial]
shaft.angular_velocity = 1
[outputs]
speed = { measure = "shaft.angular_velocity" }
"""


def test_no_step_goes_over_a_narrow_part_of_a_formula(tmp_path, monkeypatch):
    (tmp_path / "pulses.toml").write_text(PULSES)
    metafmu("new", "rotor", "--mechanism", "pulses.toml", "--structure", "dynamics", cwd=tmp_path)
    metafmu("build", "rotor.toml", "--out", "out", "--sources", cwd=tmp_path)
    packed = fmu_of(tmp_path / "out", "rotor", 2)
    # energies of hat, bell, box, and of the detent at 0.35 and 1.05, whatever the speed
    exact = np.sqrt(1.0 + 2.0 * (1.0 + 0.5 * np.sqrt(np.pi) + 1.0 + 2 * 0.2))
    for fmu in [packed, compiled_from_sources(packed, monkeypatch)]:
        for step, at in [(0.01, 0.5), (0.1, 0.4651), (0.9, 0.53)]:
            start = {"shaft.angle_start": 0.0, "shaft.angular_velocity_start": 1.0, "torque": 0.0, "at": at}
            found = simulate_fmu(fmu, fmi_type="CoSimulation", start_values=start, stop_time=0.9, output_interval=step, output=["speed"])
            assert abs(found["speed"][-1] - exact) < 1e-5, (step, at, found["speed"][-1])


COMB = """[parameters]
m = { default = 1, min = 0.5, max = 2, unit = "kg" }
[inputs]
F = { min = -5, max = 5, unit = "N" }
[bodies]
b = { mass = "m", inertia = 1 }
[joints]
z = { type = "prismatic", between = ["ground", "b"], axis = [1, 0] }
[actuators]
f = { coordinate = "z.position", effort = "F - 30*max(0, 1 - abs(mod(z.position, 0.1) - 0.05)/2e-3)" }
[initial]
z.position = 0
z.velocity = 0.5
[outputs]
x = { measure = "z.position" }
v = { measure = "z.velocity" }
"""


def test_validation_allows_for_steps_over_narrow_forces_by_its_own_solver(tmp_path):
    (tmp_path / "comb.toml").write_text(COMB)
    metafmu("new", "slide", "--mechanism", "comb.toml", "--structure", "dynamics", cwd=tmp_path)
    study = (tmp_path / "slide.toml").read_text()
    (tmp_path / "slide.toml").write_text(re.sub("test_runs = .*", "test_runs = 4", re.sub("stop = .*", "stop = 2.0", study)))
    # co-simulation has the guard; a host in model exchange, as the validation is, has its own steps
    assert "no problems found" in metafmu("build", "slide.toml", "--out", "out", cwd=tmp_path).stderr
