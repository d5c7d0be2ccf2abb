"""Hosts of the package registry run every kind of FMU as it is exported, and do what `metafmu validate --hosts` predicts."""

import subprocess

import pytest
from conftest import ROOT, metafmu
from test_habits import folder  # noqa: F401

pytestmark = pytest.mark.thorough
PYTHON = ROOT / ".hosts" / "bin" / "python"
# arrays of outputs in FMI 3.0
FAILING = {("response-with-bounds-fmi3", host) for host in ("pathsim-fmi", "cofmupy", "estim8", "casadi")}


def table(program, *arguments):
    """Rows of a table that a program prints, by their first cells."""
    assert PYTHON.exists(), "run `scripts/venv.sh --hosts` first"
    result = subprocess.run([PYTHON, ROOT / "tests" / "hosts" / program, *arguments], capture_output=True, text=True)
    lines = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in result.stdout.splitlines() if line.startswith("|")]
    assert len(lines) > 2, result.stderr
    head, _, *rows = lines
    return {row[0]: dict(zip(head[1:], row[1:], strict=True)) for row in rows}


def test_hosts_run_every_kind_as_it_is_exported(folder):  # noqa: F811
    rows = table("installed.py", folder)
    assert len(rows) == 18
    failed = {}
    for fmu, cells in rows.items():
        for host, cell in cells.items():
            if cell != "-" and not (cell[0].isdigit() and float(cell) < 1e-6):
                failed[fmu, host] = cell
    assert set(failed) == FAILING, failed


def test_hosts_do_what_is_predicted_of_boolean_ports_and_constants(folder, tmp_path):  # noqa: F811
    for name, ports in {"equations": "domain", "discrete": "domain,measured", "response-with-bounds": "bounds"}.items():
        for version in (2, 3):
            metafmu("export", folder / f"{name}.fmu", "--ports", ports, "--fmi", version, "--out", tmp_path / f"{name}-{version}")
    rows = table("predicted.py", *sorted(tmp_path.rglob("*.fmu")))
    totals = rows.pop("right of 6")
    wrong = {(fmu, host): cell for fmu, cells in rows.items() for host, cell in cells.items() if "predicted otherwise" in cell}
    assert wrong == {} and set(totals.values()) == {"6"}, wrong
    # and there is something to predict
    assert any(cell == "fails" for cells in rows.values() for cell in cells.values())
