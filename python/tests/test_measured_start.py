"""Simulations of discrete-time surrogates from measured rows, against `metafmu predict` of the same rows."""

import csv
import subprocess
import sys

import numpy as np
import pytest

import metafmu

STEP, ROWS, GIVEN = 0.02, 60, 12
STUDY = f"""name = "plant"
structure = "discrete"
source.table = "runs.csv"
time = {{ stop = {STEP * (ROWS - 1)}, step = {STEP} }}
inputs.force = {{ min = -2, max = 2 }}
outputs.position = {{}}
outputs.speed = {{}}
discrete = {{ model = "polynomial", history = 2 }}
sampling.test_runs = 2
"""


def motion(seed):
    """Force, position and speed of a mass on a spring that stiffens."""
    random = np.random.default_rng(seed)
    force, position, speed = np.interp(np.arange(ROWS) / 5, np.arange(ROWS // 5 + 2), random.uniform(-2, 2, ROWS // 5 + 2)), 0.0, 0.0
    rows = []
    for value in force:
        rows.append((value, position, speed))
        speed = 0.9 * speed + STEP * (-30.0 * position - 40.0 * position**3 + 8.0 * value)
        position += STEP * speed
    return np.array(rows)


@pytest.fixture(scope="module")
def surrogate(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plant")
    lines = [f"{run},{row * STEP!r},{force!r},{position!r},{speed!r}" for run in range(12) for row, (force, position, speed) in enumerate(motion(run).tolist())]
    (folder / "runs.csv").write_text("run,time,force,position,speed\n" + "\n".join(lines) + "\n")
    (folder / "plant.toml").write_text(STUDY)
    metafmu.Study.load(folder / "plant.toml").build(out=folder / "out")
    return metafmu.Surrogate.load(folder / "out" / "plant.safetensors")


# a motion that has begun before
TRUTH = motion(99)[20:]
TIME = STEP * np.arange(-GIVEN, len(TRUTH) - GIVEN)


@pytest.fixture(scope="module")
def expected(surrogate, tmp_path_factory):
    """The free run that `metafmu predict` computes."""
    folder = tmp_path_factory.mktemp("predict")
    surrogate.save(folder / "plant.safetensors")
    rows = "\n".join(f"{time!r},{','.join(map(repr, row))}" for time, row in zip(TIME.tolist(), TRUTH.tolist()))
    (folder / "rows.csv").write_text(f"time,force,position,speed\n{rows}\n")
    command = [sys.executable, "-m", "metafmu", "predict", folder / "plant.safetensors", folder / "rows.csv", "--out", folder / "found.csv"]
    subprocess.run(command, check=True, capture_output=True)
    with open(folder / "found.csv", newline="") as file:
        found = np.array([[float(row["position"]), float(row["speed"])] for row in csv.DictReader(file)])
    return found[GIVEN:]


def names_of(rows):
    return {"force": rows[:, 0], "position": rows[:, 1], "speed": rows[:, 2]}


def test_a_simulation_from_measured_rows_is_that_of_predict(surrogate, expected):
    pandas = pytest.importorskip("pandas")
    past, driving = TRUTH[:GIVEN], TRUTH[GIVEN:, 0]
    frame = pandas.DataFrame(names_of(past)).assign(time=TIME[:GIVEN])
    close = lambda found: found.shape == expected.shape and (np.abs(found - expected).max(axis=0) <= 1e-12 * np.ptp(expected, axis=0)).all()
    assert surrogate.sample_time == STEP
    for history in (past, names_of(past), frame, {**names_of(past), "time": TIME[:GIVEN]}):
        assert close(surrogate.simulate(TIME[GIVEN:], driving, history=history))
    # at any time, from all rows given
    late = {**names_of(past), "time": 100.0 + TIME[:GIVEN]}
    assert close(surrogate.simulate(100.0 + TIME[GIVEN:], {"force": driving}, history=late))
    assert not close(surrogate.simulate(TIME[GIVEN:], driving))
    assert np.array_equal(surrogate.simulate(TIME[GIVEN:], driving, history=past[:0]), surrogate.simulate(TIME[GIVEN:], driving))


def test_a_history_that_does_not_fit_is_refused_with_what_is_expected(surrogate):
    past, (time, driving) = TRUTH[:GIVEN], (TIME[GIVEN:], TRUTH[GIVEN:, 0])
    moved = TIME[:GIVEN].copy()
    moved[3] += 0.1 * STEP
    for history, message in [
        (past[:, :2], r"history has the shape \(12, 2\), expected \(rows, 3\): force, position, speed"),
        ({"force": past[:, 0], "speed": past[:, 2]}, "history: no column `position`, expected it among force, speed"),
        ({**names_of(past), "speed": past[:3, 2]}, r"`speed` \(3,\), expected as many numbers of each"),
        (np.where(past == past[4, 1], np.nan, past), "history has a number that is not finite in row 4"),
        ({**names_of(past), "time": moved}, r"history: `time` is -0.178.* s in row 3, expected -0.18 s: rows are 0.02 s apart"),
        ({**names_of(past), "time": TIME[:GIVEN] + STEP}, "in row 0, expected -0.24 s: rows are 0.02 s apart, the last one that long before"),
    ]:
        with pytest.raises(metafmu.Error, match=message):
            surrogate.simulate(time, driving, history=history)


def test_a_history_belongs_to_discrete_time_surrogates():
    onnx = pytest.importorskip("onnx")
    helper, double = onnx.helper, onnx.TensorProto.DOUBLE
    tensor = lambda name: helper.make_tensor_value_info(name, double, [1, 1])
    graph = helper.make_graph([helper.make_node("Mul", ["x", "k"], ["dx"])], "decay", [tensor("x")], [tensor("dx")], [helper.make_tensor("k", double, [1], [-1.0])])
    decay = metafmu.from_onnx(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), states={"x": {"derivative": "dx"}})
    assert decay.sample_time is None
    with pytest.raises(metafmu.Error, match="`model` has no past samples, expected a discrete-time surrogate"):
        decay.simulate([0.0, 1.0], history=[[1.0]])
