"""States without a range, in motions far from where they start, compared with closed forms and scipy's solutions."""

import json
import re
import shutil
import sys
import zipfile

import fmpy
import numpy as np
import pytest
from conftest import ROOT, change, compiled_from_sources, metafmu
from fmpy import simulate_fmu
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

PULLEY = """
gravity = [0, -9.81]
[parameters]
m = { default = 20, min = 10, max = 40 }
[inputs]
T = { min = 0, max = 30 }
[bodies]
d = { mass = 2, inertia = 0.02 }
l = { mass = "m" }
[joints]
drum = { type = "revolute", between = ["ground", "d"] }
lift = { type = "prismatic", between = ["ground", "l"], axis = [0, 1] }
[couplings]
rope = { coordinate = "lift.position", follows = "0.1*drum.angle/2" }
[actuators]
t = { coordinate = "drum.angle", effort = "T - 0.2*drum.angular_velocity" }
[outputs]
y = { measure = "lift.position" }
pull = { measure = "rope.effort" }
V = { measure = "potential_energy" }
"""
CAR = """
[parameters]
m = { default = 1200, min = 900, max = 1500 }
[inputs]
F = { min = -4000, max = 4000 }
[bodies]
car = { mass = "m" }
[joints]
road = { type = "prismatic", between = ["ground", "car"], axis = [1, 0] }
[actuators]
drive = { coordinate = "road.position", effort = "F - 0.4*road.velocity*abs(road.velocity)" }
[outputs]
x = { measure = "road.position" }
"""
CYCLE = [0, 120, 300, 480, 720], [1.0, 6.0, -3.0, -1.0, 1.0]
ENGINE = f"""
[parameters]
J = {{ default = 0.1, min = 0.05, max = 0.2 }}
[bodies]
flywheel = {{ mass = 2, inertia = "J" }}
[joints]
main = {{ type = "revolute", between = ["ground", "flywheel"] }}
[actuators]
gas = {{ coordinate = "main.angle", effort = "cycle(main.angle*180/pi) - 0.02*main.angular_velocity" }}
[tables.cycle]
x = {CYCLE[0]}
values = {CYCLE[1]}
interpolation = "cubic"
extrapolation = "periodic"
[initial]
main.angular_velocity = 10
[outputs]
w = {{ measure = "main.angular_velocity" }}
"""
CAR_PROGRAM = """
import math
import metafmu

@metafmu.source(
    inputs={"F": {"min": -1.0, "max": 1.0, "start": 0.0}},
    states={"x": {"min": -1.0, "max": 1.0, "start": 0.0}, "v": {"min": -3.0, "max": 3.0, "start": 0.0}},
    outputs={"x": "", "v": ""}, stop=2.0, step=0.02,
)
class Car:
    def equations(self, parameters, inputs, states):
        v = states["v"]
        return {"x": v, "v": inputs["F"] - math.tanh(8 * v)SPRING}, {"x": states["x"], "v": v}

if __name__ == "__main__":
    Car.serve()
"""


def build(folder, text, *changes):
    (folder / "source.toml").write_text(text)
    metafmu("new", "study", "--mechanism", "source.toml", "--structure", "dynamics", cwd=folder)
    change(folder / "study.toml", (r"test_runs = \d+", "test_runs = 4"), *changes)
    metafmu("build", "study.toml", "--out", "out", cwd=folder)
    return folder / "out" / "study.fmu"


def simulate(fmu, stop, outputs, **starts):
    step = stop / 200
    found = simulate_fmu(str(fmu), stop_time=stop, step_size=step, output_interval=step, start_values=starts, output=[*outputs, "in_domain"])
    return found["time"], found["in_domain"], *(found[name] for name in outputs)


