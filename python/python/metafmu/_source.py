"""A function or class as the source of a study: it answers the requests of docs/command-sources.md.

Nothing of the package is imported here but numpy, so that a worker starts fast.
"""

from __future__ import annotations

import functools
import inspect
import json
import os
import sys
import traceback

import numpy as np

PROTOCOL = 1


def source(model=None, /, *, parameters=None, outputs=None, inputs=None, states=None, stop=None, step=None, description=None):
    """Turns a function or class into a source that `metafmu` samples. ``outputs`` is required; a decorator without arguments raises TypeError.

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

    ``parameters``, ``inputs``, ``states`` and ``outputs``: a dict of a unit, or of a dict with ``unit``, ``min``, ``max``, ``start`` and
    ``description``, for each name; of a state also ``periodic`` and ``rate_of``. ``stop`` and ``step``: length of a run and time between two rows, in s.

    :class:`metafmu.Study` builds a surrogate of it. Or a script ends with ``if __name__ == "__main__": decay.serve()``; then
    `metafmu new NAME --command python SCRIPT` writes its study.
    """

    if model is not None:
        found = getattr(model, "__name__", repr(model))
        raise TypeError(f'@metafmu.source has no arguments for `{found}`, expected for instance @metafmu.source(outputs={{"x": "m"}}, stop=1.0, step=0.01)')
    if not outputs:
        raise TypeError('metafmu.source has no outputs, expected a dict of names to units, for instance outputs={"x": "m"}')

    def decorate(model):
        about = {"description": _sentence(model) if description is None else description}
        about |= {"stop": stop} if stop is not None else {}
        about |= {"step": step} if step is not None else {}
        sections = {"parameters": parameters, "inputs": inputs, "states": states, "outputs": outputs}
        return Source(model, about | {section: _quantities(known) for section, known in sections.items()})

    return decorate


class Source:
    """A function or class with the names, units and ranges of its quantities, made by :func:`metafmu.source`.

    It raises TypeError for states without a method ``equations``, and for a class with neither ``run`` nor ``equations``.
    """

    def __init__(self, model, about):
        self._about, self._origin = about, model
        #: Paths of files that the model reads: a :class:`metafmu.Study` has them, so that runs of other content are not used.
        self.files = []
        self.__doc__ = model.__doc__
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
        input. Raises :class:`metafmu.Error` for names that the source does not have, and for missing inputs.
        """
        self._refuse("states", "state", states or {}, self._about["states"])
        self._refuse("inputs", "input", inputs or {}, self._about["inputs"])
        self._refuse("inputs", "input", self._about["inputs"], inputs or {})
        return self._run(times, parameters, inputs, states)

    def _run(self, times, parameters, inputs, states):
        times = np.asarray(times, float)
        parameters = self._complete(parameters)
        inputs = {name: np.asarray(values, float) for name, values in (inputs or {}).items()}
        run = getattr(self._model, "run", None) or (None if hasattr(self._model, "equations") else self._model)
        if run is None:
            return self._integrate(times, parameters, inputs, states or {})
        further = ([inputs] if self._about["inputs"] else []) + ([states or {}] if self._about["states"] else [])
        return run(times, parameters, *further)

    def equations(self, parameters, inputs, states):
        """Derivatives of the states and outputs at one point, two dicts of numbers.

        ``parameters``, ``inputs``, ``states``: numbers by name. Missing parameters have their start values.
        """
        return self._model.equations(self._complete(parameters), inputs, states)

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
                traceback.print_exc()
                reply = {"error": f"{type(error).__name__}: {error}"}
            replies.write(json.dumps({"id": request["id"]} | reply) + "\n")
            replies.flush()

    def _reply(self, request):
        if request["request"] == "describe":
            return {"protocol": PROTOCOL} | self._about
        parameters, inputs, states = (request.get(section, {}) for section in ("parameters", "inputs", "states"))
        if request["request"] == "run":
            found = self._run(request["times"], parameters, inputs, states)
            return {"outputs": {name: _list(found[name]) for name in request["outputs"]}}
        if request["request"] == "equations":
            columns = [*parameters.values(), *inputs.values(), *states.values()]
            at = lambda values, point: {name: column[point] for name, column in values.items()}
            points = [[at(values, point) for values in (parameters, inputs, states)] for point in range(len(columns[0]))]
            found = [self.equations(*point) for point in points]
            column = lambda name, which: [float(pair[which][name]) for pair in found]
            reply = {
                "derivatives": {name: column(name, 0) for name in states},
                "outputs": {name: column(name, 1) for name in request["outputs"]},
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
        if any(name not in known for name in wanted):
            # not by a worker, whose requests have the names of the source
            from ._metafmu import Error, missing

            raise Error(f"{what}: {missing(kind, [str(name) for name in wanted], [str(name) for name in known])}")

    def _complete(self, parameters):
        self._refuse("parameters", "parameter", parameters, self._about["parameters"])
        known = self._about["parameters"].items()
        return {name: _start(options) for name, options in known if _start(options) is not None} | dict(parameters)

    def _integrate(self, times, parameters, inputs, states):
        from scipy.integrate import solve_ivp

        names = list(self._about["states"])
        start = {name: _start(options) or 0.0 for name, options in self._about["states"].items()} | states
        at = lambda t: {name: float(np.interp(t, times, values)) for name, values in inputs.items()}
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


def _quantities(known):
    return {name: {"unit": options} if isinstance(options, str) else dict(options) for name, options in (known or {}).items()}


def _start(options):
    if "start" in options or "min" not in options or "max" not in options:
        return options.get("start")
    return 0.5 * (options["min"] + options["max"])


def _list(values):
    return np.asarray(values, float).tolist()
