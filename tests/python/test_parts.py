"""Mechanisms with couplings, stops, contacts, bushings, spring forces, variables and actuator states against scipy's solutions of equations by hand."""

import json
import subprocess

import numpy as np
import pytest
import tomllib
from conftest import METAFMU, ROOT, change, compiled_from_sources, fmu_of, metafmu
from fmpy import simulate_fmu
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

PARTS = ROOT / "examples" / "dynamics" / "parts"
STOP = 2.0
ROWS = np.linspace(0.0, STOP, 201)
TABLE = tomllib.loads((PARTS / "suspension.toml").read_text())["tables"]["damper"]
DAMPER = CubicSpline(TABLE["x"], TABLE["values"])
TABLE = tomllib.loads((PARTS / "cam.toml").read_text())["tables"]["lift"]
LIFT = CubicSpline(TABLE["x"], TABLE["values"], bc_type="periodic")


def stop(x, v, low, high, stiffness, damping):
    """Force of a stop."""
    below = max(low - x, 0.0) * max(1.0 - damping * v, 0.0)
    return stiffness * (below - max(x - high, 0.0) * max(1.0 + damping * v, 0.0))


def rack(p, state):
    angle, speed = state
    torque = p["torque"] - 0.05 * speed + p["r"] * stop(p["r"] * angle, p["r"] * speed, -0.5, 0.5, 2e4, 0.2)
    return [speed, torque / (0.3 + p["m"] * p["r"] ** 2)]


def suspension(p, state):
    z, axle, vz, va = state
    rate, length = vz - va, z - axle
    at = min(max(rate, -1.0), 1.0)
    damper = DAMPER(at) + (rate - at) * DAMPER(at, 1)
    strut = -2e4 * (length - 0.7) - damper + stop(length, rate, 0.48, 0.62, 2e5, 0.5)
    tyre = max(2e5 * (0.35 + p["road"] - axle), 0.0) - 500.0 * va
    return [vz, va, strut / p["m"] - 9.81, (tyre - strut) / 40.0 - 9.81]


def magnet(p, state):
    y, speed = state
    force = 1e-4 * p["current"] ** 2 / (0.002 - y) ** 2 - 0.5 * speed + stop(y, speed, -0.03, -0.004, 1e5, 0.5)
    return [speed, force / p["m"] - 9.81]


def mount(p, state):
    x, y, angle, vx, vy, omega = state
    share = min(max((p["throttle"] - 0.2) / 0.6, 0.0), 1.0)
    torque = 120.0 * share**2 * (3.0 - 2.0 * share)
    # of the foot, from the frame
    arm = np.array([0.2 * np.sin(angle), -0.2 * np.cos(angle)])
    moved = np.array([x, y]) + arm + [0.0, 0.2]
    rate = np.array([vx, vy]) + omega * np.array([-arm[1], arm[0]])
    force = -np.array([p["k"], 2.0 * p["k"]]) * moved - np.array([200.0, 400.0]) * rate
    moment = torque - 3e3 * angle - 20.0 * omega + arm[0] * force[1] - arm[1] * force[0]
    return [vx, vy, omega, force[0] / 80.0, force[1] / 80.0 - 9.81, moment / 4.0]


def tyre(p, state):
    """Friction and normal force of the wheel's contact."""
    _, height, _, speed, rate, spin = state
    normal = 2e4 * max(0.2 - height, 0.0) * max(1.0 - 0.5 * rate, 0.0)
    return -p["mu"] * normal * np.tanh((speed + 0.2 * spin) / 0.05), normal


def wheel(p, state):
    _, _, _, speed, rate, spin = state
    friction, normal = tyre(p, state)
    weight = p["load"] + 2.0
    return [speed, rate, spin, (friction - 4.0 * speed) / (weight + 0.5), normal / weight - 9.81, (p["torque"] + 0.2 * friction) / 0.04]


def voltage(p, state):
    return 24.0 * np.tanh((p["kp"] * (p["speed"] - state[1]) + 10.0 * state[3]) / 24.0)


def motor(p, state):
    angle, omega, current, _ = state
    torque = 30.0 * (0.05 * current - 2e-4 * np.tanh(30.0 * omega / 0.5)) - 1.5 * 9.81 * 0.5 * p["L"] * np.sin(angle)
    rate = (voltage(p, state) - 1.2 * current - 0.05 * 30.0 * omega) / 0.004
    return [omega, torque / (0.5 * p["L"] ** 2 + 900.0 * 2e-5), rate, p["speed"] - omega]


def cam(p, state):
    angle, speed = state
    _, slope, curvature = (LIFT(angle, order) for order in range(3))
    torque = p["torque"] - 0.02 * speed - slope * (load(p, state) + p["m"] * curvature * speed**2)
    return [speed, torque / (0.002 + p["m"] * slope**2)]


def load(p, state):
    """Force on the cam at a constant speed of the valve."""
    lift, slope = LIFT(state[0]), LIFT(state[0], 1)
    return p["k"] * (lift + 0.02) + 3.0 * slope * state[1] + 9.81 * p["m"]


def force_on_cam(p, state):
    slope, curvature = LIFT(state[0], 1), LIFT(state[0], 2)
    return load(p, state) + p["m"] * (curvature * state[1] ** 2 + slope * cam(p, state)[1])


