"""Recorded runs in Parquet give the tables of the same runs in CSV, and every mistake is named; tables of a build are the same in both formats."""

import datetime
import decimal
import json
import shutil
import subprocess

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from conftest import ANY, METAFMU, ROOT, abort_at, metafmu, small_study

STUDY = """name = "s"
source = {{ {source} }}
time = {{ stop = 1, step = 0.01 }}
parameters = {{ a = {{ min = 0, max = 10, unit = "m" }}, b = {{ min = -1, max = 1 }} }}
outputs = {{ y = {{}}, z = {{ unit = "rad" }} }}
sampling.test_runs = 5
"""


@pytest.fixture(scope="module")
def runs():
    """120 runs of 101 rows: more than are decoded at once. Their numbers have single precision."""
    random = np.random.default_rng(1)
    run, time = np.repeat(np.arange(120), 101), np.tile(np.arange(101) / 128, 120)
    a, b = np.repeat(random.uniform(0, 10, 120), 101), np.repeat(random.uniform(-1, 1, 120), 101)
    table = pd.DataFrame({"run": run, "time": time / time[100], "a": a, "b": b, "y": np.sin(a * time) * b, "z": np.cos(a * time)})
    return table.astype("float32").astype("float64").astype({"run": "int64"})


def sample(folder, source, *more, check=True):
    (folder / "study.toml").write_text(STUDY.format(source=source))
    return metafmu("sample", folder / "study.toml", "--out", folder / "out", *more, check=check)


def sampled(folder, source='table = "runs.parquet"'):
    sample(folder, source)
    return [(folder / "out" / name).read_bytes() for name in ("train.csv", "test.csv")]


@pytest.fixture(scope="module")
def expected(runs, tmp_path_factory):
    folder = tmp_path_factory.mktemp("csv")
    runs.to_csv(folder / "runs.csv", index=False)
    return sampled(folder, 'table = "runs.csv"')


WRITTEN = {
    "by pandas": {},
    "in small row groups": {"row_group_size": 777},
    "with gzip, without dictionaries": {"compression": "gzip", "use_dictionary": False, "row_group_size": 10_000},
    "without compression": {"compression": "none", "data_page_size": 1000},
    "in pages of version 2": {"data_page_version": "2.0", "version": "1.0"},
    "with the encodings of other writers": {
        "use_dictionary": False,
        "data_page_version": "2.0",
        "column_encoding": {"run": "DELTA_BINARY_PACKED", "time": "BYTE_STREAM_SPLIT", "y": "PLAIN"},
    },
}


@pytest.mark.parametrize("options", WRITTEN.values(), ids=WRITTEN)
def test_a_table_is_that_of_csv_however_it_is_written(runs, expected, tmp_path, options):
    runs.to_parquet(tmp_path / "runs.parquet", index=False, **options)
    assert sampled(tmp_path) == expected


def typed(runs, **types):
    return runs.astype(types)


TYPES = {
    "single precision": lambda runs: typed(runs, time="float32", y="float32", z="float32"),
    "strings": lambda runs: typed(runs, run="str"),
    "categories": lambda runs: runs.assign(run=runs.run.map("run {}".format).astype("category")),
    "small integers": lambda runs: typed(runs, run="uint8"),
    "large integers": lambda runs: runs.assign(run=runs.run.astype("uint64") + np.uint64(2**64 - 200)),
    "labels in double precision": lambda runs: typed(runs, run="float64"),
    "an index": lambda runs: runs.set_index(["run", "time"]),
    "rows of another table": lambda runs: runs.set_index(runs.index + 5),
    "units in names": lambda runs: runs.rename(columns={"time": "time [s]", "a": "a (m)", "z": "z [rad]"}),
    "no labels": lambda runs: runs.drop(columns="run"),
    "columns nobody asks for": lambda runs: runs.assign(
        note="x",
        when=datetime.datetime(2026, 1, 1),
        price=decimal.Decimal("1.50"),
        list=[[1.0, 2.0]] * len(runs),
        nothing=None,
    )[["note", "list", "y", "when", "z", "b", "price", "a", "time", "run", "nothing"]],
}


@pytest.mark.parametrize("change", TYPES.values(), ids=TYPES)
def test_a_table_is_that_of_csv_with_columns_of_other_types(runs, expected, tmp_path, change):
    change(runs).to_parquet(tmp_path / "runs.parquet")
    assert sampled(tmp_path) == expected


