"""Discrete-time surrogates of recorded inputs and outputs, in fmpy, against the model file in numpy."""

import csv
import json
import os
import re
import shutil
import subprocess
import sys
from ctypes import c_double, c_int, c_uint32, create_string_buffer
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from conftest import METAFMU, OTHER_THREADS, ROOT, compiled_from_sources, fmu_of, metafmu
from fmpy import extract, read_model_description, simulate_fmu
from fmpy.simulation import instantiate_fmu
from fmpy.validation import validate_fmu
from scipy.signal import cont2discrete

sys.path.insert(0, str(ROOT / "scripts" / "measure"))
import noise
from model_file import evaluate, load

RUNS, ROWS, STEP = 14, 101, 0.02
STUDY = f"""name = "plant"
structure = "discrete"

[source]
table = "runs.csv"
columns = {{ position = "y" }}

[time]
stop = {STEP * (ROWS - 1)}
step = {STEP}

[parameters]
gain = {{ min = 0.5, max = 1.5 }}

[inputs]
force = {{ min = -2, max = 2, unit = "N" }}

[outputs]
position = {{ unit = "m" }}
speed = {{}}

[discrete]
history = 3
window = 12
stretch = 20
budget = 20    # s, a third of what a study has

[network]
hidden = [12]

[training]
epochs = 300
schedule = "cosine"    # restarts end early with so few runs, and how good the network is then depends on the processor's last digits

[sampling]
test_runs = 3
"""


def plant(forces, gain, start=0.0):
    """Position and speed at each row: a stiffening oscillator, by its own difference equation."""
    position, speed = start, 0.0
    rows = []
    for force in forces:
        rows.append((position, speed))
        speed = 0.9 * speed + STEP * (-30.0 * position - 40.0 * position**3 + 8.0 * gain * force)
        position = position + STEP * speed
    return np.array(rows)


