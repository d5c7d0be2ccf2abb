"""The reference page of the Python package, made from its docstrings."""

import ast
import importlib.util
import re

from conftest import ROOT

specification = importlib.util.spec_from_file_location("python_reference", ROOT / "scripts" / "python_reference.py")
reference = importlib.util.module_from_spec(specification)
specification.loader.exec_module(reference)

PAGE = (ROOT / "docs" / "python-api.md").read_text(encoding="utf-8")


def test_the_page_is_up_to_date():
    assert reference.document() == PAGE


def test_every_public_name_has_a_heading():
    package = ast.parse((ROOT / "python" / "python" / "metafmu" / "__init__.py").read_text(encoding="utf-8"))
    imported = {name.name for node in ast.walk(package) if isinstance(node, ast.ImportFrom) and node.level for name in node.names} - {"__version__"}
    headings = set(re.findall(r"^### `(\w+)`$", PAGE, re.M))
    assert len(imported) > 10 and imported <= headings


def test_links_within_the_page_have_headings():
    # the marks that GitHub drops of a heading
    anchors = {re.sub(r"[^\w-]", "", heading.lower()) for heading in re.findall(r"^#+ (.*)$", PAGE, re.M)}
    targets = set(re.findall(r"\]\(#([^)]+)\)", PAGE))
    assert len(targets) > 10 and targets <= anchors


def test_blocks_are_code_or_signatures():
    blocks = re.findall(r"^```python\n(.*?)^```$", PAGE, re.M | re.S)
    assert len(blocks) > 40
    signatures = re.compile(r"[\w.]+\(")
    for block in blocks:
        try:
            ast.parse(block)
        except SyntaxError:
            # a signature is the head of a function
            ast.parse(f"def {signatures.sub('f(', block, count=1).rstrip()}: ...")
