"""Nominal and periodic parameters: `values` and `periodic` in the study."""

import json
import re
import shutil
import sys
from zipfile import ZipFile

import numpy as np
import pandas as pd
import pytest
from conftest import ALL_EPOCHS, ANY, ROOT, changed, compiled_from_sources, fmu_of, metafmu
from fmpy import read_model_description, simulate_fmu
from fmpy.validation import validate_fmu

sys.path.insert(0, str(ROOT / "scripts" / "measure"))
from model_file import evaluate, load

OUTPUTS = ["thetad", "thetadd"]
MASSES = [0.3, 0.1, 1.0]


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    text = changed(
        "single-pendulum.toml",
        ('name = "single-pendulum"', 'name = "study"'),
        ("constants = { m = 0.3, g = 9.81, theta0 = 1.5707963267948966 }", "constants = { g = 9.81 }"),
        (
            "[outputs]\ntheta = {",
            "m = { values = [0.3, 0.1, 1.0] }\n"
            "theta0 = { min = -3.141592653589793, max = 3.141592653589793, periodic = true }\n[outputs]\n# {",
        ),
        ("runs = 1331", "runs = 200"),
        ("test_runs = 200", "test_runs = 30"),
        ("stop = 2.0", "stop = 0.5"),
        ("step = 0.01", "step = 0.05"),
        ("runs = 1000", "runs = 30"),
        ("hidden = [64, 64, 64, 64, 64, 64]", "hidden = [32, 32]"),
        ("batch = 1024", "batch = 64"),
        ("epochs = 150", "epochs = 60"),
        *ALL_EPOCHS,
        ('fmi = "2"', 'fmi = "both"'),
    )
    path = tmp_path_factory.mktemp("encodings") / "study.toml"
    path.write_text(text + ANY)
    return path


@pytest.fixture(scope="module", params=["full", "fixed"])
def built(study, request):
    """Its folder; `build` ends with 0 only if validation finds no problem."""
    path = study.with_stem(request.param)
    text = study.read_text().replace("[network]", f'[network]\nstructure = "{request.param}"')
    if request.param == "fixed":
        text = re.sub(r"(?m)^margin = .*\n", "", text)
    path.write_text(text)
    folder = study.parent / request.param
    metafmu("build", path, "--out", folder)
    return folder


def predicted(folder, mass, others, times):
    """Outputs computed by numpy from the model file; others are L, c, thetad0, theta0."""
    metadata, tensors = load(folder / "study.safetensors")
    length, damping, thetad0, theta0 = others
    assert [column["name"] for column in metadata["inputs"]] == ["L", "c", "thetad0", "m", "theta0", "time"]
    angle = theta0 + np.pi
    row = [length, damping, thetad0, *(mass == np.array(MASSES)), np.sin(angle), np.cos(angle)]
    return evaluate(tensors, np.array([[*row, time] for time in times]))


def test_only_listed_values_are_sampled(built):
    for name in ("train", "test", "calibration"):
        table = pd.read_csv(built / f"{name}.csv")
        assert set(table["m"]) == set(MASSES), name
        assert table["theta0"].between(-np.pi, np.pi).all()
    counts = pd.read_csv(built / "train.csv").groupby("run")["m"].first().value_counts()
    assert counts.sum() == 200 and counts.min() > 55, counts


