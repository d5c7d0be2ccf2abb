"""Names, units and ranges of variables from arguments: names, dicts, data."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from . import _metafmu
from ._surrogate import Variable, data_rows, is_frame

_INPUT_KEYS = ("causality", "variability", "min", "max", "start", "unit", "description")
_OUTPUT_KEYS = ("unit", "description")


def identifier(name):
    """A name for an FMU's model: letters, digits, ``-`` and ``_``."""
    text = re.sub(r"[^A-Za-z0-9_-]+", "_", str(name)).strip("_")
    return (text if text[:1].isalpha() else f"model_{text}")[:100] or "model"


def number(value, what):
    """The value as a float. Raises :class:`metafmu.Error` if it is not a finite number."""
    try:
        found = float(value)
    except (TypeError, ValueError):
        found = math.nan
    if not math.isfinite(found):
        raise _metafmu.Error(f"{what}: {value!r}, expected a finite number")
    return found


def check_keys(about, keys, what):
    """Raises :class:`metafmu.Error` if a dict has keys other than these."""
    unknown = [key for key in about if key not in keys]
    if unknown:
        raise _metafmu.Error(f"{what}: unknown key `{unknown[0]}`, expected one of {', '.join(keys)}")


def items_of(given, what):
    """Pairs of names and their descriptions. Raises :class:`metafmu.Error` if there are no names, or if they have no order."""
    if hasattr(given, "items"):
        return list(given.items())
    if given is None or isinstance(given, str):
        return [] if given is None else [(given, {})]
    if isinstance(given, Iterable) and not isinstance(given, (bytes, set, frozenset, Iterator)):
        return [(item, {}) for item in given]
    raise _metafmu.Error(f"{what}s: {given!r}, expected a list of names, or a dict of names to units, ranges or dicts")


def names_in(given, what):
    """Names in an argument of :func:`items_of`."""
    return [str(item.name if isinstance(item, Variable) else item) for item, _ in items_of(given, what)]


def of_section(given, count, prefix, what, keys, names=None):
    """Entries of a section of an interface: a dict of dicts by name, in the order of the model's columns.

    ``given``: a list of names or :class:`Variable`, or a dict of names to units, ranges ``(min, max)`` or dicts with the keys of
    docs/import.md. ``names``: names of the columns, used if nothing is given. If ``keys`` has ``column``, and all entries do, their number
    may differ from that of the columns.
    """
    if given is None:
        made_up = [f"{prefix}{place}" for place in range(count)] if count != 1 else [prefix]
        # an input of a name that no variable may have is better told of
        given = made_up if names is None or what == "output" and not all(map(_is_valid, names)) else names
    section = {}
    for name, about in items_of(given, what):
        if isinstance(name, Variable):
            fields = ("unit", "min", "max", "start", "description") if "min" in keys else ("unit", "description")
            about = {field: getattr(name, field) for field in fields if getattr(name, field) is not None}
            name = name.name
        elif isinstance(about, str):
            about = {"unit": about}
        elif isinstance(about, (tuple, list, np.ndarray)):
            if len(about) != 2 or "min" not in keys:
                raise _metafmu.Error(f"{what} `{name}`: {about!r}, expected a unit or a dict")
            about = {"min": about[0], "max": about[1]}
        elif about is not None and not isinstance(about, Mapping):
            expected = "a unit, a range (min, max) or a dict" if "min" in keys else "a unit or a dict"
            raise _metafmu.Error(f"{what} `{name}`: {about!r}, expected {expected}")
        about = dict(about or {})
        if wrong := [key for key in ("unit", "description", "causality", "variability", "column") if key in about and not isinstance(about[key], str)]:
            raise _metafmu.Error(f"{what} `{name}`: {wrong[0]}: {about[wrong[0]]!r}, expected a text")
        check_keys(about, keys, f"{what} `{name}`")
        about.update({key: number(about[key], f"{what} `{name}`: {key}") for key in ("min", "max", "start", "value") if key in about})
        name = str(name)
        if name in section:
            raise _metafmu.Error(f"{what} `{name}` is there twice: names of variables must be unique")
        section[name] = about
    say_which = [about for about in section.values() if "column" in about]
    if names is not None and not say_which:
        section = _in_order(section, names, hasattr(given, "items"), what)
    if len(section) != count and (not section or len(say_which) != len(section)):
        expected = f"the model has {count}"
        if names is not None:
            expected += ": " + ", ".join([*names[:12], *(["..."] if count > 12 else [])])
        raise _metafmu.Error(f"{len(section)} {what}s ({', '.join(list(section)[:20])}), {expected}")
    return section


