"""Tables without a time become static maps, and what `new` writes of any table is what `build` accepts, or the refusal says what to do."""

import csv
import json
import re
import subprocess
import sys

import fmpy
import numpy as np
import pytest
from conftest import ANY, METAFMU, ROOT, metafmu
from fmpy import simulate_fmu

sys.path.insert(0, str(ROOT / "scripts" / "measure"))
from model_file import load

RANGES = {
    "rw": (0.05, 0.15), "r": (100, 50000), "Tu": (63070, 115600), "Hu": (990, 1110),
    "Tl": (63.1, 116), "Hl": (700, 820), "L": (1120, 1680), "Kw": (9855, 12045),
}


def borehole(rw, r, Tu, Hu, Tl, Hl, L, Kw):
    """Flow through a borehole (Morris, Mitchell and Ylvisaker 1993)."""
    log = np.log(r / rw)
    return 2 * np.pi * Tu * (Hu - Hl) / (log * (1 + 2 * L * Tu / (log * rw**2 * Kw) + Tu / Tl))


def points(rows, seed=0):
    """A Latin hypercube in the ranges of the borehole function."""
    random = np.random.default_rng(seed)
    shares = np.array([random.permutation(rows) + random.uniform(size=rows) for _ in RANGES]).T / rows
    low, high = np.array(list(RANGES.values())).T
    return low + shares * (high - low)


def write(path, columns, separator=",", decimal="."):
    """A table of columns by name."""
    text = lambda value: value if isinstance(value, str) else f"{value:.12g}".replace(".", decimal)
    lines = [separator.join(map(text, row)) for row in zip(*columns.values())]
    path.write_text("\n".join([separator.join(columns), *lines]) + "\n")


def of_borehole(rows=200, seed=0):
    x = points(rows, seed)
    return {**dict(zip(RANGES, x.T)), "flow": borehole(*x.T)}


def new(folder, *arguments, check=True):
    return metafmu("new", "s", "--table", "t.csv", *arguments, cwd=folder, check=check)


def built(folder, *arguments, check=True):
    result = metafmu("build", "s.toml", *arguments, cwd=folder, check=check)
    return result, folder / "out" / "s"


def notes(folder, columns, *arguments, **how):
    """Messages of `new` about a table, and the study."""
    write(folder / "t.csv", columns, **how)
    (folder / "s.toml").unlink(missing_ok=True)
    result = new(folder, *arguments)
    return result.stderr, (folder / "s.toml").read_text()


def small(rows=24):
    """A table of a smooth function of two columns that is fitted in a moment."""
    random = np.random.default_rng(3)
    a, b = random.uniform(-1, 1, rows), random.uniform(0, 2, rows)
    return {"a": a, "b": b, "y": np.sin(a) * b}


def table_range(rows):
    """The ends of the columns of the inputs in rows of a table."""
    x = np.array([[float(row[name]) for name in RANGES] for row in rows])
    return x.min(0), x.max(0)


def fmpy_outputs(fmu, start, name):
    """Outputs of an FMU that is stepped once with these inputs."""
    result = simulate_fmu(str(fmu), fmi_type="CoSimulation", stop_time=0.1, output_interval=0.1, start_values=start, output=[name, "in_domain"])
    return result[name][-1], bool(result["in_domain"][-1])


