"""Discrete-time FMUs that start from measured outputs, in fmpy and in the command, against `metafmu predict` of the same rows."""

import csv
import re
import shutil
import subprocess

import numpy as np
import pytest
from conftest import METAFMU, ROOT, compiled_from_sources, fmu_of, metafmu
from fmpy import extract, simulate_fmu
from fmpy.validation import validate_fmu
from test_discrete import STEP, STUDY, Plant, Running, forces, plant, table

OUTPUTS = ["position", "speed"]
# none of these is at rest at the start, and all of a history is measured
MODELS = {"polynomial": 3, "state-space": 1, "feedback": 3, "window": 3}
GAIN, GIVEN = 1.1, 20
FREE = 40
# the rows before the start are those of a motion that has begun long before
FORCE = forces(99)[: 15 + GIVEN + FREE]
TRUTH = plant(FORCE, GAIN)[15:]
FORCE = FORCE[15:]
TIMES = STEP * np.arange(-GIVEN, FREE)


@pytest.fixture(scope="module")
def surrogates(tmp_path_factory):
    """A surrogate of each kind of model, made on demand."""
    made = {}

    def make(model):
        if model not in made:
            folder = tmp_path_factory.mktemp(model)
            table(folder / "runs.csv")
            study = STUDY.replace("history = 3", f'history = {MODELS[model]}\nmodel = "{model}"').replace("epochs = 300", "epochs = 40")
            (folder / "plant.toml").write_text(study)
            # how good it is does not matter here
            command = [METAFMU, "build", folder / "plant.toml", "--out", folder / "out", "--fmi", "both", "--ports", "measured"]
            subprocess.run(command, check=False, capture_output=True)
            assert (folder / "out" / "plant-fmi3.fmu").exists()
            made[model] = Plant(folder / "plant.toml", folder / "out")
        return made[model]

    return make


def rows(measured=TRUTH, times=TIMES, force=FORCE):
    """A table for `metafmu predict` and `metafmu simulate`."""
    lines = [",".join(map(repr, map(float, row))) for row in np.column_stack([times, force, measured])]
    return "\n".join(["time,force,position,speed", *lines]) + "\n"


def read(path, names=OUTPUTS):
    with open(path, newline="") as file:
        return np.array([[float(row[name]) for name in names] for row in csv.DictReader(file)])


def predicted(built, folder, text, names=OUTPUTS):
    """The rows that `metafmu predict` computes."""
    lines = text.splitlines()
    (folder / "rows.csv").write_text("\n".join([lines[0] + ",gain", *(f"{line},{GAIN}" for line in lines[1:])]) + "\n")
    metafmu("predict", built.folder / "plant.safetensors", folder / "rows.csv", "--out", folder / "predicted.csv")
    return read(folder / "predicted.csv", names)


def close(found, expected):
    """To 1e-12 of the range of each output."""
    return bool((np.abs(found - expected).max(axis=0) <= 1e-12 * np.ptp(TRUTH, axis=0)).all())


class Measured(Running):
    """An FMU that starts at the first measured row."""

    def __init__(self, fmu, folder, start=TIMES[0]):
        super().__init__(fmu, folder, start, gain=GAIN)

    def use_measured(self, on):
        self.fmu.setBoolean([self.references["use_measured"]], [on])

    def measure(self, row):
        for name, value in zip(OUTPUTS, TRUTH[row]):
            self.set(f"{name}_measured", value)

    def get_state(self):
        return self.fmu.getFMUState() if self.is_fmi3 else self.fmu.getFMUstate()

    def set_state(self, state):
        (self.fmu.setFMUState if self.is_fmi3 else self.fmu.setFMUstate)(state)

    def serialized(self, state):
        """The state after serialization and deserialization."""
        if self.is_fmi3:
            return self.fmu.deserializeFMUState(self.fmu.serializeFMUState(state))
        return self.fmu.deSerializeFMUstate(self.fmu.serializeFMUstate(state))

    def run(self, first, last, is_measured=lambda row: row < GIVEN, parts=1):
        """Outputs at the ends of the steps from a row to another one."""
        found = []
        for row in range(first, last):
            self.set("force", FORCE[row])
            if is_measured(row):
                self.measure(row)
            self.use_measured(is_measured(row))
            for _ in range(parts):
                self.step(STEP / parts)
            found.append(self.outputs())
        return np.array(found)


