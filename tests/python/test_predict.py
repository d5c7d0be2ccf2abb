"""`metafmu predict`: what it computes for a table is what fmpy gets from the FMU and what `evaluate` measures."""

import io
import json
import os
import shutil
import signal
import subprocess
import threading
import time
import zipfile

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from conftest import METAFMU, OTHER_THREADS, OUTPUTS, PARAMETERS, ROOT, metafmu, simulate_with_fmpy
from test_dynamics import KNOTS, PARAMETERS as CRANE_PARAMETERS, ROWS, STARTS, STEP, Running, build, linear

DOMAIN = ["in_domain", "domain_distance"]
DESIGNS = [(0.11, 0.02, 0.5), (0.15, 0.07, 2.5), (0.19, 0.14, 4.5)]
TIMES = np.linspace(0.0, 2.0, 201)


@pytest.fixture(scope="module")
def crane(tmp_path_factory):
    """Tests write nothing into its folder."""
    return build(tmp_path_factory.mktemp("predict") / "crane")


@pytest.fixture(scope="module")
def designs():
    rows = [(run, time, *design) for run, design in enumerate(DESIGNS) for time in TIMES]
    return pd.DataFrame(rows, columns=["run", "time", *PARAMETERS])


def predict(model, table, folder, *options, check=True, out="out.csv", **more):
    """The result as a table, and what was said."""
    if isinstance(table, pd.DataFrame):
        table.to_csv(folder / "in.csv", index=False)
        table = folder / "in.csv"
    command = [METAFMU, "predict", model, table, "--out", folder / out, *options]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, cwd=ROOT, **more)
    assert not check or done.returncode == 0, done.stderr
    if not (folder / out).exists():
        return None, done
    read = pd.read_parquet if out.endswith("parquet") else pd.read_csv
    return read(folder / out), done


def drive():
    """A roll-out of the crane: its force is linear between the rows."""
    table = pd.DataFrame({"run": "a b", "time": ROWS, **CRANE_PARAMETERS, **STARTS})
    return table.assign(force=np.interp(ROWS, KNOTS, linear(KNOTS, None)))


def test_points_are_what_the_fmu_computes(pendulum, designs, tmp_path):
    for version, fmu in pendulum.fmus.items():
        found, _ = predict(fmu, designs, tmp_path)
        assert list(found) == ["run", "time", *OUTPUTS, *DOMAIN]
        pd.testing.assert_frame_equal(found[["run", "time"]], designs[["run", "time"]])
        for run, design in enumerate(DESIGNS):
            expected = simulate_with_fmpy(pendulum, *design, version=version, stop_time=2.0, output_interval=0.01)
            expected = np.column_stack([expected[output] for output in OUTPUTS])
            # the same network; fmpy's own loop may compute a time with another rounding
            np.testing.assert_allclose(found.loc[found.run == run, OUTPUTS], expected, rtol=1e-12, atol=1e-11)
        assert found.in_domain.all() and not found.domain_distance.any()


def test_errors_on_the_test_runs_are_those_that_evaluate_measures(pendulum, crane, tmp_path):
    crane_metrics = json.loads((crane.folder / "metrics.json").read_text())
    for model, folder, metrics in [
        (pendulum.fmu, pendulum.folder, pendulum.metrics),
        (crane.fmu(2), crane.folder, crane_metrics),
    ]:
        truth = pd.read_csv(folder / "test.csv")
        found, _ = predict(model, folder / "test.csv", tmp_path)
        pd.testing.assert_frame_equal(found[["run", "time"]], truth[["run", "time"]])
        for output, measured in metrics["outputs"].items():
            error = (found[output] - truth[output]).abs()
            assert error.max() == measured["max_abs_error"]
            assert (error**2).mean() == pytest.approx(measured["mse"], rel=1e-9)


