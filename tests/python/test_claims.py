"""Sentences of the documentation that promise something or have a number are bound to what shows it: scripts/claims.toml."""

import json
import re
import subprocess
import sys
import tomllib

import pytest
from claims import claims, is_claim, listed, sentences
from conftest import METAFMU, ROOT

sys.path.insert(0, str(ROOT / "scripts"))
import gallery  # noqa: E402

CLAIMS, LISTED = claims(), listed()
FIGURES = tomllib.loads((ROOT / "scripts" / "figures.toml").read_text(encoding="utf-8"))
KINDS = {"(citation)", "(definition)", "(limit)", "(link)", "(project)"}


def renewed(page):
    """Beginnings of sentences that a figure renews with their paragraph."""
    text = (ROOT / page).read_text(encoding="utf-8")
    found = set()
    for figure in FIGURES.values():
        for beginning in figure.get("paragraphs", []) if figure["page"].split("#")[0] == page else []:
            paragraph = re.split(r"\n\s*\n|\n- ", text[text.index(beginning) :])[0]
            found |= set(sentences(paragraph))
    return found


@pytest.mark.parametrize("page", CLAIMS)
def test_every_claim_of_a_page_is_listed(page):
    bound, exempt = LISTED.get(page, {}), renewed(page)
    missing = [sentence for sentence in CLAIMS[page] if sentence not in exempt and not any(sentence.startswith(beginning) for beginning in bound)]
    assert missing == [], f"{page}: add these sentences to scripts/claims.toml with the test or figure that shows them, or write them without a promise"


@pytest.mark.parametrize("page", LISTED)
def test_every_listed_sentence_is_a_claim_of_its_page(page):
    assert [beginning for beginning in LISTED[page] if not any(sentence.startswith(beginning) for sentence in CLAIMS[page])] == []


def test_evidence_exists():
    files = subprocess.run(["git", "ls-files", "*.rs", "*.py"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    tests = set()
    for file in files:
        text = (ROOT / file).read_text(encoding="utf-8")
        pattern = r"#\[test\]\s+(?:#\[[^\n]*\]\s+)*fn (\w+)" if file.endswith(".rs") else r"^def (test_\w+)"
        tests |= set(re.findall(pattern, text, re.M))
    assert len(tests) > 1500
    unknown = []
    for page, of in LISTED.items():
        for beginning, names in of.items():
            assert names and (len(names) == 1 or not KINDS & set(names)), beginning
            for name in names:
                is_known = name in KINDS or name in tests or name.removeprefix("figure:") in FIGURES or name.startswith("scripts/") and (ROOT / name).is_file()
                unknown += [] if is_known else [f"{page}: {beginning}: {name}"]
    assert unknown == []


def test_what_counts_as_a_claim():
    text = "# Ten\n\nIt is quick. It takes 5 s, as `x = 7` says.\n- Every step is [exact](page.md#2),\n  always.\n\n| 3 |\n\n    4 times\n\nFMI 2.0 is read. See H.-S. Choi et al. 2021.\n"
    assert sentences(text) == ["It is quick.", "It takes 5 s, as `x = 7` says.", "Every step is exact, always.", "FMI 2.0 is read.", "See H.-S. Choi et al. 2021."]
    assert [is_claim(sentence) for sentence in sentences(text)] == [False, True, True, False, True]
    assert not is_claim("It prints `5`.")


def test_counts_that_pages_state(tmp_path):
    assert len(gallery.SURROGATES) == 8
    assert len(list((ROOT / "examples" / "notebooks").glob("*.ipynb"))) == 6
    templates = subprocess.run([METAFMU, "help", "new"], capture_output=True, text=True, check=True).stdout
    templates = re.search(r"--template <TEMPLATE>\n.*?--mechanism <", templates, re.S)[0]
    assert len(re.findall(r"^ +- [a-z-]+: ", templates, re.M)) == 14
    subprocess.run([METAFMU, "new", tmp_path / "one", "--system", "single-pendulum", "--schema"], capture_output=True, check=True)
    schema = json.loads((tmp_path / "study.schema.json").read_text(encoding="utf-8"))
    models = schema["properties"]["baselines"]["properties"]
    assert len(models["models"]["items"]["enum"]) == 12 and len(models["build"]["default"]) == 4