def test_two_hundred_points_of_the_borehole_function_make_an_fmu_within_the_measured_bound(tmp_path):
    write(tmp_path / "t.csv", of_borehole())
    new(tmp_path)
    study = (tmp_path / "s.toml").read_text().replace('fmi = "2"', 'fmi = "both"').replace("# [bounds]", "[bounds]").replace("# coverage = 0.95", "coverage = 0.95")
    (tmp_path / "s.toml").write_text(study)
    result, folder = built(tmp_path)
    table = result.stdout
    assert re.search(r"^network +0\.9", table, re.M) and re.search(r"^polynomial +0\.9", table, re.M), table
    assert re.search(r"^(gaussian-process|network) +0\.999.*exported$", table, re.M) and "fitted without it" in table, table
    metrics = json.loads((folder / "metrics.json").read_text())
    flow = metrics["outputs"]["flow"]
    assert metrics["rows"] == "cross-validated" and metrics["test_rows"] == 200 and flow["r2"] > 0.9999
    assert metrics["verdict"]["accepted"] and "within_bound" not in flow
    # what was measured is in unseen.csv
    with open(folder / "unseen.csv") as file:
        rows = list(csv.DictReader(file))
    errors = np.array([float(row["predicted flow"]) - float(row["flow"]) for row in rows])
    assert [int(row["row"]) for row in rows] == list(range(2, 202)) and np.mean(errors**2) == pytest.approx(flow["mse"], rel=1e-9)
    assert np.mean(np.abs(errors) <= flow["bound"]) >= 0.95
    # the FMU is the function, as often as the bound says
    x = np.clip(points(60, seed=1), *table_range(rows))
    truth = borehole(*x.T)
    for name in ("s.fmu", "s-fmi3.fmu"):
        found = [fmpy_outputs(folder / name, dict(zip(RANGES, row)), "flow") for row in x[:20 if name == "s-fmi3.fmu" else 60]]
        assert all(inside for _, inside in found)
        off = np.abs(np.array([value for value, _ in found]) - truth[: len(found)])
        assert np.mean(off <= flow["bound"]) >= 0.9 and off.max() < 20 * flow["bound"], off
    # far from the rows it says so
    description = fmpy.read_model_description(str(folder / "s.fmu"))
    variables = {variable.name: variable for variable in description.modelVariables}
    assert all(variables[name].causality == "input" for name in RANGES) and variables["flow"].causality == "output"
    assert "constant in each training run" not in " ".join(variable.description or "" for variable in variables.values())
    assert (variables["flow_bound"].causality, variables["flow_bound"].variability) == ("local", "fixed")
    assert fmpy_outputs(folder / "s.fmu", {}, "flow_bound")[0] == pytest.approx(flow["bound"])
    assert not fmpy_outputs(folder / "s.fmu", {**dict(zip(RANGES, x[0])), "rw": 0.5}, "flow")[1]
    assert not metafmu("validate", folder / "s-fmi3.fmu").stderr.count("problem:")
    report = (folder / "report.html").read_text()
    assert 'id="density-flow"' in report and 'id="error-rw-relative"' in report and "row 1" in report and "Kinds of model" in report
    assert "test run" not in report and "Time response" not in report and "over time" not in report.lower()
    card = fmpy.extract(str(folder / "s.fmu"))
    text = (tmp_path / card / "documentation" / "index.html").read_text()
    assert "cross-validation" in text and "conformal, from the errors of these 200 rows" in text and "at the start of a run" not in text