@pytest.fixture(params=["library", "sources"])
def unpacked(request, surrogates, tmp_path, monkeypatch):
    """An FMU by its library, or by the library that its C sources are compiled to."""

    def make(model, version):
        built = surrogates(model)
        if request.param == "library":
            return built, built.fmu(version)
        out = tmp_path / "sources"
        metafmu("export", built.folder / "plant.safetensors", "--out", out, "--sources", "--fmi", version, "--ports", "measured")
        return built, str(compiled_from_sources(fmu_of(out, "plant", version), monkeypatch))

    return make


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("version", [2, 3])
def test_a_free_run_after_measured_samples_is_that_of_predict(unpacked, tmp_path, model, version):
    built, fmu = unpacked(model, version)
    expected = predicted(built, tmp_path, rows())
    for parts in (1, 3):
        running = Measured(fmu, tmp_path / f"fmu-{parts}")
        found = running.run(0, FREE + GIVEN - 1, parts=parts)
        # in the measured rows, too: both have the prediction before it is corrected
        assert close(found, expected[1:]), parts
        domain = predicted(built, tmp_path, rows(), ["domain_distance"])[-1, 0]
        assert abs(running.get("domain_distance")[0] - domain) < 1e-9
    # what it starts from is not at rest, and makes a difference
    unmeasured = Measured(fmu, tmp_path / "fmu").run(0, FREE + GIVEN - 1, lambda row: False)
    if model == "window":
        assert np.array_equal(unmeasured[GIVEN - 1 :], found[GIVEN - 1 :]) or close(unmeasured[GIVEN - 1 :], expected[GIVEN:])
    else:
        assert not close(unmeasured[GIVEN - 1 : GIVEN + 3], expected[GIVEN : GIVEN + 4])


@pytest.mark.parametrize("version", [2, 3])
def test_both_validators_accept_an_fmu_with_measured_inputs(surrogates, version):
    fmu = surrogates("feedback").fmu(version)
    assert validate_fmu(fmu) == []
    assert metafmu("validate", fmu).returncode == 0


def signals(times=TIMES, given=GIVEN):
    """Input signals for fmpy."""
    names = ["time", "force", "position_measured", "speed_measured", "use_measured"]
    kinds = [float] * 4 + [bool]
    return np.array(list(zip(times, FORCE, *TRUTH.T, np.arange(len(times)) < given)), dtype=list(zip(names, kinds)))


@pytest.mark.parametrize("model", ["state-space", "feedback"])
@pytest.mark.parametrize("version", [2, 3])
def test_fmpy_simulates_from_measured_samples_by_an_array_of_inputs(surrogates, tmp_path, model, version):
    built = surrogates(model)
    expected = predicted(built, tmp_path, rows())
    result = simulate_fmu(
        built.fmu(version), start_time=TIMES[0], stop_time=TIMES[-1], step_size=STEP, output_interval=STEP, input=signals(),
        start_values={"gain": GAIN}, output=OUTPUTS,
    )  # fmt: skip
    found = np.column_stack([result[name] for name in OUTPUTS])
    assert abs(result["time"][GIVEN]) < 1e-9
    assert close(found[GIVEN : GIVEN + FREE], expected[GIVEN:])


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("version", [2, 3])
def test_the_command_simulates_from_rows_before_the_start_as_it_predicts(surrogates, tmp_path, model, version):
    built = surrogates(model)
    text = rows()
    expected = predicted(built, tmp_path, text)
    (tmp_path / "inputs.csv").write_text(text)
    arguments = ["simulate", built.fmu(version), "--input", tmp_path / "inputs.csv", "--start", f"gain={GAIN}", "--stop-time", TIMES[-1]]
    result = metafmu(*arguments, "--output", tmp_path / "found.csv")
    assert "not used" not in result.stderr
    found = read(tmp_path / "found.csv", ["time", *OUTPUTS])
    assert np.abs(found[:, 0] - TIMES).max() < 1e-9
    assert close(found[:, 1:], expected)
    # the steps may be parts of samples
    metafmu(*arguments, "--output", tmp_path / "found.csv", "--step-size", STEP / 4)
    assert close(read(tmp_path / "found.csv")[4 * GIVEN :: 4], expected[GIVEN:])


