"""Studies that `metafmu new` proposes are accepted by `metafmu build`."""

import csv
import json
import math
import re
import subprocess
import sys
import tomllib

import numpy as np
import pytest
from conftest import ANY, METAFMU, metafmu
from fmpy import read_model_description

TORSION = """gravity = [0, -9.81]
[parameters]
m = { default = 1.0, min = 0.5, max = 2.0 }
[inputs]
T = { min = -4, max = 4, unit = "N.m" }
[bodies.rod]
mass = "m"
inertia = "0.02*m"
position = [0, -0.3]
points = { o = [0, 0.3] }
[joints]
pivot = { type = "revolute", between = ["ground", "rod.o"] }
[actuators]
motor = { coordinate = "pivot.angle", effort = "T" }
[springs]
k = { coordinate = "pivot.angle", stiffness = 5, damping = 0.1 }
[initial]
pivot.angle = 0.5
[outputs]
q = { measure = "pivot.angle" }
"""
# two arms on pivots 1.5 m apart, joined by two rods, all of 1 m: five bars with the ground
FIVE_BAR = """[parameters]
m = { default = 1.0, min = 0.8, max = 1.2 }
[inputs]
Ta = { min = -1, max = 1 }
Tb = { min = -1, max = 1 }
[ground]
points = { a = [-0.75, 0], b = [0.75, 0] }
[bodies]
left = { mass = "m", inertia = 0.1, position = [-0.75, 0.5], angle = 1.5708, points = { a = [-0.5, 0], b = [0.5, 0] } }
right = { mass = "m", inertia = 0.1, position = [0.75, 0.5], angle = 1.5708, points = { a = [-0.5, 0], b = [0.5, 0] } }
rod = { mass = 1, inertia = 0.1, position = [-0.4, 1.3], angle = 0.7, points = { a = [-0.5, 0], b = [0.5, 0] } }
bar = { mass = 1, inertia = 0.1, position = [0.4, 1.3], angle = 2.4, points = { a = [-0.5, 0], b = [0.5, 0] } }
[joints]
A = { type = "revolute", between = ["ground.a", "left.a"] }
B = { type = "revolute", between = ["ground.b", "right.a"] }
C = { type = "revolute", between = ["left.b", "rod.a"] }
D = { type = "revolute", between = ["right.b", "bar.a"] }
E = { type = "revolute", between = ["rod.b", "bar.b"] }
[springs]
da = { coordinate = "A.angle", damping = 1 }
db = { coordinate = "B.angle", damping = 1 }
[actuators]
ma = { coordinate = "A.angle", effort = "Ta" }
mb = { coordinate = "B.angle", effort = "Tb" }
[initial]
A.angle = 1.5708
B.angle = 1.5708
[outputs]
a = { measure = "A.angle" }
b = { measure = "B.angle" }
"""


def new(folder, *arguments, check=True):
    result = subprocess.run([METAFMU, "new", "proposed", *arguments], cwd=folder, capture_output=True, text=True)
    assert not check or result.returncode == 0, result.stderr
    return result


def of_mechanism(folder, text, check=True):
    (folder / "m.toml").write_text(text)
    return new(folder, "--mechanism", "m.toml", "--structure", "dynamics", check=check)


def test_an_angle_whose_spring_is_not_periodic_is_learned_in_its_range(tmp_path):
    of_mechanism(tmp_path, TORSION)
    text = (tmp_path / "proposed.toml").read_text()
    assert "forces differ a turn later" in text and "all angles" not in text
    metafmu("build", "proposed.toml", cwd=tmp_path)
    metrics = json.loads((tmp_path / "out" / "proposed" / "metrics.json").read_text())
    assert metrics["motion"]["error"] < 1e-11, metrics["motion"]
    assert all(horizon["median"] < 1e-5 for horizon in metrics["roll_outs"]["horizons"]), metrics["roll_outs"]


