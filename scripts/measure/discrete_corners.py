"""Compares discrete-time surrogates with their source where no training run was.

The study must have been built. Its source is an FMU, or `--source` names one with the same inputs, outputs and parameters. Both FMUs run
from rest for ten times `time.stop`, with the parameters at their ends and in the middle. The inputs are constant at both ends, zero, a
step, a release to zero, or a square wave.

For each study the script prints the largest error in multiples of the bound, which is the largest one of `[bounds]`, or without that
section the largest error on the test runs. It prints the same figure for rows where `in_domain` is true, also as a share of the output's
range in the test runs. For these rows it adds the share with an error beyond the bound, and the number of runs with such rows. The last
number is that of rows of the test runs where `in_domain` is false. The script exits with 1 if more rows inside the domain are beyond the
bound than its coverage allows, and without `[bounds]` if any are.

Usage: .venv/bin/python scripts/measure discrete-corners [--out FOLDER] [--source FMU] [--runs N] [--json FILE] STUDY ...
"""

import argparse
import itertools
import json
import sys
import tempfile
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE

LENGTHS = 10
# `in_domain` has what FMUs log about their domain
SILENT = fmi2CallbackFunctions(logger=fmi2CallbackLoggerTYPE(lambda *_: None))


class Component:
    """An FMU 2.0 for co-simulation that is stepped from row to row, its inputs held in between."""

    def __init__(self, path: Path, folder: str):
        self.description = read_model_description(str(path))
        self.references = {variable.name: variable.valueReference for variable in self.description.modelVariables}
        self.unpacked = extract(str(path), tempfile.mkdtemp(dir=folder))

    def simulate(self, starts: dict, inputs: dict, outputs: list, step: float, domain: bool):
        description = self.description
        fmu = FMU2Slave(
            guid=description.guid, unzipDirectory=self.unpacked, modelIdentifier=description.coSimulation.modelIdentifier, instanceName="i"
        )
        fmu.instantiate(callbacks=SILENT)
        fmu.setupExperiment(startTime=0.0)
        for name, value in starts.items():
            if name in self.references:
                fmu.setReal([self.references[name]], [value])
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        driven, shown = [[self.references[name] for name in names] for names in (inputs, outputs)]
        signals = np.column_stack(list(inputs.values()))
        found, inside = [], []
        for row, values in enumerate(signals):
            found.append(fmu.getReal(shown))
            inside.append(not domain or bool(fmu.getBoolean([self.references["in_domain"]])[0]))
            if row + 1 < len(signals):
                fmu.setReal(driven, list(values))
                fmu.doStep(currentCommunicationPoint=row * step, communicationStepSize=step)
        fmu.terminate()
        fmu.freeInstance()
        return np.array(found), np.array(inside)


