"""Tutorials: their blocks run as a reader would paste them, and write the pictures that the pages show."""

import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "scripts"))
import tutorial  # noqa: E402

# the network's needs the Python package: python/tests/test_tutorial.py
PAGES = ["mechanism", "table"]


@pytest.mark.parametrize("name", PAGES)
def test_the_blocks_run(name, tmp_path):
    page = ROOT / "docs" / "tutorial" / f"{name}.md"
    tutorial.run(page, tmp_path)
    shown = tutorial.pictures(page)
    assert shown
    for picture in shown:
        assert re.search("<(path|polyline)", (tmp_path / picture).read_text(encoding="utf-8"))
        assert (page.parent / picture).is_file()


def test_every_tutorial_is_run():
    pages = {page.stem for page in (ROOT / "docs" / "tutorial").glob("*.md")}
    assert pages == {*PAGES, "network"}