@pytest.mark.parametrize(("stiffness", "turns"), [(50, 1), (2, 2), (0.6, 3)])
def test_an_angle_with_a_torsion_spring_has_the_turns_that_its_motion_reaches(tmp_path, stiffness, turns):
    of_mechanism(tmp_path, TORSION.replace("stiffness = 5", f"stiffness = {stiffness}"))
    (low, high) = re.search(r'"pivot.angle" = { min = (.*?), max = (.*?),', (tmp_path / "proposed.toml").read_text()).groups()
    assert float(high) - float(low) == pytest.approx(2 * math.pi * turns, abs=1e-9)
    assert (float(high) + float(low)) / 2 == pytest.approx(0.5, abs=1e-9)
    metafmu("build", "proposed.toml", cwd=tmp_path)
    metrics = json.loads((tmp_path / "out" / "proposed" / "metrics.json").read_text())
    assert metrics["motion"]["error"] < 1e-11, metrics["motion"]


def test_ranges_of_a_five_bar_linkage_have_no_singular_positions(tmp_path):
    proposed = of_mechanism(tmp_path, FIVE_BAR)
    assert "ranges are narrowed" in proposed.stderr, proposed.stderr
    text = (tmp_path / "proposed.toml").read_text()
    assert text.count("beyond are singular positions") == 2
    metafmu("sample", "proposed.toml", "--dry-run", cwd=tmp_path)
    # wider ranges are refused before anything is sampled
    wide = re.sub(r"min = -?[\d.]+, max = [\d.]+, start", "min = 0.1, max = 3.0, start", text)
    (tmp_path / "wide.toml").write_text(wide)
    result = metafmu("sample", "wide.toml", "--out", "other", cwd=tmp_path, check=False)
    assert result.returncode == 2 and "expected ranges without singular positions" in result.stderr, result.stderr
    assert not (tmp_path / "other" / "train.csv").exists()


def test_a_force_that_depends_on_time_is_told_with_its_line(tmp_path):
    text = TORSION.replace('effort = "T"', 'effort = "T + sin(time)"')
    line = text.splitlines().index('motor = { coordinate = "pivot.angle", effort = "T + sin(time)" }') + 1
    result = of_mechanism(tmp_path, text, check=False)
    assert result.returncode == 2 and f"m.toml:{line}: actuators.motor: the force" in result.stderr, result.stderr


@pytest.mark.parametrize("effort", ["0.1*T^2", "tanh(T)"])
def test_a_force_that_is_not_linear_in_an_input_is_proposed_and_taken(tmp_path, effort):
    of_mechanism(tmp_path, TORSION.replace('effort = "T"', f'effort = "{effort}"'))
    metafmu("sample", "proposed.toml", "--dry-run", cwd=tmp_path)


