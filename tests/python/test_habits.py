"""Habits of hosts: each gives what a host that follows the standard gets, of every kind of surrogate, with the library and with the C sources."""

import subprocess
import sys

import pytest
from conftest import ROOT

sys.path.insert(0, str(ROOT / "tests" / "hosts"))
import habits

KINDS = (
    "response", "response-of-time-points", "response-with-input", "response-with-bounds", "equations", "equations-with-actuator",
    "network-of-rates", "discrete", "recurrent",
)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("kinds")
    subprocess.run([ROOT / "target" / "release" / "examples" / "kinds", folder], check=True)
    assert {path.stem for path in folder.iterdir()} == {f"{kind}{ending}" for kind in KINDS for ending in ("", "-fmi3")}
    return folder


@pytest.mark.parametrize("ending", ["", "-fmi3"], ids=["2", "3"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_habit_gets_what_it_means(kind, ending, folder, tmp_path):
    wrong = habits.cells(folder / f"{kind}{ending}.fmu", tmp_path)
    assert len(wrong) == len(habits.HABITS) and not any(wrong.values()), wrong
    assert sum(failures is not None for failures in wrong.values()) >= 10


def test_what_is_refused_is_in_the_table_with_the_fmus_sentence(folder, tmp_path, monkeypatch):
    def set_an_output(host):
        """an output is set"""
        host.initialize()
        host.set({host.named("output")[0].name: 1.0})
        return host.finish()

    monkeypatch.setitem(habits.HABITS, "set_an_output", (set_an_output, "none", 2, "cs"))
    text, wrong = habits.table([folder / "equations.fmu"], tmp_path)
    assert wrong == 1 and text.count("is an output and cannot be set") == 2, text
    assert len(text.splitlines()) == 2 + len(habits.HABITS)


def test_the_page_has_every_habit():
    rows = [line.split(" | ") for line in (ROOT / "docs" / "calls.md").read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    listed = {row[0].removeprefix("| ") for row in rows if len(row) == 3} - {"call"}
    assert listed == {function.__doc__ for function, *_ in habits.HABITS.values()}