def _is_valid(name):
    """Returns True if a variable of an FMU may have this name."""
    return name == name.strip() and name.isprintable() and name not in ("", "time", "in_domain", "domain_distance")


def _in_order(section, names, is_dict, what):
    """Entries in the order of the columns, whose names are known. An entry with the name of a column describes that column; entries with
    other names describe the columns in their order."""
    known = set(names)
    if set(section) == known or is_dict and section and set(section) <= known:
        return {name: section.get(name, {}) for name in names}
    same, others = ([name for name in section if (name in known) is there] for there in (True, False))
    if same and others:
        raise _metafmu.Error(
            f"{what}s: {_quoted(same)} of the model, {_quoted(others)} not; expected all of its names, in any order: {', '.join(names[:20])}, "
            "or other names for all columns in their order"
        )
    return section


def _quoted(names):
    return ", ".join(f"`{name}`" for name in names[:20]) + (" is" if len(names) == 1 else " are")


def _refuse_other_orders(*lists):
    """Raises :class:`metafmu.Error` if two lists give the same names in different orders.

    Each list is a pair: a description, and names in the order of the columns. Case, punctuation and units in brackets do not distinguish
    names.
    """
    lists = [(what, list(names)) for what, names in lists if names]
    for place, of in enumerate(lists):
        for names in lists[place + 1 :]:
            if len(of[1]) == len(names[1]) and (problem := _metafmu.out_of_order(names, of)):
                raise _metafmu.Error(problem)


def _names_of_columns(known, count, given, there):
    """Names of a model's columns.

    These are ``known``, the names that the model has, unless it has none, or none of them occurs in a DataFrame's columns ``there`` or in
    ``given``. Otherwise they are the given names in the order of the DataFrame, or the names of a DataFrame with as many columns, else
    ``known``.
    """
    known = list(known) if known is not None and len(known) == len(set(known)) == count else None
    if known is not None and not (there and set(known).isdisjoint([*given, *there])):
        return known
    if len(given) == count and set(given) <= set(there):
        return [name for name in there if name in given]
    return there if there and len(there) == count else known


