"""Programs that give their mass matrix: equations of motion with exact structure."""

import json
import shutil
import sys

import numpy as np
import pytest
from conftest import ROOT, change, metafmu

COMMANDS = ROOT / "examples" / "commands"


@pytest.fixture
def robot(tmp_path, monkeypatch):
    """A folder with the robot, and with `metafmu.source` without the package that has to be built."""
    shutil.copy(ROOT / "python" / "python" / "metafmu" / "_source.py", tmp_path / "metafmu.py")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    shutil.copy(COMMANDS / "two_links.py", tmp_path)
    return tmp_path


def study(folder, *changes):
    metafmu("new", "robot", "--structure", "dynamics", "--command", sys.executable, "two_links.py", cwd=folder)
    path = folder / "robot.toml"
    # scipy integrates the runs in Python
    return change(path, (r"stop = \S+", "stop = 0.5"), (r"test_runs = \d+", "test_runs = 5"), *changes)


def results(out):
    metrics = json.loads((out / "metrics.json").read_text())
    training = json.loads((out / "training.json").read_text())
    return metrics["outputs"], training["motion"]


def test_a_robot_is_as_exact_as_its_integration(robot):
    path = study(robot, (r"\nstates = \d+", "\nstates = 1000"))
    assert 'unit = "rad/s"' in path.read_text() and 'rate_of = "elbow"' in path.read_text()
    result = metafmu("build", path, "--out", robot / "out")
    assert "learned equations of motion" in result.stderr, result.stderr
    outputs, method = results(robot / "out")
    assert method["error"] < 1e-12, method
    # scipy integrates the source with a tolerance of 1e-9
    errors = {name: output["relative_max_error"] for name, output in outputs.items()}
    assert max(errors.values()) < 1e-6, errors


def test_friction_is_left_to_a_network(robot):
    script = robot / "two_links.py"
    script.write_text(script.read_text().replace("damping = 0.4 *", "damping = 0.5 * np.tanh([v1, states['elbow.rate']]) + 0.4 *"))
    path = study(robot, (r"\nstates = \d+", "\nstates = 4000"), (r"epochs = \d+", "epochs = 1500"), (r"hidden = .*\]", "hidden = [32, 32]"))
    metafmu("build", path, "--out", robot / "out")
    outputs, method = results(robot / "out")
    errors = {candidate["name"]: candidate["error"] for candidate in method["candidates"]}
    assert method["exported"] == "dictionary and network" and errors["dictionary and network"] < 0.2 * errors["dictionary"], method
    assert min(output["r2"] for output in outputs.values()) > 0.999, outputs


@pytest.mark.parametrize(
    ("where", "pattern", "other", "says"),
    [
        ("robot.toml", ', rate_of = "elbow"', "", "states.elbow.rate.rate_of: missing, expected `elbow`: coordinates come first"),
        ("robot.toml", 'rate_of = "elbow"', 'rate_of = "shoulder"', "states.elbow.rate.rate_of: `shoulder`, expected `elbow`"),
        ("robot.toml", r"\[sampling\]", '[dynamics]\nmodel = "network"\n[sampling]', 'dynamics.model: "network", expected "best", "dictionary"'),
        ("two_links.py", "return derivatives, outputs, mass", "return derivatives, outputs", "`equations` returns two values, expected the mass matrix"),
        ("two_links.py", "return derivatives, outputs, mass", "return derivatives, outputs, mass[:1]", "the mass matrix has shape (1, 2), expected (2, 2)"),
        ("two_links.py", '"tip.x": tip\\[0\\]', '"tip.x": v1 * tip[0]', "outputs: `tip.x` depends on rates or inputs"),
        ("two_links.py", '"elbow": states\\["elbow.rate"\\], "sh', '"elbow": v2, "sh', "the derivative of `elbow` is not `elbow.rate`"),
        ("two_links.py", ', "rate_of": of', "", "states.shoulder.rate.rate_of: `shoulder`, but the program's `rate_of` is none"),
    ],
)
def test_a_mistake_is_named(robot, where, pattern, other, says):
    path = study(robot, (r"\nstates = \d+", "\nstates = 200"))
    change(robot / where, (pattern, other))
    result = metafmu("build", path, "--out", robot / "out", check=False)
    assert result.returncode == 2 and says in result.stderr, result.stderr
    # before the runs are sampled
    assert "sampled" not in result.stderr
