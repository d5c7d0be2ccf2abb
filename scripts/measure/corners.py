"""Checks surrogates with states at corners of their domain against independent integrations: ends of parameters, constant inputs, largest speeds.

For each mechanism file (those of examples/dynamics/ unless given) `metafmu new NAME --mechanism FILE --structure dynamics` writes a study,
`metafmu build` makes the FMU, and fmpy steps it in co-simulation. The truth is the mechanism itself, integrated in redundant coordinates with a
tolerance of 1e-10 or less by `metafmu sample`, which shares neither the equations nor the solver with the FMU. With `--longest` the truth is the
FMU in model exchange, integrated by scipy's DOP853 with a tolerance of 1e-11 and steps of at most this length. That checks the FMU's solver alone:
no step of scipy jumps over a force that acts for longer.

training.json states the error of the solver, `wanted`, as that of a start, and the error of the equations, relative to the largest. To find the bound of
an output at a time t, each component of the truth's initial state is perturbed: by `wanted`, and by what the equations' error adds up to.
This is the largest rate of the state in the run times the error times t. The bound is the largest change up to this time. It is at least the
sum of both errors and that of forces, times the output's range in training or in this run. The truth is not exact
either: what it changes by at ten times its tolerance is added. For each corner the script prints the largest error over this bound while
`in_domain` is true, and how long it is true. It exits with 1 if an error passes the bound there, or if a step inside the domain fails.

Usage: .venv/bin/python scripts/measure corners [--corners N] [--random N] [--longest SECONDS] [--stop SECONDS] [--every ROWS] [MECHANISM.toml ...]
"""

import argparse
import contextlib
import csv
import ctypes
import itertools
import json
import random
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import NamedTuple

import fmpy
import numpy as np
from common import METAFMU, ROOT
from fmpy.fmi2 import FMU2Model, FMU2Slave
from scipy.integrate import solve_ivp

MECHANISMS = ["pendulum", "crane", "double-pendulum", "quarter-car", "slider-crank"]
TOLERANCE = 1e-12
# by how much a start is off with which the sensitivity of the truth is found
OFF = 1e-6


def run(folder, *arguments):
    """Runs the command, which must succeed."""
    done = subprocess.run([METAFMU, *arguments], cwd=folder, capture_output=True, text=True)
    if done.returncode != 0:
        raise SystemExit(f"metafmu {' '.join(map(str, arguments))} ended with {done.returncode}:\n{done.stderr[-2000:]}")


def header(model):
    """The metadata of a model file."""
    with open(model, "rb") as file:
        length = int.from_bytes(file.read(8), "little")
        return json.loads(json.loads(file.read(length))["__metadata__"]["metafmu"])


def error_of_equations(training):
    """Error of the equations that are exported: it is the largest at corners of the domain."""
    of_dictionary = training["error"] if training["exported"] == "dictionary" else 0.0
    return max(of_dictionary, training["corners"]["accelerations"]["error"] if "corners" in training else 0.0)


def error_of_forces(training):
    """Error of forces of joints, drivers and springs, which are learned separately: at unseen configurations, and at corners of the domain."""
    of_functions = training["reactions"]["error"] if "reactions" in training else 0.0
    at_corners = training.get("corners", {}).get("forces", {"error": 0.0})
    return max(of_functions, at_corners["error"])


def coordinates(study):
    """Their number: only states of actuators have no range in a study. Velocities follow the coordinates, states of actuators come last."""
    return sum("min" in options for options in study["states"].values())


