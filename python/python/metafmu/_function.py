"""A study of a source that is defined in this process: in a notebook, a script or a closure.

The processes that sample it read a copy from a file. cloudpickle makes it: code is copied, with the variables that it uses; modules are
imported there. Nothing of the package is imported here but `_source` and the extension, so that such a process starts fast.
"""

from __future__ import annotations

import inspect
import io
import json
import marshal
import os
import pickle
import re
import subprocess
import sys
import sysconfig
import types
from collections.abc import Mapping
from pathlib import Path

from ._metafmu import Error
from ._source import Source

MADE = "# Made by `metafmu.Study`"
_STRUCTURES = ("response", "discrete", "dynamics")


def write(source, name, folder, structure, sections, program):
    """Writes the copy and the study; returns the study's path."""
    name = _name(source) if name is None else name
    if not isinstance(name, str) or os.path.basename(name) != name:
        raise Error(f"name: found {name!r}, expected a text without folders: `folder` has the place")
    if structure not in (None, *_STRUCTURES):
        raise Error(f"structure: found {structure!r}, expected one of {', '.join(_STRUCTURES)}")
    path, copy = folder / f"{name}.toml", folder / f"{name}-source.pickle"
    if path.exists() and not path.read_text(encoding="utf-8").startswith(MADE):
        raise FileExistsError(f"{path} was not made by metafmu.Study, expected another `name` or `folder`: Study.load reads it")
    if not sys.executable:
        raise RuntimeError("sys.executable is empty, expected the path of the interpreter that samples the source")
    content, modules = _copied(source, name)
    folder.mkdir(parents=True, exist_ok=True)
    copy.write_bytes(content)
    path.unlink(missing_ok=True)
    command = [sys.executable, "-m", "metafmu._function", copy.name]
    chosen = [] if structure is None else ["--structure", structure]
    made = subprocess.run([program, "new", name, *chosen, "--command", *command], cwd=folder, capture_output=True, text=True, encoding="utf-8")
    if made.returncode != 0:
        raise Error(made.stderr.strip().removeprefix("error: "))
    text = path.read_text(encoding="utf-8").split("\n", 1)[1]
    files = [*map(str, modules), *source.files]
    given = dict(sections.get("source", {}))
    if files or "files" in given:
        sections = {**sections, "source": {**given, "files": [*files, *map(str, given.get("files", []))]}}
    first = f"{MADE} of `{name}`, which replaces this file: pass changes as arguments.\n"
    path.write_text(first + _with(text, sections), encoding="utf-8")
    return path


def _name(source):
    name = getattr(source._origin, "__name__", None)
    if not name or name == "<lambda>":
        raise TypeError("the source has no name, expected the argument `name`")
    return name


# ---- The copy ----------------------------------------------------------------------------------------------------


def _copied(source, name):
    """Content of the file, and the files of the user's modules that the source imports."""
    from ._needed import needed

    cloudpickle = needed("cloudpickle", "a study of a function, which is copied to other processes,")

    modules = set()

    class Pickler(cloudpickle.Pickler):
        def reducer_override(self, value):
            if isinstance(value, types.CodeType):
                # another session has another file of a notebook's cell: equal code has equal content
                return marshal.loads, (marshal.dumps(_without_place(value, name), 2),)
            reduced = super().reducer_override(value)
            if reduced is NotImplemented:
                # a module, or what is imported from one
                self.modules.add(_module_of(value))
            elif isinstance(value, type):
                # a class has a random number in each session, by which equal ones are found again: a count serves as well
                number = lambda part: f"{self.classes.setdefault(part, len(self.classes)):032x}"
                is_random = lambda part: isinstance(part, str) and re.fullmatch("[0-9a-f]{32}", part)
                reduced = (reduced[0], tuple(number(part) if is_random(part) else part for part in reduced[1]), *reduced[2:])
            return reduced

    def dump(value):
        file = io.BytesIO()
        pickler = Pickler(file, protocol=5)
        pickler.modules, pickler.classes = modules, {}
        pickler.dump(value)
        return file.getvalue()

    try:
        content = dump(source)
    except Exception as error:
        raise TypeError(_refusal(source._origin, name, dump, error)) from error
    modules = _with_their_imports(modules)
    roots = [os.path.abspath(folder) for folder in sys.path if _is_own(os.path.abspath(folder))] if modules else []
    return pickle.dumps(roots, protocol=5) + content, modules


def _without_place(code, name):
    constants = tuple(_without_place(value, name) if isinstance(value, types.CodeType) else value for value in code.co_consts)
    return code.replace(co_filename=f"<{name}>", co_firstlineno=1, co_consts=constants)


