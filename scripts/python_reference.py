#!/usr/bin/env python3
"""Prints docs/python-api.md, the reference of the Python package, from its signatures and docstrings.

    python3 scripts/python_reference.py > docs/python-api.md

It parses the source, so neither the wheel nor a framework is needed. Every public class, function, method and property must have a
docstring. tests/python/test_python_reference.py keeps the page up to date.
"""

import ast
import inspect
import json
import re
import sys
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "python" / "python" / "metafmu"
INTRODUCTION = """# Python API

This page has each public object of the package `metafmu`: arguments, shapes, units and errors.
[From Python](python.md) explains them by task.

Returned arrays are numpy arrays of doubles. Rows may be array-like, or a DataFrame or dict with a column for each name. Two types stand for several forms of an argument:

- `Names`: a list of names, or a dict from names to units, ranges `(min, max)`, or dicts with the keys of an [interface](import.md#the-interface).
- `States`: a dict from inputs of a model to the outputs that are their next values, or to dicts with the keys of [states](import.md#states).
"""
# heading, and the public objects below it; a name with a module is returned by one of them and not part of `metafmu`
SECTIONS = [
    ("Readers of models", ["from_sklearn", "from_torch", "from_keras", "from_jax", "from_onnx"]),
    ("Fits", ["fit", "Regressor"]),
    ("Surrogates", ["Surrogate", "_surrogate.Variable"]),
    ("Studies", ["Study", "_study.Result", "_study.Report"]),
    ("Validation", ["validate", "Validation"]),
    ("Sources", ["source", "_source.Source", "mujoco"]),
    ("Graphs", ["Graph"]),
    ("Errors and warnings", ["Error", "AccuracyWarning"]),
]
# classes whose instances are made by calling them
CONSTRUCTED = ("Regressor", "Graph", "Study")
WIDTH = 120


def tree(module):
    """Syntax tree of a module of the package."""
    file = PACKAGE / f"{module}.py"
    return ast.parse((file if file.exists() else file.with_suffix(".pyi")).read_text(encoding="utf-8"))


def public():
    """Modules of all public names of the package, by name."""
    for node in tree("__init__").body:
        if isinstance(node, ast.Assign) and node.targets[0].id == "_PLACES":
            return {"Error": "_metafmu", **ast.literal_eval(node.value)}
    raise ValueError("__init__.py has no _PLACES")


def found(name):
    """Name without module, and the class or function."""
    module, _, short = name.rpartition(".")
    module = module or public()[short]
    nodes = [node for node in tree(module).body if isinstance(node, (ast.ClassDef, ast.FunctionDef)) and node.name == short]
    assert len(nodes) == 1, f"{module} has {len(nodes)} objects {short}"
    return short, nodes[0]


def decorators(node):
    return [ast.unparse(one) for one in node.decorator_list]


def signature(name, function):
    """A call as in the source, without `self`, in lines of WIDTH characters."""
    given = function.args
    arguments = given.posonlyargs + given.args
    positional = [*zip(arguments, [None] * (len(arguments) - len(given.defaults)) + given.defaults)]
    positional = [pair for pair in positional if pair[0].arg not in ("self", "cls")]
    unnamed = len([one for one in given.posonlyargs if one.arg not in ("self", "cls")])
    keywords = [*zip(given.kwonlyargs, given.kw_defaults)]

    def text(argument, default):
        annotation = f": {ast.unparse(argument.annotation)}" if argument.annotation else ""
        equals = " = " if annotation else "="
        if default is None:
            return f"{argument.arg}{annotation}"
        is_text = isinstance(default, ast.Constant) and isinstance(default.value, str)
        return f"{argument.arg}{annotation}{equals}{json.dumps(default.value) if is_text else ast.unparse(default)}"

    parts = [text(*pair) for pair in positional]
    parts[unnamed:unnamed] = ["/"] if unnamed else []
    parts += [f"*{text(given.vararg, None)}"] if given.vararg else ["*"] if keywords else []
    parts += [text(*pair) for pair in keywords] + ([f"**{text(given.kwarg, None)}"] if given.kwarg else [])
    result = f" -> {ast.unparse(function.returns)}" if function.returns else ""
    whole = f"{name}({', '.join(parts)}){result}"
    if len(whole) <= WIDTH:
        return whole
    lines = [""]
    for part in parts:
        if lines[-1] and len(lines[-1]) + len(part) > WIDTH - 8:
            lines.append("")
        lines[-1] += f"{part}, " if part is not parts[-1] else part
    return f"{name}(\n" + "".join(f"    {line.rstrip()}\n" for line in lines) + f"){result}"


