"""Prints time and error of FMUs for model exchange, by metafmu and by FMPy's CVode: a table of docs/fmu-source.md.

The FMUs are those of examples/fmu-source/exchange.py. Van der Pol's oscillator has mu = 1000; its reference is scipy's Radau at 1e-11, that of
the others is a closed form. Errors are the largest at any row. Evaluations are calls for all derivatives, as the FMU counts them. Times are
those of the whole command and of `simulate_fmu`: minima of REPEATS runs. The last row is a run without a step, so that it shows what both need
to start. FMPy's limit of 500 steps from row to row is raised. Needs target/release/metafmu, fmpy, scipy, cc.

Usage: .venv/bin/python scripts/measure model-exchange [--metafmu PATH] [--repeats 5]
"""

import argparse
import csv
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from common import METAFMU, ROOT
from fmpy import simulate_fmu
from fmpy.sundials import CVodeSolver
from scipy.integrate import solve_ivp

sys.path.insert(0, str(ROOT / "examples" / "fmu-source"))
import exchange


def relaxation(times, mu):
    rates = lambda _, x: [x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]]
    jacobian = lambda _, x: [[0, 1], [-2 * mu * x[0] * x[1] - 1, mu * (1 - x[0] ** 2)]]
    solution = solve_ivp(rates, (0, times[-1]), [2, 0], "Radau", times, rtol=1e-11, atol=1e-13, jac=jacobian)
    return dict(zip(("x0", "x1"), solution.y))


# heading, model, its solution, parameters, rows: stop and step
CASES = [
    ("Van der Pol, mu = 1000", "van_der_pol", relaxation, {"mu": 1000.0}, 3000.0, 100.0),
    ("relay, k = 1e6", "relay", exchange.relay, {"k": 1e6, "band": 1.0}, 5.0, 0.5),
    ("stick and slip", "stick_slip", exchange.stick_slip, {"stiffness": 20.0, "b": 0.5, "stick": 4.0, "slip": 2.0}, 5.0, 0.5),
    ("bouncing ball", "ball", exchange.ball, {"e": 0.7, "h_start": 1.0}, 2.4, 0.1),
]


def by_metafmu(command, fmu, parameters, stop, step, tolerance):
    starts = [f"--start={name}={value!r}" for name, value in parameters.items()]
    options = [f"--stop-time={stop}", f"--step-size={step}", f"--tolerance={tolerance}", "--interface=me"]
    done = subprocess.run([command, "simulate", fmu, *starts, *options], check=True, capture_output=True, text=True)
    rows = list(csv.DictReader(done.stdout.splitlines()))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def by_fmpy(fmu, parameters, stop, step, tolerance):
    options = {"output_interval": step, "relative_tolerance": tolerance, "record_events": False}
    return simulate_fmu(fmu, stop_time=stop, start_values=parameters, fmi_type="ModelExchange", **options)


def measured(run, counts, expected, repeats):
    """Cells of a run: error, evaluations, milliseconds."""
    seconds = []
    for _ in range(repeats):
        counts.unlink(missing_ok=True)
        begin = time.perf_counter()
        found = run()
        seconds.append(time.perf_counter() - begin)
    error = max(np.abs(found[name][: len(values)] - values).max() for name, values in expected.items())
    evaluations = int(np.loadtxt(counts, ndmin=2)[:, 0].sum())
    return f"{error:.1e} | {evaluations:,} | {1e3 * min(seconds):.0f}"


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--metafmu", type=Path, default=METAFMU)
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    # the last default is maxNumSteps
    CVodeSolver.__init__.__defaults__ = (*CVodeSolver.__init__.__defaults__[:-1], 1_000_000)
    print("| model | tolerance | error | evaluations | ms | CVode's error | evaluations | ms |\n|---|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        counts = folder / "counts"
        os.environ["EXCHANGE_COUNTS"] = str(counts)
        for heading, model, solution, parameters, stop, step in CASES:
            fmu = exchange.build(model, 2, folder)
            expected = solution(np.arange(round(stop / step) + 1) * step, *parameters.values())
            for tolerance in (1e-6, 1e-8, 1e-10):
                options = (parameters, stop, step, tolerance)
                ours = measured(lambda: by_metafmu(arguments.metafmu, fmu, *options), counts, expected, arguments.repeats)
                theirs = measured(lambda: by_fmpy(str(fmu), *options), counts, expected, arguments.repeats)
                print(f"| {heading} | {tolerance:.0e} | {ours} | {theirs} |", flush=True)
        nothing = {"v": np.zeros(1)}, arguments.repeats
        options = ({}, 1e-9, 1e-9, 1e-8)
        ours = measured(lambda: by_metafmu(arguments.metafmu, fmu, *options), counts, *nothing)
        theirs = measured(lambda: by_fmpy(str(fmu), *options), counts, *nothing)
        print(f"| no step | | {ours} | {theirs} |")


if __name__ == "__main__":
    main()