def test_the_command_says_what_it_does_not_use_and_which_row_is_no_sample(surrogates, tmp_path):
    fmu, path = surrogates("feedback").fmu(2), tmp_path / "inputs.csv"
    simulate = lambda text: (path.write_text(text), metafmu("simulate", fmu, "--input", path, "--output", tmp_path / "found.csv", check=False))[1]
    lines = rows().splitlines()
    # some of the outputs are no start
    (tmp_path / "some.csv").write_text("\n".join(line.rsplit(",", 1)[0] + (",gain" if line is lines[0] else f",{GAIN}") for line in lines) + "\n")
    message = ".csv:2: a row before time 0 has measured outputs, and all outputs are needed there: no column `speed`, expected it among "
    without_speed = ["\n".join(line.rsplit(",", 1)[0] for line in part) + "\n" for part in (lines, [lines[0], *lines[1 + GIVEN :]])]
    for refused in (simulate(without_speed[0]), metafmu("predict", fmu, tmp_path / "some.csv", check=False)):
        assert refused.returncode == 2 and message in refused.stderr, refused.stderr
    after = simulate(without_speed[1])
    assert after.returncode == 0 and "columns that are not used: position" in after.stderr
    assert read(tmp_path / "found.csv", ["time"])[0, 0] == 0.0
    # outputs after the start count for nothing
    after = simulate("\n".join([lines[0], *lines[1 + GIVEN :]]) + "\n")
    assert after.returncode == 0 and "not used" not in after.stderr and read(tmp_path / "found.csv", ["time"])[0, 0] == 0.0
    late = [*lines[:3], "-0.35," + lines[3].split(",", 1)[1], *lines[4:]]
    message = ".csv:4: time -0.35 s, expected -0.36 s: rows before time 0 are 0.02 s apart, as their outputs are measured samples"
    refused = simulate("\n".join(late) + "\n")
    assert refused.returncode == 2 and message in refused.stderr, refused.stderr
    (tmp_path / "late.csv").write_text("\n".join(late) + "\n")
    refused = metafmu("predict", fmu, tmp_path / "late.csv", "--default", "gain", check=False)
    assert refused.returncode == 2 and message in refused.stderr, refused.stderr


def test_names_of_measured_outputs_are_refused_in_a_study_with_their_lines(tmp_path):
    table(tmp_path / "runs.csv")
    named = STUDY.replace("gain =", "speed_measured =").replace("position = { unit", "use_measured = { unit").replace("position = \"y\"", "use_measured = \"y\", speed_measured = \"gain\"")
    (tmp_path / "plant.toml").write_text(named)
    refused = metafmu("sample", tmp_path / "plant.toml", "--out", tmp_path / "out", check=False).stderr
    line = lambda start: 1 + [text.startswith(start) for text in named.splitlines()].index(True)
    for start, message in [
        ("speed_measured", "parameters.speed_measured: `speed_measured` is the name of the measured value of `speed`"),
        ("use_measured", "outputs.use_measured: `use_measured` is the name of the input that switches measured outputs on"),
    ]:
        assert f"plant.toml:{line(start)}: {message}" in refused, refused


@pytest.mark.parametrize("version", [2, 3])
def test_samples_are_measured_again_during_a_run(unpacked, tmp_path, version):
    _, fmu = unpacked("feedback", version)
    # measured up to a row, free, measured once more, free
    is_measured = lambda row: row < GIVEN or 30 <= row < 40
    again = Measured(fmu, tmp_path / "again").run(0, 55, is_measured)
    late = Measured(fmu, tmp_path / "late", TIMES[30])
    # the history before is what follows from the start values, but all of it has been replaced
    found = late.run(30, 55, is_measured)
    assert close(again[39:], found[9:])
    once = Measured(fmu, tmp_path / "once").run(0, 55)
    assert not close(again[39:41], once[39:41]) and np.array_equal(again[:30], once[:30])


@pytest.mark.parametrize("version", [2, 3])
def test_what_changes_between_samples_counts_at_the_next_one(unpacked, tmp_path, version):
    _, fmu = unpacked("feedback", version)
    expected = Measured(fmu, tmp_path / "whole").run(0, 40)
    running = Measured(fmu, tmp_path / "parts")
    found = []
    for row in range(40):
        running.set("force", FORCE[row])
        running.measure(row)
        running.use_measured(row < GIVEN)
        running.step(0.4 * STEP)
        before = running.outputs()
        # neither the values nor the switch have an effect between samples
        running.measure((row + 5) % 40)
        running.use_measured(row % 2 == 0)
        assert np.array_equal(running.outputs(), before)
        running.step(0.6 * STEP)
        found.append(running.outputs())
    assert close(np.array(found), expected)


