"""The single pendulum's FMU in fmpy, against metafmu's own host and against scipy."""

import sys

import numpy as np
import pandas as pd
import pytest
from conftest import CASES, OUTPUTS, PARAMETERS, ROOT, metafmu, reference, simulate_with_fmpy
from fmpy import read_model_description, simulate_fmu
from fmpy.validation import validate_fmu

sys.path.insert(0, str(ROOT / "scripts" / "measure"))
from model_file import evaluate, load


def test_fmpy_finds_no_problem(pendulum):
    assert validate_fmu(pendulum.fmu) == []


def test_the_fmu_is_small(pendulum):
    assert pendulum.fmu.stat().st_size < 2**20


def test_accuracy_is_what_the_example_promises(pendulum):
    for output in OUTPUTS:
        assert pendulum.metrics["outputs"][output]["r2"] >= 1 - 5e-6
    assert pendulum.metrics["test_runs"] == 200


def test_error_bounds_hold_for_the_stated_share_of_the_test_runs_points(pendulum):
    table = pd.read_csv(pendulum.folder / "test.csv")
    within = {output: [] for output in OUTPUTS}
    for _, run in table.groupby("run"):
        names = [name for output in OUTPUTS for name in (output, f"{output}_bound")]
        start_values = dict(run[PARAMETERS].iloc[0])
        result = simulate_fmu(pendulum.fmus[2], start_values=start_values, output=names)
        for output in OUTPUTS:
            within[output].append(np.abs(result[output] - run[output]) <= result[f"{output}_bound"])
    for output in OUTPUTS:
        share = np.mean(np.concatenate(within[output]))
        assert 0.93 <= share <= 0.97
        assert share == pytest.approx(pendulum.metrics["outputs"][output]["within_bound"], abs=1e-9)


@pytest.mark.parametrize("case", CASES)
def test_fmpy_and_metafmu_simulate_agree(pendulum, case, tmp_path):
    result = simulate_with_fmpy(pendulum, *case)
    starts = [f"{name}={value}" for name, value in zip(["L", "c", "thetad0"], case)]
    options = [option for start in starts for option in ("--start", start)]
    metafmu("simulate", pendulum.fmu, *options, "--output", tmp_path / "run.csv")
    table = pd.read_csv(tmp_path / "run.csv")
    assert len(table) == len(result["time"]) == 201
    np.testing.assert_allclose(table["time"], result["time"], rtol=0, atol=1e-12)
    for output in OUTPUTS:
        np.testing.assert_allclose(table[output], result[output], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("case", CASES)
def test_the_fmu_is_as_close_to_scipy_as_metrics_json_says(pendulum, case):
    result = simulate_with_fmpy(pendulum, *case)
    for output, exact in zip(OUTPUTS, reference(*case, result["time"])):
        largest = np.max(np.abs(result[output] - exact))
        assert largest <= pendulum.metrics["outputs"][output]["max_abs_error"]


def test_outputs_are_right_at_t0(pendulum):
    for case in CASES:
        first = simulate_with_fmpy(pendulum, *case, stop_time=0.01)[0]
        for output, exact in zip(OUTPUTS, reference(*case, [0.0, 0.01])):
            assert abs(first[output] - exact[0]) <= pendulum.metrics["outputs"][output]["max_abs_error"]


def test_metrics_are_those_of_the_test_table(pendulum):
    """R², MSE and largest error computed again from test.csv and the FMU's own outputs."""
    table = pd.read_csv(pendulum.folder / "test.csv")
    predictions = {output: [] for output in OUTPUTS}
    for _, run in table.groupby("run"):
        result = simulate_with_fmpy(pendulum, *run[["L", "c", "thetad0"]].iloc[0])
        for output in OUTPUTS:
            predictions[output].append(result[output])
    for output in OUTPUTS:
        error = np.concatenate(predictions[output]) - table[output]
        metrics = pendulum.metrics["outputs"][output]
        assert metrics["mse"] == pytest.approx(np.mean(error**2), rel=1e-9)
        assert metrics["max_abs_error"] == pytest.approx(np.max(np.abs(error)), rel=1e-9)
        assert metrics["r2"] == pytest.approx(1 - np.mean(error**2) / np.var(table[output]), abs=1e-12)


def test_pandas_opens_the_tables_and_the_data_is_the_pendulum(pendulum):
    train, test = (pd.read_csv(pendulum.folder / name) for name in ("train.csv", "test.csv"))
    assert list(train) == ["run", "time", "L", "c", "thetad0", *OUTPUTS]
    # training runs end at 2.1 s
    assert len(train) == 1331 * 211 and len(test) == 200 * 201
    parameters = ["L", "c", "thetad0"]
    assert not set(map(tuple, train[parameters].to_numpy())) & set(map(tuple, test[parameters].to_numpy()))
    for table in (train, test):
        for number in (0, table["run"].max() // 2, table["run"].max()):
            run = table[table["run"] == number]
            exact = reference(*run[parameters].iloc[0], run["time"].to_numpy())
            for output, values in zip(OUTPUTS, exact):
                np.testing.assert_allclose(run[output], values, rtol=0, atol=2e-8)
    history = pd.read_csv(pendulum.folder / "history.csv")
    assert history["validation_loss"].idxmin() + 1 == pendulum.metrics["best_epoch"]


def test_numpy_reads_the_model_file_and_computes_the_same_outputs(pendulum):
    metadata, tensors = load(pendulum.folder / "single-pendulum.safetensors")
    assert [variable["name"] for variable in metadata["inputs"]] == ["L", "c", "thetad0", "time"]
    case = CASES[0]
    result = simulate_with_fmpy(pendulum, *case)
    outputs = evaluate(tensors, np.column_stack([np.tile(case, (201, 1)), result["time"]]))
    for column, output in enumerate(OUTPUTS):
        np.testing.assert_allclose(result[output], outputs[:, column], rtol=1e-11, atol=1e-11)


def test_the_description_carries_units_ranges_and_starts(pendulum):
    description = read_model_description(pendulum.fmu)
    variables = {variable.name: variable for variable in description.modelVariables}
    length = variables["L"]
    assert (length.causality, length.variability, length.unit) == ("parameter", "fixed", "m")
    assert [float(value) for value in (length.min, length.start, length.max)] == pytest.approx([0.1, 0.15, 0.2])
    assert [variables[output].unit for output in OUTPUTS] == ["rad", "rad/s", "rad/s2"]
    assert (float(description.defaultExperiment.stopTime), float(description.defaultExperiment.stepSize)) == (2.0, 0.01)
