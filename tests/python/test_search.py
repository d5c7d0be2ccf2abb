"""A search over a study's keys: its table, its best study, and that it ends the same after it was killed."""

import csv
import json
import shutil
import time
import tomllib

import pytest
from conftest import ALL_EPOCHS, RandomKills, abort_at, changed, metafmu

KILLS = 20
# where a search is killed one time after the other; a trial that ends has its record, then loses its checkpoint
MOMENTS = [
    "complete trial-0000.safetensors",
    "replaced trial-0002.safetensors",
    "complete trial-0004.json",
    "replaced trial-0006.json",
    "removed trial-{}.safetensors",
    "complete search.csv",
    "replaced search.csv",
    "complete study-best.toml",
    "replaced study-best.toml",
    # a trial that was stopped keeps it to the end of the search
    "removed trial-0000.safetensors",
]
SEARCH = """
[search]
method = "halving"
trials = 9
rungs = 2
[search.space]
"training.learning_rate" = { min = 1e-4, max = 1e-1, scale = "log" }
"training.optimizer" = ["adam", "soap"]
"network.hidden" = [[8], [16, 16]]
"sampling.runs" = { min = 60, max = 90 }
"""


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    text = changed(
        "single-pendulum.toml",
        ('name = "single-pendulum"', 'name = "study"'),
        ("test_runs = 200", "test_runs = 2"),
        ("step = 0.01", "step = 0.05"),
        ("batch = 1024", "batch = 64"),
        ("epochs = 150", "epochs = 30"),
        *ALL_EPOCHS,
    )
    path = tmp_path_factory.mktemp("search") / "study.toml"
    path.write_text(text + SEARCH)
    return path


def results(folder):
    """The table but for wall times, and the best study."""
    with open(folder / "search.csv") as file:
        rows = [{key: value for key, value in row.items() if key != "seconds"} for row in csv.DictReader(file)]
    return rows, (folder / "study-best.toml").read_bytes()


@pytest.fixture(scope="module")
def undisturbed(study):
    """Its folder, and how long it took."""
    folder = study.parent / "undisturbed"
    begin = time.monotonic()
    metafmu("search", study, "--out", folder)
    return folder, time.monotonic() - begin


def test_the_best_trial_is_the_best_of_the_table_and_a_study(study, undisturbed):
    rows, text = results(undisturbed[0])
    assert len(rows) == 9
    stopped = [float(row["one_minus_r2"]) for row in rows if row["status"] == "stopped"]
    finished = [row for row in rows if row["status"] == "finished"]
    assert len(finished) == 3 and len(stopped) == 6
    assert all(int(row["epochs"]) == (30 if row in finished else 10) for row in rows)
    best = min(finished, key=lambda row: float(row["one_minus_r2"]))
    found = tomllib.loads(text.decode())
    assert "search" not in found
    assert str(found["sampling"]["runs"]) == best["sampling.runs"]
    assert found["training"]["learning_rate"] == float(best["training.learning_rate"])
    assert found["training"]["optimizer"] == best["training.optimizer"]
    metafmu("build", undisturbed[0] / "study-best.toml", "--out", study.parent / "best")


def test_a_trial_is_the_training_of_its_study(study, undisturbed):
    """Trial and training find the same best epoch, whatever the number of threads."""
    rows, _ = results(undisturbed[0])
    best = min((row for row in rows if row["status"] == "finished"), key=lambda row: float(row["one_minus_r2"]))
    folder = study.parent / "alone"
    metafmu("sample", undisturbed[0] / "study-best.toml", "--out", folder)
    result = metafmu("train", undisturbed[0] / "study-best.toml", "--out", folder)
    assert f"epoch {best['best_epoch']} is the best" in result.stderr


def test_a_search_that_is_killed_goes_on_and_ends_the_same(study, undisturbed, tmp_path):
    rows, _ = results(undisturbed[0])
    finished = next(row["trial"] for row in rows if row["status"] == "finished")
    for moment in MOMENTS:
        abort_at(moment.format(f"{int(finished):04}"), "search", study, "--out", tmp_path, "--resume")
    metafmu("search", study, "--out", tmp_path, "--resume")
    assert results(tmp_path) == results(undisturbed[0])