@pytest.mark.parametrize(("mass", "torque"), [(10, 0.0), (40, 30.0), (17, 6.0)])
def test_a_load_on_a_drum_is_exact_many_turns_away(tmp_path_factory, mass, torque):
    folder = tmp_path_factory.getbasetemp() / "pulley"
    folder.mkdir(exist_ok=True)
    fmu = folder / "out" / "study.fmu"
    if not fmu.exists():
        build(folder, PULLEY, (r"velocity = \[.*\] \}", "velocity_range = [-150.0, 150.0] }"))
    assert json.loads((folder / "out" / "training.json").read_text())["motion"]["error"] < 1e-12
    times, in_domain, y, pull, potential = simulate(fmu, 5.0, ["y", "pull", "V"], m=mass, T=torque)
    # a first-order lag of the drum's speed
    inertia, drive = 0.02 + 0.0025 * mass, torque - 9.81 * 0.05 * mass
    speed = drive / 0.2 * (1 - np.exp(-0.2 * times / inertia))
    angle = drive / 0.2 * (times - inertia / 0.2 * (1 - np.exp(-0.2 * times / inertia)))
    acceleration = (drive - 0.2 * speed) / inertia
    assert in_domain.all() and np.abs(angle).max() > 8 * np.pi
    assert np.abs(y - 0.05 * angle).max() < 1e-6 * np.abs(y).max()
    assert np.abs(np.abs(pull) - mass * (9.81 + 0.05 * acceleration)).max() < 1e-5 * mass
    expected = 9.81 * mass * 0.05 * angle
    assert np.abs(potential - potential[0] - expected).max() < 1e-6 * np.abs(expected).max()


def test_a_car_is_in_its_domain_however_far_it_drives(tmp_path):
    fmu = build(tmp_path, CAR, (r"velocity = \[.*\] \}", "velocity_range = [-100.0, 100.0] }"))
    times, in_domain, x = simulate(fmu, 60.0, ["x"], m=1000, F=3000.0)
    expected = 1000 / 0.4 * np.log(np.cosh(np.sqrt(3000 * 0.4) / 1000 * times))
    assert in_domain.all() and expected[-1] > 2000
    assert np.abs(x - expected).max() < 1e-6 * expected[-1]
    # the report and the card agree with the FMU
    assert "<code>road.position</code> any value" in (tmp_path / "out" / "report.html").read_text()
    card = zipfile.ZipFile(fmu).read("documentation/index.html").decode()
    assert re.search("road.position.*any number", card.replace("\n", " "))
    assert "nothing depends on it: valid everywhere" in (tmp_path / "study.toml").read_text()


def test_a_gear_whose_ratio_is_a_parameter_is_exact_many_turns_away(tmp_path):
    gear = (ROOT / "examples" / "mechanisms" / "elements" / "gear.toml").read_text()
    fmu = build(tmp_path, gear, (r"velocity = \[.*\] \}", "velocity_range = [-150.0, 150.0] }"))
    for ratio in (2.0, 3.1, 4.0):
        times, in_domain, speed = simulate(fmu, 20.0, ["pinion"], ratio=ratio)
        inertia, damping = 0.001 + 0.05 / ratio**2, 0.05 / ratio**2
        expected = 0.2 / damping * (1 - np.exp(-damping / inertia * times))
        assert in_domain.all() and np.sum(expected) * times[1] > 80 * np.pi
        assert np.abs(speed - expected).max() < 1e-6 * expected.max()


def test_an_engine_whose_force_repeats_after_two_turns_is_in_its_domain(tmp_path):
    fmu = build(tmp_path, ENGINE, (r"velocity = \[.*\] \}", "velocity_range = [-150.0, 150.0] }"))
    assert "a full turn: all angles" in (tmp_path / "study.toml").read_text()
    knots, values = CYCLE
    gas = CubicSpline(np.radians(knots), values, bc_type="periodic")
    for start, inertia in [(0.0, 0.2), (7.0, 0.05)]:
        times, in_domain, speed = simulate(fmu, 6.0, ["w"], J=inertia, **{"main.angle_start": start, "main.angular_velocity_start": 20.0})
        rates = lambda _, y: [y[1], (gas(y[0]) - 0.02 * y[1]) / inertia]
        truth = solve_ivp(rates, (0, 6), [start, 20.0], "DOP853", times, rtol=1e-11, atol=1e-11).y
        assert in_domain.all() and truth[0][-1] > 8 * np.pi
        assert np.abs(speed - truth[1]).max() < 1e-4


