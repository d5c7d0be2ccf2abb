"""A function or class as the source of a study: it answers the requests of docs/command-sources.md.

Nothing but numpy is imported here, so that a worker starts fast. The extension is imported when there is something to say: a single file,
``metafmu.py``, works without it.
"""

from __future__ import annotations

import functools
import inspect
import json
import os
import sys
import traceback
from collections.abc import Mapping
from numbers import Real

import numpy as np

PROTOCOL = 1
_KEYS = ("unit", "min", "max", "start", "description")
_KEYS_OF_STATES = (*_KEYS, "periodic", "rate_of")


def source(model=None, /, *, parameters=None, outputs=None, inputs=None, states=None, stop=None, step=None, description=None):
    """Turns a function or class into a source that `metafmu` samples. ``outputs`` is required.

    >>> @source(parameters={"k": {"min": 1.0, "max": 2.0, "unit": "1/s"}}, outputs={"x": "m"}, stop=2.0, step=0.01)
    ... def decay(times, parameters):
    ...     return {"x": np.exp(-parameters["k"] * times)}
    >>> decay(np.array([0.0, 1.0]), {"k": 1.0})["x"]
    array([1.        , 0.36787944])

    A function has the arguments ``times`` and ``parameters``, then ``inputs`` and ``states`` if there are any, and returns an array for each
    output. ``times`` is an array, ``parameters`` and ``states`` are dicts of numbers, ``inputs`` is a dict of arrays with the values at the
    times. A class has this function as its method ``run``, and for `structure = "dynamics"` a method ``equations`` of ``parameters``,
    ``inputs`` and ``states``, dicts of numbers, that returns two dicts: derivatives of the states, and outputs. With ``equations``, ``run``
    may be missing: scipy integrates then. If states have ``rate_of``, the coordinate whose rate they are, ``equations`` returns a third value:
    the mass matrix of these rates, in their order.

    ``parameters``, ``inputs``, ``states`` and ``outputs``: names, or a dict of a unit, a range ``(min, max)`` or a dict with ``unit``, ``min``,
    ``max``, ``start`` and ``description`` for each name; of a state also ``periodic`` and ``rate_of``. Outputs have no range in brackets.
    ``stop`` and ``step``: length of a run and time between two rows, in s.

    :class:`metafmu.Study` builds a surrogate of it. Or a script ends with ``if __name__ == "__main__": decay.serve()``; then
    `metafmu new NAME --command python SCRIPT` writes its study.

    Raises TypeError for a decorator without arguments or outputs, and :class:`metafmu.Error` with a line for every other mistake: in names,
    ranges and keys, and in the arguments of the function or class.
    """

    if model is not None:
        found = getattr(model, "__name__", repr(model))
        raise TypeError(f'@metafmu.source has no arguments for `{found}`, expected for instance @metafmu.source(outputs={{"x": "m"}}, stop=1.0, step=0.01)')
    if not outputs:
        raise TypeError('metafmu.source has no outputs, expected a dict of names to units, for instance outputs={"x": "m"}')

    problems = []
    sections = {"parameters": parameters, "inputs": inputs, "states": states, "outputs": outputs}
    sections = {section: _quantities(section, given, problems) for section, given in sections.items()}
    times = {key: _number(value, key, problems) for key, value in (("stop", stop), ("step", step)) if value is not None}
    for key, value in times.items():
        if value is not None and value <= 0:
            problems.append(f"{key}: found {value}, expected a number of seconds above 0")
    if None not in (length := times.get("stop"), between := times.get("step")) and 0 < length < between:
        problems.append(f"step: found {between}, expected at most the {length} of stop")
    for name, options in sections["states"].items():
        if problem := _missing("state", [str(options.get("rate_of", name))], list(sections["states"])):
            problems.append(f"states.{name}.rate_of: {problem}")
    if description is not None and not isinstance(description, str):
        problems.append(f"description: found {description!r}, expected a text")
    _refuse_all(problems)

    def decorate(model):
        about = {"description": _sentence(model) if description is None else description}
        return Source(model, about | times | sections)

    return decorate


