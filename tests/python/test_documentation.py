"""The documentation: links between files, and the site that is built of it."""

import re
import subprocess
import tomllib
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs").rglob("*.md"))


def links(page):
    """Targets of the links of a page, without those in code."""
    text = re.sub(r"```.*?```|`[^`]*`", "", page.read_text(encoding="utf-8"), flags=re.S)
    text = "\n".join(line for line in text.splitlines() if not line.startswith("    "))
    return re.findall(r"\]\(([^)\s]+)\)", text)


def test_files_that_pages_link_to_exist():
    listed = subprocess.run(["git", "ls-files", "*.md"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    found, missing = 0, []
    for page in (ROOT / name for name in listed):
        for target in links(page):
            if re.match(r"[a-z]+:|#", target):
                continue
            found += 1
            if not (page.parent / target.split("#")[0]).exists():
                missing.append(f"{page.relative_to(ROOT)}: {target}")
    assert missing == [] and found > 150


def test_the_navigation_has_every_page_once():
    settings = tomllib.loads((ROOT / "zensical.toml").read_text(encoding="utf-8"))["project"]
    listed = [page for section in settings["nav"] for pages in section.values() for entry in pages for page in entry.values()]
    assert sorted(listed) == sorted(str(page.relative_to(ROOT / "docs")) for page in PAGES)


class Targets(HTMLParser):
    def __init__(self):
        super().__init__()
        self.found = []

    def handle_starttag(self, tag, attributes):
        self.found += [value for name, value in attributes if name in ("href", "src") and value]


@pytest.fixture(scope="module")
def site():
    subprocess.run([ROOT / "scripts" / "site.sh"], cwd=ROOT, check=True, capture_output=True)
    return ROOT / "target" / "site"


def test_the_site_has_every_page_and_no_dead_link(site):
    pages = [page for page in site.glob("docs/**/*.html") if page.name != "404.html"]
    assert len(pages) == len(PAGES)
    missing = []
    for page in pages:
        parser = Targets()
        parser.feed(page.read_text(encoding="utf-8"))
        targets = {unquote(target.split("#")[0].split("?")[0]) for target in parser.found if not re.match(r"[a-z]+:|//|#", target)}
        missing += [f"{page.name}: {target}" for target in sorted(targets) if target and not (page.parent / target).exists()]
    assert missing == []


def test_the_site_can_be_searched(site):
    index = (site / "docs" / "search.json").read_text(encoding="utf-8")
    assert "torsion" in index and "in_domain" in index
