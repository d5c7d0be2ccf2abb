"""Recorded runs as pandas writes them in other countries and other layouts give the surrogate of the plain table."""

import pandas as pd
import pytest
from conftest import ROOT, metafmu

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
    (folder / "study.toml").write_text(STUDY.format(source=source))
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