class Source:
    """A function or class with the names, units and ranges of its quantities, made by :func:`metafmu.source`.

    It raises TypeError for states without a method ``equations``, and for a class with neither ``run`` nor ``equations``. It raises
    :class:`metafmu.Error` for a function or class with other arguments.
    """

    def __init__(self, model, about):
        self._about, self._origin = about, model
        #: Paths of files that the model reads: a :class:`metafmu.Study` has them, so that runs of other content are not used.
        self.files = []
        self.__doc__ = model.__doc__
        _refuse_all(_problems_of_arguments(model, about))
        has_equations = hasattr(self._model, "equations")
        if about["states"] and not has_equations:
            raise TypeError("states without equations, expected a class with a method `equations`")
        if isinstance(model, type) and not (has_equations or hasattr(self._model, "run")):
            raise TypeError("the class has neither `run` nor `equations`")

    @functools.cached_property
    def _model(self):
        return self._origin() if isinstance(self._origin, type) else self._origin

    def __getstate__(self):
        # each process makes an object of a class
        return {key: value for key, value in self.__dict__.items() if key != "_model"}

    def __call__(self, times, parameters, inputs=None, states=None):
        """Outputs of a run: a dict of arrays, each with a number for each of ``times``, in seconds.

        ``parameters``, ``states``: numbers by name, missing ones have their start values; ``inputs``: arrays of values at the times, for each
        input. Raises :class:`metafmu.Error` for names that the source does not have, for missing inputs, and if the source does not return the
        outputs with a number for each time.
        """
        for what, values in (("parameters", parameters), ("inputs", inputs or {}), ("states", states or {})):
            if not isinstance(values, Mapping):
                raise _error(f"{what}: found {values!r}, expected a dict by name")
        try:
            times = np.asarray(times, float)
        except (TypeError, ValueError):
            raise _error(f"times: found {times!r}, expected an array of numbers") from None
        if times.ndim != 1:
            raise _error(f"times: found the shape {times.shape}, expected an array of numbers, as in [0.0, 0.1]")
        self._refuse("states", "state", states or {}, self._about["states"])
        self._refuse("inputs", "input", inputs or {}, self._about["inputs"])
        self._refuse("inputs", "input", self._about["inputs"], inputs or {})
        return self._run(times, parameters, inputs, states, self._about["outputs"])

    def _run(self, times, parameters, inputs, states, outputs):
        """Result of a run, which has these outputs."""
        times = np.asarray(times, float)
        parameters = self._complete(parameters)
        inputs = {name: np.asarray(values, float) for name, values in (inputs or {}).items()}
        run = getattr(self._model, "run", None) or (None if hasattr(self._model, "equations") else self._model)
        if run is None:
            return self._integrate(times, parameters, inputs, states or {})
        further = ([inputs] if self._about["inputs"] else []) + ([states or {}] if self._about["states"] else [])
        found = run(times, parameters, *further)
        _refuse_all(_problems_of_run(found, outputs, len(times)))
        return found

    def equations(self, parameters, inputs, states):
        """Derivatives of the states and outputs at one point, two dicts of numbers.

        ``parameters``, ``inputs``, ``states``: numbers by name. Missing parameters have their start values. Raises :class:`metafmu.Error` if
        the source does not return two dicts, or derivatives of all states.
        """
        found = self._model.equations(self._complete(parameters), inputs, states)
        _refuse_all(_problems_of_equations(found, self._about["states"]))
        return found

    def serve(self):
        """Answers requests on standard input until it is closed; what the model prints goes to standard error."""
        if sys.stdin.isatty():
            sys.exit(f"this program answers requests of metafmu: metafmu new NAME --command python {sys.argv[0]}")
        sys.stdout.flush()
        replies = os.fdopen(os.dup(1), "w", encoding="utf-8")
        os.dup2(2, 1)
        for line in sys.stdin:
            request = json.loads(line)
            try:
                reply = self._reply(request)
            except Exception as error:
                # one of ours says all that is to be known
                if getattr(error, "is_own", False):
                    reply = {"error": str(error)}
                else:
                    traceback.print_exc()
                    reply = {"error": f"{type(error).__name__}: {error}"}
            replies.write(json.dumps({"id": request["id"]} | reply) + "\n")
            replies.flush()

    def _reply(self, request):
        if request["request"] == "describe":
            return {"protocol": PROTOCOL} | self._about
        parameters, inputs, states = (request.get(section, {}) for section in ("parameters", "inputs", "states"))
        if request["request"] == "run":
            found = self._run(request["times"], parameters, inputs, states, request["outputs"])
            return {"outputs": {name: _list(found[name]) for name in request["outputs"]}}
        if request["request"] == "equations":
            columns = [*parameters.values(), *inputs.values(), *states.values()]
            at = lambda values, point: {name: column[point] for name, column in values.items()}
            points = [[at(values, point) for values in (parameters, inputs, states)] for point in range(len(columns[0]))]
            found = [self.equations(*point) for point in points]
            self._refuse("`equations` returned", "output", request["outputs"], found[0][1])
            reply = {
                "derivatives": {name: _column(found, 0, name) for name in states},
                "outputs": {name: _column(found, 1, name) for name in request["outputs"]},
            }
            return reply | ({"mass": self._mass(found)} if request.get("mass") else {})
        return {"error": f"unknown request {request['request']!r}"}

    def _mass(self, found):
        """Elements of the mass matrices by the rates of their rows and columns."""
        states = self._about["states"]
        rates = [name for name, options in states.items() if "rate_of" in options]
        if any(len(values) < 3 for values in found):
            raise TypeError("`equations` returns two values, expected the mass matrix as the third: states have `rate_of`")
        masses = np.array([values[2] for values in found], float)
        if masses.shape[1:] != (len(rates), len(rates)):
            raise ValueError(f"the mass matrix has shape {masses.shape[1:]}, expected {(len(rates), len(rates))}")
        return {row: {column: masses[:, i, k].tolist() for k, column in enumerate(rates)} for i, row in enumerate(rates)}

    @staticmethod
    def _refuse(what, kind, wanted, known):
        """Raises :class:`metafmu.Error` with all wanted names that are not known, each with the closest known one that nothing wants."""
        if problem := _missing(kind, [str(name) for name in wanted], [str(name) for name in known]):
            raise _error(f"{what}: {problem}")

    def _complete(self, parameters):
        self._refuse("parameters", "parameter", parameters, self._about["parameters"])
        known = self._about["parameters"].items()
        return {name: _start(options) for name, options in known if _start(options) is not None} | dict(parameters)

    def _integrate(self, times, parameters, inputs, states):
        from scipy.integrate import solve_ivp

        names = list(self._about["states"])
        at = lambda t: {name: float(np.interp(t, times, values)) for name, values in inputs.items()}
        start = {name: _start(options) or 0.0 for name, options in self._about["states"].items()} | states
        self.equations(parameters, at(times[0]), start)
        evaluate = lambda t, x: self._model.equations(parameters, at(t), dict(zip(names, map(float, x))))
        rates = lambda t, x: [evaluate(t, x)[0][name] for name in names]
        # inputs have kinks at the times
        step = np.diff(times).max() if inputs and len(times) > 1 else np.inf
        options = {"method": "DOP853", "t_eval": times, "rtol": 1e-9, "atol": 1e-9, "max_step": step}
        solution = solve_ivp(rates, (times[0], times[-1]), [start[name] for name in names], **options)
        if not solution.success:
            raise RuntimeError(solution.message)
        rows = [evaluate(t, x)[1] for t, x in zip(solution.t, solution.y.T)]
        return {name: [row[name] for row in rows] for name in rows[0]}