@pytest.mark.parametrize(("spring", "is_free"), [("", True), (" - 0.1 * states['x']", False)])
def test_a_state_that_a_program_does_not_use_has_no_range(tmp_path, monkeypatch, spring, is_free):
    shutil.copy(ROOT / "python" / "python" / "metafmu" / "_source.py", tmp_path / "metafmu.py")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (tmp_path / "car.py").write_text(CAR_PROGRAM.replace("SPRING", spring))
    metafmu("new", "study", "--structure", "dynamics", "--command", sys.executable, "car.py", cwd=tmp_path)
    with (tmp_path / "study.toml").open("a") as file:
        file.write('[dynamics]\nmodel = "dictionary and network"\n[accept]\nr2 = -inf\n')
    change(
        tmp_path / "study.toml",
        (r"\nstates = \d+", "\nstates = 400"),
        (r"test_runs = \d+", "test_runs = 2"),
        (r"hidden = .*\]", "hidden = [8]"),
        (r"epochs = \d+", "epochs = 20"),
    )
    metafmu("build", "study.toml", "--out", "out", cwd=tmp_path, check=False)
    runs = [simulate(tmp_path / "out" / "study.fmu", 0.5, ["v"], v_start=0.3, F=0.1, x_start=x) for x in (0.5, 40.0)]
    (_, near, v), (_, far, w) = runs
    assert near.all() and (far.all() if is_free else not far.any())
    assert (np.abs(v - w).max() == 0) == is_free


def test_a_rope_that_is_just_taut_at_the_start_is_no_problem(tmp_path):
    rope = """
gravity = [0, -9.81]
[parameters]
k = { default = 60000, min = 30000, max = 90000 }
[bodies]
load = { mass = 20 }
[joints]
s = { type = "prismatic", between = ["ground", "load"], axis = [0, -1] }
[actuators]
rope = { coordinate = "s.position", effort = "-k*max(0, s.position - 0.5) - 2000*s.velocity" }
[initial]
s.position = 0.49997
[outputs]
F = { formula = "k*max(0, s.position - 0.5)", unit = "N" }
"""
    fmu = build(tmp_path, rope)
    assert "no problems found" in metafmu("validate", fmu).stdout


KINKS = """
[inputs]
F = { min = -5, max = 5 }
[bodies]
b = { mass = 1 }
[joints]
s = { type = "prismatic", between = ["ground", "b"], axis = [1, 0] }
[actuators]
friction = { coordinate = "s.position", effort = "F - 8*sign(s.velocity)*min(1, abs(s.velocity)/0.01) - 8*s.velocity" }
[outputs]
G = { formula = "1e4*max(0, F) + 300*abs(F)", unit = "N" }
"""


@pytest.mark.parametrize("kind", ["library", "sources"])
def test_derivatives_at_a_kink_are_one_sided_slopes(tmp_path, monkeypatch, kind):
    """Friction at rest has the slope -800 on both sides, and the force of a rope 10300 and -300."""
    fmu = build(tmp_path, KINKS, (r"velocity = \[.*\] \}", "velocity_range = [-3.0, 3.0] }"))
    assert "no problems found" in metafmu("validate", fmu).stdout
    if kind == "sources":
        metafmu("export", tmp_path / "study.toml", "--out", tmp_path / "out", "--sources", "--fmi", 2)
    description = fmpy.read_model_description(str(fmu))
    references = {variable.name: variable.valueReference for variable in description.modelVariables}
    folder = compiled_from_sources(fmu, monkeypatch) if kind == "sources" else fmpy.extract(str(fmu))
    instance = fmpy.instantiate_fmu(folder, description, "ModelExchange")
    instance.setupExperiment(startTime=0.0)
    instance.enterInitializationMode()
    for known, unknown, direction, slope in [
        ("s.velocity", "der(s.velocity)", 1.0, -808.0),
        ("s.velocity", "der(s.velocity)", -1.0, -808.0),
        ("F", "G", 2.0, 10300.0),
        ("F", "G", -1.0, -300.0),
    ]:
        derivative = instance.getDirectionalDerivative([references[unknown]], [references[known]], [direction])[0]
        assert derivative == pytest.approx(slope * direction, rel=1e-12), (known, unknown, direction)
    instance.freeInstance()
    shutil.rmtree(folder)