def test_the_verbs_do_their_part_or_say_which_does(tmp_path):
    notes(tmp_path, small())
    for verb, says in [
        (["sample", "s.toml"], "`metafmu train` reads the rows"), (["sample", "s.toml", "--dry-run"], "a static map has no runs"),
        (["sample", "s.toml", "--shard", "1/2"], "a static map has no runs"), (["compare", "s.toml"], "`static.model` names"),
        (["search", "s.toml"], "`metafmu search` needs it"), (["evaluate", "s.toml"], "run `metafmu train` first"),
        (["report", "s.toml"], "run `metafmu train` first"), (["export", "s.toml"], "run `metafmu train` first"),
    ]:
        result = metafmu(*verb, cwd=tmp_path, check=False)
        assert result.returncode == 2 and says in result.stderr and "panicked" not in result.stderr, (verb, result.stderr)
    assert not (tmp_path / "out").exists()
    trained = metafmu("train", "s.toml", cwd=tmp_path)
    assert trained.stdout.split("\n")[:2] == ["out/s/s.safetensors", "out/s/unseen.csv"], trained.stdout
    evaluated = metafmu("evaluate", "s.toml", "--json", cwd=tmp_path)
    metafmu("report", "s.toml", "--plots", "plots", cwd=tmp_path)
    metafmu("export", "s.toml", "--fmi", "both", "--sources", cwd=tmp_path)
    assert (tmp_path / "plots" / "density-y.svg").exists()
    predicted = metafmu("predict", "s.toml", "t.csv", cwd=tmp_path)
    found = [float(row["y"]) for row in csv.DictReader(predicted.stdout.splitlines())]
    assert np.allclose(found, small()["y"], atol=1e-3)
    for arguments, says in [(["export", "s.toml", "--model", "ridge"], "`static.model` names"), (["report", "s.toml", "--beside", "s.toml"], "without --beside")]:
        result = metafmu(*arguments, cwd=tmp_path, check=False)
        assert result.returncode == 2 and says in result.stderr, result.stderr
    # a build is the same, and a finished one is kept
    folder = tmp_path / "out" / "s"
    before = (folder / "s.safetensors").read_bytes()
    again, _ = built(tmp_path, "--resume")
    assert "is already finished" in again.stderr and "fitting" not in again.stderr
    result, _ = built(tmp_path)
    assert "fitting to 24 rows" in result.stderr and (folder / "s.safetensors").read_bytes() == before
    assert json.loads(evaluated.stdout)["outputs"] == json.loads((folder / "metrics.json").read_text())["outputs"]
    # rows that were changed are not those that were measured
    (folder / "unseen.csv").write_text((folder / "unseen.csv").read_text().replace("2,", "3,", 1))
    result = metafmu("evaluate", "s.toml", cwd=tmp_path, check=False)
    assert result.returncode == 2 and "was changed since it was written" in result.stderr
    # another table is another study
    write(tmp_path / "t.csv", small(30))
    result = metafmu("evaluate", "s.toml", cwd=tmp_path, check=False)
    assert result.returncode == 2 and "was trained from another study" in result.stderr
    result, _ = built(tmp_path, "--resume")
    assert "fitting to 30 rows" in result.stderr


@pytest.mark.parametrize("model", ["network", "polynomial", "gaussian-process", "random-forest", "linear"])
def test_the_study_names_the_kind_of_model(tmp_path, model):
    _, study = notes(tmp_path, {**small(40), "z": np.full(40, 2.0), "y2": small(40)["a"] * 3})
    (tmp_path / "s.toml").write_text(study.replace('# model = "network"', f'model = "{model}"') + ANY)
    result, folder = built(tmp_path, check=False)
    record = json.loads((folder / "training.json").read_text())
    assert result.returncode == 0 and record["static_map"]["exported"] == model, result.stderr
    assert [candidate["name"] for candidate in record["static_map"]["candidates"]] == [model]
    assert record["epochs"] == 0 and "history.csv" not in result.stdout
    if model == "network":
        # with options of the training there are epochs
        (tmp_path / "s.toml").write_text((tmp_path / "s.toml").read_text() + "[training]\nepochs = 20\n")
        result, folder = built(tmp_path, check=False)
        assert json.loads((folder / "training.json").read_text())["epochs"] == 20 and "history.csv" in result.stdout


def kriging(x, y, lengths, noise, at):
    """Predicted standard deviation of a further observation of a Gaussian process, relative to that of the process, by dense algebra."""
    kernel = lambda a, b: np.exp(-0.5 * (((a[:, None] - b[None]) / lengths) ** 2).sum(-1))
    factor = np.linalg.cholesky(kernel(x, x) + noise * np.eye(len(x)))
    whiten = lambda values: np.linalg.solve(factor, values)
    ones, k = whiten(np.ones(len(x))), whiten(kernel(x, at))
    return np.sqrt(1 + noise - (k**2).sum(0) + (1 - ones @ k) ** 2 / (ones @ ones))