def _sentence(model):
    lines = (inspect.getdoc(model) or "").strip().splitlines()
    return lines[0] if lines else ""


def _quantities(section, given, problems):
    """Options of each quantity of a section, by name. Adds what is wrong to the problems."""
    if given is None:
        return {}
    if isinstance(given, Mapping):
        items = list(given.items())
    elif isinstance(given, (str, list, tuple)):
        items = [(name, None) for name in ([given] if isinstance(given, str) else given)]
    else:
        ranges = "" if section == "outputs" else ", ranges (min, max)"
        problems.append(f"{section}: found {given!r}, expected a list of names, or a dict of names to units{ranges} or dicts")
        return {}
    found = {}
    for name, options in items:
        if not isinstance(name, str) or not name.strip():
            problems.append(f"{section}: found the name {name!r}, expected a text")
        elif name in found:
            problems.append(f"{section}: found `{name}` twice, expected each name once")
        else:
            found[name] = _quantity(section, name, options, problems)
    return found


def _quantity(section, name, given, problems):
    """Options of a quantity. Adds what is wrong to the problems."""
    what, keys = f"{section}.{name}", _KEYS_OF_STATES if section == "states" else _KEYS
    if isinstance(given, (tuple, list)) and len(given) == 2 and section != "outputs":
        given = {"min": given[0], "max": given[1]}
    options = {} if given is None else {"unit": given} if isinstance(given, str) else given
    if not isinstance(options, Mapping):
        ranges = "" if section == "outputs" else ", a range (min, max)"
        problems.append(f"{what}: found {given!r}, expected a unit{ranges} or a dict with {', '.join(keys)}")
        return {}
    options = dict(options)
    if unknown := [str(key) for key in options if key not in keys]:
        problems.append(f"{what}: {_missing('key', unknown, list(keys))}")
    for key in ("min", "max", "start"):
        if key in options:
            options[key] = _number(options[key], f"{what}.{key}", problems)
    for key in ("unit", "description", "rate_of"):
        if not isinstance(options.get(key, ""), str):
            problems.append(f"{what}.{key}: found {options[key]!r}, expected a text")
    if not isinstance(options.get("periodic", False), bool):
        problems.append(f"{what}.periodic: found {options['periodic']!r}, expected True or False")
    low, high, start = (options.get(key) for key in ("min", "max", "start"))
    if low is not None and high is not None and low >= high:
        problems.append(f"{what}: found min {low} and max {high}, expected min < max")
    elif start is not None and not (low is None or low <= start) & (high is None or start <= high):
        problems.append(f"{what}.start: found {start}, expected a number from min {low} to max {high}")
    return options


