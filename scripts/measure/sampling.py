"""Data generation for the paper's pendulum and double pendulum: metafmu beside scipy and vectorised numpy.

Needs numpy and scipy (.venv has them) and target/release/metafmu. Prints seconds for the paper's 11-level meshes, the shortest of several.
`metafmu sample` runs on all cores, at a tolerance of 1e-10 and at its usual 1e-13. scipy's DOP853 at 1e-10 integrates a part of the mesh,
one run after the other. Fixed-step Runge-Kutta of order 8 in numpy integrates all runs at once. Errors are the largest at any row of about
60 runs, compared with numpy's with four steps a row.
"""

import argparse
import json
import subprocess
import tempfile
import time
from math import cos, sin
from pathlib import Path

import numpy as np
import pandas as pd
from common import ROOT
from scipy.integrate import solve_ivp
from scipy.integrate._ivp import dop853_coefficients as tableau

G = 9.81


def pendulum(length, damping, _):
    a, b = G / length, damping / (0.3 * length)
    return lambda t, y: (y[1], -a * sin(y[0]) - b * y[1])


def pendulums(y, p):
    return np.stack([y[1], -G / p[0] * np.sin(y[0]) - p[1] / (0.3 * p[0]) * y[1]])


def double(l1, l2, *_):
    def f(t, y):
        a, b, ad, bd = y
        c, s = cos(a - b), sin(a - b)
        r1, r2 = -l2 * bd * bd * s - 3 * G * sin(a), l1 * ad * ad * s - G * sin(b)
        determinant = 3 * l1 * l2 - l1 * l2 * c * c
        return ad, bd, (l2 * r1 - l2 * c * r2) / determinant, (3 * l1 * r2 - l1 * c * r1) / determinant

    return f


def doubles(y, p):
    (a, b, ad, bd), (l1, l2) = y, p[:2]
    c, s = np.cos(a - b), np.sin(a - b)
    r1, r2 = -l2 * bd * bd * s - 3 * G * np.sin(a), l1 * ad * ad * s - G * np.sin(b)
    determinant = 3 * l1 * l2 - l1 * l2 * c * c
    return np.stack([ad, bd, (l2 * r1 - l2 * c * r2) / determinant, (3 * l1 * r2 - l1 * c * r1) / determinant])


CASES = {
    "single-pendulum": dict(
        low=[0.1, 0, 0], high=[0.2, 0.15, 5], stop=2.0, one=pendulum, all=pendulums, start=lambda p: [np.pi / 2, p[2]]
    ),
    "double-pendulum": dict(
        low=[1, 2, 0, 0.3], high=[2, 3, 0.1, 0.5], stop=5.0, one=double, all=doubles, start=lambda p: [1.6, 1.6, p[2], p[3]]
    ),
}


def runge_kutta(f, y, p, step, count):
    """`count` steps with the tableau of DOP853, all runs at once."""
    for _ in range(count):
        stages = []
        for row in range(12):
            at = y + step * sum((a * k for a, k in zip(tableau.A[row, :row], stages) if a), np.zeros_like(y))
            stages.append(f(at, p))
        y = y + step * sum(b * k for b, k in zip(tableau.B, stages) if b)
    return y


def shortest(work, repeats):
    """Result and shortest time: what else runs on the machine only makes it longer."""
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        result = work()
        times.append(time.perf_counter() - begin)
    return result, min(times)


def main():
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    for name, case in CASES.items():
        axes = [np.linspace(low, high, 11) for low, high in zip(case["low"], case["high"])]
        mesh = np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], 1)
        count = round(case["stop"] / 0.01)
        times = np.linspace(0, case["stop"], count + 1)

        def numpy_runs(points, steps):
            """States `[time, component, run]`, `steps` steps a row."""
            states = [np.stack(np.broadcast_arrays(*[np.asarray(value, float) for value in case["start"](points.T)]))]
            for _ in times[1:]:
                states.append(runge_kutta(case["all"], states[-1], points.T, 0.01 / steps, steps))
            return np.array(states)

        part = np.arange(0, len(mesh), len(mesh) // 60)
        exact = numpy_runs(mesh[part], 4)

        def metafmu_runs(tolerance):
            """Shortest time for the mesh, and states of the part of it."""
            with tempfile.TemporaryDirectory() as folder:
                study = Path(folder) / "study.toml"
                text = (ROOT / f"examples/paper/{name}.toml").read_text()
                text = text.replace("[source]", f"[source]\ntolerance = {tolerance}", 1)
                study.write_text(text.replace("[sampling]", '[sampling]\ntables = "parquet"', 1))
                command = [ROOT / "target/release/metafmu", "sample", study, "--out", folder, "--json"]
                begin, records = time.perf_counter(), []
                while len(records) < 5 or time.perf_counter() - begin < 5:
                    records.append(json.loads(subprocess.run(command, capture_output=True, check=True, text=True).stdout))
                table = pd.read_parquet(Path(folder) / "train.parquet").to_numpy()
            runs = records[0]["train_runs"] + records[0]["test_runs"]
            seconds = min(record["sample_seconds"] for record in records) * len(mesh) / runs
            states = table.reshape(len(mesh), count + 1, -1)[part]
            parameters, columns = mesh.shape[1], exact.shape[1]
            np.testing.assert_allclose(states[:, 0, 2 : 2 + parameters], mesh[part], rtol=1e-12)
            return states[:, :, 2 + parameters : 2 + parameters + columns].transpose(1, 2, 0), seconds

        states, ours = metafmu_runs(1e-10)
        print(f"\n| {name.replace('-', ' ')}, {len(mesh):,} runs of {case['stop']:.0f} s | s | largest error | times as long as metafmu, 1e-10 |\n|---|---|---|---|")

        def report(label, seconds, error):
            print(f"| {label} | {seconds:.3g} | {error:.1e} | {seconds / ours:.3g} |", flush=True)

        report("metafmu, 1e-10, all cores", ours, np.abs(states - exact).max())
        states, seconds = metafmu_runs(1e-13)
        report("metafmu, 1e-13, all cores", seconds, np.abs(states - exact).max())

        def scipy_runs():
            def one(p):
                return solve_ivp(
                    case["one"](*map(float, p)), (0, times[-1]), case["start"](p), "DOP853", times, rtol=1e-10, atol=1e-12
                ).y.T

            return np.stack([one(p) for p in mesh[part]], 2)

        states, seconds = shortest(scipy_runs, 2)
        report("scipy DOP853, 1e-10, one core", seconds * len(mesh) / len(part), np.abs(states - exact).max())
        for steps in (2, 1):
            states, seconds = shortest(lambda: numpy_runs(mesh, steps), 1)
            report(f"numpy, {steps} {'step' if steps == 1 else 'steps'} a row, one core", seconds, np.abs(states[:, :, part] - exact).max())


if __name__ == "__main__":
    main()
