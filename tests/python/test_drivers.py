"""Surrogates of mechanisms whose drives are moved by inputs, in fmpy, against scipy's solution of equations that are written here."""

import json
import shutil
import subprocess

import numpy as np
import pandas as pd
import pytest
from conftest import METAFMU, changed, compiled_from_sources, fmu_of, metafmu
from fmpy import read_model_description, simulate_fmu
from scipy.integrate import solve_ivp

STOP, STEP = 5.0, 0.05
ROWS = np.linspace(0.0, STOP, 101)
KINDS = [(version, interface) for version in (2, 3) for interface in ("CoSimulation", "ModelExchange")]
# of the input, held over ten equal parts of the run
LEVELS = np.array([0.1, -0.7, 0.8, 0.3, -0.4, -0.9, 0.5, 0.6, -0.2, 0.7])
KNOTS = np.linspace(0.0, STOP, LEVELS.size + 1)
SYSTEM = """<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription"
    xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon" version="1.0" name="servo">
  <ssd:System name="system">
    <ssd:Connectors>
      <ssd:Connector name="target" kind="input"><ssc:Real/></ssd:Connector>
    </ssd:Connectors>
    <ssd:ParameterBindings><ssd:ParameterBinding><ssd:ParameterValues>
      <ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues" version="1.0" name="values"><ssv:Parameters>
        <ssv:Parameter name="target"><ssv:Real value="0.7"/></ssv:Parameter>
      </ssv:Parameters></ssv:ParameterSet>
    </ssd:ParameterValues></ssd:ParameterBinding></ssd:ParameterBindings>
    <ssd:Elements>
      <ssd:Component name="crane" type="application/toml" source="m.toml">
        <ssd:Connectors>
          <ssd:Connector name="target" kind="input"><ssc:Real/></ssd:Connector>
          <ssd:Connector name="theta" kind="output"><ssc:Real/></ssd:Connector>
          <ssd:Connector name="effort" kind="output"><ssc:Real/></ssd:Connector>
        </ssd:Connectors>
      </ssd:Component>
    </ssd:Elements>
    <ssd:Connections>
      <ssd:Connection startConnector="target" endElement="crane" endConnector="target"/>
    </ssd:Connections>
  </ssd:System>
  <ssd:DefaultExperiment startTime="0" stopTime="5"/>
</ssd:SystemStructureDescription>
"""
BETWEEN = np.arange(ROWS.size) % 10 != 0
GRAVITY, TROLLEY, BEARING = 9.81, 2.0, 0.5
STARTS = {"rail.position_start": 0.4, "rail.velocity_start": -0.3, "rope.angle_start": 0.5, "rope.angular_velocity_start": 0.6}


def level(time):
    """The input in the part of the run that begins then or before, over its largest value."""
    return LEVELS[np.clip((np.asarray(time) / KNOTS[1] + 1e-6).astype(int), 0, LEVELS.size - 1)]


def built(folder, mechanism, name):
    """The folder with FMUs of both versions of a mechanism, from the study that `new` writes, with fewer test runs."""
    (folder / "m.toml").write_text(mechanism)
    metafmu("new", name, "--mechanism", "m.toml", "--structure", "dynamics", cwd=folder)
    study = folder / f"{name}.toml"
    study.write_text(study.read_text().replace("test_runs = 20", "test_runs = 4"))
    metafmu("build", study.name, "--out", "out", "--fmi", "both", cwd=folder)
    return folder / "out"


def simulated(fmu, interface, values, variable, largest, outputs):
    """Rows of an FMU whose input is held over each part."""
    if interface == "CoSimulation":
        points = [(row, largest * level(row)) for row in ROWS]
        options = {"relative_tolerance": 1e-9}
    else:
        # two points at one time are a jump, an event
        points = [(time, largest * value) for begin, end, value in zip(KNOTS, KNOTS[1:], LEVELS) for time in (begin, end)]
        options = {"relative_tolerance": 1e-9, "solver": "CVode"}
    table = np.array(points, dtype=[("time", float), (variable, float)])
    options |= {"start_values": values, "input": table, "output": outputs, "stop_time": STOP, "output_interval": STEP}
    result = simulate_fmu(fmu, fmi_type=interface, **options)
    # events are rows too
    _, rows = np.unique(np.round(result["time"], 9), return_index=True)
    assert rows.size == ROWS.size
    return {output: result[output][rows] for output in outputs}


