"""Prints time and error of stiff mechanisms, simulated and as FMUs, beside scipy's Radau and CVODE: tables of docs/multibody.md.

A quarter car whose tyre has a damper of 1e7 N.s/m, and a sensor head on a bushing of 1e5 1/s. Both are linear: a matrix exponential is the truth.
Times are those of a simulated second, minimum and median of REPEATS in one run of this script. CVODE is that of scikit-sundae, which
scripts/venv.sh --peers installs. Needs target/release/metafmu.

Usage: .peers/bin/python scripts/measure stiff [--metafmu PATH] [--repeats 3]
"""

import argparse
import json
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
from common import METAFMU
from fmpy import extract, instantiate_fmu, read_model_description
from scipy.integrate import solve_ivp
from scipy.linalg import expm

TYRE = """
parameters.c = { default = 1e7, min = 1e4, max = 1e7, unit = "N.s/m" }
inputs.f = { min = -500, max = 500, unit = "N" }
bodies.body = { mass = 250, inertia = 1 }
bodies.wheel = { mass = 40, inertia = 1 }
joints.b = { type = "prismatic", between = ["ground", "body"], axis = [0, 1] }
joints.w = { type = "prismatic", between = ["ground", "wheel"], axis = [0, 1] }
springs.tyre = { coordinate = "w.position", stiffness = 160000, damping = "c" }
bushings.suspension = { between = ["wheel", "body"], stiffness = [0, 16000, 0], damping = [0, 1000, 0] }
actuators.push = { coordinate = "b.position", effort = "f" }
outputs = { y = { measure = "body.y" }, w = { measure = "wheel.y" } }
"""

HEAD = """
parameters.c = { default = 1000, min = 10, max = 1000, unit = "N.s/m" }
inputs.f = { min = -50, max = 50, unit = "N" }
bodies.base = { mass = 5, inertia = 1 }
bodies.head = { mass = 0.01, inertia = 1 }
joints.b = { type = "prismatic", between = ["ground", "base"], axis = [1, 0] }
joints.w = { type = "prismatic", between = ["base", "head"], axis = [1, 0] }
springs.g = { coordinate = "b.position", stiffness = 500, damping = 20 }
springs.bush = { coordinate = "w.position", stiffness = 1e4, damping = "c" }
actuators.m = { coordinate = "b.position", effort = "f" }
outputs = { y = { measure = "base.x" }, w = { measure = "head.x" } }
"""

# of (b, w, their rates): rates at the stiffest value of c, and by a newton; rows of the outputs; the start
TYRE_MATRIX = [[0, 0, 1, 0], [0, 0, 0, 1], [-64, 64, -4, 4], [400, -4400, 25, -250025]]
TYRE_FORCE, TYRE_OUTPUTS = [0, 0, 1 / 250, 0], [[1, 0, 0, 0], [0, 1, 0, 0]]
HEAD_MATRIX = [[0, 0, 1, 0], [0, 0, 0, 1], [-100, 2000, -4, 200], [100, -1002000, 4, -100200]]
HEAD_FORCE, HEAD_OUTPUTS = [0, 0, 1 / 5, -1 / 5], [[1, 0, 0, 0], [1, 1, 0, 0]]
CASES = {
    "quarter car": (TYRE, TYRE_MATRIX, TYRE_FORCE, TYRE_OUTPUTS, [0.05, 0.01, 0.3, -0.2], 200.0, 1e7),
    "sensor head": (HEAD, HEAD_MATRIX, HEAD_FORCE, HEAD_OUTPUTS, [0.05, 0.01, 0.2, -0.3], 20.0, 1e3),
}
STOP, STEP = 2.0, 0.02
ROWS = np.arange(round(STOP / STEP) + 1) * STEP


def exact(matrix, force, start):
    """States at the rows, with a constant force."""
    whole = np.zeros((5, 5))
    whole[:4, :4], whole[:4, 4] = matrix, force
    transition, states = expm(whole * STEP), [np.array([*start, 1.0])]
    for _ in ROWS[1:]:
        states.append(transition @ states[-1])
    return np.array(states)[:, :4]


def timed(run, repeats):
    """Result of a run, and minimum and median of its milliseconds for a simulated second."""
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        result = run()
        times.append(1e3 * (time.perf_counter() - began) / STOP)
    return result, min(times), statistics.median(times)