def corners(study, states, drivers, count):
    """Some of all combinations of ends: values of parameters, of inputs, and of the states at the start."""
    parameters = {name: (range_["min"], range_["max"]) for name, range_ in study.get("parameters", {}).items()}
    n = coordinates(study)
    begin = [low + 0.3 * (high - low) for low, high in map(start, study["states"].values())]
    speeds = [[0.0] * n, *([0.8 * state["range"][end] for state in states[n : 2 * n]] for end in (1, 0))]
    inputs = [{name: value(*range_) for name, range_ in drivers.items()} for value in (min, max, lambda low, high: min(max(0.0, low), high))]
    ends = [dict(zip(parameters, values)) for values in itertools.product(*parameters.values())]
    every = [(p, u, begin[:n] + v + begin[n:]) for v in speeds for u in (inputs if drivers else [{}]) for p in ends]
    count = min(count, len(every))
    # neighbors differ in the first parameter
    return [every[(index * len(every) // count + index * (count < len(every))) % len(every)] for index in range(count)]


def drawn(study, states, drivers, count):
    """Random values of parameters and constant inputs, and random states at the start, in the middle half of their ranges."""
    chance = random.Random(1)
    parameters = {name: (range_["min"], range_["max"]) for name, range_ in study.get("parameters", {}).items()}
    middle = [(0.75 * low + 0.25 * high, 0.25 * low + 0.75 * high) for low, high in (state["range"] for state in states)]

    def within(ranges):
        return {name: chance.uniform(*range_) for name, range_ in ranges.items()}

    return [(within(parameters), within(drivers), [chance.uniform(*range_) for range_ in middle]) for _ in range(count)]


def start(options):
    """Where the study's runs start."""
    if "start" in options:
        return options["start"]
    middle, tenth = 0.5 * (options["min"] + options["max"]), 0.1 * (options["max"] - options["min"])
    return [middle - tenth, middle + tenth]


def text_of(value):
    """A value in TOML."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f'"{key}" = {text_of(item)}' for key, item in value.items()) + " }"
    return json.dumps(value)


def truth(folder, study, mechanism, corner, times, tolerance):
    """Outputs of the mechanism itself at these times, row by row."""
    parameters, inputs, states = corner
    n = coordinates(study)
    source = {"mechanism": str(mechanism), "constants": {**study["source"].get("constants", {}), **parameters}, "tolerance": tolerance}
    starts = {}
    for k, (name, options) in enumerate(study["states"].items()):
        begin = states[k] if k < n else states[n + k]
        # runs differ, by much less than the errors that are looked for
        starts[name] = {"start": [begin, begin + 1e-12]}
        if k < n:
            starts[name] |= {"min": options["min"], "max": options["max"], "velocity": [states[n + k]] * 2}
    driven = {}
    for name, value in inputs.items():
        (folder / f"{name}.csv").write_text(f"time,{name}\n0,{value!r}\n{2 * times[-1]!r},{value!r}\n")
        driven[name] = {"recording": f"{name}.csv"}
    sections = {
        "source": source,
        "time": {"stop": times[-1], "step": times[1] - times[0]},
        "states": starts,
        "inputs": driven,
        "outputs": study["outputs"],
        "sampling": {"runs": 2, "test_runs": 1},
    }
    lines = ['name = "truth"', 'structure = "dynamics"']
    for section, content in sections.items():
        lines += [f"[{section}]", *(f'"{key}" = {text_of(value)}' for key, value in content.items())]
    (folder / "truth.toml").write_text("\n".join(lines) + "\n")
    run(folder, "sample", "truth.toml")
    with open(folder / "out" / "truth" / "test.csv", newline="") as file:
        rows = list(csv.reader(file))
    names = [name.split(" ")[0] for name in rows[0]]
    columns = [names.index(name) for name in study["outputs"]]
    values = np.array([[float(row[column]) for column in columns] for row in rows[1:]])
    if len(values) != len(times):
        raise SystemExit(f"the truth of {mechanism.stem} has {len(values)} rows instead of {len(times)}: {folder}")
    return values


def integrated(fmu, description, study, corner, starts, times, longest):
    """Outputs of the FMU in model exchange, integrated by scipy with short steps, row by row; `starts` are the names of start values."""
    parameters, inputs, begin = corner
    n = len(begin)
    references = {variable.name: variable.valueReference for variable in description.modelVariables}
    model = FMU2Model(
        guid=description.guid,
        unzipDirectory=fmu,
        modelIdentifier=description.modelExchange.modelIdentifier,
        instanceName="truth",
    )
    values = {**parameters, **inputs, **dict(zip(starts, begin))}
    outputs = [references[name] for name in study["outputs"]]
    states, rates = (ctypes.c_double * n)(), (ctypes.c_double * n)()

    def derivative(t, y):
        states[:] = y
        model.setTime(t)
        model.setContinuousStates(states, n)
        model.getDerivatives(rates, n)
        return list(rates)

    with contextlib.redirect_stdout(None):
        model.instantiate()
        model.setupExperiment(startTime=0.0)
        model.enterInitializationMode()
        model.setReal([references[name] for name in values], list(values.values()))
        model.exitInitializationMode()
        model.newDiscreteStates()
        model.enterContinuousTimeMode()
        run = solve_ivp(derivative, (times[0], times[-1]), begin, "DOP853", times, rtol=1e-11, atol=1e-12, max_step=longest)
        found = []
        for t, y in zip(run.t, run.y.T):
            derivative(t, y)
            found.append(model.getReal(outputs))
    model.freeInstance()
    return np.array(found)


class Stepped(NamedTuple):
    """Outputs of an FMU, row by row as long as it is in its domain, and the largest rate of each state."""

    outputs: np.ndarray
    rates: np.ndarray


def stepped(fmu, description, study, corner, starts, states, times):
    """Steps the FMU until it leaves its domain."""
    parameters, inputs, begin = corner
    references = {variable.name: variable.valueReference for variable in description.modelVariables}
    slave = FMU2Slave(
        guid=description.guid,
        unzipDirectory=fmu,
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName="corner",
    )
    slave.instantiate()
    values = {**parameters, **inputs, **dict(zip(starts, begin))}
    outputs = [references[name] for name in study["outputs"]]
    derivatives = [references[f"der({state['name']})"] for state in states]
    found, rates = [], np.zeros(len(states))
    with contextlib.redirect_stdout(None):
        slave.setupExperiment(startTime=0.0)
        slave.setReal([references[name] for name in values], list(values.values()))
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        for now, then in zip(times, [*times[1:], None]):
            if not slave.getBoolean([references["in_domain"]])[0]:
                break
            found.append(slave.getReal(outputs))
            rates = np.maximum(rates, np.abs(slave.getReal(derivatives)))
            if then is None:
                break
            slave.doStep(currentCommunicationPoint=now, communicationStepSize=then - now)
    slave.freeInstance()
    return Stepped(np.array(found).reshape(len(found), len(outputs)), rates)


def check(mechanism, options, folder):
    """Prints a line for each corner; returns whether all errors are below their bounds."""
    name = mechanism.stem
    run(folder, "new", name, "--mechanism", mechanism, "--structure", "dynamics")
    study = tomllib.loads((folder / f"{name}.toml").read_text())
    run(folder, "build", f"{name}.toml")
    out = folder / "out" / name
    training = json.loads((out / "training.json").read_text())["motion"]
    solver, model = training["solver"], header(out / f"{name}.safetensors")
    states = model["states"]
    of_study = list(study["states"].values())[: coordinates(study)]
    ends = [[of["min"], of["max"]] for of in of_study] + [of.get("velocity", [0.0, 0.0]) for of in of_study]
    for state, of in zip(states, ends):
        # nothing depends on it, so it has no range
        state.setdefault("range", of)
    of_equations = error_of_equations(training)
    stated = solver["wanted"] + of_equations
    stated_of_outputs = stated + error_of_forces(training)
    ranges = np.array([output["max"] - output["min"] for output in model["outputs"]])
    step = study["time"]["step"] * options.every
    times = [step * row for row in range(round((options.stop or study["time"]["stop"]) / step) + 1)]
    drivers = {of["name"]: (of["min"], of["max"]) for of in model["inputs"] if of["role"]["causality"] == "input"}
    how = f"tolerance {solver['tolerance']:.0e}" if solver.get("tolerance") else f"fixed steps of {solver['step']} s"
    print(f"{name}: {how}, stated error of a start {stated:.1e}", flush=True)
    fmu = fmpy.extract(out / f"{name}.fmu", unzipdir=folder / "unzipped" / name)
    description = fmpy.read_model_description(fmu)
    good = True
    starts = [of["name"] for of in model["inputs"] if of["role"]["causality"] == "start"]
    every = corners(study, states, drivers, options.corners) + drawn(study, states, drivers, options.random)

    def exactly(corner, times, tolerance=TOLERANCE):
        if options.longest:
            return integrated(fmu, description, study, corner, starts, times, options.longest)
        return truth(folder, study, mechanism, corner, times, tolerance)

    for corner in every:
        found, rates = stepped(fmu, description, study, corner, starts, states, times)
        # the truth is needed only for as long as the surrogate claims to be valid
        rows = max(len(found), 2)
        exact = exactly(corner, times[:rows])[: len(found)]
        parameters, inputs, begin = corner
        by_start, since = np.zeros_like(exact), np.array(times[: len(found)])[:, None]
        for state in range(len(begin)):
            moved = (parameters, inputs, [value + OFF * (k == state) for k, value in enumerate(begin)])
            by_state = np.abs(exactly(moved, times[:rows])[: len(found)] - exact) / OFF
            by_start += by_state * (solver["wanted"] + of_equations * rates[state] * since)
        by_start = np.maximum.accumulate(by_start, axis=0)
        # scipy's run stands for the truth as it is
        of_truth = np.zeros_like(exact) if options.longest else np.abs(exactly(corner, times[:rows], 10 * TOLERANCE)[: len(found)] - exact)
        widths = np.maximum(ranges, np.ptp(exact, axis=0)) if len(exact) else ranges
        bound = np.maximum(by_start, stated_of_outputs * widths) + np.maximum.accumulate(of_truth, axis=0) + 1e-10 * ranges
        share = (np.abs(found - exact) / bound).max(initial=0.0)
        is_good = bool(share <= 1.0)
        good &= is_good
        text = ", ".join(f"{name} {value:.3g}" for name, value in [*parameters.items(), *inputs.items()])
        velocities = ", ".join(f"{value:.3g}" for value in begin[coordinates(study) :])
        verdict = "" if is_good else "  PASSED ITS BOUND"
        print(f"  {share:9.2e} of the bound, in the domain for {times[max(len(found) - 1, 0)]:.3g} of {times[-1]:.3g} s: {text}, speeds {velocities}{verdict}", flush=True)
    return good


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mechanisms", nargs="*", type=Path, help="mechanism files")
    parser.add_argument("--corners", type=int, default=12, help="of each mechanism, at most")
    parser.add_argument("--random", type=int, default=0, help="further runs with random parameters, inputs and starts")
    parser.add_argument("--longest", type=float, help="longest step of scipy, in s, which then integrates the FMU's equations")
    parser.add_argument("--stop", type=float, help="length of the runs, in s; that of the study unless given")
    parser.add_argument("--every", type=int, default=1, help="communication steps, in rows of the study")
    options = parser.parse_args()
    mechanisms = options.mechanisms or [ROOT / "examples" / "dynamics" / f"{name}.toml" for name in MECHANISMS]
    good = True
    for mechanism in mechanisms:
        with tempfile.TemporaryDirectory() as folder:
            good &= check(mechanism.resolve(), options, Path(folder))
    sys.exit(0 if good else 1)


if __name__ == "__main__":
    main()