def crane(acceleration, length, mass):
    """Position, angle and effort of a crane whose trolley has this acceleration, of the input's level, position and velocity."""

    def accelerations(u, x, v, theta):
        a = acceleration(u, x, v)
        return a, -(GRAVITY * np.sin(theta) + a * np.cos(theta)) / length

    rows = [list(STARTS.values())]
    for begin, end, u in zip(KNOTS, KNOTS[1:], LEVELS):
        times = ROWS[(ROWS > begin + 1e-9) & (ROWS < end + 1e-9)].clip(max=end)

        def rates(_, state):
            x, v, theta, omega = state
            a, alpha = accelerations(u, x, v, theta)
            return [v, a, omega, alpha]

        rows.extend(solve_ivp(rates, (begin, end), rows[-1], "DOP853", times, rtol=1e-11, atol=1e-12).y.T)
    x, v, theta, omega = np.array(rows).T
    a, alpha = accelerations(level(ROWS), x, v, theta)
    # Newton's law for both bodies
    effort = (TROLLEY + mass) * a + mass * length * (alpha * np.cos(theta) - omega**2 * np.sin(theta)) + BEARING * v
    return {"x": x, "theta": theta, "effort": effort}


def compare(found, expected, interface):
    """The tolerance of model exchange is that of CVode."""
    tolerance = 1e-7 if interface == "CoSimulation" else 1e-5
    for name, values in expected.items():
        # an effort jumps with the input
        rows = BETWEEN if name == "effort" else slice(None)
        error, largest = np.abs(found[name] - values)[rows].max(), np.abs(values).max()
        assert largest > 0.2 and error < tolerance * largest, (name, error, largest)


@pytest.fixture(scope="module")
def servo(tmp_path_factory):
    """The example: the input is a position that the trolley follows."""
    return built(tmp_path_factory.mktemp("servo"), changed("dynamics/servo-crane.toml"), "servo")


@pytest.fixture(scope="module")
def accelerated(tmp_path_factory):
    """The textbook's crane: the input is the trolley's acceleration."""
    changes = [('"w^2*(target - rail.position) - 1.6*w*rail.velocity"', '"a"'), ("target = {", "a = {"), ("w = {", "# w = {")]
    return built(tmp_path_factory.mktemp("accelerated"), changed("dynamics/servo-crane.toml", *changes), "accelerated")


@pytest.mark.parametrize("version, interface", KINDS)
def test_a_trolley_follows_a_commanded_position_and_the_load_swings_as_the_textbook_says(servo, version, interface):
    length, mass, w = 1.3, 0.8, 2.6
    values = {"l": length, "m": mass, "w": w, **STARTS}
    found = simulated(fmu_of(servo, "servo", version), interface, values, "target", 0.8, ["x", "theta", "effort"])
    compare(found, crane(lambda u, x, v: w * w * (0.8 * u - x) - 1.6 * w * v, length, mass), interface)


@pytest.mark.parametrize("version, interface", KINDS)
def test_a_trolley_with_a_commanded_acceleration_is_the_textbooks(accelerated, version, interface):
    length, mass = 1.7, 1.2
    values = {"l": length, "m": mass, **STARTS}
    found = simulated(fmu_of(accelerated, "accelerated", version), interface, values, "a", 1.5, ["x", "theta", "effort"])
    compare(found, crane(lambda u, x, v: 1.5 * u, length, mass), interface)


def follower(w, target):
    """Position of the drive from rest at zero, in closed form."""
    damped, decay = 0.6 * w, 0.8 * w
    return target * (1 - np.exp(-decay * ROWS) * (np.cos(damped * ROWS) + decay / damped * np.sin(damped * ROWS)))


def test_a_step_of_the_commanded_position_has_its_closed_form(servo, tmp_path):
    w, target = 3.5, 0.7
    values = {"w": w, "target": target, "rail.position_start": 0.0, "rail.velocity_start": 0.0}
    found = simulate_fmu(fmu_of(servo, "servo", 2), start_values=values, output=["x"], stop_time=STOP, output_interval=STEP)
    assert np.abs(found["x"] - follower(w, target)).max() < 1e-7
    pd.DataFrame({"time": ROWS, **values}).to_csv(tmp_path / "in.csv", index=False)
    metafmu("predict", fmu_of(servo, "servo", 2), "in.csv", "--default", "l", "--default", "m", "--out", "out.csv", cwd=tmp_path)
    assert np.abs(pd.read_csv(tmp_path / "out.csv")["x"] - follower(w, target)).max() < 1e-7