def _number(value, what, problems):
    """The value as a number; None, and a problem more, if it is not a finite number."""
    if not isinstance(value, Real) or isinstance(value, (bool, np.bool_)) or not np.isfinite(value):
        problems.append(f"{what}: found {value!r}, expected a finite number")
        return None
    return value if isinstance(value, int) else float(value)


def _refuse_all(problems):
    """Raises :class:`metafmu.Error` with a line for each problem."""
    if problems:
        raise _error("\n".join(f"metafmu.source: {problem}" for problem in problems))


def _problems_of_arguments(model, about):
    """Problems of the arguments of the functions that metafmu calls."""
    further = [section for section in ("inputs", "states") if about[section]]
    of_run, of_equations = ["times", "parameters", *further], ["parameters", "inputs", "states"]
    methods = [("run", of_run), ("equations", of_equations)]
    called = [(f"{getattr(model, '__name__', 'the object')}.{name}", getattr(model, name), names) for name, names in methods if hasattr(model, name)]
    if isinstance(model, type):
        called = [(getattr(model, "__name__"), model, []), *called]
    elif not called and callable(model):
        called = [(getattr(model, "__name__", type(model).__name__), model, of_run)]
    elif not called:
        return [f"found {model!r}, expected a function or class below the decorator"]
    problems = []
    for name, function, names in called:
        # a method of a class has the object as its first argument
        is_method = isinstance(model, type) and function is not model and inspect.isfunction(inspect.getattr_static(model, name.rpartition(".")[2]))
        expected = ["self", *names] if is_method else names
        try:
            signature = inspect.signature(function)
        except (TypeError, ValueError):
            # compiled code does not tell
            continue
        try:
            signature.bind(*expected)
        except TypeError:
            problems.append(f"found `{name}{signature}`, expected `{name}({', '.join(expected)})`")
    return problems


def _problems_of_run(found, outputs, count):
    """Problems of the result of a run with `count` times."""
    if not isinstance(found, Mapping):
        return [f"the function returned {_kind(found)}, expected a dict with an array for each of {', '.join(outputs)}"]
    if problem := _missing("output", list(outputs), [str(name) for name in found]):
        return [f"the function returned {problem}"]
    problems = []
    for name in outputs:
        try:
            shape = np.asarray(found[name], float).shape
        except (TypeError, ValueError):
            problems.append(f"the function returned the output `{name}` of the type {_kind(found[name])}, expected {count} numbers, one for each time")
            continue
        if shape != (count,):
            problems.append(f"the function returned the output `{name}` of the shape {shape}, expected ({count},), a number for each time")
    return problems


def _problems_of_equations(found, states):
    """Problems of the result of the method `equations`."""
    if not isinstance(found, (tuple, list)) or len(found) not in (2, 3) or not all(isinstance(part, Mapping) for part in found[:2]):
        return [f"`equations` returned {_kind(found)}, expected two dicts: derivatives of the states, and outputs"]
    problem = _missing("derivative", list(states), [str(name) for name in found[0]])
    return [f"`equations` returned {problem}"] if problem else []


def _column(found, which, name):
    """Numbers of one name at all points."""
    try:
        return [float(parts[which][name]) for parts in found]
    except (TypeError, ValueError):
        value = next(parts[which][name] for parts in found if not isinstance(parts[which][name], Real))
        raise _error(f"`equations` returned {_kind(value)} for `{name}`, expected a number") from None


def _kind(value):
    """Type of a value, and its shape if it has one."""
    shape = getattr(value, "shape", None)
    return "None" if value is None else f"`{type(value).__name__}`" + (f" of the shape {shape}" if shape is not None else "")


def _start(options):
    if "start" in options or "min" not in options or "max" not in options:
        return options.get("start")
    return 0.5 * (options["min"] + options["max"])


def _list(values):
    return np.asarray(values, float).tolist()


def _error(message):
    """:class:`metafmu.Error`, or ValueError without the extension."""
    try:
        from ._metafmu import Error as kind
    except ImportError:
        kind = ValueError
    error = kind(message)
    error.is_own = True
    return error


def _missing(kind, wanted, known):
    """A sentence on the wanted names that are not known, with the nearest ones; None if all are."""
    if lacking := [name for name in wanted if name not in known]:
        try:
            from ._metafmu import missing
        except ImportError:
            return f"no {kind} {', '.join(lacking)}, expected one of {', '.join(known)}"
        return missing(kind, wanted, known)
    return None
