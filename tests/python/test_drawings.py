"""The pictures of docs/elements, which scripts/drawings.py makes from runs of examples/mechanisms/elements."""

import re
import sys
from xml.etree import ElementTree

import pytest
from conftest import ROOT

sys.path.insert(0, str(ROOT / "scripts"))
import drawings

PAGE = (ROOT / "docs" / "mechanisms.md").read_text()


def test_every_element_has_a_mechanism_and_a_picture_in_the_page():
    names = sorted(drawings.ELEMENTS)
    assert len(names) == 17
    for folder, kind in ((drawings.MECHANISMS, "toml"), (drawings.PICTURES, "svg")):
        assert sorted(path.name for path in folder.iterdir()) == [f"{name}.{kind}" for name in names]
    shown = re.findall(r"^!\[(.+)\]\(elements/(.+)\.svg\)$", PAGE, re.MULTILINE)
    assert sorted(shown, key=lambda pair: pair[1]) == [(drawings.ELEMENTS[name][0], name) for name in names]


@pytest.mark.parametrize("name", drawings.ELEMENTS)
def test_a_picture_is_what_its_runs_give(name):
    """The script compares each run with its reference, to a millionth."""
    drawn = drawings.drawn(name)
    assert drawn == (drawings.PICTURES / f"{name}.svg").read_text(encoding="utf-8"), "run scripts/drawings.py"
    assert ElementTree.fromstring(drawn).tag.endswith("svg") and len(drawn.encode()) < 60_000
