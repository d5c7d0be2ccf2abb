"""The tutorial of the package: its blocks run as a reader would paste them."""

import re
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "scripts"))
import tutorial  # noqa: E402


def test_the_blocks_of_the_network_tutorial_run(tmp_path):
    page = ROOT / "docs" / "tutorial" / "network.md"
    tutorial.run(page, tmp_path)
    for picture in tutorial.pictures(page):
        assert re.search("<(path|polyline)", (tmp_path / picture).read_text(encoding="utf-8"))
        assert (page.parent / picture).is_file()
