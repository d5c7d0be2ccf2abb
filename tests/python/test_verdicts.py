"""Verdicts on surrogates whose test runs are no measure of them: motions that leave the domain, sources with a coarse time step."""

import json
import math
import shutil
import sys

import numpy as np
import pandas as pd
import pytest
from conftest import ROOT, metafmu
from scipy.integrate import solve_ivp

# an arm of 0.3 m on the lintel, the door of 0.9 m as its rod, a roller in a rail: its dead points are at 0.6 and 1.2 m
DOOR = """
parameters.load = { default = 2.0, min = 1.0, max = 3.0, unit = "kg" }
inputs.pull = { min = -6.0, max = 6.0, unit = "N" }
outputs.roller = { measure = "rail.position" }
outputs.arm = { measure = "lintel.angle" }
[bodies]
arm = { mass = 1, inertia = 0.02, position = [0, 0.15], angle = 1.5707963267948966, points = { pin = [-0.15, 0], tip = [0.15, 0] } }
roller = { mass = "load", position = [0.8485281374238571, 0] }
[bodies.door]
mass = 3
inertia = 0.2
position = [0.42426406871192857, 0.15]
angle = -0.3398369094541219
points = { top = [-0.45, 0], foot = [0.45, 0] }
[joints]
lintel = { type = "revolute", between = ["ground", "arm.pin"] }
hinge = { type = "revolute", between = ["arm.tip", "door.top"] }
foot = { type = "revolute", between = ["door.foot", "roller"] }
rail = { type = "prismatic", between = ["ground", "roller"], axis = [1, 0] }
[springs.bearing]
coordinate = "lintel.angle"
damping = 0.05
[actuators.opener]
coordinate = "rail.position"
effort = "pull"
"""
DOOR_STUDY = """
name = "door"
structure = "dynamics"
[source]
mechanism = "door.toml"
[time]
stop = 2.5
step = 0.05
[states]
rail.position = { min = 0.75, max = 1.12, start = [0.8, 0.95], velocity = [0.0, VELOCITY] }
[inputs]
pull = { bandwidth = 0.5 }
[parameters]
load = { min = 1.0, max = 3.0 }
[outputs]
roller = {}
arm = {}
[sampling]
states = 500
test_runs = 8
[dynamics]
model = "dictionary"
"""


def door(folder, velocity):
    (folder / "door.toml").write_text(DOOR)
    (folder / "study.toml").write_text(DOOR_STUDY.replace("VELOCITY", str(velocity)))
    done = metafmu("build", folder / "study.toml", "--out", folder / "out", check=False)
    return done, json.loads((folder / "out" / "metrics.json").read_text())


def test_a_motion_through_a_dead_point_does_not_reject_exact_equations(tmp_path):
    done, metrics = door(tmp_path, 0.6)
    outside, verdict = metrics["outside"], metrics["verdict"]
    assert min(output["r2"] for output in metrics["outputs"].values()) < 0.9
    assert (done.returncode, verdict["accepted"], verdict["problems"]) == (0, True, []), verdict
    inside = outside["inside"]
    assert min(output["r2"] for output in inside["outputs"].values()) > 0.999999
    # the arm and the door are one line
    assert {exit["variable"] for exit in outside["exits"]} == {"rail.position"}
    upper = [exit["dead_point"] for exit in outside["exits"] if exit["value"] > 1.12]
    assert upper == pytest.approx([1.2] * len(upper), abs=1e-6) and upper
    # rows are counted from the source's own motion, which leaves the range as well
    runs = pd.read_csv(tmp_path / "out" / "test.csv")
    left = sum((~run.roller.between(0.75, 1.12).cummin()).sum() for _, run in runs.groupby("run"))
    assert outside["rows"] == left and inside["test_rows"] == len(runs) - left
    text = f"{len(outside['exits'])} of 8 test runs leave the domain, {left} of {len(runs)} rows are outside"
    reasons = verdict["notes"] if verdict["grade"] == "good" else verdict["limits"]
    assert f"R² of {inside['test_rows']} rows before motions leave it: " in done.stdout
    assert text in done.stdout and (reasons[0]["check"], text in reasons[0]["cause"]) == ("domain", True), verdict
    assert text in (tmp_path / "out" / "report.html").read_text().split("</header>")[0]