def interface(
    count_inputs, count_outputs, *, inputs, outputs, data, name, description, step, stop, domain="data", input_names=None, output_names=None,
    states=None, sample=None, solver_step=None, named=False,
):
    """Text of an interface, in JSON, and the rows of the data as an array in the order of the variables, or None.

    ``input_names``, ``output_names``: names of the columns, as far as the model has them. ``named``: entries may refer to columns by these
    names.
    """
    if domain not in ("data", "ranges"):
        raise _metafmu.Error(f"domain: {domain!r}, expected \"data\" or \"ranges\"")
    there = [str(name) for name in data.columns] if is_frame(data) else []
    of_model = {"inputs": input_names, "outputs": output_names}
    input_names = _names_of_columns(input_names, count_inputs, names_in(inputs, "input"), there)
    output_names = _names_of_columns(output_names, count_outputs, names_in(outputs, "output"), [])
    column = ("column",) if named else ()
    of_inputs = of_section(inputs, count_inputs, "x", "input", (*column, *(("value",) if named else ()), *_INPUT_KEYS), input_names)
    variables = {name: about for name, about in of_inputs.items() if "value" not in about}
    of_outputs = of_section(outputs, count_outputs, "y", "output", (*column, *_OUTPUT_KEYS), output_names)
    for what, of, section in (("inputs", input_names, of_inputs), ("outputs", output_names, of_outputs)):
        # entries that say which column they are have no order
        if not any("column" in about for about in section.values()):
            _refuse_other_orders(("the model's columns", of_model[what]), ("`data`" if what == "inputs" else "`y`", of), (f"`{what}`", section))
    rows = None
    if data is not None:
        # entries that say which column they are may be more or less than the columns
        columns = dict(zip(of_inputs, input_names)) if input_names is not None and len(of_inputs) == count_inputs else {}
        rows = data_rows(data, list(variables), [about.get("column", columns.get(name, name)) for name, about in variables.items()])
        if not len(rows):
            raise _metafmu.Error("data has no rows, expected at least one")
        if not np.isfinite(rows).all():
            row, column = np.argwhere(~np.isfinite(rows))[0]
            raise _metafmu.Error(f"data: {rows[row, column]} in row {row} of `{list(variables)[column]}`, expected a finite number")
    elif missing := [name for name, about in variables.items() if about.get("causality") != "time" and not {"min", "max"} <= set(about)]:
        raise _metafmu.Error(
            f"no range of the inputs {', '.join(f'`{name}`' for name in missing[:20])}: expected data=X with the rows that the model was "
            "trained on, or inputs={\"NAME\": {\"min\": 0.0, \"max\": 1.0, \"unit\": \"m\"}, ...}"
        )
    time = {"step": step, "sample": sample, "solver_step": solver_step, "stop": stop}
    text = json.dumps(
        {
            "name": identifier(name),
            "description": description,
            "domain": domain,
            "time": {key: number(value, key) for key, value in time.items() if value is not None},
            "states": states or {},
            "inputs": of_inputs,
            "outputs": of_outputs,
        }
    )
    return text, rows


def as_bytes(rows):
    """The rows as bytes, as the extension takes them."""
    return None if rows is None else rows.tobytes()


_STATE_KEYS = ("column", "next", "derivative", "start", "min", "max", "unit", "description")


def interface_of_columns(columns, results, *, outputs, states, **about):
    """Interface of a model with named columns: text and rows, as :func:`interface` returns them.

    ``columns``, ``results``: names of the model's input and output columns, some of which may be states. ``states``: a dict of names to the
    output that is the next value, or to dicts with the keys of docs/import.md.
    """
    if not isinstance(states or {}, Mapping):
        raise _metafmu.Error(f"states: {states!r}, expected a dict: {{\"INPUT\": \"OUTPUT\", ...}}")
    of_states = {name: _state(name, given) for name, given in (states or {}).items()}
    for name, given in of_states.items():
        if not _named(columns, given["column"]):
            raise _metafmu.Error(f"state `{name}`: \"{given['column']}\" is no column of the model's inputs: {', '.join(columns[:20])}")
    left = _without(columns, [given["column"] for given in of_states.values()])
    shown = _without(results, [given.get("next", given.get("derivative", "")) for given in of_states.values()])
    if not shown and of_states:
        # a model that returns only next values or derivatives of its states shows the states
        of_model = [column for column in columns if column not in left]
        section = of_section(outputs, len(of_model), "y", "output", ("column", *_OUTPUT_KEYS), of_model)
        outputs = {name: {"column": column, **about} for column, (name, about) in zip(of_model, section.items())}
    return interface(len(left), len(shown), outputs=outputs, states=of_states, input_names=left, output_names=shown, named=True, **about)


def _state(name, about):
    """The entry of a state, from its next value or a dict."""
    what = f"state `{name}`"
    about = {"next": about} if isinstance(about, str) else about
    if not isinstance(about, Mapping):
        raise _metafmu.Error(f"{what}: {about!r}, expected the output that is its next value, or a dict")
    check_keys(about, _STATE_KEYS, what)
    about = {"column": name, "start": 0.0, **about}
    return about | {key: number(about[key], f"{what}: {key}") for key in ("start", "min", "max") if key in about}


def _without(columns, taken):
    """Columns that are none of those taken, which are columns or stand for all columns of an input or output."""
    return [column for column in columns if column not in taken and column.split("[")[0] not in taken]


def _named(columns, taken):
    """The columns that a name stands for."""
    return [column for column in columns if taken in (column, column.split("[")[0])]