def anchor(name):
    """Fragment of a heading, as GitHub and the site make it."""
    return re.sub(r"[^\w-]", "", name.lower())


def markdown(name, docstring, known):
    """A docstring as Markdown: roles become links to headings of this page, lines of `>>>` become blocks."""

    def link(match):
        target = match[1].removeprefix("metafmu.")
        full = target if target in known else f"{name.split('.')[0]}.{target}"
        assert full in known, f"{name}: unknown {match[0]}"
        return f"[`{full}`](#{anchor(full)})"

    text, is_code = "", False
    for line in inspect.cleandoc(docstring).splitlines():
        starts = line.startswith(">>> ")
        if starts and not is_code:
            text += "```python\n"
        elif is_code and not line.strip():
            text += "```\n"
        is_code = (starts or is_code) and bool(line.strip())
        prompt = re.match(r"(>>>|\.\.\.) ?", line)
        text += f"{(line[prompt.end() :] if prompt else '# ' + line) if is_code else line}\n"
    text = re.sub(r":\w+:`([\w.]+)`", link, text + ("```\n" if is_code else ""))
    return re.sub(r"(?<!`)``(?!`)([^`]+)``", lambda match: f"`{' '.join(match[1].split())}`", text).rstrip()


def documented(name, node):
    """Docstring of a public object; without one the page cannot be made."""
    text = ast.get_docstring(node, clean=False)
    assert text, f"{name} has no docstring"
    return text


def members(node):
    """Public methods and properties of a class."""
    return [one for one in node.body if isinstance(one, ast.FunctionDef) and (one.name == "__call__" or not one.name.startswith("_"))]


def described(name, node, known):
    """The section of a public object."""
    text = f"\n### `{name}`\n"
    if isinstance(node, ast.FunctionDef):
        text += f"\n```python\n{signature(f'metafmu.{name}', node)}\n```\n"
        return text + f"\n{markdown(name, documented(name, node), known)}\n"
    makes = [one for one in node.body if isinstance(one, ast.FunctionDef) and one.name == "__init__" and name in CONSTRUCTED]
    if makes:
        text += f"\n```python\n{signature(f'metafmu.{name}', makes[0])}\n```\n"
    text += f"\n{markdown(name, documented(name, node), known)}\n"
    for one in members(node):
        full = f"{name}.{one.name}"
        text += f"\n#### `{full}`\n"
        if "property" in decorators(one):
            text += f"\nProperty: `{ast.unparse(one.returns)}`\n" if one.returns else "\nProperty\n"
        else:
            called = name.lower() if one.name == "__call__" else f"{'metafmu.' + name if 'classmethod' in decorators(one) else name.lower()}.{one.name}"
            text += f"\n```python\n{signature(called, one)}\n```\n"
        text += f"\n{markdown(full, documented(full, one), known)}\n"
    return text


def document():
    """The text of the page."""
    listed = [name for _, names in SECTIONS for name in names]
    missing = set(public()) - set(listed)
    assert not missing, f"in no section of the page: {', '.join(sorted(missing))}"
    objects = [(title, [found(name) for name in names]) for title, names in SECTIONS]
    known = set()
    for _, group in objects:
        for name, node in group:
            known |= {name, *(f"{name}.{one.name}" for one in (members(node) if isinstance(node, ast.ClassDef) else []))}
    text = INTRODUCTION
    for title, group in objects:
        text += f"\n## {title}\n" + "".join(described(name, node, known) for name, node in group)
    return text


if __name__ == "__main__":
    sys.stdout.write(document())