def record(step, rows, decimals=None):
    """One run of a first-order lag, stamps rounded or not."""
    times, random = step * np.arange(rows), np.random.default_rng(1)
    u = np.repeat(random.uniform(-1, 1, rows // 25 + 1), 25)[:rows]
    y = np.zeros(rows)
    for row in range(1, rows):
        y[row] = 0.95 * y[row - 1] + 0.05 * u[row - 1]
    stamps = times if decimals is None else np.round(times, decimals)
    lines = [f"{t!r},{a!r},{b!r}" for t, a, b in zip(stamps.tolist(), u.tolist(), y.tolist())]
    return "\n".join(["time,u,y", *lines]) + "\n"


def test_inputs_of_a_table_of_motions_are_those_that_are_named(tmp_path):
    (tmp_path / "record.csv").write_text(record(0.05, 400))
    new(tmp_path, "--table", "record.csv", "--structure", "dynamics", "--inputs", "u")
    study = tomllib.loads((tmp_path / "proposed.toml").read_text())
    assert (list(study["states"]), list(study["inputs"]), list(study["outputs"])) == (["y"], ["u"], ["y"])
    for structure, name, message in [("response", "u", "--inputs belongs to studies with inputs"), ("dynamics", "force", "no column `force`")]:
        refused = metafmu("new", "other", "--table", "record.csv", "--structure", structure, "--inputs", name, cwd=tmp_path, check=False)
        assert refused.returncode == 2 and message in refused.stderr, refused.stderr


def test_one_long_record_is_cut_into_runs(tmp_path):
    (tmp_path / "record.csv").write_text(record(0.05, 2000))
    new(tmp_path, "--table", "record.csv", "--structure", "discrete", "--inputs", "u")
    text = (tmp_path / "proposed.toml").read_text()
    assert "stop = 9.95 " in text and "step = 0.05 " in text and "test_runs = 2 " in text, text
    plan = metafmu("sample", "proposed.toml", "--dry-run", cwd=tmp_path).stdout.splitlines()
    assert [sum(line.startswith(f"{part},") for line in plan) for part in ("train", "test")] == [8, 2]
    # unless set, the FMU starts where the first training run does: means of several runs are no state
    (tmp_path / "proposed.toml").write_text(text.replace("epochs = 300", "epochs = 2") + ANY)
    built = metafmu("build", "proposed.toml", cwd=tmp_path)
    # the first state space is exact, which ends the search
    assert "state space: 0 hidden states, linear" in built.stderr
    folder = tmp_path / "out" / "proposed"
    with open(folder / "train.csv") as file:
        first = next(row for row in csv.DictReader(file) if float(row["time"]) == 0)
    variables = read_model_description(str(folder / "proposed.fmu")).modelVariables
    (start,) = (float(variable.start) for variable in variables if variable.name == "y_start")
    assert start == pytest.approx(float(first["y_start"]), rel=1e-12)


@pytest.mark.parametrize("decimals", [3, 6])
def test_rounded_time_stamps_are_those_of_the_recorder(tmp_path, decimals):
    """Sampled with 10 MHz / 2^14, as the silver box."""
    (tmp_path / "record.csv").write_text(record(0.0016384, 4000, decimals))
    new(tmp_path, "--table", "record.csv", "--structure", "discrete", "--inputs", "u")
    step = float(re.search(r"^step = (\S+)", (tmp_path / "proposed.toml").read_text(), re.M)[1])
    assert abs(step - 0.0016384) < 1e-6 * 0.0016384
    metafmu("sample", "proposed.toml", cwd=tmp_path)
    # a missing row is reported with its line
    lines = (tmp_path / "record.csv").read_text().splitlines()
    (tmp_path / "record.csv").write_text("\n".join(lines[:300] + lines[301:]) + "\n")
    result = metafmu("sample", "proposed.toml", cwd=tmp_path, check=False)
    assert result.returncode == 2 and "record.csv:301: time" in result.stderr, result.stderr


def motions(folder, name, *columns):
    """A table of one motion of a double pendulum in absolute angles."""
    make_tables = (METAFMU.parents[2] / "examples" / "dynamics" / "mbd-node" / "make_tables.py").read_text()
    scope = {"__name__": "make_tables"}
    exec(make_tables, scope)
    scope["write"](folder)
    return folder / f"{name}.csv"


def test_angles_without_a_unit_are_noticed(tmp_path):
    table = motions(tmp_path, "double-pendulum")
    header, *rows = table.read_text().splitlines()
    table.write_text("\n".join([re.sub(r" \[[^]]*\]", "", header), *rows]) + "\n")
    new(tmp_path, "--table", table.name, "--structure", "dynamics")
    assert "{ periodic" not in (tmp_path / "proposed.toml").read_text()
    metafmu("build", "proposed.toml", cwd=tmp_path)
    record = json.loads((tmp_path / "out" / "proposed" / "training.json").read_text())["trajectories"]
    assert record["periodic"] == ["theta1", "theta2"] and record["candidates"][0]["error"] < 1e-6, record


def test_a_column_that_is_not_the_rate_is_noticed(tmp_path):
    table = motions(tmp_path, "spring")
    header, *rows = table.read_text().splitlines()
    values = np.array([[float(field) for field in row.split(",")] for row in rows])
    # velocities half a step late
    values[1:, -1] = 0.5 * (values[1:, -1] + values[:-1, -1])
    table.write_text("\n".join([header, *(",".join(map(repr, row)) for row in values.tolist())]) + "\n")
    proposed = new(tmp_path, "--table", table.name, "--structure", "dynamics")
    assert "differs from the derivative of `x` by" in proposed.stderr, proposed.stderr
    text = (tmp_path / "proposed.toml").read_text()
    assert "x = {  }" in text and 'rate = "v"' not in text, text
    metafmu("build", "proposed.toml", cwd=tmp_path)
    given = text.replace("x = {  }", 'x = { rate = "v" }').replace("x_rate = {}", "v = {}")
    (tmp_path / "given.toml").write_text(given.replace('"proposed"', '"given"'))
    result = metafmu("build", "given.toml", cwd=tmp_path, check=False)
    assert "`v` is not the derivative of `x`: they differ by" in result.stderr, result.stderr
    record = json.loads((tmp_path / "out" / "given" / "training.json").read_text())["trajectories"]
    [(name, error)] = record["rate_errors"]
    assert name == "v" and 1e-3 < error < 0.1


@pytest.mark.parametrize("name", ["crane", "cam", "wishbone"])
def test_a_template_is_a_mechanism_to_start_from(tmp_path, name):
    result = metafmu("new", "my", "--template", name, cwd=tmp_path)
    assert result.stdout.splitlines()[:2] == ["my-mechanism.toml", "my.toml"], result.stdout
    text = (tmp_path / "my.toml").read_text()
    assert 'structure = "dynamics"' in text and 'mechanism = "my-mechanism.toml"' in text
    metafmu("sample", "my.toml", "--dry-run", cwd=tmp_path)
    (tmp_path / "my.toml").unlink()
    assert "my-mechanism.toml: exists already and is not overwritten" in metafmu("new", "my", "--template", name, check=False, cwd=tmp_path).stderr


def test_an_unknown_template_is_refused_with_those_there_are(tmp_path):
    result = metafmu("new", "my", "--template", "kran", check=False, cwd=tmp_path)
    assert result.returncode == 2 and "quarter-car" in result.stderr, result.stderr


def test_mistakes_of_a_proposal_are_located_in_its_table(tmp_path):
    """Numbers that no study takes: not a line of a study that is not written."""
    rows = [f"{row},{row % 3},{'-' * (row % 2)}1e308,{'-' * (row % 2)}1e305" for row in range(12)]
    (tmp_path / "rows.csv").write_text("\n".join(["a,b,x.y [N],z", *rows]) + "\n")
    result = metafmu("new", "big", "--table", "rows.csv", "--structure", "static", "--outputs", "x.y,z", cwd=tmp_path, check=False)
    errors = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    assert [error.split(": from ")[0] for error in errors] == ["error: rows.csv:1: column `x.y`", "error: rows.csv:1: column `z`"], result.stderr
    assert result.returncode == 2 and [path.name for path in tmp_path.iterdir()] == ["rows.csv"]


def test_surrogates_of_our_own_fmus_are_proposed(pendulum, tmp_path):
    model = pendulum.folder / "single-pendulum.safetensors"
    metafmu("export", model, "--ports", "domain", "--out", tmp_path)
    [fmu] = tmp_path.glob("*.fmu")
    metafmu("new", "again", "--fmu", fmu, cwd=tmp_path)
    outputs = tomllib.loads((tmp_path / "again.toml").read_text())["outputs"]
    assert list(outputs) == ["theta", "thetad", "thetadd"]


def test_proposed_bandwidths_suit_the_step(tmp_path):
    """A run of ten samples has no ten periods."""
    description = {"protocol": 1, "inputs": {"u": {"min": -1, "max": 1}}, "outputs": {"y": {}}, "stop": 1.0, "step": 0.1}
    (tmp_path / "model.py").write_text(
        "import json, sys\nfor line in sys.stdin:\n    request = json.loads(line)\n"
        f"    reply = {description!r} if request['request'] == 'describe' else {{'outputs': {{'y': request['inputs']['u']}}}}\n"
        "    print(json.dumps({'id': request['id'], **reply}), flush=True)\n"
    )
    metafmu("new", "steps", "--structure", "discrete", "--command", sys.executable, "model.py", cwd=tmp_path)
    assert tomllib.loads((tmp_path / "steps.toml").read_text())["inputs"]["u"]["bandwidth"] == 5.0