def test_predicted_standard_deviations_are_outputs_of_the_fmu(tmp_path):
    random = np.random.default_rng(8)
    x = random.uniform([-1, 0], [1, 2], (120, 2))
    y = np.sin(3 * x[:, 0]) * x[:, 1] + random.normal(0, 0.1, 120)
    _, study = notes(tmp_path, {"a": x[:, 0], "b": x[:, 1], "y": y})
    study = study.replace('fmi = "2"', 'fmi = "both"').replace("# [bounds]", "[bounds]").replace("# coverage = 0.95", "coverage = 0.95")
    (tmp_path / "s.toml").write_text(study.replace("# std = true", "std = true"))
    result, folder = built(tmp_path, "--sources")
    assert "within two predicted standard deviations, % of these rows: 9" in result.stdout, result.stdout
    metrics = json.loads((folder / "metrics.json").read_text())
    assert list(metrics["outputs"]) == ["y"] and metrics["static_map"]["exported"] == "gaussian-process"
    with open(folder / "unseen.csv") as file:
        rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
    within = np.mean([abs(row["predicted y"] - row["y"]) <= 2 * row["predicted y_std"] for row in rows])
    assert within == pytest.approx(metrics["outputs"]["y"]["within_two_std"]) and 0.9 < within < 1.0
    assert metrics["outputs"]["y"]["mse"] == pytest.approx(np.mean([(row["predicted y"] - row["y"]) ** 2 for row in rows]))
    # the formula, with the numbers of the model file
    _, model = load(folder / "s.safetensors")
    centres, lengths = next((model[name], model[name.replace("centres", "lengths")]) for name in model if name.endswith(".centres"))
    mean, scale = model["graph.0.mean"], model["graph.0.scale"]
    predicted = list(csv.DictReader(metafmu("predict", "s.toml", "t.csv", cwd=tmp_path).stdout.splitlines()))
    assert list(predicted[0]) == ["y", "y_std", "in_domain", "domain_distance"]
    stds = np.array([float(row["y_std"]) for row in predicted])
    numbers = [values for name, values in model.items() if name.endswith(".parameters")]
    noise = next(values[1] for values in numbers if len(values) == 2 and values[0] == 1.0 and values[1] > 0)
    of_process = next(values[0] for values in numbers if len(values) == 2 and values[1] == 0.0)
    expected = of_process * kriging(centres, y, lengths, noise, (x - mean) / scale)
    assert np.allclose(stds, expected, rtol=1e-6, atol=0) and 0.09 < np.median(stds) < 0.12
    # scikit-learn has the same process without the uncertainty of the mean
    assert of_process * np.sqrt(noise) == pytest.approx(0.1, rel=0.2)
    for name in ("s.fmu", "s-fmi3.fmu"):
        variables = {variable.name: variable for variable in fmpy.read_model_description(str(folder / name)).modelVariables}
        assert variables["y_std"].causality == "output" and variables["y_std"].description == "predicted standard deviation of y"
        assert "y_bound" in variables and "y_std_bound" not in variables
        for row in (0, 7):
            assert fmpy_outputs(folder / name, {"a": x[row, 0], "b": x[row, 1]}, "y_std")[0] == pytest.approx(stds[row], rel=1e-9)
        assert metafmu("validate", folder / name).returncode == 0
    assert "Within two predicted standard deviations" in (folder / "report.html").read_text()
    card = fmpy.extract(str(folder / "s.fmu"))
    assert "…_std" in (tmp_path / card / "documentation" / "index.html").read_text()
    # what has none is refused before anything is fitted
    text = (tmp_path / "s.toml").read_text()
    (tmp_path / "s.toml").write_text(text.replace("std = true", 'std = true\nmodel = "network"'))
    result, _ = built(tmp_path, check=False)
    assert result.returncode == 2 and "static.std: network has no predicted standard deviation, expected gaussian-process" in result.stderr
    (tmp_path / "s.toml").write_text(text)
    write(tmp_path / "t.csv", {"a": random.uniform(-1, 1, 1001), "b": random.uniform(0, 2, 1001), "y": random.uniform(0, 2, 1001)})
    result, _ = built(tmp_path, check=False)
    assert result.returncode == 2 and "1001 rows, expected 2 to 1000" in result.stderr and "fitting" not in result.stderr, result.stderr


def test_of_a_thousand_rows_some_choose_and_others_judge(tmp_path):
    x = np.random.default_rng(5).uniform(-1, 1, (1200, 2))
    notes(tmp_path, {"a": x[:, 0], "b": x[:, 1], "y": x[:, 0] ** 2 + x[:, 1]})
    result, folder = built(tmp_path)
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["rows"] == "held-out" and metrics["test_rows"] == 60 and "60 unseen rows" in result.stdout
    assert "gaussian-process   failed: 1200 rows, expected at most 1000" in result.stdout, result.stdout
    assert metrics["static_map"]["exported"] == "polynomial" and metrics["train_rows"] == 1140