def test_position_and_velocity_of_the_drive_are_states(servo):
    description = read_model_description(fmu_of(servo, "servo", 2))
    units = {variable.name: variable.unit for variable in description.modelVariables}
    expected = {"rail.position": "m", "der(rail.velocity)": "m/s2", "target": "m", "effort": "N"}
    assert {name: units[name] for name in expected} == expected
    assert len(description.derivatives) == 4


def test_a_crank_with_a_commanded_acceleration_takes_the_torque_of_its_linkage(tmp_path):
    """Closed form: M a + M' w² / 2 + c w, with M from the positions of the bodies."""
    changes = [("[actuators.motor]", "[drivers.motor]"), ('effort = "torque"', 'acceleration = "10*alpha"'), ("torque = {", "alpha = {")]
    text = changed("dynamics/slider-crank.toml", *changes)
    outputs = 'effort = { measure = "motor.effort" }\nslider = { measure = "slider.x" }\n'
    folder = built(tmp_path, text + outputs, "crank")
    mass, c = 1.4, 0.2
    values = {"m": mass, "c": c, "A.angle_start": 0.5, "A.angular_velocity_start": 3.0}
    found = simulated(fmu_of(folder, "crank", 3), "CoSimulation", values, "alpha", 1.0, ["theta", "effort", "slider"])
    theta, omega = [0.5], [3.0]
    for row in ROWS[:-1]:
        theta.append(theta[-1] + STEP * omega[-1] + 5.0 * level(row) * STEP**2)
        omega.append(omega[-1] + 10.0 * level(row) * STEP)
    theta, omega = np.array(theta), np.array(omega)
    assert np.ptp(theta) > 2 * np.pi, "it goes around"

    def slider(theta):
        return 0.3 * np.cos(theta) + np.sqrt(0.81 - 0.09 * np.sin(theta) ** 2)

    def inertia(theta):
        """Twice the kinetic energy at one rad/s."""

        def rate(position):
            return np.imag(position(theta + 1e-30j)) / 1e-30

        crank = 0.02 + 0.15**2
        rod_x, rod_angle = rate(lambda theta: 0.5 * (0.3 * np.cos(theta) + slider(theta))), rate(lambda theta: np.arcsin(np.sin(theta) / 3))
        rod = 0.8 * (rod_x**2 + (0.15 * np.cos(theta)) ** 2) + 0.06 * rod_angle**2
        return crank + rod + mass * rate(slider) ** 2

    near, far = (inertia(theta + h) - inertia(theta - h) for h in (1e-3, 2e-3))
    slope = (8 * near - far) / 12e-3
    effort = inertia(theta) * 10.0 * level(ROWS) + 0.5 * slope * omega**2 + c * omega
    compare(found, {"theta": theta, "slider": slider(theta), "effort": effort}, "CoSimulation")


@pytest.mark.parametrize("version", [2, 3])
def test_validation_has_no_finding(servo, version):
    run = subprocess.run([METAFMU, "validate", fmu_of(servo, "servo", version)], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr


def test_the_mechanism_and_its_surrogate_move_alike_in_a_system(servo):
    system = servo.parent / "SystemStructure.ssd"
    system.write_text(SYSTEM)
    options = ["--component", "crane", "--with", fmu_of(servo, "servo", 2), "--step-size", "0.02", "--json"]
    comparison = json.loads(metafmu("swap", system, *options).stdout)
    differences = {one["output"]: one["relative_max"] for one in comparison["outputs"]}
    assert set(differences) == {"crane.theta", "crane.effort"} and max(differences.values()) < 1e-6, differences


def test_the_c_sources_follow_the_command_as_well(servo, tmp_path, monkeypatch):
    study = shutil.copytree(servo.parent, tmp_path / "copy")
    metafmu("export", "servo.toml", "--out", "out", "--sources", cwd=study)
    unpacked = compiled_from_sources(str(fmu_of(study / "out", "servo", 2)), monkeypatch)
    values = {"l": 1.3, "m": 0.8, "w": 2.6, **STARTS}
    for interface in ("CoSimulation", "ModelExchange"):
        found = simulated(str(unpacked), interface, values, "target", 0.8, ["x", "theta", "effort"])
        compare(found, crane(lambda u, x, v: 2.6**2 * (0.8 * u - x) - 1.6 * 2.6 * v, 1.3, 0.8), interface)