# coordinates and actuator states, what is compared and which coordinate it is, points at corners of parameters, inputs and speeds
CASES = {
    "rack": (rack, ["shaft.angle"], {"x": lambda p, s: p["r"] * s[0], "speed": lambda p, s: s[1]}, [
        ({"r": 0.1, "m": 8.0, "torque": 2.0}, [0.5, 3.0]),
        ({"r": 0.3, "m": 3.0, "torque": -2.0}, [-1.0, -4.0]),
        ({"r": 0.3, "m": 8.0, "torque": 0.0}, [1.6, 2.0]),
    ]),
    "cam": (cam, ["camshaft.angle"], {"angle": lambda p, s: s[0], "lift": lambda p, s: LIFT(s[0]), "force": force_on_cam}, [
        ({"m": 0.1, "k": 1200.0, "torque": 2.0}, [0.3, 18.0]),
        ({"m": 0.4, "k": 600.0, "torque": -2.0}, [-3.0, 22.0]),
    ]),
    "suspension": (suspension, ["guide.position", "axle.position"], {"z": lambda p, s: s[0], "travel": lambda p, s: s[0] - s[1]}, [
        ({"m": 250.0, "road": 0.05}, [0.95, 0.34, 1.0, -1.0]),
        ({"m": 400.0, "road": -0.05}, [0.86, 0.36, -2.0, 0.5]),
    ]),
    "magnet": (magnet, ["guide.position"], {"y": lambda p, s: s[0], "speed": lambda p, s: s[1]}, [
        ({"m": 0.4, "current": 0.0}, [-0.005, 0.3]),
        ({"m": 0.6, "current": 4.0}, [-0.025, -0.3]),
    ]),
    "mount": (mount, ["engine.x", "engine.y", "engine.angle"], {"x": lambda p, s: s[0], "y": lambda p, s: s[1], "angle": lambda p, s: s[2]}, [
        ({"k": 1e4, "throttle": 1.0}, [0.01, -0.02, 0.1, 0.2, 0.0, -1.0]),
        ({"k": 4e4, "throttle": 0.5}, [0.0, 0.0, -0.1, 0.0, 0.3, 1.0]),
    ]),
    "wheel": (wheel, ["slide.position", "lift.position", "hub.angle"], {
        "position": lambda p, s: s[0], "height": lambda p, s: s[1], "spin": lambda p, s: s[5], "friction": lambda p, s: tyre(p, s)[0],
    }, [
        # slides, bounces, then rolls
        ({"mu": 0.2, "load": 8.0, "torque": 3.0}, [0.0, 0.25, 0.0, 0.5, 0.0, 8.0]),
        ({"mu": 1.0, "load": 3.0, "torque": -3.0}, [-0.2, 0.2, 1.0, -0.5, 0.0, 2.0]),
    ]),
    "motor": (motor, ["hinge.angle", "current", "integral"], {
        "angle": lambda p, s: s[0], "omega": lambda p, s: s[1], "current": lambda p, s: s[2], "power": lambda p, s: voltage(p, s) * s[2],
    }, [
        ({"L": 0.3, "kp": 4.0, "speed": 4.0}, [0.5, -4.0, 3.0, -0.3]),
        ({"L": 0.5, "kp": 1.0, "speed": -4.0}, [2.0, 1.0, -2.0, 0.2]),
    ]),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_the_study_that_new_proposes_is_exact(name, tmp_path, monkeypatch):
    rates, coordinates, outputs, points = CASES[name]
    metafmu("new", name, "--mechanism", PARTS / f"{name}.toml", "--structure", "dynamics", cwd=tmp_path)
    change(tmp_path / f"{name}.toml", (r"test_runs = \d+", "test_runs = 4"))
    subprocess.run([METAFMU, "build", f"{name}.toml", "--out", "out", "--sources"], cwd=tmp_path, check=True, capture_output=True)
    verdict = json.loads((tmp_path / "out" / "metrics.json").read_text())["verdict"]
    assert verdict["grade"] == "good", verdict
    packed = fmu_of(tmp_path / "out", name, 2)
    for fmu in [packed, compiled_from_sources(packed, monkeypatch)]:
        for p, start in points:
            positions = [name for name in coordinates if "." in name]
            names = [*positions, *map(rate_of, positions), *(name for name in coordinates if "." not in name)]
            values = {**p, **{f"{name}_start": value for name, value in zip(names, start, strict=True)}}
            found = simulate_fmu(fmu, fmi_type="CoSimulation", start_values=values, stop_time=STOP, output_interval=ROWS[1], output=[*outputs])
            exact = solve_ivp(lambda t, s: rates(p, s), (0.0, STOP), start, t_eval=ROWS, method="DOP853", rtol=1e-11, atol=1e-12, max_step=5e-3).y
            for output, of in outputs.items():
                expected = np.array([of(p, state) for state in exact.T])
                error = np.abs(found[output] - expected).max() / np.ptp(expected)
                assert error < 1e-5, (name, output, p, error)


def rate_of(position):
    """Name of the rate of a position."""
    owner, what = position.rsplit(".", 1)
    return f"{owner}.{ {'angle': 'angular_velocity', 'position': 'velocity', 'x': 'vx', 'y': 'vy'}[what] }"
