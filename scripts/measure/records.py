"""Measures surrogates of public records of measurements: Cascaded Tanks and Silverbox, by the studies that `metafmu new` writes.

The surrogate of the rows for estimation simulates the official test rows, from 50 measured samples; errors are root mean squares of what follows.
FOLDER has cascaded-tanks.csv and silverbox.csv (nonlinearbenchmark.org); results are written to out/.

Usage: .venv/bin/python scripts/measure records --data FOLDER [--seeds 3] [--out FOLDER] [RECORD...]
"""

import argparse
import re
import resource
import subprocess
from pathlib import Path

import numpy as np
from common import METAFMU

GIVEN = 50


def tanks(file):
    data = np.genfromtxt(file, delimiter=",", names=True)
    of = lambda part: np.column_stack([data["u" + part], data["y" + part]])
    return 4.0, of("Est"), {"test": of("Val")}


def silverbox(file):
    data = np.genfromtxt(file, delimiter=",", names=True)
    rows = np.column_stack([data["V1"], data["V2"]])
    parts = {"multisine": rows[105712:127400], "arrow": rows[100:40575], "arrow without extrapolation": rows[100:32100]}
    return 1 / 610.35, rows[40650:105712], parts


RECORDS = {"cascaded-tanks": (tanks, "V", 1), "silverbox": (silverbox, "mV", 1e3)}


def write(file, rows, step, given=0):
    times = (np.arange(len(rows)) - given) * step
    np.savetxt(file, np.column_stack([times, rows]), fmt="%.12g", delimiter=",", header="time,u,y", comments="")


def run(folder, *arguments):
    done = subprocess.run([METAFMU, *map(str, arguments)], cwd=folder, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    # a surrogate that is rejected is measured as well
    if done.returncode and "\nrejected: " not in done.stdout:
        raise SystemExit(f"error: metafmu {' '.join(map(str, arguments))}: {done.stdout}")
    return done.stdout


def measure(name, data, seed, folder):
    read, _, factor = RECORDS[name]
    step, training, tests = read(data / f"{name}.csv")
    folder = folder / f"{name}-{seed}"
    folder.mkdir(parents=True, exist_ok=True)
    write(folder / "estimation.csv", training, step)
    study = folder / "study.toml"
    study.unlink(missing_ok=True)
    run(folder, "new", "study", "--table", "estimation.csv", "--structure", "discrete", "--inputs", "u")
    study.write_text(re.sub(r"(?m)^seed = \d+", f"seed = {seed}", study.read_text()))
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    (folder / "build.txt").write_text(run(folder, "build", "study.toml"))
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    errors = []
    for test, rows in tests.items():
        file = folder / f"{test.replace(' ', '-')}.csv"
        write(file, rows, step, GIVEN)
        found = folder / f"{file.stem}-predicted.csv"
        found.unlink(missing_ok=True)
        run(folder, "predict", "study.toml", file, "--out", found)
        outputs = np.genfromtxt(found, delimiter=",", names=True)
        errors.append(factor * np.sqrt(np.mean((outputs["y"] - rows[len(rows) - len(outputs) :, 1])[-(len(rows) - GIVEN) :] ** 2)))
    return errors, seconds


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("record", nargs="*", metavar="RECORD", help=f"of {', '.join(RECORDS)}; all unless given")
    parser.add_argument("--data", required=True, type=Path, help="folder of the records")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--out", type=Path, default=Path("out/records"))
    options = parser.parse_args()
    for name in options.record or RECORDS:
        found = [measured for seed in range(1, options.seeds + 1) for measured in [measure(name, options.data, seed, options.out.resolve())]]
        for errors, seconds in found:
            print(f"{name}: {' / '.join(f'{error:.3g}' for error in errors)} {RECORDS[name][1]}, {seconds:.0f} s", flush=True)
        median = np.median([errors for errors, _ in found], axis=0)
        print(f"{name}, median: {' / '.join(f'{error:.3g}' for error in median)} {RECORDS[name][1]}")


if __name__ == "__main__":
    main()
