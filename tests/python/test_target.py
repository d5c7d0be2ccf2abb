"""A study with a target: runs are added until it is met; a kill changes nothing."""

import subprocess

import pandas as pd
import pytest
from conftest import ALL_EPOCHS, ANY, METAFMU, ROOT, abort_at, metafmu

RESULTS = ["study.safetensors", "train.csv", "added.csv"]
# what is printed last before a kill, and what the next build says how often at least
KILLED_AT = [
    ("epoch 5/10", "continuing after epoch", 1),
    ("round 1 with 40 runs", "is already finished", 1),
    ("simulated 20 of 20 further runs", "is already finished", 1),
    ("round 2 with 60 runs", "is already finished", 2),
    ("round 3 with 80 runs", "is already finished", 3),
]


def study_text(target):
    text = (ROOT / "examples" / "single-pendulum.toml").read_text()
    for line, smaller in [
        ('name = "single-pendulum"', 'name = "study"'),
        ("runs = 1331", "runs = 40"),
        ("test_runs = 200", "test_runs = 20"),
        ("\nruns = 1000", "\nruns = 20"),
        ("step = 0.01", "step = 0.02"),
        ("hidden = [64, 64, 64, 64, 64, 64]", "hidden = [16, 16]"),
        ("batch = 1024", "batch = 128"),
        ("epochs = 150", "epochs = 10"),
        *ALL_EPOCHS,
        ("validation = 0.03", "validation = 0.25"),
    ]:
        assert line in text, line
        text = text.replace(line, smaller)
    return text + f"\n[target]\n{target}\n"


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    path = tmp_path_factory.mktemp("target") / "study.toml"
    path.write_text(study_text("r2 = 0.99999\nruns = 20\nmax_runs = 90"))
    return path


@pytest.fixture(scope="module")
def undisturbed(study):
    folder = study.parent / "undisturbed"
    result = metafmu("build", study, "--out", folder, check=False)
    assert result.returncode == 1, "a target that is missed is a problem\n" + result.stderr
    assert "round 4 with 90 runs" in result.stderr and "no more runs allowed" in result.stderr
    return folder


def test_runs_are_added_up_to_the_budget_and_training_goes_on_from_the_network(undisturbed):
    folder = undisturbed
    rounds = pd.read_csv(folder / "rounds.csv")
    assert list(rounds["runs"]) == [40, 60, 80, 90]
    worst = rounds.filter(like="r2_").min(axis=1)
    assert worst.iloc[-1] > worst.iloc[0]
    added = pd.read_csv(folder / "added.csv")
    train, test = (pd.read_csv(folder / name) for name in ("train.csv", "test.csv"))
    parameters = ["L", "c", "thetad0"]
    points = [set(map(tuple, table[parameters].to_numpy())) for table in (train, added, test)]
    assert [len(some) for some in points] == [40, 50, 20]
    assert len(set.union(*points)) == 110, "no run is for two of it"
    history = pd.read_csv(folder / "history.csv")
    assert list(history["epoch"]) == list(range(1, 41)) and history["seconds"].is_monotonic_increasing
    assert not (folder / "rounds").exists()


def test_a_target_that_is_met_at_once_adds_nothing(study, tmp_path):
    easy = tmp_path / "study.toml"
    easy.write_text(study_text("r2 = 0.01\nruns = 20\nmax_runs = 90\n") + ANY)
    result = metafmu("build", easy, "--out", tmp_path)
    assert "the target is met" in result.stderr
    assert not (tmp_path / "added.csv").exists()


@pytest.mark.parametrize("line, says, times", KILLED_AT)
def test_a_killed_training_goes_on_where_it_was_to_the_same_bytes(study, undisturbed, tmp_path, line, says, times):
    process = subprocess.Popen([METAFMU, "build", study, "--out", tmp_path], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    printed = []
    for text in process.stderr:
        printed.append(text)
        if line in text:
            break
    process.kill()
    process.wait()
    process.stderr.close()
    assert line in printed[-1], printed
    resumed = metafmu("build", study, "--out", tmp_path, "--resume", check=False).stderr
    # it may have come further before it ended
    assert resumed.count(says) >= times, resumed
    assert {name: (tmp_path / name).read_bytes() for name in RESULTS} == {name: (undisturbed / name).read_bytes() for name in RESULTS}


def test_added_runs_are_parquet_if_the_study_says_so(study, undisturbed, tmp_path):
    other = tmp_path / "other.toml"
    other.write_text(study.read_text().replace("[sampling]", '[sampling]\ntables = "parquet"'))
    folder = tmp_path / "out"
    for moment in ("complete added.parquet", "replaced added.parquet", "replaced added.sha256 2"):
        abort_at(moment, "build", other, "--out", folder, "--resume")
    assert metafmu("build", other, "--out", folder, "--resume", check=False).returncode == 1
    assert (folder / "study.safetensors").read_bytes() == (undisturbed / "study.safetensors").read_bytes()
    expected = pd.read_csv(undisturbed / "added.csv")
    pd.testing.assert_frame_equal(pd.read_parquet(folder / "added.parquet"), expected, check_exact=True)
    assert not (folder / "added.csv").exists() and not (folder / "rounds").exists()
