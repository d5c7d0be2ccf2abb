"""A build that is killed at any moment resumes with --resume and ends in the same bytes."""

import subprocess
import time

import pytest
from conftest import ANY, METAFMU, ROOT, RandomKills, abort_at, changed, losses, metafmu, small_study

KILLS = 20
EPOCHS = 8
# its bytes hold no wall times
RESULTS = ["study.fmu", "study.safetensors", "train.csv", "test.csv", "calibration.csv"]
# what a build writes, and what it has removed when it ends; nothing but files outlives a process, so that between two of
# these moments it does not matter when it is killed
WRITTEN = [
    *RESULTS,
    *("samples.json", "history.csv", "training.json", "metrics.json", "comparison.json", "comparison.csv", "report.html"),
]
MOMENTS = [
    *(f"{moment} {name}" for name in [*WRITTEN, "checkpoint.safetensors"] for moment in ("complete", "replaced")),
    "removed checkpoint.safetensors",
    "appended unfinished-runs.bin",
    "removed unfinished-runs.bin",
]


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    text = small_study(EPOCHS)
    path = tmp_path_factory.mktemp("resume") / "study.toml"
    path.write_text(text + ANY)
    return path


def results(folder):
    return {name: (folder / name).read_bytes() for name in RESULTS}


@pytest.fixture(scope="module")
def undisturbed(study):
    folder = study.parent / "undisturbed"
    metafmu("build", study, "--out", folder)
    return folder


def expect_same(folder, expected):
    assert results(folder) == results(expected)
    assert losses(folder) == losses(expected)
    # neither a checkpoint nor what was being written when it was killed
    assert {path.name for path in folder.iterdir()} == {path.name for path in expected.iterdir()}


def test_the_moments_are_those_of_every_file_that_a_build_writes(undisturbed):
    assert {path.name for path in undisturbed.iterdir()} == set(WRITTEN)


@pytest.mark.parametrize("moment", MOMENTS)
def test_a_build_that_is_killed_goes_on_and_ends_in_the_same_bytes(study, undisturbed, tmp_path, moment):
    abort_at(moment, "build", study, "--out", tmp_path)
    metafmu("build", study, "--out", tmp_path, "--resume")
    expect_same(tmp_path, undisturbed)


def test_a_build_that_is_killed_after_every_epoch_ends_in_the_same_bytes(study, undisturbed, tmp_path):
    """A process keeps its first epoch in any case, and the last one is not kept in a checkpoint."""
    for epoch in range(1, EPOCHS):
        abort_at("replaced history.csv", "build", study, "--out", tmp_path, "--resume")
        assert len(losses(tmp_path)) == epoch and (tmp_path / "checkpoint.safetensors").exists()
    result = metafmu("build", study, "--out", tmp_path, "--resume")
    assert f"continuing after epoch {EPOCHS - 1}" in result.stderr
    expect_same(tmp_path, undisturbed)


@pytest.mark.thorough
def test_a_build_that_is_killed_at_random_goes_on_and_ends_in_the_same_bytes(study, tmp_path):
    longer = tmp_path / "study.toml"
    longer.write_text(study.read_text().replace(f"epochs = {EPOCHS}", "epochs = 3000"))
    begin = time.monotonic()
    metafmu("build", longer, "--out", tmp_path / "undisturbed")
    kill = RandomKills(time.monotonic() - begin)
    killed = went_on = 0
    for number in range(KILLS):
        folder = tmp_path / f"killed-{number}"
        killed += kill("build", longer, "--out", folder)
        # and again, while it continues
        kill("build", longer, "--out", folder, "--resume", latest=0.5)
        went_on += (folder / "checkpoint.safetensors").exists()
        metafmu("build", longer, "--out", folder, "--resume")
        expect_same(folder, tmp_path / "undisturbed")
    assert killed >= KILLS / 2 and went_on >= KILLS / 4, (killed, went_on)


@pytest.fixture(scope="module")
def pushed(tmp_path_factory):
    """A study of a pendulum with a motor, and the folder of its build."""
    folder = tmp_path_factory.mktemp("pushed")
    mechanism = folder / "pendulum.toml"
    mechanism.write_text((ROOT / "examples" / "dynamics" / "pendulum.toml").read_text())
    study = folder / "pushed.toml"
    command = [METAFMU, "new", "pushed", "--mechanism", mechanism, "--structure", "dynamics"]
    subprocess.run(command, check=True, capture_output=True, cwd=folder)
    study.write_text(study.read_text().replace("stop = 10.0", "stop = 1.0"))
    metafmu("build", study, "--out", folder / "undisturbed")
    return study