def test_every_form_of_a_model_predicts_the_same(pendulum, designs, tmp_path):
    expected = predict(pendulum.fmu, designs, tmp_path)[0]
    (tmp_path / "out").mkdir()
    shutil.copytree(pendulum.folder, tmp_path / "out" / "single-pendulum")
    shutil.copy(ROOT / "examples" / "single-pendulum.toml", tmp_path / "study.toml")
    for model in ("study.toml", "out/single-pendulum/single-pendulum.safetensors"):
        done = subprocess.run([METAFMU, "predict", model, "in.csv"], capture_output=True, text=True, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        pd.testing.assert_frame_equal(pd.read_csv(io.StringIO(done.stdout)), expected, check_exact=True)


def test_parquet_has_the_same_values_and_types(pendulum, designs, tmp_path):
    # several row groups, and more rows than are read at a time
    table = pd.concat([designs.assign(run=designs.run + 3 * copy, c=designs.c / (copy + 1)) for copy in range(230)])
    table = table.reset_index(drop=True)
    expected, _ = predict(pendulum.fmu, table, tmp_path)
    assert expected.dtypes.astype(str).to_list() == ["int64", *4 * ["float64"], "bool", "float64"]
    table.to_parquet(tmp_path / "in.parquet")
    found, _ = predict(pendulum.fmu, tmp_path / "in.parquet", tmp_path, out="out.parquet")
    pd.testing.assert_frame_equal(found, expected, check_exact=True)
    assert pq.ParquetFile(tmp_path / "out.parquet").num_row_groups == 2
    before = (tmp_path / "out.parquet").read_bytes()
    predict(pendulum.fmu, tmp_path / "in.parquet", tmp_path, out="out.parquet", env=os.environ | OTHER_THREADS)
    assert (tmp_path / "out.parquet").read_bytes() == before

    named = designs.assign(run=designs.run.map("run {}".format))
    found, _ = predict(pendulum.fmu, named, tmp_path, out="named.parquet")
    assert found.run.to_list() == named.run.to_list()


def test_missing_columns_are_one_error_unless_their_values_are_asked_for(pendulum, designs, tmp_path):
    table = designs.drop(columns=["c"]).rename(columns={"L": "l", "thetad0": "thetad_0"})
    found, done = predict(pendulum.fmu, table, tmp_path, check=False)
    message = (
        ":1: no columns `L`, `c`, `thetad0`, expected them among run, time, l, thetad_0; did you mean `l` for `L`, `thetad_0` for `thetad0`? "
        "Not used: l, thetad_0. For constants: --default L=0.15 --default c=0.075 --default thetad0=2.5"
    )
    assert (found, done.returncode) == (None, 2) and message in done.stderr, done.stderr

    expected, _ = predict(pendulum.fmu, designs.assign(c=0.075, thetad0=3.5), tmp_path)
    table = designs.drop(columns=["c", "thetad0"]).assign(thetad_0=1.0, theta=0.0)
    found, done = predict(pendulum.fmu, table, tmp_path, "--quiet", "--default", "c", "--default", "thetad0=3.5")
    pd.testing.assert_frame_equal(found, expected, check_exact=True)
    # what may be a mistake is said even so, and nothing else
    assert done.stderr == "warning: `thetad0` has its default value, and the column `thetad_0` is not used\n"
    _, done = predict(pendulum.fmu, table, tmp_path, "--default", "c", "--default", "thetad0=3.5")
    assert "constant, without a column: c = 0.075 kg.m/s, thetad0 = 3.5 rad/s\ncolumns that are not used: thetad_0" in done.stderr
    for option, says in [("C", "--default C: no such variable, expected one of"), ("c=x", "`x` is not a finite number")]:
        _, done = predict(pendulum.fmu, table, tmp_path, "--default", option, check=False)
        assert done.returncode == 2 and says in done.stderr


def test_a_state_at_the_start_has_its_start_value_unless_a_column_may_be_meant(crane, tmp_path):
    table = drive().drop(columns=[name for name in STARTS])
    found, done = predict(crane.fmu(2), table, tmp_path)
    assert len(found) == len(table) and "constant, without a column: rail.position_start = " in done.stderr
    _, done = predict(crane.fmu(2), table.assign(angle0=0.2), tmp_path, check=False)
    assert done.returncode == 2 and "no columns `rail.position_start`, " in done.stderr and "Not used: angle0. For constants: --default " in done.stderr
    _, done = predict(crane.fmu(2), table.rename(columns={"run": "Run"}), tmp_path, check=False)
    assert done.returncode == 2 and "Not used: Run." in done.stderr
    _, done = predict(crane.fmu(2), drive().rename(columns={"run": "Run"}), tmp_path, check=False)
    assert done.returncode == 2 and "column `Run`, expected the spelling `run`, or another name" in done.stderr


def test_units_are_compared_by_their_meaning(pendulum, designs, tmp_path):
    expected, _ = predict(pendulum.fmu, designs, tmp_path)
    for units in [("m", "kg·m/s", "rad·s⁻¹"), ("m", "kg*m*s**-1", "rad s^-1"), ("m", "(kg m)/s", "rad/s")]:
        names = {name: f"{name} [{unit}]" for name, unit in zip(PARAMETERS, units)}
        found, _ = predict(pendulum.fmu, designs.rename(columns=names), tmp_path)
        pd.testing.assert_frame_equal(found, expected, check_exact=True)


def test_the_domain_is_that_of_the_fmu(pendulum, designs, tmp_path):
    table = designs.assign(L=np.where(designs.index == 7, 0.25, designs.L))
    found, done = predict(pendulum.fmu, table, tmp_path, "--json", "--outputs", "thetad,theta")
    assert list(found) == ["run", "time", "thetad", "theta", *DOMAIN]
    assert found.index[~found.in_domain].to_list() == [7]
    assert found.domain_distance[7] == pytest.approx(0.5)
    assert f"1 of {len(table)} rows, the first is row 8" in done.stderr
    summary = json.loads(done.stdout)
    assert summary["rows"] == len(table) and "runs" not in summary
    assert summary["outside"] == {"rows": 1, "first": 8} and summary["not_finite"] == {"rows": 0}
    bounds = {name: pendulum.metrics["outputs"][name]["bound"] for name in ("thetad", "theta")}
    assert summary["bounds"] == bounds


def test_a_roll_out_is_what_the_fmu_does(crane, tmp_path):
    found, done = predict(crane.fmu(2), drive(), tmp_path)
    assert f"{len(ROWS)} rows of 1 run " in done.stdout and set(found.run) == {"a b"}
    with Running(crane.fmu(2), "CoSimulation", tmp_path / "fmu") as running:
        expected = [running.get(["x", "theta"])]
        for row in range(len(ROWS) - 1):
            begin, end = linear(ROWS[row : row + 2], None)
            running.set("force", begin)
            running.set_slope((end - begin) / STEP)
            running.step(row)
            expected.append(running.get(["x", "theta"]))
    np.testing.assert_allclose(found[["x", "theta"]], expected, rtol=1e-9, atol=1e-10)


def test_a_run_without_labels_ends_where_the_time_goes_back(crane, tmp_path):
    one, other = drive(), drive().assign(l=1.8)
    later = other.assign(time=other.time + 3.0)
    expected, _ = predict(crane.fmu(3), pd.concat([one, later.assign(run="c")]), tmp_path)
    found, done = predict(crane.fmu(3), pd.concat([later, one]).drop(columns="run"), tmp_path)
    assert "of 2 runs" in done.stdout
    rows = len(ROWS)
    for part, other in [(found[:rows], expected[rows:]), (found[rows:], expected[:rows])]:
        np.testing.assert_array_equal(part[["time", "x", "theta"]], other[["time", "x", "theta"]])


def test_what_cannot_be_computed_is_no_number_and_told(crane, tmp_path):
    # the inertia of a load on such a long rope overflows
    table = pd.concat([drive(), drive().assign(run="none", l=1e200), drive().assign(run="last")])
    found, done = predict(crane.fmu(2), table, tmp_path, check=False)
    assert done.returncode == 1 and len(found) == len(table)
    lost = found[["x", "theta"]].isna().any(axis=1)
    assert set(found.run[lost]) == {"none"} and lost.sum() >= len(ROWS) - 1
    assert f"{lost.sum()} of {len(table)} rows, the first is row {lost.idxmax() + 1}" in done.stderr


POINTS = "time,L,c,thetad0\n0,0.12,0.05,1\n0.5,0.12,0.05,1\n"
ROLL_OUT = "run,time,l,force,m,b\na,0,1.5,0,1,1\na,1,1.5,2,1,1\nb,0,1.2,0,1,1\n"
MISTAKES = [
    ("pendulum", POINTS.replace("0.5,0.12", "0.5,x"), ":3: column `L`: `x`, expected a finite number"),
    ("pendulum", POINTS.replace("0.5,0.12", "0.5,"), ":3: column `L`: is empty, expected a finite number"),
    ("pendulum", POINTS.replace("0.5,0.12", "NaN,0.12"), ":3: column `time`: `NaN`, expected a finite number"),
    ("pendulum", POINTS.replace("0.5,0.12", "0.12"), ":3: 3 fields, expected 4"),
    ("pendulum", POINTS.replace("time", "t"), ":1: no column `time`, expected it among t, L, c, thetad0"),
    (
        "pendulum",
        POINTS.replace("L,c", "L [mm],c [kg]"),
        ":1: column `L`: unit `mm`, expected `m`; column `c`: unit `kg`, expected `kg.m/s`",
    ),
    ("pendulum", POINTS.replace("thetad0", "L"), ":1: column `L` is duplicated"),
    ("pendulum", "time,L,c,thetad0\n", ":1: the table has no rows"),
    ("pendulum", "", ":1: the table is empty"),
    ("crane", ROLL_OUT.replace("time", "t"), ":1: no column `time`"),
    ("crane", ROLL_OUT.replace("a,1,1.5,2", "a,0,1.5,2"), ":3: time 0 s is duplicated in run `a`"),
    ("crane", ROLL_OUT.replace("a,1,1.5,2", "a,-1,1.5,2"), ":3: time -1 s after 0 s in run `a`"),
    ("crane", ROLL_OUT.replace("a,1,1.5,2", "a,1,1.6,2"), ":3: column `l`: 1.6 after 1.5, expected one value in a run"),
    ("crane", ROLL_OUT + "a,2,1.5,0,1,1\n", ":5: run `a` again, it began in line 2"),
    ("crane", ROLL_OUT.replace("b,0", ",0"), ":4: column `run`: is empty, expected the run's label"),
    ("crane", ROLL_OUT.replace("1.5,2", "1.5,inf"), ":3: column `force`: `inf`, expected a finite number"),
]


@pytest.mark.parametrize("model, text, says", MISTAKES, ids=[says for *_, says in MISTAKES])
def test_a_mistake_is_told_with_line_and_column_and_nothing_is_written(request, model, text, says, tmp_path):
    model = request.getfixturevalue(model)
    fmu = model.fmu if hasattr(model, "metrics") else model.fmu(2)
    (tmp_path / "in.csv").write_text(text)
    for out in ("out.csv", "out.parquet"):
        found, done = predict(fmu, tmp_path / "in.csv", tmp_path, check=False, out=out)
        assert (found, done.returncode) == (None, 2)
        assert f"error: {tmp_path}/in.csv{says}" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["in.csv"]


def test_a_mistake_in_parquet_is_told_with_its_row(pendulum, designs, tmp_path):
    designs.assign(c=designs.c.where(designs.index != 16)).to_parquet(tmp_path / "in.parquet")
    _, done = predict(pendulum.fmu, tmp_path / "in.parquet", tmp_path, check=False)
    assert done.returncode == 2 and "in.parquet, row 17: column `c`: is empty" in done.stderr


def test_what_is_no_surrogate_and_no_output_is_refused(pendulum, designs, tmp_path):
    designs.to_csv(tmp_path / "in.csv")
    with zipfile.ZipFile(tmp_path / "other.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", "<fmiModelDescription/>")
    (tmp_path / "text.fmu").write_text("text")
    for model, options, says in [
        (tmp_path / "other.fmu", [], "this is a third-party FMU: `metafmu simulate` runs it"),
        (tmp_path / "text.fmu", [], "not an FMU"),
        (tmp_path / "in.csv", [], "expected a surrogate, a file that ends in .fmu or .safetensors"),
        (tmp_path / "none.safetensors", [], "none.safetensors: cannot read"),
        (pendulum.fmu, ["--outputs", "theta,thetat"], "variable `thetat`: the surrogate has no such output, expected one of"),
        (pendulum.fmu, ["--outputs", "theta,theta"], "variable `theta`: is listed twice"),
        (pendulum.fmu, ["--out", tmp_path / "x.xlsx"], "expected a file that ends in .csv or .parquet"),
        (pendulum.fmu, ["--json"], "--out"),
    ]:
        done = metafmu("predict", model, tmp_path / "in.csv", *options, check=False)
        assert done.returncode == 2 and says in done.stderr
        if options == ["--json"]:
            assert says in "\n".join(json.loads(done.stdout)["problems"])
        else:
            assert not done.stdout


def test_ctrl_c_ends_it_and_leaves_no_file(pendulum, tmp_path):
    table = tmp_path / "table"
    os.mkfifo(table)
    defaults = ["--default", "c", "--default", "thetad0"]
    process = subprocess.Popen([METAFMU, "predict", pendulum.fmu, table, "--out", tmp_path / "out.csv", *defaults], stderr=subprocess.PIPE)
    rows = b"0.5,0.15\n" * 10_000

    def write():
        with open(table, "wb", buffering=0) as pipe:
            pipe.write(b"time,L\n")
            # so much that some of it has been read
            for _ in range(20):
                pipe.write(rows)
            process.send_signal(signal.SIGINT)
            # until nobody reads any more
            while True:
                pipe.write(rows)

    writer = threading.Thread(target=lambda: pytest.raises(BrokenPipeError, write))
    writer.start()
    assert process.wait(60) == 130, process.stderr.read()
    writer.join()
    process.stderr.close()
    assert [path.name for path in tmp_path.iterdir()] == ["table"]


@pytest.mark.parametrize("header", [None, b"time,L\n"])
@pytest.mark.parametrize("verb", ["predict", "simulate"])
def test_the_first_ctrl_c_ends_the_wait_for_a_pipe(pendulum, tmp_path, verb, header):
    """A pipe that nobody writes to, and one whose writer has stopped."""
    table = tmp_path / "table"
    os.mkfifo(table)
    command = [verb, pendulum.fmu, table, "--default", "c"] if verb == "predict" else [verb, pendulum.fmu, "--input", table]
    process = subprocess.Popen([METAFMU, *command], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    # what it waits for
    assert b"table" in process.stderr.readline()
    writer = None if header is None else open(table, "wb", buffering=0)
    if writer:
        writer.write(header)
        time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    assert process.wait(10) == 130
    assert process.stderr.read().endswith(b"error: stopped\n")
    process.stderr.close()
    if writer:
        writer.close()


def test_the_time_takes_no_default_value(pendulum, crane, tmp_path):
    says = "--default time: found a default value, expected a column `time`: it differs from row to row"
    for fmu, folder in ((pendulum.fmu, pendulum.folder), (crane.fmu(2), crane.folder)):
        result = metafmu("predict", fmu, folder / "test.csv", "--default", "time=1", "--out", tmp_path / "out.csv", check=False)
        assert result.returncode == 2 and says in result.stderr, result.stderr


def test_one_row_is_not_plural(pendulum, tmp_path):
    (tmp_path / "row.csv").write_text("time,L,c,thetad0\n0.5,0.15,0.1,2\n")
    result = metafmu("predict", pendulum.fmu, tmp_path / "row.csv", "--out", tmp_path / "out.csv")
    assert ": 1 row in " in result.stdout, result.stdout