def signals(ranges: list, rows: int, hold: int):
    """Name and values of all combinations: the first input in all ways, the others constant."""
    row = np.arange(rows)
    constant = {
        "low": lambda low, high: np.full(rows, low),
        "zero": lambda low, high: np.full(rows, np.clip(0.0, low, high)),
        "high": lambda low, high: np.full(rows, high),
    }
    moving = {
        "step": lambda low, high: np.where(row < hold, low, high),
        "release": lambda low, high: np.where(row < hold, high, np.clip(0.0, low, high)),
        "square": lambda low, high: np.where(row // hold % 2 == 0, high, low),
    }
    for kinds in itertools.product({**constant, **moving}, *[constant] * (len(ranges) - 1)):
        yield "/".join(kinds), [{**constant, **moving}[kind](low, high) for kind, (low, high) in zip(kinds, ranges)]


def corners(ranges: list):
    return itertools.product(*[(low, 0.5 * (low + high), high) for low, high in ranges])


def check(study: Path, out: Path, source: Path | None, runs: int | None) -> dict:
    options = tomllib.loads(study.read_text())
    name, step, stop = options["name"], options["time"]["step"], options["time"]["stop"]
    metrics = json.loads((out / name / "metrics.json").read_text())
    outputs, inputs, parameters = list(options["outputs"]), list(options["inputs"]), options.get("parameters", {})
    coverage = options["bounds"].get("coverage", 0.95) if "bounds" in options else 1.0
    bounds = np.array([metrics["outputs"][output].get("bound", metrics["outputs"][output]["max_abs_error"]) for output in outputs])
    test = pd.read_csv(out / name / "test.csv")
    widths = np.array([test[output].max() - test[output].min() for output in outputs])
    described = read_model_description(str(out / name / f"{name}.fmu"))
    variables = {variable.name: variable for variable in described.modelVariables}
    ranges = [(float(variables[name].min), float(variables[name].max)) for name in inputs]
    with tempfile.TemporaryDirectory() as folder:
        surrogate = Component(out / name / f"{name}.fmu", folder)
        truth = Component(source or study.parent / options["source"]["fmu"], folder)
        # the share of the test runs that counts as outside
        rows, outside = 0, 0
        for _, run in test.groupby("run"):
            if run["time"].iloc[0] < 0.0:
                continue
            starts = {column: run[column].iloc[0] for column in [*parameters, *(f"{name}_start" for name in [*outputs, *inputs])]}
            inside = surrogate.simulate(starts, {name: run[name].to_numpy() for name in inputs}, outputs, step, True)[1]
            rows, outside = rows + len(inside), outside + int((~inside).sum())
        count = round(LENGTHS * stop / step) + 1
        cases = []
        values = corners([(options["min"], options["max"]) for options in parameters.values()])
        every = itertools.product(values, signals(ranges, count, round(stop / step / 3)))
        for point, (kinds, driven) in itertools.islice(every, runs):
            starts, driven = dict(zip(parameters, point)), dict(zip(inputs, driven))
            true, _ = truth.simulate(starts, driven, outputs, step, False)
            found, inside = surrogate.simulate(starts, driven, outputs, step, True)
            errors = np.abs(found - true)
            ratio, share = np.max(errors / bounds, axis=1), np.max(errors / widths, axis=1)
            cases.append({
                "parameters": starts,
                "inputs": kinds,
                "largest": float(ratio.max()),
                "inside": float(np.max(ratio, where=inside, initial=0.0)),
                "inside_share": float(np.max(share, where=inside, initial=0.0)),
                "rows": int(inside.sum()),
                "beyond": int(((ratio > 1.0) & inside).sum()),
                "left": float(np.argmin(inside) * step) if not inside.all() else None,
            })
    beyond = sum(case["beyond"] for case in cases) / max(sum(case["rows"] for case in cases), 1)
    alarms = outside / max(rows, 1)
    return {"study": study.name, "bounds": dict(zip(outputs, bounds)), "coverage": coverage, "beyond": beyond, "alarms": alarms, "cases": cases}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, default=Path("out"), help="where `metafmu build` wrote its results")
    parser.add_argument("--source", type=Path, help="FMU to compare with, unless the study names one")
    parser.add_argument("--runs", type=int, help="number of combinations; all unless given")
    parser.add_argument("--json", type=Path, help="write all figures to this file")
    options = parser.parse_args()
    found = [check(study, options.out, options.source, options.runs) for study in options.study]
    print("| study | largest error, in bounds | where `in_domain` is true | of the output's range | rows there beyond the bound | rows of the test runs outside |")
    print("|---|---|---|---|---|---|")
    for result in found:
        largest, inside, share = (max(case[key] for case in result["cases"]) for key in ("largest", "inside", "inside_share"))
        cells = [f"{largest:.3g}", f"{inside:.2g}", f"{100 * share:.2g} %", f"{100 * result['beyond']:.2g} %", f"{100 * result['alarms']:.2g} %"]
        print(f"| {result['study']} | {' | '.join(cells)} |")
    for result in found:
        late = [case for case in result["cases"] if case["inside"] > 1.0]
        for case in sorted(late, key=lambda case: -case["inside"])[:10]:
            point = ", ".join(f"{name} = {value:g}" for name, value in case["parameters"].items())
            left = "never" if case["left"] is None else f"first at {case['left']:g} s"
            print(f"    {case['inside']:.2f}: {case['inputs']}{', ' if point else ''}{point}; outside {left}")
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))
    sys.exit(0 if all(result["beyond"] <= 1.0 - result["coverage"] for result in found) else 1)


if __name__ == "__main__":
    main()