def test_true_and_false_and_integers_are_numbers(runs, tmp_path):
    runs = runs.assign(y=runs.y > 0, z=np.arange(len(runs)) - 6000, b=runs.run.astype("float32") / 128)
    # two parameters of other types in the same place
    runs.assign(y=runs.y.astype(int)).to_csv(tmp_path / "runs.csv", index=False)
    runs.assign(z=runs.z.astype("int16")).to_parquet(tmp_path / "runs.parquet")
    assert sampled(tmp_path) == sampled(tmp_path, 'table = "runs.csv"')


def test_an_index_and_its_files_may_both_be_parquet(runs, expected, tmp_path):
    index = []
    for run, rows in runs.groupby("run"):
        rows[["time", "y", "z"]].to_parquet(tmp_path / f"{run}.parquet", index=False)
        index.append([f"{run}.parquet", *rows[["a", "b"]].iloc[0]])
    index = pd.DataFrame(index, columns=["file", "a", "b"])
    index.to_parquet(tmp_path / "index.parquet", index=False)
    index.to_csv(tmp_path / "index.csv", index=False)
    assert sampled(tmp_path, 'index = "index.parquet"') == expected
    assert sampled(tmp_path, 'index = "index.csv"') == expected
    # the files' content counts
    assert sample(tmp_path, 'index = "index.parquet"').returncode == 0
    runs[runs.run == 3].assign(y=5.0).to_parquet(tmp_path / "3.parquet", index=False)
    assert sampled(tmp_path, 'index = "index.parquet"') != expected
    runs[runs.run == 3][:50].to_parquet(tmp_path / "3.parquet", index=False)
    message = sample(tmp_path, 'index = "index.parquet"', check=False).stderr
    assert "3.parquet, row 50: run `3.parquet` ends before this row at " in message, message
    runs[:0].to_parquet(tmp_path / "3.parquet", index=False)
    message = sample(tmp_path, 'index = "index.parquet"', check=False).stderr
    assert "3.parquet: run `3.parquet` has no rows" in message, message
    (tmp_path / "3.parquet").unlink()
    message = sample(tmp_path, 'index = "index.parquet"', check=False).stderr
    assert "index.parquet, row 4: " in message and "3.parquet" in message, message


def cell(row, column, value):
    """A change of one value; rows are counted from 1."""

    def change(runs):
        runs.loc[row - 1, column] = value
        return runs

    return change


def without(first, last):
    return lambda runs: runs.drop(index=range(first - 1, last)).reset_index(drop=True)


def swap(runs):
    order = list(range(len(runs)))
    order[301], order[302] = 302, 301
    return runs.iloc[order].reset_index(drop=True)


def again(runs):
    runs.loc[runs.run == 7, "run"] = 2
    return runs


def same_parameters(runs):
    runs.loc[runs.run == 7, ["a", "b"]] = runs.loc[runs.run == 2, ["a", "b"]].values[0]
    return runs


