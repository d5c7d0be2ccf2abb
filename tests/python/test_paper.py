"""The paper, repeated: the page has every table, figure and claim, and the command that writes it runs."""

import json
import re
import subprocess
import sys
from xml.etree import ElementTree

import pytest
from conftest import ROOT

sys.path.insert(0, str(ROOT / "scripts" / "measure"))
import paper_page

PAGE = (ROOT / "docs" / "paper.md").read_text(encoding="utf-8")
PICTURES = ROOT / "docs" / "paper"
RESULTS = json.loads((PICTURES / "results.json").read_text(encoding="utf-8"))
ROWS = {(kind, name): row for kind in ("claims", "tables", "figures") for name, row in paper_page.LISTED[kind].items()}
NAMES = {row["picture"] for row in ROWS.values() if "picture" in row}


def rows_of(text):
    """Cells of the rows of five columns, by the first."""
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("| ")]
    return {row[0]: row for row in rows if len(row) == 5}


def test_the_list_has_the_eleven_tables_and_seventeen_figures_of_the_paper():
    for kind, what, count in (("tables", "Table", 11), ("figures", "Figure", 17)):
        numbers = [int(re.match(rf"{what} (\d+): ", row["title"])[1]) for row in paper_page.LISTED[kind].values()]
        assert numbers == list(range(1, count + 1))
    assert len(paper_page.LISTED["claims"]) == 21


@pytest.mark.parametrize("key", ROWS, ids="-".join)
def test_every_item_of_the_paper_has_a_complete_row(key):
    row = ROWS[key]
    found = rows_of(PAGE)[row["title"]]
    assert found[1] == row["paper"] and all(found)
    assert ("part" in row) != ("ours" in row)
    # every value is of a part that was measured
    parts = {row["part"], f"{row['part']}-full"} if "part" in row else set()
    if parts and not parts & set(RESULTS):
        assert all(cell.startswith("not measured: `--") for cell in found[2:4])
        assert found[4] == "-"


def test_a_claim_holds_only_with_values_that_show_it():
    column = {name: rows_of(PAGE)[row["title"]][4] for (kind, name), row in ROWS.items() if kind == "claims"}
    assert set(column.values()) <= {"yes", "no", "-"} and column["pendulum-r2"] == "yes"
    inaccurate = RESULTS["single-pendulum"] | {"full": RESULTS["single-pendulum"]["full"] | {"r2": [0.99, 0.999, 0.999]}}
    page = paper_page.document(RESULTS | {"single-pendulum": inaccurate})
    assert rows_of(page)[ROWS["claims", "pendulum-r2"]["title"]][4] == "no"


def test_the_page_is_what_its_results_give():
    assert paper_page.document(RESULTS) == PAGE, "run scripts/measure paper"


def test_a_part_that_was_never_measured_has_no_values():
    empty = rows_of(paper_page.document({}))
    for row in ROWS.values():
        if "part" in row:
            assert all(cell.startswith("not measured: `--") for cell in empty[row["title"]][2:4])


def test_every_measured_part_has_its_small_pictures():
    drawn = {row["picture"] for row in ROWS.values() if "picture" in row and paper_page.is_drawn(row, RESULTS)}
    assert {path.stem for path in PICTURES.glob("*.svg")} == drawn and "systems" in drawn
    for name in drawn:
        text = (PICTURES / f"{name}.svg").read_text(encoding="utf-8")
        assert ElementTree.fromstring(text).find("{*}title").text
        assert len(text.encode()) < 150_000, name
        assert f"(paper/{name}.svg)" in PAGE


def test_scores_have_two_digits_of_their_distance_to_one():
    assert [paper_page.score(r2) for r2 in (0.99968, 0.99999994, 0.5, -1.0)] == ["0.99968", "0.999999940", "0.500", "-1.000"]


def test_the_smallest_part_of_the_command_runs(tmp_path):
    command = [sys.executable, ROOT / "scripts" / "measure", "paper", "--only", "samples", "--docs", tmp_path, "--out", tmp_path / "out"]
    subprocess.run(command, check=True, capture_output=True, cwd=ROOT)
    values = json.loads((tmp_path / "paper" / "results.json").read_text(encoding="utf-8"))["samples"]
    # five decimals of the paper's Table 1, and the numbers of rows in its text
    assert values["table-1"] < 5.1e-6
    assert [values["rows"][system]["rows"] for system in ("single-pendulum", "double-pendulum")] == [267_531, 7_335_141]
    assert (tmp_path / "paper" / "systems.svg").read_bytes() == (PICTURES / "systems.svg").read_bytes()
    fresh, page = rows_of((tmp_path / "paper.md").read_text(encoding="utf-8")), rows_of(PAGE)
    for row in ROWS.values():
        if row.get("part") == "samples":
            assert fresh[row["title"]] == page[row["title"]]
