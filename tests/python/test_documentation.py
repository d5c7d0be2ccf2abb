"""The documentation: links between files, and the site that is built of it."""

import re
import subprocess
import tomllib
from html.parser import HTMLParser
from urllib.parse import unquote

import pytest
from conftest import DESKTOP, PHONE, ROOT, show
from selenium.webdriver.support.wait import WebDriverWait

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


@pytest.mark.parametrize("page", ["index.html", "tutorial/mechanism.html", "maintainers/style.html"])
def test_a_page_loads_nothing_from_elsewhere(site, browser, page):
    requested = show(browser, site / "docs" / page, DESKTOP)
    assert len(requested) > 5 and [url for url in requested if not url.startswith(("file:", "data:"))] == []


def test_no_page_names_a_file_from_elsewhere(site):
    loads = re.compile(r"""<(?:script|img|iframe|source|embed|link (?:[^>]* )?rel="(?!canonical|prev|next)[^"]*")[^>]*(?:src|href)="((?:https?:)?//[^"]*)""")
    assert {page.name: loads.findall(page.read_text(encoding="utf-8")) for page in site.glob("docs/**/*.html")}.keys() >= {"index.html", "404.html"}
    assert [found for page in site.glob("docs/**/*.html") for found in loads.findall(page.read_text(encoding="utf-8"))] == []


def test_the_search_finds_pages_that_are_opened_as_files(site, browser):
    show(browser, site / "docs" / "index.html", DESKTOP)
    focused = "const field = document.activeElement?.shadowRoot?.activeElement; if (!field) document.querySelector('.md-search__button').click(); return field"
    WebDriverWait(browser, 60).until(lambda browser: browser.execute_script(focused)).send_keys("torsion")
    found = "return [...document.activeElement.shadowRoot.querySelectorAll('a')].map(a => a.href).filter(href => href.includes('h=torsion'))"
    assert WebDriverWait(browser, 60).until(lambda browser: browser.execute_script(found))
    assert browser.get_log("browser") == []


def test_comments_of_commands_stay_inside_a_phone(site, browser):
    show(browser, site / "docs" / "install.html", PHONE)
    cut = "return [...document.querySelectorAll('.wraps, .wraps .comment')].filter(e => e.getBoundingClientRect().right > innerWidth || e.scrollWidth > e.clientWidth + 1 && e.tagName == 'CODE').length"
    assert browser.execute_script("return document.querySelectorAll('.wraps .comment').length") > 3
    assert browser.execute_script(cut) == 0


def test_the_site_has_the_version_of_the_package(site):
    version = tomllib.loads((ROOT / "Cargo.toml").read_text(encoding="utf-8"))["workspace"]["package"]["version"]
    settings = tomllib.loads((ROOT / "zensical.toml").read_text(encoding="utf-8"))["project"]
    assert settings["site_name"] == f"metafmu {version}" and f"metafmu {version}, " in settings["copyright"]
    assert f"metafmu {version}" in (site / "docs" / "install.html").read_text(encoding="utf-8")