@pytest.mark.thorough
def test_a_search_that_is_killed_at_random_goes_on_and_ends_the_same(study, undisturbed):
    expected_folder, seconds = undisturbed
    kill, killed = RandomKills(seconds), 0
    for number in range(KILLS):
        folder = study.parent / f"killed-{number}"
        for arguments in ([], ["--resume"]):
            killed += kill("search", study, "--out", folder, *arguments)
        metafmu("search", study, "--out", folder, "--resume")
        assert results(folder) == results(expected_folder), number
    assert killed >= KILLS / 2


def test_a_baselines_options_are_searched(study):
    text = study.read_text()
    space = """[search]
method = "grid"
model = "polynomial"
[search.space]
"baselines.polynomial.degree" = [1, 4]
"""
    path = study.with_stem("polynomial")
    path.write_text(text[: text.index("[search]")] + space)
    folder = study.parent / "polynomial"
    metafmu("search", path, "--out", folder)
    first, second = results(folder)[0]
    assert [row["status"] for row in (first, second)] == ["finished", "finished"]
    assert float(second["one_minus_r2"]) < float(first["one_minus_r2"])
    best = folder / "study-best.toml"
    assert tomllib.loads(best.read_text())["baselines"]["polynomial"]["degree"] == 4
    metafmu("sample", best, "--out", folder)
    path.write_text(path.read_text().replace('model = "polynomial"', ""))
    refused = metafmu("search", path, check=False)
    assert refused.returncode == 2 and "expected `search.model`" in refused.stderr, refused.stderr


def test_what_cannot_be_searched_is_said_with_its_line(study):
    text = study.read_text()
    path = study.with_stem("wrong")
    path.write_text(text.replace("trials = 9", "trials = 1"))
    result = metafmu("search", path, check=False)
    assert result.returncode == 2 and "search.trials: 1, expected at least 2" in result.stderr
    path.write_text(text[: text.index("[search]")])
    result = metafmu("search", path, check=False)
    assert result.returncode == 2 and "search: missing" in result.stderr
    path.write_text(text.replace('"soap"]', '"soap", "adamm"]'))
    result = metafmu("sample", path, "--out", study.parent / "wrong", check=False)
    assert result.returncode == 2 and not (study.parent / "wrong").exists(), "before the first run"
    assert 'search.space.training.optimizer: "adamm", expected one of ' in result.stderr
    path.write_text(text.replace("[[8], [16, 16]]", "[[8], [0]]"))
    result = metafmu("sample", path, "--out", study.parent / "wrong", check=False)
    assert result.returncode == 2 and not (study.parent / "wrong").exists(), "before the first run"
    assert "search.space.network.hidden: [0]: network.hidden: hidden layer 1 has 0 nodes" in result.stderr


def test_values_that_do_not_go_together_are_trials_that_fail(study):
    text = study.read_text()
    space = """[search]
method = "grid"
[search.space]
"training.optimizer" = ["adam", "adamw"]
"training.weight_decay" = [0.0, 0.01]
"training.epochs" = [2]
"sampling.runs" = [60]
"""
    path = study.with_stem("together")
    path.write_text(text[: text.index("[search]")] + space)
    result = metafmu("search", path, "--out", study.parent / "together", check=False)
    assert result.returncode == 1, result.stderr
    assert "1 of 4 trials have values that are not valid together and fail, the first: " in result.stderr.splitlines()[0]
    with open(study.parent / "together" / "search.csv") as file:
        rows = list(csv.DictReader(file))
    assert [row["status"] for row in rows] == ["finished", "failed", "finished", "finished"]
    assert "weight_decay: belongs to the optimizers" in rows[1]["message"]


def test_a_score_that_was_changed_decides_nothing(study, undisturbed, tmp_path):
    folder = shutil.copytree(undisturbed[0], tmp_path / "out")
    for path in (folder / "search").glob("trial-*.json"):
        record = json.loads(path.read_text())
        if record["status"] == "finished" and record["score"] > min_score(folder):
            record["score"] = 1e-12
            path.write_text(json.dumps(record, indent=2))
            break
    metafmu("search", study, "--out", folder, "--resume")
    assert results(folder) == results(undisturbed[0])


def min_score(folder):
    return min(float(row["one_minus_r2"]) for row in results(folder)[0] if row["status"] == "finished")