def forces(seed):
    levels = np.random.default_rng(seed).uniform(-2, 2, ROWS // 5 + 2)
    return np.interp(np.arange(ROWS) / 5, np.arange(levels.size), levels)


def table(path, change=lambda rows: rows):
    rows = [["run", "time", "gain", "force", "y", "speed"]]
    for run in range(RUNS):
        gain = 0.5 + run / (RUNS - 1)
        force = forces(run)
        for row, (value, (position, speed)) in enumerate(zip(force, plant(force, gain))):
            rows.append([f"r{run}", repr(round(row * STEP, 6)), repr(gain), repr(float(value)), repr(float(position)), repr(float(speed))])
    with open(path, "w", newline="") as file:
        csv.writer(file).writerows(change(rows))


@dataclass
class Plant:
    study: Path
    folder: Path

    def fmu(self, version):
        return str(fmu_of(self.folder, "plant", version))

    def simulate(self, force, gain, start=(0.0, 0.0)):
        """The outputs at all rows by the model file, which is specified in fmu-template/runtime/src/format.rs."""
        _, tensors = load(self.folder / "plant.safetensors")
        past_outputs, past_inputs = tensors["samples.history"]
        sample = np.concatenate([start, tensors.get("samples.hidden", [])])
        y, u = [sample] * max(past_outputs, 1), [0.0] * past_inputs
        found = [y[0]]
        for value in force[:-1]:
            u = [value, *u[:-1]]
            z = np.array([*np.ravel(y[:past_outputs]), *u, gain])
            y = [*evaluate(tensors, z[None]), *y[:-1]]
            found.append(y[0])
        return np.array(found)[:, : len(start)]


def build(folder, model="feedback", **environment):
    folder.mkdir(parents=True, exist_ok=True)
    table(folder / "runs.csv")
    (folder / "plant.toml").write_text(STUDY.replace("history = 3", f'history = 3\nmodel = "{model}"') if model else STUDY)
    command = [METAFMU, "build", folder / "plant.toml", "--out", folder / "out", "--fmi", "both"]
    subprocess.run(command, check=True, capture_output=True, env=os.environ | environment)
    return Plant(folder / "plant.toml", folder / "out")


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Tests write nothing into its folder."""
    return build(tmp_path_factory.mktemp("discrete") / "plant")


class Running:
    """An FMU, packed or unpacked, that fmpy has loaded and initialized, to be called function by function."""

    def __init__(self, fmu, folder, start=0.0, **starts):
        self.description = read_model_description(fmu)
        self.is_fmi3 = self.description.fmiVersion.startswith("3")
        self.references = {variable.name: variable.valueReference for variable in self.description.modelVariables}
        self.fmu = instantiate_fmu(fmu if Path(fmu).is_dir() else extract(fmu, folder), self.description, "CoSimulation")
        if not self.is_fmi3:
            self.fmu.setupExperiment(startTime=start)
        for name, value in starts.items():
            self.set(name, value)
        self.fmu.enterInitializationMode(**({"startTime": start} if self.is_fmi3 else {}))
        self.fmu.exitInitializationMode()
        self.time = start

    def set(self, name, value):
        setter = self.fmu.setFloat64 if self.is_fmi3 else self.fmu.setReal
        setter([self.references[name]], [value])

    def get(self, *names):
        getter = self.fmu.getFloat64 if self.is_fmi3 else self.fmu.getReal
        return np.array(getter([self.references[name] for name in names]))

    def step(self, size):
        self.fmu.doStep(currentCommunicationPoint=self.time, communicationStepSize=size)
        self.time += size

    def outputs(self):
        return self.get("position", "speed")


def test_accuracy_is_that_of_simulations_and_the_best_model_is_exported(tmp_path):
    built = build(tmp_path, model=None)
    metrics = json.loads((built.folder / "metrics.json").read_text())
    candidates = {candidate["name"]: candidate["error"] for candidate in metrics["discrete"]["candidates"]}
    assert set(candidates) == {"linear", "polynomial", "state-space", "window", "feedback"}
    # the plant is a polynomial of a past sample; the residual is rounding
    assert metrics["discrete"]["exported"] == min(candidates, key=candidates.get) == "polynomial"
    assert candidates["polynomial"] < 1e-6
    assert candidates["feedback"] < 0.3 * candidates["linear"]
    assert candidates["state-space"] < 0.5 * candidates["linear"]
    assert metrics["roll_outs"]["long_runs"] == [2, 2]
    assert metrics["test_runs"] == 3 and all(output["r2"] > 0.99 for output in metrics["outputs"].values())
    # a force and a gain that it has not seen, against the plant itself
    found = built.simulate(forces(99), 1.1)
    truth = plant(forces(99), 1.1)
    assert np.all(np.abs(found - truth).std(axis=0) < 0.1 * truth.std(axis=0))


@pytest.mark.parametrize("model", ["linear", "polynomial", "state-space"])
def test_models_of_a_single_past_sample_are_evaluated_as_their_fmus_simulate(tmp_path, model):
    table(tmp_path / "runs.csv")
    (tmp_path / "plant.toml").write_text(STUDY.replace("history = 3", f'history = 1\nmodel = "{model}"'))
    subprocess.run([METAFMU, "build", tmp_path / "plant.toml", "--out", tmp_path / "out"], capture_output=True, check=False)
    built = Plant(tmp_path / "plant.toml", tmp_path / "out")
    metrics = json.loads((built.folder / "metrics.json").read_text())
    with open(built.folder / "test.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    runs = {label: [row for row in rows if row["run"] == label] for label in dict.fromkeys(row["run"] for row in rows)}
    column = lambda run, name: np.array([float(row[name]) for row in run])
    squares = []
    for run in runs.values():
        force, gain = column(run, "force"), column(run, "gain")[0]
        truth = np.stack([column(run, "position"), column(run, "speed")], axis=1)
        found = built.simulate(force, gain, truth[0])
        squares.append((found - truth)[1:] ** 2)
        # and so does the FMU, whose hidden states begin as those of the model file
        time = np.arange(len(force)) * STEP
        signals = np.array(list(zip(time, force)), dtype=[("time", float), ("force", float)])
        starts = {"gain": gain, "position_start": truth[0, 0], "speed_start": truth[0, 1]}
        result = simulate_fmu(built.fmu(2), stop_time=time[-1], step_size=STEP, output_interval=STEP, input=signals, start_values=starts)
        np.testing.assert_allclose(result["position"][: len(force)], found[:, 0], rtol=1e-7, atol=1e-9)
    mse = np.concatenate(squares).mean(axis=0)
    reported = [metrics["outputs"][name]["mse"] for name in ("position", "speed")]
    # of rounding where the model is exact
    np.testing.assert_allclose(reported, mse, rtol=1e-6, atol=1e-20)


def test_error_bounds_are_measured_on_runs_of_their_own_and_grow(tmp_path):
    table(tmp_path / "runs.csv")
    study = STUDY.replace("[sampling]", '[bounds]\ncoverage = 0.7\nruns = 4\n[sampling]').replace("[discrete]", '[discrete]\nmodel = "linear"')
    (tmp_path / "plant.toml").write_text(study)
    metafmu("build", tmp_path / "plant.toml", "--out", tmp_path / "out")
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())["outputs"]
    running = Running(str(tmp_path / "out" / "plant.fmu"), tmp_path / "fmu")
    first = running.get("position_bound", "speed_bound")
    assert (first > 0.0).all()
    running.step((ROWS - 1) * STEP)
    last = running.get("position_bound", "speed_bound")
    np.testing.assert_allclose(last, [metrics[name]["bound"] for name in ("position", "speed")], rtol=1e-12)
    assert (last > first).all()


@pytest.mark.parametrize("version", [2, 3])
def test_rows_of_fmpy_are_those_of_the_model_file(built, version):
    force = forces(99)
    signal = np.array(list(zip(np.arange(ROWS) * STEP, force)), dtype=[("time", float), ("force", float)])
    result = simulate_fmu(
        built.fmu(version), input=signal, start_values={"gain": 1.1}, output=["position", "speed"], stop_time=STEP * (ROWS - 1),
        output_interval=STEP, fmi_type="CoSimulation",
    )
    expected = built.simulate(force, 1.1)
    assert np.abs(np.column_stack([result["position"], result["speed"]]) - expected).max() < 1e-12
    assert validate_fmu(built.fmu(version)) == []


@pytest.mark.parametrize("version", [2, 3])
def test_parts_of_samples_and_several_samples_agree_at_samples(built, version, tmp_path):
    force = forces(7)
    expected = built.simulate(force, 0.8, (0.1, -0.2))
    starts = {"gain": 0.8, "position_start": 0.1, "speed_start": -0.2}
    halves = Running(built.fmu(version), tmp_path / "halves", **starts)
    assert np.array_equal(halves.outputs(), expected[0])
    for row in range(20):
        halves.set("force", force[row])
        halves.step(0.5 * STEP)
        # outputs are linear in between; what an input is there does not count
        assert np.abs(halves.outputs() - 0.5 * (expected[row] + expected[row + 1])).max() < 1e-12
        halves.set("force", 2.0)
        halves.step(0.5 * STEP)
        assert np.abs(halves.outputs() - expected[row + 1]).max() < 1e-12
    held = np.repeat(force[:12:3], 3)
    expected = built.simulate(held, 0.8, (0.1, -0.2))
    threes = Running(built.fmu(version), tmp_path / "threes", **starts)
    for row in range(0, 9, 3):
        threes.set("force", held[row])
        threes.step(3 * STEP)
        assert np.abs(threes.outputs() - expected[row + 3]).max() < 1e-12


@pytest.mark.parametrize("version", [2, 3])
def test_a_state_between_samples_is_restored_and_serialized(built, version, tmp_path):
    running = Running(built.fmu(version), tmp_path, gain=1.2)
    fmu = running.fmu
    running.set("force", 1.5)
    running.step(2.4 * STEP)
    state = fmu.getFMUState() if running.is_fmi3 else fmu.getFMUstate()
    time = running.time

    def go_on():
        running.set("force", -0.5)
        rows = []
        for _ in range(5):
            running.step(0.7 * STEP)
            rows.append(running.outputs())
        return np.array(rows)

    first = go_on()
    serialized = fmu.serializeFMUState(state) if running.is_fmi3 else fmu.serializeFMUstate(state)
    for again in (state, (fmu.deserializeFMUState if running.is_fmi3 else fmu.deSerializeFMUstate)(serialized)):
        (fmu.setFMUState if running.is_fmi3 else fmu.setFMUstate)(again)
        running.time = time
        assert np.array_equal(go_on(), first)


@pytest.mark.parametrize("version", [2, 3])
def test_it_is_for_cosimulation_only(built, version):
    description = read_model_description(built.fmu(version))
    assert description.modelExchange is None and description.coSimulation.canHandleVariableCommunicationStepSize
    names = {variable.name: variable for variable in description.modelVariables}
    assert (names["force"].causality, names["gain"].causality, names["position_start"].causality) == ("input", "parameter", "parameter")
    assert metafmu("validate", built.fmu(version)).returncode == 0


@pytest.mark.parametrize("version", [2, 3])
def test_the_sources_compute_what_the_library_does(built, version, tmp_path, monkeypatch):
    folder = shutil.copytree(built.folder, tmp_path / "out")
    metafmu("export", built.study, "--out", folder, "--sources", "--fmi", version)
    packed = str(fmu_of(folder, "plant", version))
    assert validate_fmu(packed) == []
    unpacked = compiled_from_sources(packed, monkeypatch)
    assert "discrete.c and graph.c have the formula" in (unpacked / "sources" / "model_data.h").read_text()
    force = forces(99)
    signal = np.array(list(zip(np.arange(ROWS) * STEP, force)), dtype=[("time", float), ("force", float)])
    # whole samples, parts of them, and more than one
    for step in (STEP, 0.3 * STEP, 1.7 * STEP):
        found, expected = (
            simulate_fmu(
                fmu, fmi_type="CoSimulation", stop_time=1, step_size=step, output_interval=step, input=signal,
                start_values={"gain": 1.1, "position_start": 0.1},
            )
            for fmu in (str(unpacked), packed)
        )
        assert np.ptp(expected["position"]) > 0.1
        for column in expected.dtype.names:
            np.testing.assert_allclose(found[column].astype(float), expected[column].astype(float), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("version", [2, 3])
def test_what_is_fed_back_is_part_of_the_domain(built, version, tmp_path):
    def simulate(name, force, gain):
        running = Running(built.fmu(version), tmp_path / name, gain=gain)
        inside, distance, found = [], [], [running.outputs()]
        for value in force[:-1]:
            running.set("force", value)
            running.step(STEP)
            references = [running.references["in_domain"]]
            inside.append(running.fmu.getBoolean(references)[0])
            distance.append(running.get("domain_distance")[0])
            found.append(running.outputs())
        assert [value == 0.0 for value in distance] == [bool(value) for value in inside]
        return np.array(inside, dtype=bool), np.array(distance), np.array(found)

    # a force like those of the training
    inside, _, _ = simulate("usual", forces(99), 1.1)
    assert inside.mean() > 0.9
    # in its range all the time, but for ten times as long and with a jump from one end to the other, which no run had
    rows = 10 * ROWS
    force = np.where(np.arange(rows) < 200, 2.0, -2.0)
    inside, distance, found = simulate("corner", force, 1.5)
    truth = plant(force, 1.5)
    assert not inside.all() and distance.max() > 0.05
    largest = [output["max_abs_error"] for output in json.loads((built.folder / "metrics.json").read_text())["outputs"].values()]
    late = (np.abs(found - truth)[1:] > 2.0 * np.array(largest)).any(axis=1) & inside
    assert not late.any(), np.flatnonzero(late)


def tank(levels, step):
    """Level of a tank whose inflow is linear between rows: the source of a table may do that, and the model cannot know."""
    inflow = np.interp(np.arange(4 * len(levels)) / 4, np.arange(len(levels)), levels)
    found = [0.25]
    for value in inflow[:-1]:
        found.append(found[-1] + step / 4 * (value - np.sqrt(max(found[-1], 0.0))))
    return np.array(found[::4])


def test_inputs_that_change_more_often_than_in_training_leave_the_domain(tmp_path):
    random, rows, step = np.random.default_rng(1), 201, 0.2
    inflows = lambda hold: np.concatenate([[0.5], np.repeat(random.uniform(0.2, 1.0, rows // hold + 1), hold)])[:rows]

    def write(path, hold, runs):
        signals = [inflows(hold) for _ in range(runs)]
        lines = ["run,time,inflow,level"]
        for run, inflow in enumerate(signals):
            lines += [f"{run},{row * step:.6f},{u!r},{y!r}" for row, (u, y) in enumerate(zip(inflow.tolist(), tank(inflow, step).tolist()))]
        path.write_text("\n".join(lines) + "\n")

    write(tmp_path / "runs.csv", 20, 63)
    write(tmp_path / "like.csv", 20, 20)
    write(tmp_path / "often.csv", 1, 20)
    (tmp_path / "tank.toml").write_text(f"""name = "tank"
structure = "discrete"
[source]
table = "runs.csv"
[time]
stop = {step * (rows - 1)}
step = {step}
[inputs]
inflow = {{ start = 0.5 }}
[outputs]
level = {{}}
[discrete]
model = "polynomial"
[sampling]
test_runs = 3
""")
    metafmu("build", tmp_path / "tank.toml", "--out", tmp_path / "out", check=False)

    def inside(name):
        found = tmp_path / "found.csv"
        metafmu("predict", tmp_path / "out" / "tank.safetensors", tmp_path / name, "--out", found)
        with open(found, newline="") as file:
            return np.mean([row["in_domain"] in ("1", "true") for row in csv.DictReader(file)])

    assert inside("like.csv") >= 0.97
    assert inside("often.csv") <= 0.1


@pytest.mark.parametrize("model", ["linear", "state-space"])
def test_predict_starts_from_rows_before_the_start(tmp_path, model):
    # one long record, cut into runs that each start with the rows before them
    force = np.concatenate([forces(seed) for seed in range(6)])
    rows = zip(np.arange(len(force)) * STEP, force, plant(force, 1.0))
    lines = ["time,force,y,speed", *(f"{time:.6f},{float(value)!r},{float(y)!r},{float(speed)!r}" for time, value, (y, speed) in rows)]
    (tmp_path / "runs.csv").write_text("\n".join(lines) + "\n")
    study = STUDY.replace("[parameters]\ngain = { min = 0.5, max = 1.5 }\n", "").replace("test_runs = 3", "test_runs = 2")
    (tmp_path / "plant.toml").write_text(study.replace("history = 3", f'history = 3\nmodel = "{model}"'))
    subprocess.run([METAFMU, "build", tmp_path / "plant.toml", "--out", tmp_path / "out"], capture_output=True, check=False)
    test, found = tmp_path / "out" / "test.csv", tmp_path / "found.csv"
    result = metafmu("predict", tmp_path / "out" / "plant.safetensors", test, "--out", found)
    assert "position" not in result.stderr, result.stderr
    read = lambda path: list(csv.DictReader(open(path, newline="")))
    measured, predicted = read(test), read(found)
    is_given = np.array([float(row["time"]) < 0 for row in measured])
    assert is_given.sum() >= 12
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    for name in ("position", "speed"):
        errors = np.array([float(a[name]) - float(b[name]) for a, b in zip(measured, predicted)])
        # the first row of a run from rest is given as well
        count = metrics["test_rows"]
        np.testing.assert_allclose((errors[~is_given] ** 2).sum() / count, metrics["outputs"][name]["mse"], rtol=1e-9)
    # without measured outputs, runs begin from start values and are wrong at first
    stripped = tmp_path / "stripped.csv"
    names = [name for name in measured[0] if not name.startswith(("position", "speed", "force_start"))]
    stripped.write_text("\n".join([",".join(names), *(",".join(row[name] for name in names) for row in measured)]) + "\n")
    metafmu("predict", tmp_path / "out" / "plant.safetensors", stripped, "--out", found)
    errors = [abs(float(a["position"]) - float(b["position"])) for a, b in zip(measured, read(found))]
    assert max(np.array(errors)[is_given]) > 1e-6


def test_predict_rolls_out_the_runs_of_a_table(built, tmp_path):
    result = metafmu("predict", built.fmu(2), built.folder / "test.csv", "--out", tmp_path / "found.csv")
    # with one past sample, the force before the start has no effect
    counts = "force_start" in {variable.name for variable in read_model_description(built.fmu(2)).modelVariables}
    assert counts == ("force_start" not in result.stderr)
    with open(built.folder / "test.csv", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["run"] == "1"]
    with open(tmp_path / "found.csv", newline="") as file:
        found = [[float(row["position"]), float(row["speed"])] for row in csv.DictReader(file) if row["run"] == "1"]
    force = [float(row["force"]) for row in rows]
    expected = built.simulate(force, float(rows[0]["gain"]), (float(rows[0]["position_start"]), float(rows[0]["speed_start"])))
    assert np.abs(np.array(found) - expected).max() < 1e-12


def test_other_numbers_of_threads_give_the_same_bytes(built, tmp_path):
    again = build(tmp_path / "again", **OTHER_THREADS)
    for name in ("plant.fmu", "plant-fmi3.fmu", "plant.safetensors"):
        assert (again.folder / name).read_bytes() == (built.folder / name).read_bytes(), name


@pytest.mark.parametrize("moving", [False, True])
def test_a_single_run_is_cut_into_runs_that_go_on_from_the_rows_before(moving, tmp_path):
    count, stop = 8, 20
    # a record that begins in the middle of a motion shows this in its first rows
    earlier, given = (15, 12) if moving else (0, 0)
    force = np.concatenate([forces(run)[:stop] for run in range(count)] + [forces(count)[: given + earlier + 1]])
    values = plant(force, 1.0)[earlier:]
    force = force[earlier:]
    lines = [f"{row * STEP:.6f},{u!r},{y!r},{v!r}" for row, (u, (y, v)) in enumerate(zip(force.tolist(), values.tolist()))]
    (tmp_path / "runs.csv").write_text("time,force,y,speed\n" + "\n".join(lines) + "\n")
    text = STUDY.replace("[parameters]\ngain = { min = 0.5, max = 1.5 }\n", "").replace(f"stop = {STEP * (ROWS - 1)}", f"stop = {stop * STEP}")
    (tmp_path / "plant.toml").write_text(text.replace("stretch = 20", "stretch = 8"))
    said = [metafmu(verb, tmp_path / "plant.toml", "--out", tmp_path / "out", check=verb == "sample").stderr for verb in ("sample", "train")]
    assert ("the record does not begin at rest: its first 12 rows are given" in said[0]) == moving
    found = {}
    for name in ("train", "test"):
        with open(tmp_path / "out" / f"{name}.csv", newline="") as file:
            for row in csv.DictReader(file):
                found.setdefault((name, row["run"]), []).append([float(row[key]) for key in ("time", "force", "position", "speed")])
    assert sum(name == "test" for name, _ in found) == 3 and len(found) == count
    rows = np.column_stack([force, values])
    begins = set()
    for run in map(np.array, found.values()):
        # the forces identify the piece
        start = next(piece for piece in range(count) if np.array_equal(run[run[:, 0] > -1e-9][:, 1], force[given + piece * stop :][: stop + 1]))
        before = 0 if start == 0 and not moving else 12
        assert np.abs(run[:, 0] - STEP * np.arange(-before, stop + 1)).max() < 1e-12
        assert np.array_equal(run[:, 1:], rows[given + start * stop - before : given + (start + 1) * stop + 1])
        begins.add(start)
    assert begins == set(range(count))
    # held-out runs are simulated from the rows before them: nearly linear motions are simulated well from the first row on
    record = json.loads((tmp_path / "out" / "training.json").read_text())
    assert min(candidate["error"] for candidate in record["discrete"]["candidates"]) < 0.3


@pytest.mark.parametrize("earlier", [0, 15])
def test_runs_of_a_table_that_do_not_begin_at_rest_are_noticed(earlier, tmp_path):
    lines = []
    for run in range(6):
        force = forces(run)
        rows = zip(force[earlier:].tolist(), plant(force, 1.0)[earlier:].tolist())
        lines += [f"{run},{row * STEP:.6f},{u!r},{y!r},{v!r}" for row, (u, (y, v)) in enumerate(rows)]
    (tmp_path / "runs.csv").write_text("run,time,force,y,speed\n" + "\n".join(lines) + "\n")
    text = STUDY.replace("[parameters]\ngain = { min = 0.5, max = 1.5 }\n", "")
    (tmp_path / "plant.toml").write_text(text.replace(f"stop = {STEP * (ROWS - 1)}", f"stop = {STEP * (ROWS - 1 - earlier)}"))
    said = metafmu("sample", tmp_path / "plant.toml", "--out", tmp_path / "out").stderr
    notice = "of the first 6 runs do not begin at rest, but are simulated from rest: add the rows before them, with negative times"
    assert (notice in said) == bool(earlier), said


def with_row(number, **values):
    """Changes fields of a row, counted as lines of the file."""

    def change(rows):
        for name, value in values.items():
            rows[number - 1][rows[0].index(name)] = value
        return rows

    return change


def test_a_state_space_starts_from_positions_where_nothing_was_at_rest(tmp_path):
    # of two masses on springs that are released with the force at 0, the first one's position is recorded
    a = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-10, 6, -0.4, 0], [6, -6, 0, -0.3]])
    step, random = 0.05, np.random.default_rng(4)
    a, b, *_ = cont2discrete((a, np.array([[0], [0], [0], [1]]), np.eye(4), np.zeros((4, 1))), step)

    def motion(force, start):
        state, found = np.array([start, start, 0, 0]), []
        for value in force:
            found.append(state[0])
            state = a @ state + b[:, 0] * value
        return np.array(found)

    def run(start):
        force = np.repeat(random.uniform(-2, 2, 20), 10)
        return np.column_stack([np.round(step * np.arange(200), 6), force, motion(force, start)])

    runs = [np.column_stack([np.full(200, number), run(random.uniform(-0.5, 0.5))]) for number in range(12)]
    np.savetxt(tmp_path / "runs.csv", np.concatenate(runs), fmt="%.17g", delimiter=",", header="run,time,force,position", comments="")
    metafmu("new", tmp_path / "study", "--table", tmp_path / "runs.csv", "--structure", "discrete")
    study = tmp_path / "study.toml"
    study.write_text(study.read_text().replace("[discrete]", '[discrete]\nmodel = "state-space"'))
    metafmu("build", study, "--out", tmp_path / "out")
    for start in [-0.5, 0.0, 0.5]:
        unseen = run(start)
        np.savetxt(
            tmp_path / "inputs.csv", np.column_stack([unseen[:, :2], np.full(200, start)]), fmt="%.17g", delimiter=",",
            header="time,force,position_start", comments="",
        )  # fmt: skip
        lines = metafmu("predict", tmp_path / "out" / "study.safetensors", tmp_path / "inputs.csv").stdout.splitlines()
        found = np.genfromtxt(lines, delimiter=",", names=True)["position"]
        assert np.abs(found - unseen[:, 2]).max() < 1e-6 * np.ptp(unseen[:, 2])


def test_noise_of_the_first_row_has_little_effect_on_a_simulation_from_rest(tmp_path):
    random = np.random.default_rng(3)
    (force, quiet), (unseen, truth) = (noise.record(random, 2000) for _ in range(2))
    deviation = 0.05 * quiet.std()
    times = noise.STEP * np.arange(2000)

    def write(name, header, *columns):
        np.savetxt(tmp_path / name, np.column_stack([times, *columns]), fmt="%.12g", delimiter=",", header=header, comments="")

    write("record.csv", "time,force,position", force, quiet + deviation * random.standard_normal(2000))
    metafmu("new", tmp_path / "study", "--table", tmp_path / "record.csv", "--structure", "discrete")
    study = tmp_path / "study.toml"
    # of the training runs, none begins at rest
    text = study.read_text().replace("seed = 1", "seed = 3").replace("[discrete]", '[discrete]\nmodel = "state-space"\nbudget = 20')
    study.write_text(text)
    metafmu("build", study, "--out", tmp_path / "out")
    errors = []
    for start in [0.0, deviation, -deviation]:
        write("inputs.csv", "time,force,position_start", unseen, np.full(2000, start))
        found = np.genfromtxt(
            metafmu("predict", tmp_path / "out" / "study.safetensors", tmp_path / "inputs.csv").stdout.splitlines(), delimiter=",", names=True
        )["position"]
        errors.append(np.sqrt(np.mean((found - truth)[:100] ** 2)) / deviation)
    assert max(errors) < 0.6, errors


@pytest.mark.parametrize(
    "change, message",
    [
        (with_row(5, time="0.0601"), "runs.csv:5: time 0.0601 s, expected 0.06 s: rows are 0.02 s apart (time.step)"),
        (with_row(5, force="2.5"), "runs.csv:5: column `force`: 2.5, expected -2 to 2, the study's range"),
        (with_row(5, force=""), "runs.csv:5: column `force`: is empty"),
        (with_row(5, y="40"), "runs.csv:5: column `y`: 40 is an outlier, all other rows are from "),
        (lambda rows: [rows[0], *rows[1:50], *rows[102:]], "ends before this line at 0.96 s, expected 2 s"),
        (with_row(2, time="-0.04"), "runs.csv:2: run `r0` begins at -0.04 s, expected 0 s, or at least 12 rows before it"),
        (lambda rows: [row[:3] + row[4:] for row in rows], "runs.csv:1: no column `force`"),
        (
            lambda rows: [*rows, *(["again", *row[1:]] for row in rows[1 + 2 * ROWS : 1 + 3 * ROWS])],
            "run `again` has the same rows as run `r2`: runs must differ, or tests repeat training runs",
        ),
    ],
)
def test_tables_that_are_no_samples_are_refused_with_their_line(tmp_path, change, message):
    table(tmp_path / "runs.csv", change)
    (tmp_path / "plant.toml").write_text(STUDY)
    result = metafmu("sample", tmp_path / "plant.toml", "--out", tmp_path / "out", check=False)
    assert result.returncode != 0 and message in result.stderr, result.stderr


@pytest.mark.parametrize(
    "old, new, message",
    [
        ('table = "runs.csv"\ncolumns = { position = "y" }', 'system = "single-pendulum"', "source: the structure \"discrete\" is learned from recorded runs"),
        ('force = { min = -2, max = 2, unit = "N" }', "", "inputs: no input, expected at least one"),
        ("max = 2, unit", "max = -3, unit", "inputs.force: from -2 to -3, expected min below max"),
        ("max = 2, unit", "max = 2, start = 3, unit", "inputs.force.start: 3, expected -2 to 2"),
        ("max = 2, unit", "max = 2, bandwidth = 1, unit", "inputs.force.bandwidth: belongs to sources that are simulated"),
        ("history = 3", "history = 0", "discrete.history: 0, expected a number from 1 to 10000"),
        ("stretch = 20", 'model = "best"', "discrete.model"),
        ("hidden = [12]", "hidden = []", "network.hidden: no hidden layer, expected at least one"),
        ("epochs = 300", "epochs = 300\nbatch_norm = true", "training.batch_norm: belongs to the structure \"response\""),
        ("[sampling]", "[bounds]\nruns = 3\n[sampling]", "bounds.runs: 3 runs, expected at least 19 for a coverage of 0.95"),
        ("[sampling]", "[states]\nx = { min = 0, max = 1 }\n[sampling]", "states: belongs to the structure \"dynamics\""),
        ("speed = {}", "speed = {}\nforce_start = {}", "`force_start` is the name of a variable's value before the start"),
        ('structure = "discrete"', "", "discrete: belongs to the structure \"discrete\""),
        ("step = 0.02", "step = 2.0", "time.stop: 2 s, expected at least two steps"),
    ],
)
def test_mistakes_in_a_study_are_found_with_key_and_line(tmp_path, old, new, message):
    table(tmp_path / "runs.csv")
    assert old in STUDY, old
    (tmp_path / "plant.toml").write_text(STUDY.replace(old, new, 1))
    result = metafmu("sample", tmp_path / "plant.toml", "--dry-run", check=False)
    assert result.returncode != 0 and message in result.stderr, result.stderr
    assert "plant.toml:" in result.stderr


def test_a_budget_limits_the_epochs(tmp_path):
    table(tmp_path / "runs.csv")
    study = STUDY.replace("history = 3", 'history = 3\nmodel = "window"').replace("budget = 20", "budget = 1").replace("[12]", "[512, 512]")
    (tmp_path / "plant.toml").write_text(study)
    result = metafmu("build", tmp_path / "plant.toml", "--out", tmp_path / "out", check=False)
    epochs = re.search(r"(\d+) of 300 epochs are within the budget \(discrete.budget\)", result.stderr)
    history = (tmp_path / "out" / "history.csv").read_text().splitlines()
    assert epochs and len(history) - 1 <= int(epochs[1]) < 50, result.stderr


def test_a_new_study_of_a_table_names_inputs_and_builds(tmp_path):
    table(tmp_path / "runs.csv")

    def new(*arguments):
        return subprocess.run([METAFMU, "new", *arguments], cwd=tmp_path, capture_output=True, text=True)

    result = new("mine", "--table", "runs.csv", "--structure", "discrete")
    assert result.returncode == 0, result.stderr
    text = (tmp_path / "mine.toml").read_text()
    assert "[inputs]\nforce = {}\n\n[outputs]\ny = {}\nspeed = {}\n" in text and "gain = { min = 0.5, max = 1.5 }" in text
    (tmp_path / "mine.toml").write_text(text.replace("epochs = 300", "epochs = 5"))
    built = subprocess.run([METAFMU, "build", "mine.toml"], cwd=tmp_path, capture_output=True, text=True)
    assert "FMI 2.0 co-simulation, " in built.stdout, built.stderr
    assert new("other", "--table", "runs.csv", "--structure", "discrete", "--inputs", "speed,force").returncode == 0
    assert "[inputs]\nforce = {}\nspeed = {}\n\n[outputs]\ny = {}\n" in (tmp_path / "other.toml").read_text()
    (tmp_path / "plain.csv").write_text((tmp_path / "runs.csv").read_text().replace("force", "push"))
    refused = new("third", "--table", "plain.csv", "--structure", "discrete")
    assert refused.returncode == 2 and "no column is known to drive the runs: say which they are with --inputs COLUMNS (push, y, speed)" in refused.stderr
    assert new("third", "--mechanism", "runs.csv", "--structure", "discrete").returncode == 2