PENDULUM = """
import numpy as np
import metafmu


@metafmu.source(
    parameters={},
    inputs={"torque": {"min": -1.0, "max": 1.0, "start": 0.0, "unit": "N.m"}},
    states={
        "angle": {"min": -3.0, "max": 3.0, "start": 0.0, "unit": "rad"},
        "rate": {"min": -9.0, "max": 9.0, "start": 0.0, "unit": "rad/s", "rate_of": "angle"},
    },
    outputs={"angle": "rad"},
    stop=5.0,
    step=0.05,
)
class Pendulum:
    def run(self, times, parameters, inputs, states):
        y, rows = np.array([states["angle"], states["rate"]]), [states["angle"]]
        for row, (time, end) in enumerate(zip(times, times[1:])):
            size = (end - time) / STEPS
            for step in range(STEPS):
                begin, middle = (np.interp(time + (step + part) * size, times, inputs["torque"]) for part in (0, 0.5))
                rates = self.rates(y, begin)
                # Euler's method, or the midpoint rule
                y = y + size * (rates if EULER else self.rates(y + size / 2 * rates, middle))
            rows.append(y[0])
        return {"angle": np.array(rows)}

    def rates(self, y, torque):
        return np.array([y[1], (torque - 9.81 * np.sin(y[0])) / 1.0])

    def equations(self, parameters, inputs, states):
        angle, rate = self.rates([states["angle"], states["rate"]], inputs["torque"])
        return {"angle": angle, "rate": rate}, {"angle": states["angle"]}, np.array([[1.0]])


Pendulum.serve()
"""


def pendulum(folder, **choices):
    program = PENDULUM
    for name, value in choices.items():
        program = program.replace(name, str(value))
    (folder / "pendulum.py").write_text(program)
    metafmu("new", "pendulum", "--structure", "dynamics", "--command", sys.executable, "pendulum.py", cwd=folder)
    study = folder / "pendulum.toml"
    lines = study.read_text().replace("test_runs = 20", "test_runs = 4").splitlines()
    lines = ["states = 500" if line.startswith("states = ") else line for line in lines]
    study.write_text("\n".join(lines) + "\n")
    done = metafmu("build", study, "--out", folder / "out", check=False)
    return done, json.loads((folder / "out" / "metrics.json").read_text())


@pytest.fixture
def source(tmp_path, monkeypatch):
    """A folder with `metafmu.source` without the package that has to be built."""
    shutil.copy(ROOT / "python" / "python" / "metafmu" / "_source.py", tmp_path / "metafmu.py")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return tmp_path


@pytest.mark.parametrize(("steps", "r2"), [(1, (-math.inf, 0.9)), (4, (0.9, 0.99))])
def test_a_coarse_time_step_of_the_source_does_not_speak_against_its_equations(source, steps, r2):
    done, metrics = pendulum(source, STEPS=steps, EULER=True)
    # Euler's method makes energy
    assert r2[0] < metrics["outputs"]["angle"]["r2"] < r2[1]
    verdict, equations = metrics["verdict"], metrics["source_equations"]
    assert (done.returncode, verdict["grade"]) == (0, "usable"), verdict
    limit = verdict["limits"][0]
    assert (limit["check"], limit["place"]) == ("source-step", "angle") and "a shorter time step of the source" in verdict["advice"][0], verdict
    assert equations["surrogate"]["outputs"]["angle"]["max_abs_error"] < 1e-4
    # the source's own error, by another integrator
    worst = equations["source"]["angle"]
    runs = pd.read_csv(source / "out" / "test.csv")
    run = runs[runs.run == worst["worst_run"]]
    torque = lambda t: np.interp(t, run.time, run.torque)
    start = [run.angle_start.iloc[0], run.rate_start.iloc[0]]
    exact = solve_ivp(lambda t, y: [y[1], torque(t) - 9.81 * np.sin(y[0])], (0, 5), start, t_eval=run.time, rtol=1e-9, atol=1e-9, max_step=0.05)
    assert worst["max_abs_error"] == pytest.approx(np.abs(exact.y[0] - run.angle).max(), rel=1e-3)
    assert "off by up to" in (source / "out" / "report.html").read_text()
    # the verbs that judge again
    assert metafmu("evaluate", source / "pendulum.toml", "--out", source / "out").returncode == 0


def test_a_source_with_a_fine_time_step_needs_no_comparison(source):
    done, metrics = pendulum(source, STEPS=20, EULER=False)
    assert (done.returncode, metrics["verdict"]["grade"]) == (0, "good"), metrics["verdict"]
    assert "source_equations" not in metrics and "leave the domain" not in done.stdout
