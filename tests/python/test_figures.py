"""The list of commands behind the documentation's figures, and the script that runs them."""

import importlib.util
import json
import re
import subprocess
import sys

import pytest
from conftest import ROOT

specification = importlib.util.spec_from_file_location("figures", ROOT / "scripts" / "figures.py")
figures = importlib.util.module_from_spec(specification)
specification.loader.exec_module(figures)

LISTED = figures.figures()
COMMANDS = "\n".join(command for figure in LISTED.values() for command in figure["commands"])
# `scripts/measure WHAT`
MEASURED = re.compile(r"scripts/measure ([a-z][a-z-]*)")
HELP = subprocess.run([sys.executable, ROOT / "scripts" / "measure", "--help"], capture_output=True, text=True, check=True).stdout
SUBCOMMANDS = set(re.findall(r"^  ([a-z-]+)  ", HELP, re.M))
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def test_every_measurement_that_docs_name_exists():
    named = {what: page.name for page in PAGES for what in MEASURED.findall(page.read_text(encoding="utf-8"))}
    assert len(named) > 25
    assert {what: page for what, page in named.items() if what not in SUBCOMMANDS} == {}


def test_every_measurement_is_in_the_list():
    assert len(SUBCOMMANDS) > 25
    # that one compares two builds, for maintainers
    assert SUBCOMMANDS - {"golden"} == set(MEASURED.findall(COMMANDS))


def test_options_that_docs_give_to_a_measurement_are_known():
    """Options of commands in the list: docs and scripts change apart from it."""
    for command in re.findall(r"scripts/measure ([a-z][a-z-]*)([^\n;&|]*)", COMMANDS):
        what, rest = command
        file = ROOT / "scripts" / "measure" / f"{what.replace('-', '_')}.py"
        for option in re.findall(r"(?<!\S)(--[a-z-]+)", rest):
            assert f'"{option}"' in file.read_text(encoding="utf-8"), f"scripts/measure {what} has no {option}"


@pytest.mark.parametrize("name", LISTED)
def test_an_entry_has_its_page_and_its_files(name):
    figure = LISTED[name]
    assert set(figure) <= {"page", "commands", "key", "blocks", "paragraphs", "minutes", "needs", "root"} and figure["commands"] and figure["minutes"] > 0
    page, _, heading = figure["page"].partition("#")
    text = (ROOT / page).read_text(encoding="utf-8")
    slugs = {re.sub(r"[^\w -]", "", line.lower()).strip().replace(" ", "-") for line in re.findall(r"^#+ (.*)$", text, re.M)}
    assert not heading or heading in slugs, sorted(slugs)
    commands = "\n".join(figure["commands"])
    for path in re.findall(r"(?<![\w/$])(?:examples|scripts|docs)/[\w/.-]+\.(?:toml|py|sh|ssd|md)\b", commands):
        assert (ROOT / path).is_file(), path
    # what is not ours comes from a variable that the entry explains
    known = {"ROOT", "OUT", "WORK", "PEERS", "PWD", "name", "force", *figure.get("needs", {})}
    assert set(re.findall(r"\$\{?([A-Za-z]+)", commands)) <= known


def call(*arguments):
    return subprocess.run([sys.executable, ROOT / "scripts" / "figures.py", *map(str, arguments)], capture_output=True, text=True)


def test_rows_of_a_page_are_renewed_by_their_first_cells():
    page = "| model | error | ns |\n|---|---|---|\n| `crane` | 1e-9 | 5 |\n| pendulum | 2e-9 | 3 |\n\n| model | mass | L |\n|---|---|---|\n| crane | 4 | 2 |\n"
    output = "$ command\n| model | error | ns |\n|---|---|---|\n[WARNING] outside\n| crane | 1e-9 | 7 |\n| wiper | 1 | 2 |\n"
    text, count = figures.renewed(page, output, 1)
    assert (text, count) == (page.replace("| `crane` | 1e-9 | 5 |", "| crane | 1e-9 | 7 |"), 1)


def test_blocks_of_a_page_are_renewed_up_to_an_empty_line():
    page = "Text\n\n    metafmu build x.toml\n\n    output   R²\n    x   0.9\n\nMore x\n"
    output = "$ metafmu build x.toml\noutput     R²\nx        0.95\ny     0.8\n\nother\n"
    text, count = figures.with_blocks(page, output, ["output R²"])
    assert (text, count) == (page.replace("    output   R²\n    x   0.9\n", "    output     R²\n    x        0.95\n    y     0.8\n"), 3)
    with pytest.raises(ValueError, match="begins no block of the output"):
        figures.with_blocks(page, "", ["output R²"])


def test_paragraphs_of_a_page_are_renewed_and_wrapped():
    page = "Text\n\n- **Pays:** it takes 5 s,\n  or more.\n- Other\n\nA cable takes 7 s.\nReally.\n\nEnd\n"
    long = "- **Pays:** " + "it takes 6 s, " * 12
    output = f"$ command\n{long.strip()}\nA cable takes 8 s.\n"
    text, count = figures.with_paragraphs(page, output, ["- **Pays:**", "A cable"])
    item, rest = text.removeprefix("Text\n\n").split("\n- Other\n", 1)
    assert item.replace("\n  ", " ") == long.strip() and [len(line) <= 140 for line in item.split("\n")] == [True, True]
    assert rest == "\nA cable takes 8 s.\n\nEnd\n" and count == 3
    with pytest.raises(ValueError, match="begins no paragraph of the page"):
        figures.with_paragraphs("", output, ["A cable"])


