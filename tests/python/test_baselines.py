"""Baselines beside the network, and FMUs of them."""

import csv
import json
import shutil
import signal
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from conftest import CASES, METAFMU, OUTPUTS, PARAMETERS, ROOT, fmu_of, metafmu
from fmpy import read_model_description, simulate_fmu
from fmpy.validation import validate_fmu
from sklearn.ensemble import HistGradientBoostingRegressor

sys.path.insert(0, str(ROOT / "scripts" / "measure"))
from model_file import evaluate, load

STUDY = "examples/single-pendulum.toml"


@pytest.fixture(scope="module")
def folder(pendulum, tmp_path_factory):
    """A copy of the build, so that other tests do not see what is written here."""
    copy = tmp_path_factory.mktemp("baselines") / "single-pendulum"
    shutil.copytree(pendulum.folder, copy)
    return copy


@pytest.fixture(scope="module")
def comparison(folder):
    models = ["linear", "ridge", "lasso", "elastic-net", "polynomial", "decision-tree", "gaussian-process"]
    metafmu("compare", STUDY, "--out", folder, *[word for model in models for word in ("--model", model)])
    return json.loads((folder / "comparison.json").read_text())


def r2(comparison, model):
    row = next(row for row in comparison["models"] if row["model"] == model)
    assert row["status"] == "fine", row
    return np.array([row["outputs"][name]["r2"] for name in OUTPUTS])


def test_the_network_is_first_and_baselines_are_as_good_as_those_of_scikit_learn(comparison):
    assert comparison["models"][0]["model"] == "network"
    assert r2(comparison, "network").min() > 0.9999
    # scikit-learn 1.x on the same problem: linear .033 .060 .007, degree-6 polynomial .59 in the mean, tree .990 .986
    # .985, Gaussian process on 600 rows .992 .982 .977
    for model in ["linear", "ridge", "lasso", "elastic-net"]:
        np.testing.assert_allclose(r2(comparison, model), [0.033, 0.060, 0.007], atol=0.02)
    assert 0.5 < r2(comparison, "polynomial").mean() < 0.7
    assert 0.97 < r2(comparison, "decision-tree").min() < 0.995
    assert 0.95 < r2(comparison, "gaussian-process").min() < 0.9999


def test_the_table_is_csv_with_a_line_for_each_output(folder, comparison):
    with open(folder / "comparison.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == sum(len(row["outputs"]) for row in comparison["models"])
    for row in rows:
        model = next(model for model in comparison["models"] if model["model"] == row["model"])
        assert float(row["mse"]) == model["outputs"][row["output"]]["mse"]
    assert all(row["note"].startswith("on ") for row in rows if row["model"] == "gaussian-process")


def test_one_that_is_too_slow_and_one_that_fails_are_rows_and_the_others_go_on(folder, tmp_path):
    text = (ROOT / STUDY).read_text()
    options = "\n[baselines]\ntime_budget = 2\ngaussian-process = { rows = 20000, kernel_rows = 20000 }\n"
    study = tmp_path / "study.toml"
    study.write_text(text + options + "polynomial = { degree = 5, rows = 20, alpha = 0.0 }\n")
    models = ["gaussian-process", "polynomial", "linear"]
    output = metafmu("compare", study, "--out", folder, "--json", *[f"--model={model}" for model in models])
    rows = {row["model"]: row for row in json.loads(output.stdout)["models"]}
    assert rows["gaussian-process"]["status"] == "too slow"
    assert rows["gaussian-process"]["note"].startswith("not done after 2 s with 20000 of ")
    assert rows["polynomial"]["status"] == "failed"
    assert "the terms depend on each other in these rows" in rows["polynomial"]["note"]
    assert rows["linear"]["status"] == "fine"


@pytest.fixture
def few_rows(tmp_path):
    """The study with baselines that are fitted to few rows: their formulas are the same."""
    options = "random-forest = { rows = 5000 }\nsvr = { rows = 500 }\ngradient-boosting = { rows = 2000 }\nknn = { rows = 2000 }\n"
    study = tmp_path / "study.toml"
    study.write_text(f"{(ROOT / STUDY).read_text()}\n[baselines]\n{options}")
    return study


# with the kind of a step that it must have: affine, distances, forest
@pytest.mark.parametrize("model, kind", [("ridge", 0), ("svr", 6), ("random-forest", 7), ("gradient-boosting", 7)])
def test_an_exported_baseline_is_its_formula_in_every_host(folder, few_rows, model, kind):
    metafmu("export", few_rows, "--out", folder, "--model", model, "--fmi", "both")
    _, tensors = load(folder / f"single-pendulum-{model}.safetensors")
    assert kind in tensors["graph.steps"][:, 0]
    for version in (2, 3):
        fmu = fmu_of(folder, f"single-pendulum-{model}", version)
        assert validate_fmu(str(fmu)) == []
        metafmu("validate", fmu)
        assert model in read_model_description(str(fmu)).description
        for case in CASES[:2]:
            start = dict(zip(PARAMETERS, case))
            result = simulate_fmu(fmu, start_values=start, stop_time=2.0, output_interval=0.1, output=OUTPUTS)
            inputs = np.array([[*case, time] for time in result["time"]])
            expected = evaluate(tensors, inputs)
            found = np.stack([result[name] for name in OUTPUTS], axis=1)
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * expected.std(axis=0).max())