MISTAKES = {
    "a missing column": (lambda runs: runs.drop(columns="y"), ": no column `y`, expected it among run, time, a, b, z"),
    "a name twice": (lambda runs: runs.rename(columns={"y": "z [m]"}), ": column `z` is duplicated"),
    "another unit": (lambda runs: runs.rename(columns={"z": "z [deg]"}), ": column `z`: unit `deg`, expected `rad`"),
    "another unit of time": (lambda runs: runs.rename(columns={"time": "time [ms]"}), ": column `time`: unit `ms`, expected `s`"),
    "a missing value": (cell(10_000, "y", None), ", row 10000: column `y`: is empty, expected a finite number"),
    "a missing time": (cell(205, "time", None), ", row 205: column `time`: is empty"),
    "a missing label": (lambda runs: typed(runs, run="Int64").pipe(cell(9, "run", None)), ", row 9: column `run`: is empty, expected"),
    "a missing string": (lambda runs: typed(runs, run="str").pipe(cell(9, "run", None)), ", row 9: column `run`: is empty, expected"),
    "infinity": (cell(300, "z", np.inf), ", row 300: column `z`: `inf`, expected a finite number"),
    "a parameter out of range": (cell(102, "a", 10.5), ", row 102: column `a`: 10.5, expected 0 to 10, the study's range"),
    "a parameter that changes": (cell(103, "b", 0.25), ", row 103: column `b`: 0.25 after "),
    "times out of order": (swap, ", row 303: time 0.99"),
    "a time twice": (cell(204, "time", 0.0), ", row 204: time 0 s is duplicated in run `2`"),
    "a late beginning": (without(102, 103), ", row 102: run `1` begins at "),
    "an early end": (without(150, 202), ", row 150: run `1` ends before this row at "),
    "an early end of all": (without(12120, 12120), ", row 12119: run `119` ends before this row at "),
    "a label again": (again, ", row 708: run `2` again, it began in row 203: a run's rows must be contiguous"),
    "parameters again": (same_parameters, ", row 708: a second run with a = "),
    "too few runs": (without(607, 12120), ", row 606: 6 runs, expected at least 7: 5 for the tests, 2 to train"),
    "no rows": (lambda runs: runs[:0], ": 0 runs, expected at least 7"),
    "text": (lambda runs: typed(runs, y="str"), ": column `y` is BYTE_ARRAY (String), expected DOUBLE, FLOAT, INT32, INT64 or BOOLEAN"),
    "decimals": (
        lambda runs: runs.assign(y=decimal.Decimal("1.50")),
        ": column `y` is FIXED_LEN_BYTE_ARRAY (Decimal), expected DOUBLE, FLOAT, INT32, INT64 or BOOLEAN",
    ),
    "timestamps": (lambda runs: runs.assign(y=datetime.datetime(2026, 1, 1)), ": column `y` is INT64 (Timestamp), expected DOUBLE,"),
    "durations": (lambda runs: runs.assign(y=datetime.time(1)), ": column `y` is INT64 (Time), expected DOUBLE,"),
    "dates": (lambda runs: runs.assign(run=datetime.date(2026, 1, 1)), ": column `run` is INT32 (Date), expected BYTE_ARRAY (String), DOUBLE,"),
    "bytes": (lambda runs: runs.assign(run=b"x"), ": column `run` is BYTE_ARRAY, expected BYTE_ARRAY (String), DOUBLE,"),
    "half precision": (lambda runs: typed(runs, y="float16"), ": column `y` is FIXED_LEN_BYTE_ARRAY (Float16), expected DOUBLE,"),
    "lists": (lambda runs: runs.assign(y=[[1.0, 2.0]] * len(runs)), ": column `y` is nested, expected DOUBLE,"),
    "structures": (lambda runs: runs.assign(y=[{"x": 1.0}] * len(runs)), ": column `y` is nested, expected DOUBLE,"),
    "nulls only": (lambda runs: runs.assign(y=None), ", row 1: column `y`: is empty, expected a finite number"),
}