@pytest.mark.parametrize("name", [name for name, figure in LISTED.items() if "paragraphs" in figure])
def test_the_page_of_an_entry_has_its_paragraphs(name):
    lines = (ROOT / LISTED[name]["page"].split("#")[0]).read_text(encoding="utf-8").split("\n")
    for beginning in LISTED[name]["paragraphs"]:
        assert any(line.startswith(beginning) for line in lines), beginning


@pytest.mark.parametrize("name", [name for name, figure in LISTED.items() if "blocks" in figure])
def test_the_page_of_an_entry_has_its_blocks(name):
    text = (ROOT / LISTED[name]["page"].split("#")[0]).read_text(encoding="utf-8")
    lines = [" ".join(line.split()) for line in text.split("\n") if line.startswith("    ")]
    for heading in LISTED[name]["blocks"]:
        assert any(line.startswith(heading) for line in lines), heading


def test_the_page_of_measurements_keeps_rows_of_other_figures_in_the_order_of_the_list(tmp_path):
    (tmp_path / "machine.json").write_text(json.dumps({"commit": "abc", "processor": "P", "processors": 2}))
    for name, code in [("stds", 0), ("plans", 1)]:
        (tmp_path / f"{name}.json").write_text(json.dumps({"exit_code": code, "started": "2026-01-02 03:04", "load": 0.1, "seconds": 90.0}))
    heading = "| figure | page | date | commit | processor | cores | load before | min |\n|---|---|---|---|---|---|---|---|\n"
    page = f"# Page\n\n{heading}| plans | old |\n| gone | old |\n\nend\n"
    listed = {name: {"page": "docs/tables.md#x"} for name in ("stds", "plans")}
    row = "| stds | [docs/tables.md](../tables.md#x) | 2026-01-02 | abc | P | 2 | 0.1 | 1.5 |\n"
    assert figures.listed_measurements(page, listed, tmp_path) == f"# Page\n\n{heading}{row}| plans | old |\n\nend\n"
    assert row in figures.listed_measurements(f"# Page\n\n{heading}", listed, tmp_path)
    assert figures.MEASUREMENTS.read_text(encoding="utf-8").count(heading) == 1


def test_the_list_names_figures_and_pages():
    done = call("--list", "stds", "plans")
    assert done.returncode == 0
    assert re.findall(r"^(\w+) +(docs/\S+),", done.stdout, re.M) == [
        ("stds", "docs/tables.md#predicted-standard-deviations"),
        ("plans", "docs/tables.md#plan-the-points"),
    ]
    unknown = call("--list", "stdz")
    assert unknown.returncode == 1 and "`stdz`" in unknown.stderr and "stds" in unknown.stderr


def test_it_goes_on_after_a_failure_and_does_not_repeat_what_is_finished(tmp_path):
    entry = lambda commands, minutes=1: f'page = "README.md"\ncommands = {json.dumps(commands)}\nminutes = {minutes}\n'
    file = tmp_path / "list.toml"
    entries = {
        "bad": entry(["echo before", "false", "echo after"]),
        "good": entry(["metafmu --version", "echo x >> $OUT/count"]),
        "other": entry(["echo $NOT_SET_HERE"]) + "needs = { NOT_SET_HERE = 'a thing' }\n",
        "long": entry(["touch $OUT/never"], 99),
    }
    file.write_text("".join(f"[{name}]\n{text}" for name, text in entries.items()))
    first = call("--from", file, "--out", tmp_path / "out", "--minutes", "5")
    assert first.returncode == 1 and "NOT_SET_HERE is not set: a thing" in first.stdout and "1 of 3 failed: bad" in first.stdout
    [folder] = (tmp_path / "out").iterdir()
    commit = subprocess.run(["git", "rev-parse", "--short=9", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
    assert re.match(rf"\d{{4}}-\d\d-\d\d-{commit}", folder.name)
    machine = json.loads((folder / "machine.json").read_text())
    assert machine["processor"] and machine["commit"].startswith(commit)
    output = (folder / "bad.txt").read_text()
    assert "before" in output and "$ false" in output and "after" not in output
    assert json.loads((folder / "bad.json").read_text())["exit_code"] == 1
    assert "metafmu 0." in (folder / "good.txt").read_text() and not (folder / "long").exists()

    second = call("--from", file, "--out", tmp_path / "out", "bad", "good")
    assert second.returncode == 1 and "good: finished before" in second.stdout
    assert (folder / "good" / "count").read_text() == "x\n"
    # a command that changed is run again
    file.write_text(file.read_text().replace("echo x", "echo y"))
    assert call("--from", file, "--out", tmp_path / "out", "good").returncode == 0
    assert (folder / "good" / "count").read_text() == "x\ny\n"