def scipy_run(method, matrix, force, start, tolerance):
    matrix, force = np.array(matrix, float), np.array(force, float)
    options = {"jac": matrix} if method != "LSODA" else {"jac": lambda t, y: matrix}
    solution = solve_ivp(lambda t, y: matrix @ y + force, (0, STOP), start, method, ROWS, rtol=tolerance, atol=tolerance, **options)
    return solution.y.T


def cvode_run(matrix, force, start, tolerance):
    from sksundae.cvode import CVODE

    matrix, force = np.array(matrix, float), np.array(force, float)

    def rates(t, y, yp):
        yp[:] = matrix @ y + force

    def jacobian(t, y, yp, jac):
        jac[:, :] = matrix

    solver = CVODE(rates, method="BDF", rtol=tolerance, atol=tolerance, jacfn=jacobian, max_num_steps=1_000_000)
    return solver.solve(ROWS, np.array(start, float)).y


class Fmu:
    """The FMU of a case, stepped without anything else."""

    def __init__(self, path, folder):
        self.description = read_model_description(path)
        self.references = {variable.name: variable.valueReference for variable in self.description.modelVariables}
        self.fmu = instantiate_fmu(extract(path, str(folder)), self.description, "CoSimulation")
        self.is_used = False

    def run(self, values):
        if self.is_used:
            self.fmu.reset()
        self.is_used = True
        self.fmu.setupExperiment(startTime=0.0)
        self.fmu.setReal([self.references[name] for name in values], list(values.values()))
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        outputs = [self.references[name] for name in ("y", "w")]
        rows = [self.fmu.getReal(outputs)]
        for t in ROWS[:-1]:
            self.fmu.doStep(t, STEP)
            rows.append(self.fmu.getReal(outputs))
        return np.array(rows)


def study(text, folder, name, command):
    """Builds the study that `new` writes; returns its folder and the record of its solver."""
    (folder / f"{name}.mechanism.toml").write_text(text)
    run = lambda *arguments: subprocess.run([command, *arguments], cwd=folder, check=True, capture_output=True)
    run("new", name, "--mechanism", f"{name}.mechanism.toml", "--structure", "dynamics")
    subprocess.run([command, "build", f"{name}.toml", "--out", name], cwd=folder, capture_output=True)
    return folder / name, json.loads((folder / name / "training.json").read_text())["motion"]["solver"]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--metafmu", type=Path, default=METAFMU)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    for name, (text, matrix, by_newton, outputs, start, force, damping) in CASES.items():
        push = np.array(by_newton) * force
        outputs = np.array(outputs)
        truth = exact(matrix, push, start) @ outputs.T
        print(f"\n| {name} | tolerance | largest error, m | minimum | median |\n|---|---|---|---|---|")

        def line(what, tolerance, run):
            found, least, median = timed(run, arguments.repeats)
            print(f"| {what} | {tolerance} | {np.abs(found - truth).max():.1e} | {least:.3g} | {median:.3g} |", flush=True)

        for method in ("Radau", "LSODA"):
            line(f"scipy {method}", "1e-12", lambda: scipy_run(method, matrix, push, start, 1e-12) @ outputs.T)
        for tolerance in ("1e-8", "1e-12"):
            line("CVODE", tolerance, lambda: cvode_run(matrix, push, start, float(tolerance)) @ outputs.T)
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            built, solver = study(text, folder, "case", arguments.metafmu)
            speed = json.loads((built / "metrics.json").read_text())["speed"]
            fmu = Fmu(str(built / "case.fmu"), folder / "unpacked")
            b, w, vb, vw = start
            starts = {"b.position_start": b, "w.position_start": w, "b.velocity_start": vb, "w.velocity_start": vw}
            line("FMU in fmpy", f"{solver['tolerance']:.0e}".replace("e-0", "e-"), lambda: fmu.run({"c": damping, "f": force, **starts}))
            steps = ", ".join(f"{steps:.0f}" for steps in solver["steps_per_second"])
            print(f"\nsolver: implicit {solver.get('implicit')}, steps a second in the median and at most: {steps}, error {solver['error']:.1e}")
            print(f"source {1e3 * speed['source']:.3g} ms, FMU {1e3 * speed['surrogate']:.3g} ms a simulated second: {speed['speed_up']:.3g} times as fast")


if __name__ == "__main__":
    main()
