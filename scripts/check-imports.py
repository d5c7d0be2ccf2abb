"""Checks that imports go downward only, that there is no circle among modules, that a type name means one thing, and that no message decides.

In the crates of ORDERED a module may use those before it in ORDER and no other. Below that, and in the other crates, the modules of a folder may use each
other in one direction: every circle among them is printed with its arrows. A folder's own file, `mod.rs`, and the modules below it count as
one. Re-exports are followed to the module that has the name. Tests may import anything.

The types of all crates together, of every module and macro except tests, have different names: a name that two definitions share is printed with both places.
Types inside functions, and associated types, may have any name.

Kinds of surrogate, in src/kinds/ and core/src/study/kinds/, do not know each other.

C files of the FMU's sources call each other in one direction too. Files that define the same functions are alternatives, each for one kind of model.

Outside of tests nothing looks for words in the message of an error, in Rust and in the Python package: an error has fields for what the program needs.
So no function of Rust returns text as its error.

Ends with exit code 1 if an arrow goes up, a circle is found, a name is shared, or an error is only text.

Usage: python3 scripts/check-imports.py [--table] [SRC...]     (--table: how many modules each folder has, and its arrows)
"""

import argparse
import re
import sys
from pathlib import Path

# from the bottom to the top; modules in one line do not know each other
ORDER = """
reading
diagnostics fail_points parallel process unit worst
files integrate processor_time signal unpacking variable
table
multibody systems
dataset dynamics
layout
scaling
study
sampling network
compliant training evaluation fmi
acceptance baselines calibration discrete html refinement source swap templates
search surrogate
import report
project
kinds
export
pipeline
"""

ROOT = Path(__file__).parent.parent
ORDERED = [ROOT / crate / "src" for crate in ["crates/numerics", "crates/tables", "core", "crates/source", "crates/surrogate", "crates/report", "crates/export", "."]]
FOLDERS = [*ORDERED, *(ROOT / crate / "src" for crate in ["crates/fmi", "crates/multibody", "fmu-template", "fmu-template/runtime", "baselines", "python"])]
C = ROOT / "fmu-template" / "c"
# functions with external linkage: the brace of a definition begins its line
FUNCTION_OF_C = re.compile(r"^(?!static\b|typedef\b|#)\w[\w *]*?\b(\w+)\([^;{}]*\)\n\{", re.MULTILINE)
LEVELS = {module: level for level, line in enumerate(ORDER.split("\n")) for module in line.split()}
REEXPORTED = {"Error": "diagnostics", "Result": "diagnostics"}
KINDS = {path.name for path in (ROOT / "src" / "kinds").iterdir() if path.is_dir()} - {"record"}
PROGRAM = ("main", "cli", "commands")
TYPE = r"(?:pub(?:\([^)]*\))? )?(?:struct|enum|trait|type|union) (\w+)"
# formatted code: definitions of a module begin their lines, and so does the last brace of an inner module or macro
OF_MODULE, INSIDE = re.compile(rf"^{TYPE}", re.MULTILINE), re.compile(rf"^ +{TYPE}", re.MULTILINE)
# what the TOML parser says is put in other words; it has no codes
TRANSLATED = ROOT / "crates" / "tables" / "src" / "diagnostics" / "origin" / "words.rs"
MESSAGE = r"\b\w*(?:message|error|reason|failure|problem)\w*"
WORDS_IN_RUST = re.compile(rf"{MESSAGE}(?:\.(?:to_string\(\)|message|as_str\(\)))*\s*\.(?:contains|starts_with|split_once)\(")
WORDS_IN_PYTHON = re.compile(rf"str\({MESSAGE}\)\.(?:startswith|find|split)|\bin str\({MESSAGE}\)")
SENTENCE_AS_ERROR = re.compile(r"\bResult<[^;{}]*,\s*(?:Vec<String>|String)>")
INNER = re.compile(r"^(?:macro_rules!|(?:pub(?:\([^)]*\))? )?mod) \w+ \{\n.*?^\}", re.MULTILINE | re.DOTALL)


def without_tests(text):
    """The code with comments, and modules for tests only, blanked out: lines keep their numbers."""
    blank = lambda match: re.sub(r"[^\n]", " ", match[0])
    text = re.sub(r"//[^\n]*", blank, text)
    # formatted code: the brace that ends such a module begins its line
    return re.sub(r"#\[cfg\(test\)\]\n(pub(\(crate\))? )?mod \w+ \{\n.*?\n\}", blank, text, flags=re.DOTALL)


def is_for_tests(path):
    """Returns true if all of a file, by its path below `src`, is for tests."""
    return "tests" in path.stem or "tests" in path.parts or path.stem == "testing"