def _refusal(origin, name, dump, error):
    functions = [origin] if not isinstance(origin, type) else [value for value in vars(origin).values() if inspect.isfunction(value)]
    for function in filter(inspect.isfunction, functions):
        used = inspect.getclosurevars(function)
        for variable, value in {**used.globals, **used.nonlocals}.items():
            try:
                dump(value)
            except Exception as reason:
                return (
                    f"`{name}` uses the variable `{variable}` of the type {type(value).__name__}, which cannot be copied to another process "
                    f"({reason}): create it in the function, or in `__init__` of a class"
                )
    return f"`{name}` cannot be copied to another process: {error}"


def _module_of(value):
    return value.__name__ if isinstance(value, types.ModuleType) else str(getattr(value, "__module__", ""))


def _is_own(path):
    """Returns true if a file or folder belongs to the user: not to Python, an installed package, or this one."""
    parts = Path(path).parts
    if "site-packages" in parts or "dist-packages" in parts:
        return False
    installed = [*map(sysconfig.get_paths().get, ("stdlib", "platstdlib", "purelib", "platlib")), os.path.dirname(__file__)]
    return not any(Path(path).is_relative_to(folder) for folder in installed) and not path.endswith(".zip")


def _with_their_imports(names):
    """Files of the user's modules among some, and of those that they import: after a change of one the runs are made again."""
    found, waiting = {}, list(names)
    while waiting:
        name = waiting.pop()
        module = sys.modules.get(name)
        file = getattr(module, "__file__", None)
        if name in found or name in ("__main__", "") or not file or not _is_own(os.path.abspath(file)):
            continue
        found[name] = Path(os.path.abspath(file))
        for value in list(vars(module).values()):
            waiting.append(_module_of(value))
    return sorted(set(found.values()))


def serve(path):
    """Answers the requests of `metafmu` with the source in a file."""
    with open(path, "rb") as file:
        sys.path += pickle.load(file)
        pickle.load(file).serve()


# ---- The study ---------------------------------------------------------------------------------------------------


def _with(text, sections):
    """A study's text with other values of some keys; None leaves a key out."""
    lines = text.splitlines()
    # keys outside of sections come first, so that no section precedes them
    for section, keys in sorted(sections.items(), key=lambda item: isinstance(item[1], Mapping)):
        in_section = isinstance(keys, Mapping)
        if not in_section and keys is not None and _header(lines, section) is not None:
            raise Error(f"{section}: found {keys!r}, expected a dict with keys of [{section}]")
        for key, value in (keys if in_section else {section: keys}).items():
            try:
                lines = _set(lines, section if in_section else None, key, value)
            except TypeError:
                what = f"{section}.{key}" if in_section else key
                raise Error(f"{what}: found {value!r}, expected a number, a text, True or False, a list or a dict") from None
    return "\n".join(lines) + "\n"


def _set(lines, section, key, value):
    is_header = [re.match(r"\[[^\]]+\]", line) is not None for line in lines]
    begin = -1
    if section is not None:
        header = _header(lines, section)
        if header is None:
            lines, is_header = [*lines, "", f"[{section}]"], [*is_header, False, True]
        begin = len(lines) - 1 if header is None else header
    end = next((number for number in range(begin + 1, len(lines)) if is_header[number]), len(lines))
    name = key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else json.dumps(key, ensure_ascii=False)
    new = [] if value is None else [f"{name} = {_toml(value)}"]
    for prefix in ("", "# "):
        for number in range(begin + 1, end):
            if re.match(rf"{prefix}{re.escape(name)}\s*=", lines[number]):
                return [*lines[:number], *new, *lines[number + 1 :]]
    while end > begin + 1 and not lines[end - 1].strip():
        end -= 1
    return [*lines[:end], *new, *lines[end:]]


def _header(lines, section):
    """Number of the line that opens a section, or None."""
    return next((number for number, line in enumerate(lines) if re.match(rf"\[\s*{re.escape(section)}\s*\]", line)), None)


def _toml(value):
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{json.dumps(str(key), ensure_ascii=False)} = {_toml(item)}" for key, item in value.items()) + " }"
    value = value.tolist() if hasattr(value, "tolist") else value
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, (bool, float)):
        return repr(value).lower()
    if isinstance(value, int):
        return str(value)
    return json.dumps(os.fspath(value), ensure_ascii=False)


if __name__ == "__main__":
    # the copy holds classes of the module, not of the script
    from metafmu._function import serve as serve_copy

    serve_copy(sys.argv[1])
