#!/usr/bin/env python3
"""Prints a reference page, docs/study-file.md or docs/mechanism-file.md, from the schema that `metafmu schema` prints.

    python3 scripts/reference.py study > docs/study-file.md
    python3 scripts/reference.py mechanism > docs/mechanism-file.md

The schema comes from the types that read the files: what a key means is said in their doc comments. tests/python/test_schema.py
keeps the pages up to date.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
METAFMU = ROOT / "target" / "release" / "metafmu"
EDITORS = """
## In an editor

`metafmu new {options} --schema` writes {kind}.schema.json, the JSON schema of these files, beside a new file. `metafmu schema {kind} > {kind}.schema.json`
writes it for an existing one. Editors that use Taplo, such as Visual Studio Code with Even Better TOML, complete and check a file that begins with

```toml
#:schema ./{kind}.schema.json
```
"""
NEW = {"study": "NAME --table runs.csv", "mechanism": "NAME --template crane"}
INTRODUCTIONS = {
    "study": """# The study file, key by key

What is sampled, how, and what is made of it, in TOML. `metafmu new` writes a commented one; only `name`, `[source]`, `[time]`,
`[parameters]`, `[outputs]` and `[sampling]` are required, of the structure "static" only `name`, `[source]`, `[inputs]` and `[outputs]`. Mistakes are reported with file, line and key, all at once and before any work
is done ([bad-input.md](bad-input.md)). A default of "-" is a key that may be left out: its meaning says what happens then.
""",
    "mechanism": """# The mechanism file, key by key

Planar rigid bodies, joints, springs, forces and drivers, in TOML, in SI units and radians. [mechanisms.md](mechanisms.md) explains them by
an example. An expression is a number, or arithmetic on the file's parameters in quotes, such as `"m*L^2/12"`. NAME is a name of
your choice: a letter or `_`, then letters, digits and `_`. A default of "-" is a key that may be left out.
""",
}
HEAD = "| key | type | default | unit | meaning |\n|---|---|---|---|---|\n"


def schema(kind):
    """The JSON schema of a kind of file."""
    return json.loads(subprocess.run([METAFMU, "schema", kind], capture_output=True, text=True, check=True).stdout)


def choices(node):
    """The texts that a value may have, with what each means, if that is said."""
    described = {}
    for one in node.get("oneOf", []):
        names = [one["const"]] if "const" in one else one["enum"]
        described |= {name: one.get("description", "") for name in names}
    return described or dict.fromkeys(node.get("enum", []), "")


def kind_of(node):
    """Type of a value as text."""
    if choices(node):
        return "one of " + ", ".join(f'`"{name}"`' for name in choices(node))
    if "anyOf" in node:
        kinds = [kind_of(one) for one in node["anyOf"]]
        return "expression" if kinds == ["number", "expression"] else " or ".join(kinds)
    if node.get("format") in ("expression", "path"):
        return node["format"]
    kind = node.get("type")
    if kind == "array":
        least, most = node.get("minItems"), node.get("maxItems")
        count = "" if least is None else f"{least} of " if most in (None, least) else f"{least} to {most} of "
        items = node.get("items", {})
        each = kind_of(items) if items not in ({}, True) else "values"
        return f"list of {count}({each})" if " or list" in each else f"list of {count}{each}"
    if kind == "object":
        others = node.get("additionalProperties")
        return f"table of {kind_of(others)}" if isinstance(others, dict) else "table"
    return {"number": "number", "integer": "whole number", "boolean": "true or false", "string": "text"}[kind]


def in_toml(value):
    """A value as TOML in one line."""
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e6:
        return f"{value:.1f}"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list):
        return f"[{', '.join(map(in_toml, value))}]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {in_toml(inner)}" for key, inner in value.items()) + " }" if value else "{}"
    return json.dumps(value)


def in_one_line(text):
    return " ".join(text.split()).replace("|", "\\|")


def row(key, node, is_required):
    """A line of the table."""
    default = f"`{in_toml(node['default'])}`" if node.get("default") not in (None, {}) else "-"
    meaning = in_one_line(node.get("description", ""))
    for name, what in choices(node).items():
        meaning += f"<br>`\"{name}\"`: {in_one_line(what)}" if what else ""
    if "examples" in node and node.get("type") == "object":
        meaning += " Example: " + " or ".join(f"`{in_toml(example)}`" for example in node["examples"])
    assert meaning, f"{key} has no meaning"
    unit = node.get("x-unit", "-")
    return f"| `{key}` | {kind_of(node)} | {'required' if is_required else default} | {unit} | {meaning} |\n"


def is_section(node):
    """Returns True if a value is written as a table with a heading."""
    others = node.get("additionalProperties")
    return "properties" in node or isinstance(others, dict) and ("properties" in others or "anyOf" in others and is_section_of_tables(others))


def is_section_of_tables(node):
    return any("properties" in one for one in node["anyOf"])


def section(heading, node, level="##"):
    """The tables of a section and of those in it."""
    properties, required = node.get("properties", {}), node.get("required", [])
    plain = {key: inner for key, inner in properties.items() if not is_section(inner)}
    text = f"\n{level} {heading}\n\n{in_one_line(node.get('description', ''))}\n" if heading else ""
    if plain:
        text += "\n" + HEAD + "".join(row(key, inner, key in required) for key, inner in plain.items())
    path = heading.strip("`[]")
    for key, inner in properties.items():
        if key in plain:
            continue
        own = f"{path}.{key}" if path else key
        if "properties" in inner:
            text += section(f"`[{own}]`", inner)
            continue
        others = inner["additionalProperties"]
        if "properties" in others:
            text += section(f"`[{own}.NAME]`", {**others, "description": inner["description"]})
        else:
            text += f"\n## `[{own}]`\n\n{in_one_line(inner.get('description', ''))} Each is a {kind_of(others)}, with\n"
            for one in others["anyOf"]:
                if "properties" in one:
                    keys = one["properties"].items()
                    text += "\n" + HEAD + "".join(row(key, inner, key in one.get("required", [])) for key, inner in keys)
    return text


def document(kind):
    """The text of the page."""
    return INTRODUCTIONS[kind] + section("", schema(kind)) + EDITORS.format(kind=kind, options=NEW[kind])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", choices=INTRODUCTIONS)
    sys.stdout.write(document(parser.parse_args().kind))
