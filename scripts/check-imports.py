"""Checks that imports in core/src/ and src/ go downward only: a module may use those before it in ORDER and no other.

Prints every arrow that goes up, with its file and line, and ends with exit code 1 if there is one. Tests may look anywhere.
What `use` lines and paths name after `crate::` is a module, or something re-exported by one (`Error`, `Result`).

Usage: python3 scripts/check-imports.py [SRC...]
"""

import argparse
import re
import sys
from pathlib import Path

# from the bottom to the top; modules in one line do not know each other
ORDER = """
diagnostics fail_points
files integrate signal variable
table multibody systems
dataset dynamics
layout
scaling
study
sampling network interface
training evaluation fmi
baseline calibration html source swap
acceptance search surrogate refinement
import report
export
pipeline
"""

LEVELS = {module: level for level, line in enumerate(ORDER.split("\n")) for module in line.split()}
REEXPORTED = {"Error": "diagnostics", "Result": "diagnostics"}


def without_tests(text):
    """The code with comments, and modules for tests only, blanked out: lines keep their numbers."""
    blank = lambda match: re.sub(r"[^\n]", " ", match[0])
    text = re.sub(r"//[^\n]*", blank, text)
    # formatted code: the brace that ends such a module begins its line
    return re.sub(r"#\[cfg\(test\)\]\n(pub(\(crate\))? )?mod \w+ \{\n.*?\n\}", blank, text, flags=re.DOTALL)


def matching(text, start):
    """The end of the braces that open at `start`."""
    depth = 0
    for place in range(start, len(text)):
        depth += {"{": 1, "}": -1}.get(text[place], 0)
        if depth == 0:
            return place + 1
    sys.exit(f"braces do not match: {text[start : start + 60]!r}")


def imports(text):
    """Positions and names of what follows `crate::`, in braces or not."""
    for match in re.finditer(r"\bcrate::\s*", text):
        start = match.end()
        if text[start] != "{":
            yield start, re.match(r"\w*", text[start:])[0]
            continue
        end, depth = matching(text, start), 0
        for item in re.finditer(r"[{},]|\w+(?=\s*(::|,|\}| as ))", text[start:end]):
            if item[0] in "{}":
                depth += 1 if item[0] == "{" else -1
            elif item[0] != "," and depth == 1 and not text[: start + item.start()].rstrip().endswith("::"):
                yield start + item.start(), item[0]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    root = Path(__file__).parent.parent
    folders = [root / "core" / "src", root / "src"]
    parser.add_argument("src", type=Path, nargs="*", default=folders, help="the folders; core/src/ and src/ unless given")
    mistakes, arrows = [], set()
    for src, path in ((src, path) for src in parser.parse_args().src for path in sorted(src.rglob("*.rs"))):
        module = path.relative_to(src).parts[0].removesuffix(".rs")
        is_test = "tests" in path.stem or "tests" in path.parts or path.stem == "testing"
        if is_test or module in ("main", "lib", "cli", "commands"):
            continue
        if module not in LEVELS:
            mistakes.append(f"{path}: module `{module}` is not in the order of {Path(__file__).name}")
            continue
        text = without_tests(path.read_text())
        for place, name in imports(text):
            target = REEXPORTED.get(name, name)
            if target == module:
                continue
            where = f"{path}:{text.count(chr(10), 0, place) + 1}"
            if target not in LEVELS:
                mistakes.append(f"{where}: `crate::{name}` is not a module of the order")
            elif LEVELS[target] >= LEVELS[module]:
                mistakes.append(f"{where}: {module} -> {target} goes up")
            arrows.add((module, target))
    for mistake in mistakes:
        print(mistake)
    if mistakes:
        sys.exit(1)
    print(f"{len(arrows)} arrows between {len(LEVELS)} modules, none goes up")


main()
