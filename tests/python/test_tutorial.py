"""Tutorials: their blocks run as a reader would paste them, and write the pictures that the pages show."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "scripts"))
import tutorial  # noqa: E402

# the network's needs the Python package: python/tests/test_tutorial.py
PAGES = ["mechanism", "table"]


@pytest.fixture(scope="module", params=PAGES)
def finished(request, tmp_path_factory):
    """A page, and the folder in which its blocks ran."""
    page, folder = ROOT / "docs" / "tutorial" / f"{request.param}.md", tmp_path_factory.mktemp(request.param)
    tutorial.run(page, folder)
    return page, folder


def test_the_blocks_run(finished):
    page, folder = finished
    shown = tutorial.pictures(page)
    assert shown
    for picture in shown:
        assert re.search("<(path|polyline)", (folder / picture).read_text(encoding="utf-8"))
        assert (page.parent / picture).is_file()


def test_an_arm_beyond_its_range_leaves_the_domain(finished):
    page, folder = finished
    if page.stem != "mechanism":
        pytest.skip("another page")
    assert "Set `L` to 0.7 instead of 0.55, beyond its\nrange: `in_domain` becomes false" in page.read_text(encoding="utf-8")
    script = (folder / "loop.py").read_text(encoding="utf-8")
    assert script.count("0.55") == 1
    # an assertion of both conditions: only the domain may fail
    outside = script.replace("0.55", "0.7").replace("assert abs(angle[-1] - target) < 0.01 and all(in_domain)", "assert not any(in_domain)")
    found = subprocess.run([sys.executable, "-c", outside], cwd=folder, capture_output=True, text=True)
    assert found.returncode == 0, found.stderr
    assert "variable `L`: 0.7 is outside the training range from 0.4 to 0.6" in found.stdout + found.stderr


def test_every_tutorial_is_run():
    pages = {page.stem for page in (ROOT / "docs" / "tutorial").glob("*.md")}
    assert pages == {*PAGES, "network"}