@pytest.mark.parametrize("change, says", MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_is_named_by_its_row(runs, tmp_path, change, says):
    change(runs.copy()).to_parquet(tmp_path / "runs.parquet", index=False, row_group_size=5000)
    result = sample(tmp_path, 'table = "runs.parquet"', check=False)
    assert result.returncode == 2 and f"runs.parquet{says}" in result.stderr, result.stderr
    assert "panicked" not in result.stderr and not (tmp_path / "out" / "train.csv").exists()


def test_what_only_other_writers_do_is_named(runs, tmp_path):
    table = pa.Table.from_pandas(runs, preserve_index=False)

    def says(**options):
        pq.write_table(options.pop("table", table), tmp_path / "runs.parquet", **options)
        return sample(tmp_path, 'table = "runs.parquet"', check=False).stderr

    for codec in ("zstd", "brotli", "lz4"):
        message = says(compression={**dict.fromkeys(table.column_names, "snappy"), "z": codec})
        assert f"runs.parquet: column `z`: compressed with {codec.upper()}" in message, message
        assert 'write the file again with `compression="snappy"`' in message
    when = table.append_column("w", pa.array([datetime.datetime(2026, 1, 1)] * len(runs))).drop_columns("y").rename_columns({"w": "y"})
    assert ": column `y` is INT96, expected DOUBLE" in says(table=when, use_deprecated_int96_timestamps=True)
    value = table.set_column(4, "y", pa.array([1.0] * 4999 + [float("nan")] + [1.0] * (len(runs) - 5000)))
    assert ", row 5000: column `y`: `NaN`, expected a finite number" in says(table=value)
    twice = pa.table([*table.columns, table["y"]], [*table.column_names, "y"])
    assert ": column `y` is duplicated" in says(table=twice)
    bytes_ = pa.array([b"\xff\xfe"] * len(runs)).view(pa.string())
    assert 'row 1: column `run`: "\ufffd\ufffd" is not UTF-8' in says(table=table.set_column(0, "run", bytes_))


def test_a_damaged_file_is_named(runs, tmp_path):
    file = tmp_path / "runs.parquet"
    runs.to_parquet(file, index=False)
    whole = file.read_bytes()
    for length in (5, 1000, len(whole) // 2, len(whole) - 1):
        file.write_bytes(whole[:length])
        result = sample(tmp_path, 'table = "runs.parquet"', check=False)
        assert result.returncode == 2 and "runs.parquet: the file is damaged or cut off: " in result.stderr, result.stderr
    # the middle of the columns
    file.write_bytes(whole[:20_000] + bytes(1000) + whole[21_000:])
    result = sample(tmp_path, 'table = "runs.parquet"', check=False)
    assert result.returncode == 2 and "the file is damaged" in result.stderr, result.stderr
    assert "panicked" not in result.stderr


def test_a_study_is_written_from_parquet_as_from_csv(runs, tmp_path):
    runs = runs.rename(columns={"a": "Rod.Length [m]"})
    runs.to_csv(tmp_path / "runs.csv", index=False)
    # filtered: pandas writes the numbers of the rows
    runs.set_index(runs.index + 5).to_parquet(tmp_path / "runs.parquet")
    texts = []
    for suffix in ("csv", "parquet"):
        subprocess.run([METAFMU, "new", "x", "--table", f"runs.{suffix}"], cwd=tmp_path, check=True, capture_output=True)
        texts.append((tmp_path / "x.toml").read_text().replace(f"runs.{suffix}", "runs"))
        (tmp_path / "x.toml").unlink()
    assert texts[0] == texts[1] and '"Rod.Length" = { min' in texts[0]


def test_a_list_of_points_may_be_parquet(tmp_path):
    points = pd.DataFrame({"L": [0.1, 0.15, 0.2, 0.12], "note": list("abcd")})
    points.to_parquet(tmp_path / "points.parquet")
    points.to_csv(tmp_path / "points.csv", index=False)
    study = 'name = "s"\n[source]\nsystem = "single-pendulum"\n[time]\nstop = 1\nstep = 0.5\n[parameters]\nL = { min = 0.1, max = 0.2 }\n'
    study += '[outputs]\ntheta = {}\n[sampling]\nmethod = "list"\nfile = "points.csv"\ntest_runs = 1\n'
    tables = []
    for suffix in ("csv", "parquet"):
        (tmp_path / "study.toml").write_text(study.replace(".csv", f".{suffix}"))
        metafmu("sample", tmp_path / "study.toml", "--out", tmp_path / suffix)
        tables.append((tmp_path / suffix / "train.csv").read_bytes())
    assert tables[0] == tables[1]


SETS = ["train", "test", "calibration"]


@pytest.fixture(scope="module")
def builds(tmp_path_factory):
    """A study and the folder of its build, with tables in each format."""
    text = small_study(epochs=4)
    folder, found = tmp_path_factory.mktemp("builds"), {}
    for name in ("csv", "parquet"):
        study = folder / f"{name}.toml"
        study.write_text(text.replace("[sampling]", f'[sampling]\ntables = "{name}"') + ANY)
        printed = metafmu("build", study, "--out", folder / name).stdout
        assert all(f"{folder / name / table}.{name}  " in printed for table in SETS), printed
        found[name] = study, folder / name
    return found


def tables_of(folder):
    return sorted(path.name for path in folder.iterdir() if path.stem in SETS)


def test_tables_of_a_build_are_the_same_in_parquet_and_so_is_the_surrogate(builds, tmp_path):
    (_, of_csv), (study, folder) = builds["csv"], builds["parquet"]
    assert tables_of(folder) == sorted(f"{name}.parquet" for name in SETS)
    for name in SETS:
        expected = pd.read_csv(of_csv / f"{name}.csv")
        found = pd.read_parquet(folder / f"{name}.parquet")
        pd.testing.assert_frame_equal(found, expected, check_exact=True)
        assert list(found.dtypes) == ["int64"] + ["float64"] * (len(found.columns) - 1)
        assert np.array_equal(found.to_numpy().view("int64"), expected.to_numpy().view("int64")), "also the sign of zero"
        described = pq.ParquetFile(folder / f"{name}.parquet").schema_arrow
        assert described.names == list(expected.columns) and not any(field.nullable for field in described)
    # the format has no part in the digests of the study
    for name in ("study.safetensors", "study.fmu"):
        assert (folder / name).read_bytes() == (of_csv / name).read_bytes(), name
    evaluated = [json.loads(metafmu("evaluate", *of, "--json").stdout)["outputs"] for of in ((study, "--out", folder), (study, "--out", of_csv))]
    assert evaluated[0] == evaluated[1]
    predicted = []
    for out, table in ((of_csv, "test.csv"), (folder, "test.parquet")):
        metafmu("predict", out / "study.fmu", out / table, "--out", tmp_path / "predicted.csv")
        predicted.append((tmp_path / "predicted.csv").read_bytes())
    assert predicted[0] == predicted[1]


def test_the_bytes_of_a_table_are_those_of_any_number_of_threads(builds, tmp_path):
    study, folder = builds["parquet"]
    for threads in (1, 3):
        metafmu("sample", study, "--out", tmp_path, "--threads", threads)
        assert all((tmp_path / name).read_bytes() == (folder / name).read_bytes() for name in tables_of(folder))


@pytest.mark.parametrize(
    "moment",
    [f"{moment} {name}.parquet" for name in SETS for moment in ("complete", "replaced")]
    + ["removed samples.json", "removed train.csv", "removed test.csv", "removed calibration.csv", "complete samples.json"],
)
def test_a_build_that_is_killed_among_tables_of_another_format_ends_in_the_same_bytes(builds, tmp_path, moment):
    (other, _), (study, folder) = builds["csv"], builds["parquet"]
    metafmu("sample", other, "--out", tmp_path)
    abort_at(moment, "build", study, "--out", tmp_path)
    assert not (tmp_path / "samples.json").exists(), "no table is trusted"
    metafmu("build", study, "--out", tmp_path, "--resume")
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in folder.iterdir()}
    for name in (*tables_of(folder), "study.safetensors", "study.fmu"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes(), name


def test_tables_of_another_format_are_kept_by_a_build_that_continues(builds, tmp_path):
    (study, folder), (other, of_csv) = builds["parquet"], builds["csv"]
    shutil.copytree(of_csv, tmp_path, dirs_exist_ok=True)
    metafmu("build", study, "--out", tmp_path, "--resume")
    assert tables_of(tmp_path) == tables_of(of_csv)
    metafmu("build", study, "--out", tmp_path)
    assert tables_of(tmp_path) == tables_of(folder)
    metafmu("sample", other, "--out", tmp_path)
    assert tables_of(tmp_path) == tables_of(of_csv)


def test_a_damaged_table_of_a_build_is_used_by_no_verb(builds, tmp_path):
    study, folder = builds["parquet"]
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    for number, (verb, table) in enumerate([("train", "train"), ("train", "calibration"), ("evaluate", "test"), ("report", "test"), ("build", "train")]):
        path = tmp_path / f"{table}.parquet"
        good = path.read_bytes()
        wrong = bytearray(good)
        wrong[(number + 1) * len(good) // 7] ^= 1 << number
        for damaged in (bytes(wrong), good[: len(good) // 2], b""):
            path.write_bytes(damaged)
            resume = ["--resume"] if verb == "build" else []
            refused = metafmu(verb, study, "--out", tmp_path, *resume, check=False)
            assert refused.returncode == 2 and f"{path}: was changed or damaged after the sampling" in refused.stderr, refused.stderr
            assert "panicked" not in refused.stderr and path.read_bytes() == damaged
        path.write_bytes(good)
    metafmu("evaluate", study, "--out", tmp_path)


def test_a_table_of_more_than_five_million_numbers_is_parquet_unless_the_study_says_csv(tmp_path):
    text = (ROOT / "examples" / "mechanisms" / "double-pendulum-study.toml").read_text()
    text = text.replace('"double-pendulum.toml"', f'"{ROOT / "examples" / "mechanisms" / "double-pendulum.toml"}"')
    study = tmp_path / "study.toml"
    study.write_text(text.replace("step = 0.01", "step = 0.001").replace("test_runs = 100", "test_runs = 5").replace("runs = 1000", "runs = 100"))
    metafmu("sample", study, "--out", tmp_path / "out")
    assert tables_of(tmp_path / "out") == ["test.csv", "train.parquet"]
