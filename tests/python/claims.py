"""Sentences of the documentation that promise something or have a number, and the list of what shows each: scripts/claims.toml."""

import re
import tomllib

from conftest import ROOT

LIST = ROOT / "scripts" / "claims.toml"
# of a page that is neither README nor a tutorial: what is seen before scrolling
FIRST_SCREEN_LINES = 25
NUMBERS = "two|three|four|five|six|seven|eight|nine|ten|twelve|twenty|fifty|hundred|thousand"
PROMISE = re.compile(rf"\d|\b(?:every|always|never|exact|exactly|all|no|none|nothing|neither|{NUMBERS})\b", re.I)
# numbers in names and in versions that are required
NAMES = re.compile(r"FMI [\d.]+(?: (?:or|and) [\d.]+)?|SSP [\d.]+|x86-64|64-bit|(?:Python|CPython|Rust|glibc|Windows) [\d.]+|C99|UTF-8|Latin-1|float32|\d+-D\b")


def sentences(text):
    """Sentences of paragraphs and list items: without headings, tables, pictures, code and targets of links."""
    # a block may end beyond the first screen
    text = re.sub(r"^---\n.*?^---\n|<!--.*?-->|```.*?(?:```|\Z)", "", text, flags=re.S | re.M)
    lines = [line for line in text.split("\n") if not re.match(r"    |#|\||!\[|</?div", line)]
    paragraphs = re.split(r"\n\s*\n|\n(?=\s*(?:-|\d+\.) )", "\n".join(lines))
    found = []
    for paragraph in paragraphs:
        plain = re.sub(r"^\s*(?:-|\d+\.) +", "", " ".join(paragraph.split()))
        plain = re.sub(r"!?\[([^\]]*)\](?:\([^)]*\))?", r"\1", plain).replace("**", "").replace("*", "")
        found += [sentence for sentence in re.split(r"(?<!al\.)(?<![\s-][A-Z]\.)(?<=[.!?])\s+", plain) if sentence]
    return found


def is_claim(sentence):
    return bool(PROMISE.search(NAMES.sub("", re.sub(r"`[^`]*`", "", sentence))))


def pages():
    """Texts that are checked, by name of the page."""
    found = {"README.md": (ROOT / "README.md").read_text(encoding="utf-8")}
    for page in sorted((ROOT / "docs").rglob("*.md")):
        text = page.read_text(encoding="utf-8")
        if page.parent.name == "maintainers":
            continue
        if page.parent.name != "tutorial":
            lines = text.split("\n")
            # to the first heading of the second level, or to the end of the paragraph at the edge of the screen
            ends = lambda number, line: line.startswith("## ") or number >= FIRST_SCREEN_LINES and not line.strip()
            end = next((number for number, line in enumerate(lines) if ends(number, line)), len(lines))
            text = "\n".join(lines[:end])
        found[str(page.relative_to(ROOT))] = text
    return found


def claims():
    """Sentences that promise something or have a number, by page."""
    return {page: [sentence for sentence in sentences(text) if is_claim(sentence)] for page, text in pages().items()}


def listed(file=LIST):
    """Evidence of each claim: names by beginning of the sentence, by page."""
    return {page: {beginning: names.split() for beginning, names in of.items()} for page, of in tomllib.loads(file.read_text(encoding="utf-8")).items()}
