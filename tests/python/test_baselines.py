"""Baselines beside the network."""

import csv
import json
import shutil

import numpy as np
import pytest
from conftest import OUTPUTS, metafmu

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
    text = open(STUDY).read()
    options = "\n[baselines]\ntime_budget = 2\ngaussian-process = { rows = 20000, kernel_rows = 20000 }\n"
    study = tmp_path / "study.toml"
    study.write_text(text + options + "polynomial = { degree = 20, rows = 100, alpha = 0.0 }\n")
    models = ["gaussian-process", "polynomial", "linear"]
    output = metafmu("compare", study, "--out", folder, "--json", *[f"--model={model}" for model in models])
    rows = {row["model"]: row for row in json.loads(output.stdout)["models"]}
    assert rows["gaussian-process"]["status"] == "too slow"
    assert rows["gaussian-process"]["note"].startswith("not done after 2 s with 20000 of ")
    assert rows["polynomial"]["status"] == "failed"
    assert rows["linear"]["status"] == "fine"