def types(src):
    """Names, files and lines of the types that the modules and macros of a folder define."""
    for path in sorted(src.rglob("*.rs")):
        if is_for_tests(path.relative_to(src)):
            continue
        text = without_tests(path.read_text())
        inside = (found for block in INNER.finditer(text) for found in INSIDE.finditer(text, block.start(), block.end()))
        for found in [*OF_MODULE.finditer(text), *inside]:
            yield found[1], path, text.count("\n", 0, found.start(1)) + 1


def shared_names(folders):
    """Names of types that several modules define, with the places."""
    places = {}
    for name, path, line in (found for src in folders for found in types(src)):
        places.setdefault(name, {}).setdefault(path, f"    {path.relative_to(ROOT)}:{line}")
    for name, files in sorted(places.items()):
        if len(files) > 1:
            yield "\n".join([f"type {name}: {len(files)} definitions, expected different names", *files.values()])


def errors_as_text():
    """The lines of code that search the message of an error for words, or return an error that is only text."""
    rust = [path for src in FOLDERS for path in sorted(src.rglob("*.rs")) if not is_for_tests(path) and path != TRANSLATED]
    python = sorted((ROOT / "python" / "python").rglob("*.py"))
    for path in [*rust, *python]:
        of_rust = path.suffix == ".rs"
        text = path.read_text()
        pattern, text = (WORDS_IN_RUST, without_tests(text)) if of_rust else (WORDS_IN_PYTHON, text)
        for match in pattern.finditer(text):
            yield f"{path.relative_to(ROOT)}:{text.count(chr(10), 0, match.start()) + 1}: searches a message: {match[0]}"
        for match in SENTENCE_AS_ERROR.finditer(text) if of_rust else ():
            yield f"{path.relative_to(ROOT)}:{text.count(chr(10), 0, match.start()) + 1}: an error without a type: {match[0]}"


def matching(text, start):
    """The end of the braces that open at `start`."""
    depth = 0
    for place in range(start, len(text)):
        depth += {"{": 1, "}": -1}.get(text[place], 0)
        if depth == 0:
            return place + 1
    sys.exit(f"braces do not match: {text[start : start + 60]!r}")


def paths(text, start, prefix=()):
    """Places and paths of what is named at `start`: one path, or several in braces."""
    start += len(text[start:]) - len(text[start:].lstrip())
    if text[start : start + 1] == "{":
        item, place, end = start + 1, start + 1, matching(text, start)
        while place < end:
            if text[place] == "{":
                place = matching(text, place)
                continue
            if text[place] in ",}":
                yield from paths(text[:place], item, prefix)
                item = place + 1
            place += 1
    elif match := re.match(r"(\w+)\s*(::)?", text[start:]):
        path = (*prefix, match[1])
        if match[2]:
            yield from paths(text, start + match.end(), path)
        else:
            yield start, path


class Crate:
    """Modules of a folder, what they name and what they re-export."""

    def __init__(self, src):
        self.src, self.files = src, {}
        for path in sorted(src.rglob("*.rs")):
            parts = list(path.relative_to(src).with_suffix("").parts)
            if is_for_tests(path.relative_to(src)) or parts[0] in PROGRAM:
                continue
            if parts[-1] in ("mod", "lib"):
                parts.pop()
            self.files[tuple(parts)] = (path, without_tests(path.read_text()))
        self.modules = {module[:length] for module in self.files for length in range(len(module) + 1)}
        self.reexports, self.uses = {}, []
        for module, (path, text) in self.files.items():
            self.read(module, path, text)

    def read(self, module, path, text):
        imported = []
        for match in re.finditer(r"(?:\b(pub(?:\([^)]*\))?)\s+)?\buse\s+", text):
            end = text.find(";", match.end())
            imported.append((match.start(), end))
            for place, named in paths(text[:end], match.end()):
                full = self.absolute(module, named)
                if full is not None and match[1]:
                    self.reexports.setdefault(module, {})[named[-1]] = full
                elif full is not None:
                    self.uses.append((module, full, path, text.count("\n", 0, place) + 1))
        for match in re.finditer(r"(?<!::)\b(crate|super)::(?!\s*\{)", text):
            if not any(start <= match.start() <= end for start, end in imported):
                for place, named in paths(text, match.start()):
                    self.uses.append((module, self.absolute(module, named), path, text.count("\n", 0, place) + 1))

    def absolute(self, module, named):
        """A path from the root of the crate; none if it is of another one."""
        ups = next((length for length, part in enumerate(named) if part != "super"), len(named))
        if named[0] == "crate":
            return named[1:]
        if named[0] == "self":
            return module + named[1:]
        if ups:
            return module[: len(module) - ups] + named[ups:]
        return module + named if module + named[:1] in self.modules else None

    def target(self, full, depth=0):
        """The module that has what a path names."""
        for length in range(len(full), -1, -1):
            module = full[:length]
            if module in self.modules:
                again = self.reexports.get(module, {}).get(full[length]) if length < len(full) else None
                # a re-export of a re-export, but not of itself
                return self.target(again + full[length + 1 :], depth + 1) if again and depth < 8 else module
        return ()

    def arrows(self):
        """By folder: pairs of its modules, the first of which uses the second, and where."""
        found = {}
        for module, full, path, line in self.uses:
            target = self.target(full)
            common = next((k for k, (a, b) in enumerate(zip(module, target)) if a != b), min(len(module), len(target)))
            if common < len(module) and common < len(target):
                pair = (module[common], target[common])
                found.setdefault(module[:common], {}).setdefault(pair, f"{path.relative_to(ROOT)}:{line}")
        return found


