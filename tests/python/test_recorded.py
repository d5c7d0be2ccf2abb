"""Recorded runs as pandas writes them in other countries and other layouts give the surrogate of the plain table."""

import subprocess

import pandas as pd
import pytest
from conftest import ANY, METAFMU, ROOT, metafmu

OUTPUTS = ["theta", "psi"]
PARAMETERS = ["crank_length", "theta0", "damping"]

STUDY = """name = "four-bar"
[source]
{source}
[time]
stop = 1.0
step = 0.01
[parameters]
crank_length = {{ min = 0.15, max = 0.25, unit = "m" }}
theta0 = {{ min = 0.5, max = 1.1, unit = "rad" }}
damping = {{ min = 0.02, max = 0.1 }}
[outputs]
theta = {{ unit = "rad" }}
psi = {{}}
[sampling]
test_runs = 4
[network]
hidden = [8]
[training]
epochs = 2
"""


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A few runs of the four-bar linkage as metafmu samples them."""
    folder = tmp_path_factory.mktemp("four-bar")
    study = (ROOT / "examples" / "mechanisms" / "four-bar-study.toml").read_text()
    mechanism = ROOT / "examples" / "mechanisms" / "four-bar.toml"
    study = study.replace("\nruns = 500", "\nruns = 20").replace('"four-bar.toml"', f'"{mechanism}"')
    (folder / "study.toml").write_text(study)
    metafmu("sample", folder / "study.toml", "--out", folder)
    return pd.read_csv(folder / "train.csv")[["run", "time", *PARAMETERS, *OUTPUTS]]


def trained(folder, source):
    """The bytes of the tables, and the losses of the first epoch."""
    (folder / "study.toml").write_text(STUDY.format(source=source) + ANY)
    metafmu("build", folder / "study.toml", "--out", folder / "out")
    tables = [(folder / "out" / name).read_bytes() for name in ("train.csv", "test.csv")]
    return tables, (folder / "out" / "history.csv").read_text().split("\n")[1].rsplit(",", 1)[0]


def test_every_layout_is_the_same_table(runs, tmp_path):
    folders = [tmp_path / name for name in ("plain", "german", "tabs", "files")]
    for folder in folders:
        folder.mkdir()
    runs.to_csv(folders[0] / "runs.csv", index=False)
    german = runs.rename(columns={"theta": "Kurbel.Winkel [rad]", "time": "Zeit [s]"})
    german.to_csv(folders[1] / "runs.csv", index=False, sep=";", decimal=",", encoding="utf-8-sig", quoting=1)
    runs.drop(columns="run").to_csv(folders[2] / "runs.csv", index=False, sep="\t", lineterminator="\r\n")
    index = []
    for run, rows in runs.groupby("run"):
        index.append([f"run{run}.csv", *rows[PARAMETERS].iloc[0]])
        rows[["time", *OUTPUTS]].to_csv(folders[3] / f"run{run}.csv", index=False)
    pd.DataFrame(index, columns=["file", *PARAMETERS]).to_csv(folders[3] / "index.csv", index=False)

    table = 'table = "runs.csv"'
    names = 'columns = { theta = "Kurbel.Winkel", time = "Zeit" }'
    expected = trained(folders[0], table)
    assert trained(folders[1], f"{table}\n{names}") == expected
    assert trained(folders[2], table) == expected
    assert trained(folders[3], 'index = "index.csv"') == expected


def test_a_value_that_pandas_left_out_is_named(runs, tmp_path):
    runs = runs.copy()
    runs.loc[7, "psi"] = float("nan")
    runs.to_csv(tmp_path / "runs.csv", index=False)
    (tmp_path / "study.toml").write_text(STUDY.format(source='table = "runs.csv"'))
    result = metafmu("sample", tmp_path / "study.toml", "--out", tmp_path / "out", check=False)
    assert result.returncode == 2
    assert "runs.csv:9: column `psi`: is empty, expected a finite number" in result.stderr
    assert not (tmp_path / "out" / "train.csv").exists()


def test_a_study_is_written_from_a_table(tmp_path):
    rows = ["run;t;Rod.Length [m];mass;Tip.Angle [rad];on"]
    for run in range(12):
        for step in range(5):
            time, length, angle = (str(x).replace(".", ",") for x in (0.25 * step, 1 + 0.125 * run, 0.5 * step + run))
            rows.append(f"r{run};{time};{length};3;{angle};{step % 2}")
    (tmp_path / "runs.csv").write_text("\n".join(rows) + "\n")
    run = lambda *arguments: subprocess.run([METAFMU, *arguments], cwd=tmp_path, capture_output=True, text=True)
    result = run("new", "x", "--table", "runs.csv")
    assert result.returncode == 0, result.stderr
    text = (tmp_path / "x.toml").read_text()
    for line in [
        'columns = { time = "t" }',
        "stop = 1.0 ",
        "step = 0.25 ",
        '"Rod.Length" = { min = 1.0, max = 2.375, unit = "m" }',
        "# mass is always 3",
        '"Tip.Angle" = { unit = "rad" }',
        "on = {}",
    ]:
        assert line in text, text
    result = run("sample", "x.toml", "--out", "out")
    assert result.returncode == 0, result.stderr
    # without labels a time that does not come after the one before begins a run
    (tmp_path / "plain.csv").write_text("\n".join(row.partition(";")[2] for row in rows) + "\n")
    assert run("new", "plain", "--table", "plain.csv").returncode == 0
    body = lambda name: (tmp_path / name).read_text().partition("[time]")[2]
    assert body("plain.toml") == body("x.toml")
    # nothing to learn from
    (tmp_path / "flat.csv").write_text("run,time,a,y\n0,0,1,2\n0,1,1,3\n1,0,1,2\n1,1,1,3\n")
    result = run("new", "flat", "--table", "flat.csv")
    assert result.returncode == 2 and "flat.csv:1: no column has one value in each run and others in other runs" in result.stderr
    assert not (tmp_path / "flat.toml").exists()