@pytest.mark.parametrize("model", ["state-space", "feedback"])
@pytest.mark.parametrize("version", [2, 3])
def test_a_state_among_measured_samples_is_restored_and_serialized(unpacked, tmp_path, model, version):
    _, fmu = unpacked(model, version)
    running = Measured(fmu, tmp_path / "fmu")
    running.run(0, 10)
    running.set("force", FORCE[10])
    running.measure(10)
    running.step(0.3 * STEP)
    state, time = running.get_state(), running.time

    def go_on():
        # the switch and the values are those of the state
        running.step(0.7 * STEP)
        running.step(STEP)
        return np.array([*running.run(12, 30), running.outputs()])

    first = go_on()
    for again in (state, running.serialized(state)):
        running.set_state(again)
        running.time = time
        assert running.fmu.getBoolean([running.references["use_measured"]]) == [True]
        assert np.array_equal(go_on(), first)
    running.fmu.terminate()
    running.fmu.reset()
    if not running.is_fmi3:
        running.fmu.setupExperiment()
    running.fmu.enterInitializationMode()
    assert running.fmu.getBoolean([running.references["use_measured"]]) == [False]
    assert np.array_equal(running.get("position_measured", "speed_measured"), [0.0, 0.0])


@pytest.mark.parametrize("version", [2, 3])
def test_outputs_follow_from_measured_ones_a_sample_later_only(surrogates, tmp_path, version):
    running = Measured(surrogates("feedback").fmu(version), tmp_path)
    description = running.description
    names = {variable.name: variable for variable in description.modelVariables}
    assert (names["use_measured"].causality, names["use_measured"].variability, names["use_measured"].start) == ("input", "discrete", "false")
    assert (names["position_measured"].causality, names["position_measured"].unit) == ("input", "m")
    for unknown in description.outputs:
        assert not any(known.name.endswith("_measured") for known in unknown.dependencies or []), unknown.variable.name
    running.run(0, 3)
    running.step(0.5 * STEP)
    before = running.outputs()
    running.measure(30)
    assert np.array_equal(running.outputs(), before)
    knowns, unknowns = ([running.references[name] for name in of] for of in (["position_measured", "speed_measured"], OUTPUTS))
    assert running.fmu.getDirectionalDerivative(unknowns, knowns, [1.0, -2.0]) == [0.0, 0.0]
    if version == 3:
        assert running.fmu.getAdjointDerivative(unknowns, knowns, [1.0, -2.0]) == [0.0, 0.0]


@pytest.mark.parametrize("version", [2, 3])
def test_a_measured_value_outside_the_training_leaves_the_domain_by_the_policy(unpacked, tmp_path, version):
    _, fmu = unpacked("feedback", version)
    inside = lambda running: bool(running.fmu.getBoolean([running.references["in_domain"]])[0])
    running = Measured(fmu, tmp_path / "fmu")
    # the strictest policy does not mind the change from start values to a motion, which may be larger than any of the training
    set_policy = running.fmu.setInt32 if running.is_fmi3 else running.fmu.setInteger
    set_policy([running.references["domain_policy"]], [2])
    running.run(0, 12)
    # now the history is measured
    assert inside(running) and running.get("domain_distance")[0] == 0.0
    running.set("position_measured", 50.0)
    running.step(STEP)
    assert not inside(running) and running.get("domain_distance")[0] > 1.0
    running.step(STEP)
    # a prediction from there is refused
    running.use_measured(False)
    with pytest.raises(Exception, match="DoStep"):
        running.step(STEP)


@pytest.mark.parametrize("version", [2, 3])
def test_the_example_of_the_documentation_runs_free_as_predict(surrogates, tmp_path, monkeypatch, version):
    built = surrogates("feedback")
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "using-the-fmu.md").read_text(), re.DOTALL)
    [example] = [block for block in blocks if "use_measured" in block]
    # a record that begins in the middle of a motion, the free run of which is at time 0
    given = 50
    force = np.concatenate([forces(98), forces(99)])[-given - FREE - 15 :]
    times, truth, force = STEP * np.arange(-given, FREE), plant(force, 1.0)[15:], force[15:]
    shutil.copy(built.fmu(version), tmp_path / "plant.fmu")
    (tmp_path / "record.csv").write_text(rows(truth, times, force))
    metafmu("predict", tmp_path / "plant.fmu", tmp_path / "record.csv", "--default", "gain", "--out", tmp_path / "predicted.csv")
    monkeypatch.chdir(tmp_path)
    scope = {}
    exec(example, scope)
    # fmpy may record the change of the switch as well, which rounding puts right before or after the row
    _, places = np.unique(np.round(scope["free"]["time"] / STEP), return_index=True)
    free = np.column_stack([scope["free"][name][places] for name in OUTPUTS])
    assert close(free, read(tmp_path / "predicted.csv")[given:])
    # and so does the command
    metafmu("simulate", tmp_path / "plant.fmu", "--input", tmp_path / "record.csv", "--stop-time", times[-1], "--output", tmp_path / "found.csv")
    assert close(read(tmp_path / "found.csv")[given:], read(tmp_path / "predicted.csv")[given:])
