"""Prints how far surrogates from 300 rows of one motion are from the motion: tables of docs/dynamics-measurements.md, beside what others published of other rows of
the same motions.

The studies of examples/dynamics/mbd-node/ are built from tables in double and in single precision and with noise. The FMUs are run in fmpy
from t = 0 over all 400 rows. Then the double pendulum of examples/dynamics/ is simulated as a mechanism from a chaotic start. The script
prints the time until the surrogate is 0.1 rad from the truth, and the time until the truth from a slightly perturbed start is. Needs
target/release/metafmu and fmpy.

Usage: .venv/bin/python scripts/measure motions
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from common import METAFMU, ROOT
from fmpy import simulate_fmu
from scipy.integrate import solve_ivp

EXAMPLES = ROOT / "examples" / "dynamics" / "mbd-node"
sys.path.insert(0, str(EXAMPLES))
import make_tables

SEEN = 300
# standard deviations, in m, m/s, rad and rad/s
NOISE = [1e-4, 1e-3]
# mean squared errors of MBD-NODE, an LSTM and a network of time over the 400 rows, recomputed from the arrays that the authors published
PUBLISHED = {"spring": (8.59e-4, 1.78e-2, 9.85e-2), "triple-mass": (8.23e-3, 0.176, 4.2e-2), "double-pendulum": (0.202, 0.642, 2.15)}
GRAVITY = 9.81
# s, and what counts as diverged, in rad
STOP, DIVERGED = 60.0, 0.1


def build(study, folder):
    """The FMU of a study, and the seconds that takes."""
    began = time.monotonic()
    # one that is rejected, of noisy rows, has an FMU as well
    subprocess.run([METAFMU, "build", study, "--out", folder], capture_output=True)
    return str(folder / f"{study.stem.removesuffix('-study')}.fmu"), time.monotonic() - began


def run(fmu, outputs, stop, step, **options):
    """A run in co-simulation, without the warnings about rows that are outside the range of those seen."""
    options["logger"] = lambda *_: None
    return simulate_fmu(fmu, fmi_type="CoSimulation", output=outputs, stop_time=stop, output_interval=step, **options)


def errors(name, folder):
    """Mean squared errors over all rows, those seen and those beyond them, and the seconds of the build."""
    shutil.copy(EXAMPLES / f"{name}.toml", folder)
    fmu, seconds = build(folder / f"{name}.toml", folder / "out" / name)
    times, truth = make_tables.motion(name)
    columns = [column.split(" ")[0] for column in make_tables.SYSTEMS[name][3]]
    step = times[1] - times[0]
    result = run(fmu, columns, times[-1], step)
    squares = (np.column_stack([result[column] for column in columns])[: len(times)] - truth) ** 2
    return squares.mean(), squares[:SEEN].mean(), squares[SEEN:].mean(), seconds


def recorded():
    print("| system | rows | mean squared error of 400 rows | first 300, last 100 | MBD-NODE, LSTM, network of time on the published rows | build, s |")
    print("|---|---|---|---|---|---|")
    for precision, options in [("double", {}), ("single", {"single": True}), *((f"noise {noise:.0e}", {"noise": noise}) for noise in NOISE)]:
        with tempfile.TemporaryDirectory() as folder:
            make_tables.write(folder, **options)
            for name, published in PUBLISHED.items():
                whole, seen, beyond, seconds = errors(name, Path(folder))
                others = ", ".join(f"{value:.3g}" for value in published)
                print(f"| {name} | {precision} | {whole:.1e} | {seen:.1e}, {beyond:.1e} | {others} | {seconds:.1f} |", flush=True)


def diverged(times, one, other):
    """The first time at which an angle is off by more than 0.1 rad."""
    far = np.abs(one - other).max(axis=1) > DIVERGED
    return f"{times[far.argmax()]:.1f} s" if far.any() else f"not in {times[-1]:.0f} s"


def asked():
    """The mechanism's double pendulum, whose lower angle is against the upper rod."""
    times = np.linspace(0, STOP, 6001)
    start = np.array([np.pi / 2, np.pi / 4, 0, 0])

    def truth(start, tolerance=1e-13):
        rates = lambda t, state: make_tables.double_pendulum(t, state, GRAVITY)
        return solve_ivp(rates, (0, STOP), start, method="DOP853", t_eval=times, rtol=tolerance, atol=0.1 * tolerance).y.T[:, :2]

    exact = truth(start)
    print("\n| from (90°, 45°) at rest, in absolute angles | 0.1 rad off after |\n|---|---|")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        mechanism = ROOT / "examples" / "dynamics" / "double-pendulum.toml"
        subprocess.run([METAFMU, "new", "asked", "--mechanism", mechanism, "--structure", "dynamics"], cwd=folder, check=True, capture_output=True)
        fmu, _ = build(folder / "asked.toml", folder / "out")
        values = {"L1": 1, "L2": 1, "torque": 0, "shoulder.angle_start": start[0], "elbow.angle_start": start[1] - start[0]}
        values |= {"shoulder.angular_velocity_start": 0, "elbow.angular_velocity_start": 0}
        for what, options in [("the FMU, its own steps", {}), ("the FMU, tolerance 1e-12", {"relative_tolerance": 1e-12})]:
            result = run(fmu, ["theta1", "theta2"], STOP, 0.01, start_values=values, **options)
            angles = np.column_stack([result["theta1"], result["theta1"] + result["theta2"]])[: len(times)]
            print(f"| {what} | {diverged(times, angles, exact)} |", flush=True)
    for off in (1e-6, 1e-9, 1e-12):
        print(f"| the truth with an initial state perturbed by {off:.0e} | {diverged(times, truth(start + off), exact)} |")
    print(f"| the truth with a tolerance of 1e-12 instead of 1e-13 | {diverged(times, truth(start, 1e-12), exact)} |")


def main():
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    recorded()
    asked()


if __name__ == "__main__":
    main()