@pytest.mark.parametrize(
    "moment",
    ["replaced train.csv", "replaced test.csv", "complete pushed.safetensors", "replaced training.json", "complete pushed.fmu"],
)
def test_a_component_with_states_goes_on_as_well(pushed, tmp_path, moment):
    abort_at(moment, "build", pushed, "--out", tmp_path)
    metafmu("build", pushed, "--out", tmp_path, "--resume")
    for name in ["pushed.fmu", "pushed.safetensors", "train.csv", "test.csv"]:
        assert (tmp_path / name).read_bytes() == (pushed.parent / "undisturbed" / name).read_bytes(), name
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in (pushed.parent / "undisturbed").iterdir()}


def test_a_training_that_is_killed_goes_on_with_train(study, undisturbed, tmp_path):
    metafmu("sample", study, "--out", tmp_path)
    abort_at("replaced checkpoint.safetensors", "train", study, "--out", tmp_path)
    result = metafmu("train", study, "--out", tmp_path, "--resume")
    assert "continuing after epoch 1" in result.stderr
    assert (tmp_path / "study.safetensors").read_bytes() == (undisturbed / "study.safetensors").read_bytes()
    assert losses(tmp_path) == losses(undisturbed)


def test_a_checkpoint_of_another_training_is_refused_and_a_damaged_one_too(study, undisturbed, tmp_path):
    checkpoint = tmp_path / "checkpoint.safetensors"
    metafmu("sample", study, "--out", tmp_path)
    abort_at("replaced checkpoint.safetensors", "train", study, "--out", tmp_path)
    other = study.with_stem("other")
    other.write_text(study.read_text().replace("hidden = [16, 16]", "hidden = [16, 15]"))
    good = checkpoint.read_bytes()
    for path, content in [(other, good), (study, good[:-1]), (study, b""), (study, b"\xff" * 100)]:
        checkpoint.write_bytes(content)
        result = metafmu("train", path, "--out", tmp_path, "--resume", check=False)
        assert result.returncode == 2
        assert "checkpoint.safetensors" in result.stderr and "without --resume" in result.stderr
        assert checkpoint.read_bytes() == content
    # without --resume it does not matter
    metafmu("train", study, "--out", tmp_path)
    assert (tmp_path / "study.safetensors").read_bytes() == (undisturbed / "study.safetensors").read_bytes()


FRICTION = """name = "study"
structure = "dynamics"
[source]
mechanism = "pendulum.toml"
[time]
stop = 1.0
step = 0.05
[states]
pivot.angle = { min = -3.141592653589793, max = 3.141592653589793, velocity = [-2.0, 2.0] }
[inputs]
torque = { bandwidth = 1.0 }
[outputs]
theta = {}
[sampling]
states = 600
test_runs = 2
[dynamics]
compare = true
[network]
hidden = [8]
[training]
learning_rate = 0.01
schedule = "cosine"
batch = 128
epochs = 6
"""


def test_networks_in_equations_of_motion_go_on_where_they_were(tmp_path):
    bearing = '[springs.bearing]\ncoordinate = "pivot.angle"\ndamping = "c"\n'
    friction = '[actuators.friction]\ncoordinate = "pivot.angle"\neffort = "-0.1 * tanh(pivot.angular_velocity / 0.2)"\n'
    (tmp_path / "pendulum.toml").write_text(changed("dynamics/pendulum.toml", (bearing, friction)))
    study = tmp_path / "study.toml"
    study.write_text(FRICTION + ANY)
    undisturbed, folder = tmp_path / "undisturbed", tmp_path / "out"
    metafmu("build", study, "--out", undisturbed)
    # within the second training, the first one being finished
    abort_at("replaced checkpoint-2.safetensors", "build", study, "--out", folder)
    kept = sorted(path.name for path in folder.glob("checkpoint*"))
    assert kept == ["checkpoint-1.safetensors", "checkpoint-2.safetensors"]
    resumed = metafmu("build", study, "--out", folder, "--resume")
    assert resumed.stderr.count("continuing after epoch 6") == 1 and "continuing after epoch 1" in resumed.stderr
    name = "study.safetensors"
    assert (folder / name).read_bytes() == (undisturbed / name).read_bytes()
    assert {path.name for path in folder.iterdir()} == {path.name for path in undisturbed.iterdir()}
    assert losses(folder) == losses(undisturbed)


def test_short_runs_of_a_sampling_that_was_killed_are_kept(study, undisturbed, tmp_path):
    abort_at("appended unfinished-runs.bin", "sample", study, "--out", tmp_path)
    kept = (tmp_path / "unfinished-runs.bin").stat().st_size
    assert kept > 32 and not (tmp_path / "train.csv").exists()
    result = metafmu("sample", study, "--out", tmp_path)
    assert "kept from a sampling that was not finished" in result.stderr, result.stderr
    for table in ("train.csv", "test.csv", "calibration.csv"):
        assert (tmp_path / table).read_bytes() == (undisturbed / table).read_bytes()
    assert not (tmp_path / "unfinished-runs.bin").exists()
