"""Compares surrogates with their sources at equal errors: the lines of README that say when a surrogate pays.

CABLE, CRANE and PENDULUM are the folders that `metafmu build` wrote for examples/commands/cable.toml, examples/dynamics/crane-study.toml and
examples/quick/single-pendulum.toml. The cable's errors are those of tip.x and tip.y at all rows of a hundred unseen runs, relative to the range, against
Exudyn with twice the elements and a fortieth of the output step. Exudyn is then run with all of the meshes and time steps below, alternately with
the FMU: the fastest whose error is no larger than the FMU's is compared. A run includes the set-up of the model, and of the FMU's instance.
The shortest of three processor times counts. The other two speed-ups are those of `metafmu build`, and of `metafmu swap` for the crane in a loop
with a controller in Python. Needs target/release/metafmu, the example step_time, exudyn, PythonFMU, and the package `metafmu` for sources.

Usage: .venv/bin/python scripts/measure worth CABLE CRANE PENDULUM
"""

import argparse
import csv
import itertools
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from common import METAFMU, ROOT, run

RUNS = 100
MESHES, TIME_STEPS = (6, 8, 12, 16), (1, 2, 3, 5)
# elements, and time steps in a row
TRUTH = (32, 40)
OUTPUTS = ("tip.x", "tip.y")
STEP_TIME = ROOT / "target" / "release" / "examples" / "step_time"
ROUNDS = 3


def unseen(folder, fmu):
    """Parameters of the first unseen runs, their times, and the outputs of the FMU: runs by outputs by rows."""
    rows = list(csv.DictReader((folder / "test.csv").read_text(encoding="utf-8").splitlines()))
    names = list(rows[0])[2 : -len(OUTPUTS)]
    runs = sorted({row["run"] for row in rows}, key=int)[:RUNS]
    table = folder / "unseen-runs.csv"
    with open(table, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["run", "time", *names])
        writer.writerows([row["run"], row["time"], *(row[name] for name in names)] for row in rows if row["run"] in runs)
    predicted = folder / "predicted-runs.csv"
    run(folder, "predict", fmu, table, "--out", predicted)
    outputs = list(csv.DictReader(predicted.read_text(encoding="utf-8").splitlines()))
    first = [next(row for row in rows if row["run"] == label) for label in runs]
    parameters = [{name: float(row[name]) for name in names} for row in first]
    times = np.array([float(row["time"]) for row in outputs if row["run"] == runs[0]])
    return parameters, times, np.array([[[float(row[output]) for row in outputs if row["run"] == label] for output in OUTPUTS] for label in runs])


def exudyn_runs(cable, setting, times, parameters):
    """Outputs of Exudyn with a mesh and a number of time steps in a row, and processor milliseconds of each run."""
    cable.ELEMENTS, cable.STEPS_PER_ROW = setting
    found, milliseconds = [], []
    for of_run in parameters:
        begin = time.process_time()
        rows = cable.cable(times, of_run)
        milliseconds.append(1e3 * (time.process_time() - begin))
        found.append([rows[output] for output in OUTPUTS])
    return np.array(found), np.array(milliseconds)


def fmu_run(fmu, times):
    """Milliseconds of a run of the FMU with its instance: the shortest of several."""
    words = [STEP_TIME, fmu, times[-1], times[1], *OUTPUTS]
    step, instance = map(float, subprocess.run(list(map(str, words)), check=True, capture_output=True, text=True).stdout.split())
    return 1e-3 * (instance + step * (len(times) - 1))


def rounded(number):
    """Text of a number with two digits that count."""
    return f"{float(f'{number:.2g}'):,.10g}"


