"""The gallery: its page, its pictures and the commands that it shows."""

import re
import sys
from xml.etree import ElementTree

import pytest
from conftest import ROOT

sys.path.insert(0, str(ROOT / "scripts"))
import gallery

PAGE = gallery.PAGE.read_text(encoding="utf-8")


def test_the_page_is_what_the_script_writes():
    accuracies = gallery.accuracies_of(PAGE)
    assert len(accuracies) == 8
    for sentence in accuracies.values():
        assert re.fullmatch(r"Largest error of all outputs in \d+ unseen (runs|rows): (less than 0\.001|0\.\d+|\d) % of the range\.", sentence)
    assert gallery.document(accuracies) == PAGE


def test_every_entry_has_a_small_picture():
    assert sorted(path.name for path in gallery.PICTURES.iterdir()) == sorted(f"{name}.svg" for name in gallery.SURROGATES)
    for name in gallery.SURROGATES:
        text = (gallery.PICTURES / f"{name}.svg").read_text(encoding="utf-8")
        picture = ElementTree.fromstring(text)
        assert picture.find("{*}title").text == gallery.alternative(name)
        assert len(text.encode()) < 50_000


@pytest.mark.parametrize("name", gallery.SURROGATES)
def test_commands_name_files_of_the_examples(name):
    one = gallery.SURROGATES[name]
    files = [word for command in one.commands for word in command.split() if word.startswith("examples/")]
    assert len(files) == 1 and (ROOT / files[0]).is_file()
    text = (ROOT / files[0]).read_text(encoding="utf-8")
    for output in one.outputs:
        # of a mechanism, or of a study that takes it from there
        assert re.search(rf'^"?{re.escape(output)}"? = ', text, re.M), output


def test_a_curve_keeps_its_corners_and_loses_points_on_its_lines():
    line = [(float(x), 0.0) for x in range(50)]
    assert gallery.thinned(line) == [line[0], line[-1]]
    assert gallery.thinned([*line, (50.0, 7.0), (51.0, 0.0)]) == [line[0], line[-1], (50.0, 7.0), (51.0, 0.0)]


def test_a_picture_is_what_its_commands_give(tmp_path):
    """The cam is exact, so its picture does not depend on the processor."""
    gallery.build("cam", tmp_path)
    assert gallery.drawn("cam", tmp_path) == (gallery.PICTURES / "cam.svg").read_text(encoding="utf-8"), "run scripts/gallery.py cam"
    assert gallery.accuracy("cam", tmp_path) == gallery.accuracies_of(PAGE)["cam"]
