"""A pendulum with dry friction in tanh, whose formula the FMU keeps, against scipy's solution of its equations."""

import json
import subprocess

import numpy as np
import pytest
from conftest import METAFMU, ROOT, changed, fmu_of, metafmu
from fmpy import simulate_fmu
from scipy.integrate import solve_ivp

STOP, STEP = 5.0, 0.05
ROWS = np.linspace(0.0, STOP, 101)
BEARING = """[springs.bearing]
coordinate = "pivot.angle"
damping = "c"
"""
FRICTION = """[actuators.friction]
coordinate = "pivot.angle"
effort = "-c * tanh(pivot.angular_velocity / 0.2)"
"""
STUDY = """name = "pendulum"
structure = "dynamics"
[source]
mechanism = "pendulum-with-friction.toml"
[time]
stop = 5.0
step = 0.05
[states]
pivot.angle = { min = -3.141592653589793, max = 3.141592653589793, velocity = [-2.0, 2.0] }
[inputs]
torque = { bandwidth = 1.0 }
[parameters]
L = { min = 0.5, max = 1.0 }
c = { min = 0.0, max = 0.2 }
[outputs]
theta = {}
[sampling]
test_runs = 4
"""


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    folder = tmp_path_factory.mktemp("friction")
    (folder / "pendulum-with-friction.toml").write_text(changed("dynamics/pendulum.toml", (BEARING, FRICTION)))
    (folder / "pendulum.toml").write_text(STUDY)
    subprocess.run([METAFMU, "build", "pendulum.toml", "--out", "out", "--fmi", "both"], cwd=folder, check=True, capture_output=True)
    return folder


def solution(length, friction, torque):
    """Angles at the rows, the torque being constant."""
    mass = 1.0

    def rates(t, state):
        angle, speed = state
        moment = torque - friction * np.tanh(speed / 0.2)
        return [speed, moment / (mass * length**2) - 9.81 / length * np.sin(angle)]

    return solve_ivp(rates, (0.0, STOP), [0.8, 1.0], t_eval=ROWS, rtol=1e-10, atol=1e-12).y[0]


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("interface", ["CoSimulation", "ModelExchange"])
def test_the_fmu_has_the_friction(pendulum, version, interface):
    for length, friction, torque in [(0.7, 0.15, 0.5), (0.9, 0.1, -1.5)]:
        values = {"L": length, "c": friction, "torque": torque, "pivot.angle_start": 0.8, "pivot.angular_velocity_start": 1.0}
        options = {"fmi_type": interface, "start_values": values, "stop_time": STOP, "output_interval": STEP, "relative_tolerance": 1e-10}
        found = simulate_fmu(fmu_of(pendulum / "out", "pendulum", version), output=["theta"], **options)
        exact, without = solution(length, friction, torque), solution(length, 0.0, torque)
        error, effect = np.abs(found["theta"] - exact).max(), np.abs(without - exact).max()
        assert error < (1e-6 if interface == "CoSimulation" else 1e-5) and effect > 0.1, (error, effect)


def test_the_equations_are_exact_and_need_no_network(pendulum):
    motion = json.loads((pendulum / "out" / "training.json").read_text())["motion"]
    assert motion["error"] < 1e-12 and motion["exported"] == "dictionary" and "candidates" not in motion


def test_a_network_alone_is_exported_if_the_study_says_so(pendulum, tmp_path):
    (tmp_path / "pendulum-with-friction.toml").write_text((pendulum / "pendulum-with-friction.toml").read_text())
    more = "[dynamics]\nmodel = \"network\"\n[training]\nepochs = 60\n[sampling]\nstates = 6000"
    study = STUDY.replace("[sampling]", more)
    (tmp_path / "pendulum.toml").write_text(study)
    metafmu("sample", tmp_path / "pendulum.toml", "--out", tmp_path / "out")
    done = metafmu("train", tmp_path / "pendulum.toml", "--out", tmp_path / "out", check=False)
    motion = json.loads((tmp_path / "out" / "training.json").read_text())["motion"]
    assert motion["exported"] == "network" and {c["name"] for c in motion["candidates"]} == {"dictionary", "network"}
    assert "exported: network" in done.stdout + done.stderr
    for wrong, message in [('model = "forest"', "dynamics.model"), ("compares = true", "dynamics.compares")]:
        (tmp_path / "wrong.toml").write_text(study.replace('model = "network"', wrong))
        done = metafmu("sample", tmp_path / "wrong.toml", "--dry-run", check=False)
        assert done.returncode != 0 and message in done.stderr


@pytest.mark.parametrize("force", ["friction", "drag"])
def test_the_fmu_takes_the_place_of_its_mechanism_in_a_system(force, tmp_path):
    example = ROOT / "examples" / "dynamics" / "known-forces"
    subprocess.run([METAFMU, "new", force, "--mechanism", example / f"{force}.toml", "--structure", "dynamics"], cwd=tmp_path, check=True)
    metafmu("build", tmp_path / f"{force}.toml", "--out", tmp_path / "out")
    system, fmu = example / f"{force}.ssd", tmp_path / "out" / f"{force}.fmu"
    done = metafmu("swap", system, "--component", "pendulum", "--with", fmu, "--step-size", 0.01, "--json")
    outputs = json.loads(done.stdout)["outputs"]
    assert {output["output"] for output in outputs} == {"pendulum.q", "pendulum.w"}
    # the error of the solver, far from that of a network
    assert max(output["relative_max"] for output in outputs) < 1e-6
