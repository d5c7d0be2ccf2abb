"""A build that is killed at any moment goes on with --resume and ends in the same bytes."""

import random
import time

import pytest
from conftest import ALL_EPOCHS, changed, kill_after, losses, metafmu

KILLS = 20
# its bytes hold no wall times
RESULTS = ["study.fmu", "study.safetensors", "train.csv", "test.csv"]


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    text = changed(
        "single-pendulum.toml",
        ('name = "single-pendulum"', 'name = "study"'),
        ("runs = 1331", "runs = 150"),
        ("test_runs = 200", "test_runs = 20"),
        ("step = 0.01", "step = 0.02"),
        ("hidden = [64, 64, 64, 64, 64, 64]", "hidden = [32, 32]"),
        ("batch = 1024", "batch = 128"),
        ("epochs = 150", "epochs = 160"),
        *ALL_EPOCHS,
    )
    path = tmp_path_factory.mktemp("resume") / "study.toml"
    path.write_text(text)
    return path


def results(folder):
    return {name: (folder / name).read_bytes() for name in RESULTS}


@pytest.fixture(scope="module")
def undisturbed(study):
    """Its folder, and how long it took."""
    folder = study.parent / "undisturbed"
    begin = time.monotonic()
    metafmu("build", study, "--out", folder)
    return folder, time.monotonic() - begin


def test_a_build_that_is_killed_goes_on_and_ends_in_the_same_bytes(study, undisturbed):
    expected_folder, seconds = undisturbed
    moments = random.Random(1)
    killed = went_on = 0
    for number in range(KILLS):
        folder = study.parent / f"killed-{number}"
        killed += kill_after(moments.uniform(0, seconds), "build", study, "--out", folder)
        # and again, while it goes on
        kill_after(moments.uniform(0, seconds / 2), "build", study, "--out", folder, "--resume")
        went_on += (folder / "checkpoint.safetensors").exists()
        metafmu("build", study, "--out", folder, "--resume")
        assert results(folder) == results(expected_folder), number
        assert losses(folder) == losses(expected_folder), number
        assert not (folder / "checkpoint.safetensors").exists()
        # nor what was being written when it was killed
        assert {path.suffix for path in folder.iterdir()} <= {".fmu", ".safetensors", ".csv", ".json", ".html"}
    assert killed >= KILLS / 2 and went_on >= KILLS / 4, (killed, went_on)


def test_a_training_that_is_killed_goes_on_with_train(study, undisturbed):
    folder = study.parent / "train"
    metafmu("sample", study, "--out", folder)
    for _ in range(100):
        kill_after(0.3 * undisturbed[1], "train", study, "--out", folder, "--resume")
        if (folder / "checkpoint.safetensors").exists():
            break
    result = metafmu("train", study, "--out", folder, "--resume")
    assert "continuing after epoch" in result.stderr
    assert (folder / "study.safetensors").read_bytes() == (undisturbed[0] / "study.safetensors").read_bytes()
    assert losses(folder) == losses(undisturbed[0])


def test_a_checkpoint_of_another_training_is_refused_and_a_damaged_one_too(study, undisturbed):
    folder = study.parent / "refused"
    checkpoint = folder / "checkpoint.safetensors"
    metafmu("sample", study, "--out", folder)
    for _ in range(100):
        kill_after(0.3 * undisturbed[1], "train", study, "--out", folder)
        if checkpoint.exists():
            break
    other = study.with_stem("other")
    other.write_text(study.read_text().replace("hidden = [32, 32]", "hidden = [32, 31]"))
    good = checkpoint.read_bytes()
    for path, content in [(other, good), (study, good[:-1]), (study, b""), (study, b"\xff" * 100)]:
        checkpoint.write_bytes(content)
        result = metafmu("train", path, "--out", folder, "--resume", check=False)
        assert result.returncode == 2
        assert "checkpoint.safetensors" in result.stderr and "without --resume" in result.stderr
        assert checkpoint.read_bytes() == content
    # without --resume it does not matter
    metafmu("train", study, "--out", folder)
    assert (folder / "study.safetensors").read_bytes() == (undisturbed[0] / "study.safetensors").read_bytes()