def test_new_says_what_it_takes_the_columns_for(tmp_path):
    said, study = notes(tmp_path, small())
    assert "outputs are y (by name), inputs a, b; --inputs or --outputs COLUMNS changes that" in said
    rows = 24
    extra = {"No.": np.arange(1, rows + 1), **small(), "gravity": np.full(rows, 9.81), "color": ["red"] * rows}
    said, study = notes(tmp_path, extra)
    for note in ["column `No.`: numbers the rows and is left out", "column `gravity`: is always 9.81 and left out", "column `color`: is text and left out"]:
        assert note in said and note.split(": ")[1] in study, said
    assert "inputs a, b;" in said
    said, _ = notes(tmp_path, small(), "--inputs", "a,y")
    assert "outputs are b (all but --inputs), inputs a, y;" in said
    said, _ = notes(tmp_path, small(), "--outputs", "a")
    assert "outputs are a (by --outputs), inputs b, y;" in said
    said, _ = notes(tmp_path, extra, "--inputs", "a", "--outputs", "y")
    assert "column `b`: is neither in --inputs nor in --outputs and left out" in said
    # the last column, if no name tells
    x = small()
    said, _ = notes(tmp_path, {"speed": x["a"], "drag": x["y"], "torque": x["b"]})
    assert "outputs are torque (the last column)" in said
    # what may be a time
    said, _ = notes(tmp_path, {"stamp": 0.1 * np.arange(50), "force": np.sin(np.arange(50.0))})
    assert "column `stamp` grows evenly" in said and '--time "stamp"' in said
    said, study = notes(tmp_path, {"t": small()["a"], "b": small()["b"], "y": small()["y"]}, "--structure", "static")
    assert "inputs t, b;" in said and 'structure = "static"' in study
    # units of a second row and of names, repeated rows, and rows of other outputs
    (tmp_path / "t.csv").write_text("a [m],y [N]\n1,2\n2,3\n1,2\n2,4\n3,5\n")
    (tmp_path / "s.toml").unlink()
    said = new(tmp_path).stderr
    assert "1 of 5 rows repeat other rows" in said and "1 of 4 rows have the inputs of other rows" in said
    assert 'a = { unit = "m" }' in (tmp_path / "s.toml").read_text()


def test_mistakes_in_arguments_and_tables_are_refused_and_nothing_is_written(tmp_path):
    x = small()
    write(tmp_path / "t.csv", x)
    for arguments, says in [
        (["--inputs", "a,speed"], "no column `speed`, expected it among a, b, y"),
        (["--inputs", "a", "--outputs", "a"], "column `a` is among --inputs and --outputs"),
        (["--structure", "response"], "none of the columns is the time"),
        (["--structure", "response"], "--structure static"),
        (["--structure", "dynamics"], "--structure static"),
        (["--outputs", "a,b,y"], "no column is left for an input"),
    ]:
        result = new(tmp_path, *arguments, check=False)
        assert result.returncode == 2 and says in result.stderr and not (tmp_path / "s.toml").exists(), (arguments, result.stderr)
    write(tmp_path / "t.csv", {"time": np.arange(24.0), **x})
    result = new(tmp_path, "--outputs", "y", check=False)
    assert result.returncode == 2 and "--structure static" in result.stderr
    lines = ["a,b,y", "1,2,3", "2,,4", "3,x,5", "4,NaN,inf", "5,6,7", "6,8,8"]
    (tmp_path / "t.csv").write_text("\n".join(lines))
    result = new(tmp_path, check=False)
    found = [line for line in result.stderr.splitlines() if "t.csv:" in line]
    assert result.returncode == 2 and not (tmp_path / "s.toml").exists()
    assert [line.split("t.csv:")[1].split(":")[0] for line in found] == ["3", "4", "5", "5"] and "leave out the rows" in found[-1], found