def arrows_of_c():
    """Pairs of C files, the first of which calls a function that the second defines, and where."""
    texts = {path: re.sub(r"/\*.*?\*/", lambda match: re.sub(r"[^\n]", " ", match[0]), path.read_text(), flags=re.DOTALL) for path in sorted(C.glob("*.c"))}
    defined = {path: set(FUNCTION_OF_C.findall(text)) for path, text in texts.items()}
    arrows = {}
    for path, text in texts.items():
        for match in re.finditer(r"\b(\w+)\(", text):
            for other, functions in defined.items():
                if match[1] in functions and match[1] not in defined[path]:
                    arrows.setdefault((path.name, other.name), f"{path.relative_to(ROOT)}:{text.count(chr(10), 0, match.start()) + 1}")
    return arrows


def circle_problems(name, pairs):
    """The circles of a folder, with their arrows."""
    for circle in sorted(circles(pairs), key=sorted):
        inside = [f"    {a} -> {b}: {where}" for (a, b), where in sorted(pairs.items()) if {a, b} <= circle]
        yield "\n".join([f"{name}: a circle of {', '.join(sorted(circle))}", *inside])


def circles(pairs):
    """Sets of modules that use each other."""
    reached = {a: {b for of, b in pairs if of == a} for a in {a for a, _ in pairs}}
    while True:
        more = {a: of.union(*(reached.get(b, set()) for b in of)) for a, of in reached.items()}
        if more == reached:
            break
        reached = more
    return {frozenset(b for b in of if a in reached.get(b, ())) for a, of in reached.items() if a in of}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--table", action="store_true", help="print a line for each folder")
    parser.add_argument("src", type=Path, nargs="*", default=FOLDERS, help="the folders; those of all crates unless given")
    arguments = parser.parse_args()
    mistakes, count = list(shared_names(arguments.src)), 0
    for crate in map(Crate, arguments.src):
        if crate.src in ORDERED:
            mistakes += upward(crate)
        for folder, pairs in sorted(crate.arrows().items()):
            count += len(pairs)
            name = "/".join([str(crate.src.relative_to(ROOT)), *folder])
            if arguments.table:
                print(f"{name}: {len({module for pair in pairs for module in pair})} modules, {len(pairs)} arrows")
            mistakes += circle_problems(name, pairs)
            if name in ("src/kinds", "core/src/study/kinds"):
                mistakes += [f"{where}: the kind {a} knows {b}" for (a, b), where in pairs.items() if {a, b} <= KINDS]
    of_c = arrows_of_c()
    mistakes += circle_problems(str(C.relative_to(ROOT)), of_c)
    mistakes.extend(errors_as_text())
    for mistake in mistakes:
        print(mistake)
    if mistakes:
        sys.exit(1)
    print(f"{count} arrows between modules of {len(arguments.src)} folders, {len(of_c)} between C files: none goes up, none is part of a circle; type names differ; no message decides")


def upward(crate):
    """Imports that go up in ORDER, and modules that are missing from it."""
    for module in sorted({module[0] for module in crate.files if module} - set(LEVELS)):
        yield f"{crate.src / module}: module `{module}` is not in the order of {Path(__file__).name}"
    for module, full, path, line in crate.uses:
        name = full[0] if full else ""
        target = REEXPORTED.get(name, name)
        if not module or target == module[0] or module[0] not in LEVELS:
            continue
        if target not in LEVELS:
            yield f"{path}:{line}: `crate::{name}` is not a module of the order"
        elif LEVELS[target] >= LEVELS[module[0]]:
            yield f"{path}:{line}: {module[0]} -> {target} goes up"


main()