def test_what_cannot_be_exported_says_why(folder, few_rows):
    result = metafmu("export", few_rows, "--out", folder, "--model", "knn", check=False)
    assert result.returncode == 2
    assert "carry every training row" in result.stderr


def test_gradient_boosting_is_as_good_as_that_of_scikit_learn(tmp_path):
    """Both are fitted to the same rows, but for those of one run; R² on the same test rows, of a function with a jump."""
    random = np.random.default_rng(6)
    p, q = random.uniform(-1, 1, (2, 1200))
    runs = pd.DataFrame({"run": np.arange(1200), "time": 0.0, "p": p, "q": q, "y": np.sin(4 * p) * q + (q > 0.3)})
    both = pd.concat([runs, runs.assign(time=1.0, y=runs.y + runs.p)]).sort_values(["run", "time"], kind="stable")
    both.to_csv(tmp_path / "runs.csv", index=False)
    (tmp_path / "study.toml").write_text(
        'name = "s"\nsource = { table = "runs.csv" }\ntime = { stop = 1, step = 1 }\nparameters = { p = { min = -1, max = 1 }, q = { min = -1, max = 1 } }\n'
        "outputs.y = {}\nsampling.test_runs = 200\ntraining.validation = 0.001\n"
    )
    metafmu("sample", "study.toml", "--out", "out", cwd=tmp_path)
    metafmu("compare", "study.toml", "--out", "out", "--model", "gradient-boosting", cwd=tmp_path)
    _, row = json.loads((tmp_path / "out" / "comparison.json").read_text())["models"]
    train, test = (pd.read_csv(tmp_path / "out" / f"{name}.csv") for name in ("train", "test"))
    columns = ["p", "q", "time"]
    theirs = HistGradientBoostingRegressor(learning_rate=0.3, max_iter=100, early_stopping=False).fit(train[columns], train["y"])
    assert row["rows"] == len(train) - 2 and row["exportable"]
    assert row["outputs"]["y"]["r2"] > theirs.score(test[columns], test["y"]) - 0.002 > 0.98


def test_an_interrupt_while_baselines_are_fitted_is_told_by_the_exit_code(tmp_path):
    study = tmp_path / "study.toml"
    study.write_text(
        'name = "study"\n[source]\nsystem = "single-pendulum"\n[time]\nstop = 2\nstep = 0.01\n'
        '[parameters]\nL = { min = 0.1, max = 0.2, unit = "m" }\n[outputs]\ntheta = {}\n'
        '[sampling]\nmethod = "sobol"\nruns = 60\ntest_runs = 5\n[network]\nhidden = [16]\n'
        '[training]\nschedule = "cosine"\nepochs = 20\n'
        '[baselines]\nbuild = ["linear", "gaussian-process"]\ngaussian-process = { rows = 10000 }\ntime_budget = 600\n'
    )
    command = [METAFMU, "build", study, "--out", tmp_path / "out"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while not (line := process.stderr.readline()).startswith("linear:"):
        assert line, "the build ended before the baselines"
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    # the verdict and the report are there, and the last lines say what is missing
    assert "report.html" in out and ("good" in out or "usable" in out or "rejected" in out)
    assert (tmp_path / "out" / "report.html").exists()
    ending = "stopped by Ctrl-C while models were compared\ndone: all files\nmissing: models of the comparison (gaussian-process)\ncontinue with: metafmu build "
    assert ending in err and err.endswith(" --resume\n"), err
    rows = json.loads((tmp_path / "out" / "comparison.json").read_text())["models"]
    assert [(row["model"], row["status"], row["note"]) for row in rows][1:] == [
        ("linear", "fine", ""),
        ("gaussian-process", "stopped", "by Ctrl-C"),
    ]
    # what was made before is complete
    assert validate_fmu(str(tmp_path / "out" / "study.fmu")) == []