def compared(folder):
    """Line of README on the cable; the settings of Exudyn are printed as a table."""
    sys.path.insert(0, str(ROOT / "examples" / "commands"))
    import cable

    trained = cable.ELEMENTS, cable.STEPS_PER_ROW
    fmu = folder / "cable.fmu"
    parameters, times, predicted = unseen(folder, fmu)
    truth, _ = exudyn_runs(cable, TRUTH, times, parameters)
    widths = np.ptp(truth, axis=(0, 2))
    error = lambda found: (np.abs(found - truth).max(axis=(0, 2)) / widths).max()
    largest = error(predicted)
    errors, shortest, of_fmu = {}, {}, np.inf
    for _ in range(ROUNDS):
        of_fmu = min(of_fmu, fmu_run(fmu, times))
        for setting in itertools.product(MESHES, TIME_STEPS):
            found, milliseconds = exudyn_runs(cable, setting, times, parameters)
            errors[setting] = error(found)
            shortest[setting] = np.minimum(shortest.get(setting, np.inf), milliseconds)
    means = {setting: of_runs.mean() for setting, of_runs in shortest.items()}
    print("| cable of | elements | time step, ms | error, of the range | a run, ms |\n|---|---|---|---|---|")
    for (mesh, steps), mean in means.items():
        print(f"| Exudyn | {mesh} | {1e3 * times[1] / steps:.3g} | {100 * errors[mesh, steps]:.2g} % | {mean:.3g} |")
    print(f"| the FMU | | | {100 * largest:.2g} % | {of_fmu:.2g} |")
    equal = [mean for setting, mean in means.items() if errors[setting] <= largest]
    if not equal:
        raise SystemExit("error: no setting is as accurate as the FMU")
    fastest = min(equal)
    metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    cost = metrics["sample_seconds"] + metrics["train_seconds"]
    return (
        f"- **Yes, beyond the break-even.** To simulate one second of a flexible cable, with the set-up, takes the FMU {rounded(of_fmu)} ms and Exudyn "
        f"{rounded(fastest)} ms, {rounded(fastest / of_fmu)} times as long. The FMU's largest error is {100 * largest:.2g} % of the range, and Exudyn has its "
        f"fastest setting that is at least as accurate. With the finer time steps of the training runs it takes {rounded(means[trained] / of_fmu)} times as long, "
        f"and {metrics['speed']['speed_up']:.0f} times without set-ups, as in the picture. Its {metrics['train_runs']} training runs and the training took {cost:.0f} s: "
        f"it pays from about {rounded(cost / (1e-3 * (fastest - of_fmu)))} runs on, and sooner if the source is slower."
    )


def speed_up(folder):
    """How many times the FMU is as fast as its source, as the build measured it."""
    return json.loads((folder / "metrics.json").read_text(encoding="utf-8"))["speed"]["speed_up"]


def speed_ups_in_loop(folder):
    """How many times the crane's FMU and the whole loop are as fast as with the source in its place."""
    with tempfile.TemporaryDirectory() as loop:
        script = ROOT / "examples" / "embedding" / "crane_control.py"
        subprocess.run([sys.executable, script, folder / "crane.fmu", loop], check=True, stdout=subprocess.DEVNULL)
        words = [METAFMU, "swap", Path(loop) / "mechanism.ssp", "--component", "crane", "--with", folder / "crane.fmu", "--step-size", "0.02", "--json"]
        report = json.loads(subprocess.run(list(map(str, words)), check=True, capture_output=True, text=True).stdout)
    return report["component_step"]["speed_up"], report["system_step"]["speed_up"]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name in ("cable", "crane", "pendulum"):
        parser.add_argument(name, type=Path, help=f"folder of the {name}'s build")
    options = parser.parse_args()
    print(compared(options.cable.resolve()))
    crane, pendulum = speed_up(options.crane), speed_up(options.pendulum)
    component, loop = speed_ups_in_loop(options.crane.resolve())
    print(
        "- **Yes, in a loop.** The FMU of a crane holds equations that were learned from metafmu's own simulator of mechanisms. At equal error it is "
        f"{rounded(crane)} times as fast as this simulator. In a loop with a controller in Python its step is [{rounded(component)} times as fast](docs/swap.md), "
        f"and the whole loop {loop:.1f} times."
    )
    print(
        f"- **No, if the source is quick already.** The FMU of a damped pendulum holds a network, and takes {rounded(1 / pendulum)} times as long as its source, which solves two "
        "equations in compiled code. Nor does it pay for a few runs, or outside the ranges of the training."
    )


if __name__ == "__main__":
    main()
