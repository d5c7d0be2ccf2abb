"""`metafmu plan` writes points that its study's table accepts, in the ranges, none twice, and better than random ones."""

import csv

import numpy as np
from conftest import metafmu

STUDY = """name = "s"
structure = "static"
[source]
table = "points.csv"
columns = { b = "Wide B" }
[inputs]
a = { min = -1, max = 1 }
b = { min = 0, max = 300, unit = "m" }
[outputs]
y = {}
"""


def plan(folder, points, *arguments, check=True):
    return metafmu("plan", "s.toml", "--points", points, *arguments, cwd=folder, check=check)


def rows(text):
    return list(csv.DictReader(text.splitlines()))


def of(row):
    return float(np.sin(3 * float(row["a"])) * float(row["Wide B [m]"]))


def filled(text):
    """The table with outputs."""
    table = rows(text)
    return "a,Wide B [m],y\n" + "".join(f"{row['a']},{row['Wide B [m]']},{of(row)!r}\n" for row in table)


def test_points_fill_the_ranges_before_a_table_exists_and_then_its_gaps(tmp_path):
    (tmp_path / "s.toml").write_text(STUDY)
    first = plan(tmp_path, 12)
    assert first.stdout == plan(tmp_path, 12).stdout and "fill the ranges of a, b" in first.stderr
    table = rows(first.stdout)
    assert len(table) == 12 and all(row["y"] == "" for row in table)
    # a Latin hypercube: one point in each twelfth of each range
    for column, low, width in [("a", -1, 2), ("Wide B [m]", 0, 300)]:
        assert sorted(int((float(row[column]) - low) / width * 12) for row in table) == list(range(12))
    (tmp_path / "points.csv").write_text(filled(first.stdout))
    second = plan(tmp_path, 8, "--out", "next.csv")
    assert second.stdout == "" and "beside 12 rows" in second.stderr
    more = (tmp_path / "next.csv").read_text()
    every = rows(first.stdout) + rows(more)
    places = {(row["a"], row["Wide B [m]"]) for row in every}
    assert len(places) == 20 and all(-1 <= float(a) <= 1 and 0 <= float(b) <= 300 for a, b in places)
    # rows without outputs are planned: further points are others
    (tmp_path / "points.csv").write_text(filled(first.stdout) + more.split("\n", 1)[1])
    third = plan(tmp_path, 3)
    assert "8 of them planned" in third.stderr
    assert not places & {(row["a"], row["Wide B [m]"]) for row in rows(third.stdout)}
    # with outputs all rows are a table to build from
    (tmp_path / "points.csv").write_text(filled(first.stdout) + filled(more).split("\n", 1)[1])
    built = metafmu("build", "s.toml", cwd=tmp_path, check=False)
    assert built.returncode in (0, 1) and (tmp_path / "out" / "s" / "s.fmu").exists(), built.stderr


def test_the_columns_are_those_of_the_table_that_new_has_read(tmp_path):
    random = np.random.default_rng(1)
    lines = [f"{number},steel,{a!r},{b!r},{a * b!r}" for number, (a, b) in enumerate(random.uniform(0, 1, (15, 2)).tolist(), 1)]
    (tmp_path / "points.csv").write_text("\n".join(["id,material,a [mm],b,y", *lines]) + "\n")
    metafmu("new", "s", "--table", "points.csv", cwd=tmp_path)
    text = plan(tmp_path, 4).stdout
    assert text.splitlines()[0] == "id,material,a [mm],b,y"
    assert all(row["id"] == row["material"] == row["y"] == "" and 0 <= float(row["a [mm]"]) <= 1 for row in rows(text))


def test_what_cannot_be_planned_is_refused_with_the_reason(tmp_path):
    (tmp_path / "s.toml").write_text(STUDY.replace("a = { min = -1, max = 1 }", "a = { min = -1 }"))
    refused = plan(tmp_path, 3, check=False)
    assert refused.returncode == 2 and "inputs.a: has no range, expected `min` and `max`" in refused.stderr, refused.stderr
    (tmp_path / "s.toml").write_text(STUDY)
    for points, says in [(0, "--points: 0, expected 1 to 1000000"), (2_000_000, "--points: 2000000")]:
        refused = plan(tmp_path, points, check=False)
        assert refused.returncode == 2 and says in refused.stderr, refused.stderr
    (tmp_path / "points.csv").write_text("a,Wide B,y\n0,1,2\n0.5,x,3\n")
    refused = plan(tmp_path, 3, check=False)
    assert refused.returncode == 2 and "points.csv:3: column `Wide B`: `x`" in refused.stderr, refused.stderr
    # the rows would be lost
    refused = plan(tmp_path, 3, "--out", "points.csv", check=False)
    assert refused.returncode == 2 and "would replace the rows" in refused.stderr, refused.stderr
    metafmu("new", "p", "--system", "single-pendulum", cwd=tmp_path)
    refused = metafmu("plan", "p.toml", "--points", "3", cwd=tmp_path, check=False)
    assert refused.returncode == 2 and "structure" in refused.stderr and "sample --dry-run" in refused.stderr, refused.stderr