def of_runs(count, rows, step=0.1, seed=2):
    """Recorded runs of a lag that an input drives."""
    random, table = np.random.default_rng(seed), {"run": [], "time": [], "u": [], "y": []}
    for run in range(count):
        u, y = np.repeat(random.uniform(-1, 1, rows // 8 + 1), 8)[:rows], 0.0
        for row in range(rows):
            table["run"].append(float(run)), table["time"].append(row * step), table["u"].append(u[row]), table["y"].append(y)
            y = 0.8 * y + 0.2 * u[row]
    return {name: np.array(values) for name, values in table.items()}


def response(count=12, rows=11):
    """Recorded runs with a parameter."""
    c, t = np.repeat(np.linspace(1, 2, count), rows), np.tile(np.linspace(0, 1, rows), count)
    return {"time": t, "c": c, "y": np.exp(-c * t)}


def without(columns, *names):
    return {name: values for name, values in columns.items() if name not in names}


def holed(columns, name, *places):
    values = [f"{value:.12g}" for value in columns[name]]
    for place in places:
        values[place] = ""
    return {**columns, name: values}


def tables():
    """Tables as users have them: the columns, the arguments of `new`, and what a refusal says; None if it is to be built."""
    x, one = small(), of_runs(1, 400)
    discrete = ("--structure", "discrete", "--inputs", "u")
    rounded = {**one, "time": np.round(one["time"] * 0.016384, 3)}
    flat = {**one, "y": np.where(np.arange(400) < 40, 0.0, one["y"]), "u": np.where(np.arange(400) < 60, 0.0, one["u"])}
    return {
        "points": (x, (), None),
        "three rows": ({name: values[:3] for name, values in x.items()}, (), None),
        "equal rows": ({name: np.full(9, values[0]) for name, values in x.items()}, (), "no column is left for an input"),
        "a row": ({name: values[:1] for name, values in x.items()}, (), "no column is left for an input"),
        "no number": ({"a": ["p"] * 4, "b": ["q", "r"] * 2}, (), "is text"),
        "a constant input": ({"k": np.full(24, 3.0), **x}, (), None),
        "a constant output": ({**x, "y1": np.full(24, 3.0)}, (), None),
        "text": ({"name": ["p"] * 24, **x}, (), None),
        "text among the inputs": ({"name": ["p"] * 24, **x}, ("--inputs", "name,a,b"), "`name` of --inputs and --outputs: text"),
        "row numbers": ({"id": np.arange(24.0), **x}, (), None),
        "drop-outs": (holed(x, "b", 3, 7), (), "leave out the rows"),
        "an empty column": ({**x, "spare": [""] * 24}, (), None),
        "names of built-in variables": ({"in_domain": x["a"], "time": x["b"], "y": x["y"]}, ("--structure", "static"), None),
        "names of other columns": ({"row": x["a"], "predicted y": x["b"], "y": x["y"]}, (), None),
        "names with characters": ({'Größe "x"': x["a"], "a.b c": x["b"], "f(x)": x["y"]}, (), None),
        "an unknown time": ({"Zeitstempel": 0.1 * np.arange(60), "s": np.sin(0.1 * np.arange(60))}, (), None),
        "large and small": ({"a": 1e12 * x["a"], "b": 1e-12 * x["b"], "y": 1e-9 * x["y"]}, (), None),
        "a wide table": ({**{f"x{i}": np.random.default_rng(i).uniform(size=24) for i in range(40)}, "y": x["y"]}, (), None),
        "repeated rows": ({name: np.tile(values[:12], 2) for name, values in x.items()}, (), None),
        "an integer output": ({**x, "y": np.round(3 * x["y"])}, (), None),
        "response": (response(), (), None),
        "a response run": (without(one, "run"), (), "--structure discrete"),
        "discrete runs": (of_runs(12, 60), discrete, None),
        "a discrete record": (without(one, "run"), discrete, None),
        "millisecond stamps": (without(rounded, "run"), discrete, None),
        "drop-outs of a record": (holed(without(one, "run"), "y", 50, 51), discrete, "expected a finite number"),
        "constant stretches": (without(flat, "run"), discrete, None),
        "a record of 60 rows": ({name: values[:60] for name, values in without(one, "run").items()}, discrete, None),
        "signals with an offset": ({**without(one, "run"), "u": 3e5 + one["u"], "y": 1e5 + one["y"]}, discrete, None),
        "a short record": ({name: values[:12] for name, values in without(one, "run").items()}, discrete, "expected at least"),
        "no input": (without(one, "run", "u"), ("--structure", "discrete"), "say which they are with --inputs"),
        "dynamics": ({"time": 0.05 * np.arange(400), "x": np.cos(0.05 * np.arange(400)), "v": -np.sin(0.05 * np.arange(400))}, ("--structure", "dynamics"), None),
    }


# what does not change what is accepted, and takes long
QUICK = [(r"epochs = \d+ *", "epochs = 3 "), (r"hidden = \[[^\]]*\]", "hidden = [4]"), (r"stretch = 64", "stretch = 16")]


@pytest.mark.parametrize("name", tables())
def test_what_new_writes_is_what_build_accepts_or_the_refusal_says_what_to_do(tmp_path, name):
    columns, arguments, refusal = tables()[name]
    write(tmp_path / "t.csv", columns, separator=";" if "characters" in name else ",")
    result = new(tmp_path, *arguments, check=False)
    assert "panicked" not in result.stderr
    if refusal:
        assert result.returncode == 2 and refusal in result.stderr, (result.returncode, result.stderr)
        return
    assert result.returncode == 0, result.stderr
    study = (tmp_path / "s.toml").read_text()
    if "static" not in study:
        for pattern, quick in QUICK:
            study = re.sub(pattern, quick, study)
        (tmp_path / "s.toml").write_text(study + ANY)
    result, folder = built(tmp_path, check=False)
    # accuracy may be poor, which is no refusal
    assert result.returncode in (0, 1) and (folder / "s.fmu").exists(), result.stderr
    assert "problems found" not in result.stderr or "no problems found" in result.stderr
    assert metafmu("validate", folder / "s.fmu").returncode == 0


@pytest.mark.parametrize(("separator", "decimal"), [(";", ","), ("\t", "."), (";", ".")])
def test_tables_of_other_countries_are_the_same_study(tmp_path, separator, decimal):
    models = []
    for folder, how in [(tmp_path / "a", {}), (tmp_path / "b", {"separator": separator, "decimal": decimal})]:
        folder.mkdir()
        notes(folder, small(), **how)
        _, results = built(folder)
        models.append(json.loads((results / "metrics.json").read_text())["outputs"])
    assert models[0] == models[1]


def test_the_example_is_built_from_its_table(tmp_path):
    result = metafmu("build", "examples/tables/borehole.toml", "--out", tmp_path / "out")
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["outputs"]["flow"]["r2"] > 0.9999 and "flow" in result.stdout
    table = np.genfromtxt(ROOT / "examples" / "tables" / "borehole.csv", delimiter=",", skip_header=1)
    assert np.allclose(borehole(*table[:, 1:9].T), table[:, 9], rtol=1e-7), "the table is that of the formula"
    # what docs/tables.md shows is what it prints
    shown = (ROOT / "docs" / "tables.md").read_text().split("fits in seconds and prints\n\n")[1]
    numbers = re.search(r"^    flow +(\S+) +(\S+)", shown, re.M)
    assert numbers and numbers[0].split()[1] == "m3/yr"
    assert re.search(r"R² +MSE +90 % bound", result.stdout)


def test_ctrl_c_leaves_nothing_that_looks_finished(tmp_path):
    x = np.random.default_rng(5).uniform(-1, 1, (900, 6))
    notes(tmp_path, {**{f"x{i}": x[:, i] for i in range(6)}, "y": np.sin(x.sum(1))})
    process = subprocess.Popen([METAFMU, "build", "s.toml"], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    for line in process.stderr:
        if "fitting to 900 rows" in line:
            process.send_signal(2)
            break
    process.stderr.read()
    assert process.wait() == 130
    assert not list((tmp_path / "out" / "s").glob("*.fmu")) and not (tmp_path / "out" / "s" / "s.safetensors").exists()