@pytest.mark.parametrize("version", [2, 3])
def test_fmpy_computes_what_numpy_reads_from_the_file(built, version):
    fmu = fmu_of(built, "study", version)
    assert validate_fmu(str(fmu)) == []
    others = (0.1583, 0.055, 2.0, 0.4)
    for mass in MASSES:
        for turns in (0, 1, -2):
            start_values = dict(zip(["L", "c", "thetad0", "theta0"], others), m=mass)
            start_values["theta0"] += 2 * np.pi * turns
            result = simulate_fmu(
                str(fmu), start_values=start_values, output=[*OUTPUTS, "in_domain"], stop_time=0.5, output_interval=0.02
            )
            assert result["in_domain"].all()
            expected = predicted(built, mass, others, result["time"])
            for column, output in enumerate(OUTPUTS):
                np.testing.assert_allclose(result[output], expected[:, column], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("version", [2, 3])
def test_the_description_tells_the_values_and_no_limits_of_what_is_periodic(built, version):
    description = read_model_description(str(fmu_of(built, "study", version)))
    variables = {variable.name: variable for variable in description.modelVariables}
    mass, angle = variables["m"], variables["theta0"]
    assert (float(mass.min), float(mass.max), float(mass.start)) == (0.1, 1.0, 0.3)
    assert mass.description.endswith("(one of 0.3, 0.1, 1)"), mass.description
    assert (angle.min, angle.max) == (None, None) and "any number" in angle.description
    with ZipFile(fmu_of(built, "study", version)) as archive:
        card = archive.read("documentation/index.html").decode()
    assert "only 0.3, 0.1, 1, starts at 0.3" in card and "periodic, " in card


def test_it_learns_from_both(built):
    # 180 rows for each of the networks of "fixed"
    least = {"full": 0.98, "fixed": 0.8}[built.name]
    metrics = json.loads((built / "metrics.json").read_text())["outputs"]
    assert all(metrics[output]["r2"] > least for output in OUTPUTS), metrics


def test_a_baseline_takes_the_same_columns_in_the_fmu_as_when_it_was_measured(study):
    path, folder = study.with_stem("polynomial"), study.parent / "polynomial"
    path.write_text(study.read_text().replace('fmi = "both"', 'fmi = "2"').replace("epochs = 60", "epochs = 1"))
    for verb in ("sample", "train", "compare", "export"):
        model = ("--model", "polynomial") if verb in ("compare", "export") else ()
        metafmu(verb, path, "--out", folder, *model)
    measured = json.loads((folder / "comparison.json").read_text())["models"][1]
    table = pd.read_csv(folder / "test.csv")
    squares = []
    for _, run in table.groupby("run"):
        start_values = {name: run[name].iloc[0] for name in ("L", "c", "thetad0", "m", "theta0")}
        result = simulate_fmu(
            str(folder / "study-polynomial.fmu"), start_values=start_values, output=OUTPUTS, stop_time=0.5, output_interval=0.05
        )
        squares += [[(result[output] - run[output].to_numpy()) ** 2 for output in OUTPUTS]]
    for output, found in zip(OUTPUTS, np.mean(squares, axis=(0, 2))):
        assert found == pytest.approx(measured["outputs"][output]["mse"], rel=1e-9)


@pytest.mark.parametrize("version", [2, 3])
def test_the_sources_compute_what_the_library_does(built, tmp_path, monkeypatch, version):
    folder = shutil.copytree(built, tmp_path / "out")
    metafmu("export", built.with_suffix(".toml"), "--out", folder, "--sources", "--fmi", version)
    packed = fmu_of(folder, "study", version)
    unpacked = compiled_from_sources(packed, monkeypatch)
    for mass, angle in [(0.1, 0.4), (0.6, 9.0)]:
        found, expected = (
            simulate_fmu(str(fmu), start_values={"m": mass, "theta0": angle}, stop_time=0.5, output_interval=0.02)
            for fmu in (unpacked, packed)
        )
        for name in expected.dtype.names:
            np.testing.assert_allclose(found[name].astype(float), expected[name].astype(float), rtol=1e-12, atol=1e-12)


def test_recorded_runs_must_have_listed_values(tmp_path):
    rows = "".join(f"{run},{time},{value},{run}\n" for run, value in enumerate((12, 17, 24, 12.5)) for time in (0, 1))
    (tmp_path / "runs.csv").write_text("run,time,teeth,y\n" + rows)
    (tmp_path / "s.toml").write_text(
        'name = "s"\nsource = { table = "runs.csv" }\ntime = { stop = 1, step = 1 }\n'
        "[parameters]\nteeth = { values = [12, 17, 24] }\n[outputs]\ny = {}\n[sampling]\ntest_runs = 1\n"
    )
    refused = metafmu("sample", tmp_path / "s.toml", "--dry-run", check=False)
    says = "runs.csv:8: column `teeth`: 12.5, expected one of 12, 17, 24, the study's values"
    assert refused.returncode == 2 and says in refused.stderr, refused.stderr
