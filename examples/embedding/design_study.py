"""A design study: 10,000 parameter sets of the single pendulum through one instance of its FMU, compared with solving the equations.

Usage: design_study.py NAME.fmu [SETS], after `metafmu build examples/single-pendulum.toml`

Prints the time of a run, minimum and median of ten equal shares of the sets. The speedup is that over solving the equations at 1e-12 in the
same language. scipy solves only the first hundredth of the sets. Everything runs in one thread.
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from fmpy import read_model_description
from master import Component
from scipy.integrate import solve_ivp

ROOT = Path(__file__).resolve().parents[2]
STUDY = ROOT / "examples" / "single-pendulum.toml"
PARAMETERS, OUTPUTS = ["L", "c", "thetad0"], ["theta", "thetad", "thetadd"]
STOP, STEPS = 2.0, 200
RUST = ["cargo", "run", "--quiet", "--release", "--locked", "--example", "design_study", "--"]
BLOCKS = 10


def draw(fmu, count):
    """Parameter sets, evenly distributed over the ranges that the FMU states."""
    variables = {variable.name: variable for variable in read_model_description(fmu).modelVariables}
    low, high = ([float(getattr(variables[name], bound)) for name in PARAMETERS] for bound in ("min", "max"))
    return np.random.default_rng(1).uniform(low, high, (count, len(PARAMETERS)))


class Study:
    """One instance for all parameter sets."""

    def __init__(self, fmu):
        self.component = Component(fmu, "design_study")
        self.parameters, self.outputs = (
            [self.component.references[name] for name in names] for names in (PARAMETERS, OUTPUTS)
        )

    def start(self, point):
        slave = self.component.slave
        slave.reset()
        slave.setupExperiment(startTime=0.0)
        slave.setReal(self.parameters, point)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        return slave

    def run(self, point):
        """The outputs at every communication point."""
        slave = self.start(point)
        step = STOP / STEPS
        rows = [slave.getReal(self.outputs)]
        for index in range(STEPS):
            slave.doStep(index * step, step)
            rows.append(slave.getReal(self.outputs))
        return rows

    def end(self, point):
        """The outputs at the stop time, by one long step: the surrogate has no history."""
        slave = self.start(point)
        slave.doStep(0.0, STOP)
        return slave.getReal(self.outputs)


def solve(point, method, tolerance):
    """theta and thetad at the same times, by scipy."""
    length, damping, thetad0 = point
    mass, gravity = 0.3, 9.81

    def derivative(_, state):
        theta, thetad = state
        return [thetad, -gravity / length * np.sin(theta) - damping / (mass * length) * thetad]

    times = np.linspace(0, STOP, STEPS + 1)
    start = [np.pi / 2, thetad0]
    return solve_ivp(derivative, (0, STOP), start, method, times, rtol=tolerance, atol=tolerance).y


def by_rust(command, fmu, points):
    """Outputs at the stop time, and for each block the seconds a run takes: by steps, by one step, by the integrator."""
    with tempfile.TemporaryDirectory() as folder:
        table, result = Path(folder) / "points.csv", Path(folder) / "result.csv"
        np.savetxt(table, points, "%.17g", ",", header=",".join(PARAMETERS), comments="")
        command = [*command, STUDY, fmu, table, result, str(BLOCKS)]
        printed = subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT).stdout
        times = np.array([line.split(",") for line in printed.splitlines()], dtype=float)
        return np.loadtxt(result, delimiter=",", skiprows=1), times.T


def seconds(function, points):
    """Seconds a run takes, for each block."""
    times = []
    for block in np.array_split(points, BLOCKS):
        started = time.perf_counter()
        for point in block:
            function(point)
        times.append((time.perf_counter() - started) / len(block))
    return np.array(times)


def main(fmu, count=10_000):
    points = draw(fmu, int(count))
    few = points[: max(len(points) // 100, BLOCKS)]
    study = Study(fmu)
    _, (in_steps, in_one_step, integrator) = by_rust(RUST, fmu, points)
    scipy = seconds(lambda point: solve(point, "DOP853", 1e-12), few)
    methods = [
        ("metafmu's integrator, 1e-12", len(points), integrator, integrator),
        ("FMU in metafmu's host, 200 steps", len(points), in_steps, integrator),
        ("FMU in metafmu's host, one step", len(points), in_one_step, integrator),
        ("scipy DOP853, 1e-12", len(few), scipy, scipy),
        ("scipy RK45, 1e-3", len(few), seconds(lambda point: solve(point, "RK45", 1e-3), few), scipy),
        ("FMU in fmpy, 200 steps", len(points), seconds(study.run, points), scipy),
        ("FMU in fmpy, one step", len(points), seconds(study.end, points), scipy),
    ]
    study.component.close()
    print(f"{'':34}{'runs':>7}{'least us':>10}{'median us':>11}{'faster, least':>15}{'median':>9}")
    for name, runs, times, solving in methods:
        least, median = np.min(times), np.median(times)
        ratios = f"{np.min(solving) / least:15.2f}{np.median(solving) / median:9.2f}"
        print(f"{name:34}{runs:7}{1e6 * least:10.1f}{1e6 * median:11.1f}{ratios}")


if __name__ == "__main__":
    main(*sys.argv[1:])
