"""Measures surrogates of public records of measurements: Cascaded Tanks and Silverbox, by the studies that `metafmu new` writes.

The FMU of the rows for estimation simulates the official test rows in fmpy, from 50 measured samples; errors are root mean squares of what follows.
Of Cascaded Tanks, which has 1024 rows for estimation, the test rows are those of the study too, so that none for estimation are set aside.
FOLDER has cascaded-tanks.csv and silverbox.csv (nonlinearbenchmark.org); results are written to out/.

Usage: .venv/bin/python scripts/measure records --data FOLDER [--seeds 3] [--out FOLDER] [RECORD...]
"""

import argparse
import re
import resource
from pathlib import Path

import numpy as np
from common import build_record
from fmpy import simulate_fmu

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


# unit, its factor, and the test rows that are those of the study
RECORDS = {"cascaded-tanks": (tanks, "V", 1, "test"), "silverbox": (silverbox, "mV", 1e3, None)}


def write(file, rows, step):
    table = np.column_stack([np.arange(len(rows)) * step, rows])
    np.savetxt(file, table, fmt="%.12g", delimiter=",", header="time,u,y", comments="")


def simulated(fmu, rows, step):
    """Outputs of the FMU in fmpy, from measured rows."""
    times = np.arange(len(rows)) * step
    signals = np.zeros(len(rows), [("time", float), ("u", float), ("y_measured", float), ("use_measured", bool)])
    signals["time"], signals["u"], signals["y_measured"], signals["use_measured"] = times, rows[:, 0], rows[:, 1], np.arange(len(rows)) < GIVEN
    result = simulate_fmu(str(fmu), input=signals, output=["y"], stop_time=times[-1], output_interval=step, fmi_type="CoSimulation")
    return result["y"][: len(rows)]


def measure(name, data, seed, folder):
    read, _, factor, official = RECORDS[name]
    step, training, tests = read(data / f"{name}.csv")
    folder = folder / f"{name}-{seed}"
    folder.mkdir(parents=True, exist_ok=True)
    write(folder / "estimation.csv", training, step)
    if official:
        write(folder / "test.csv", tests[official], step)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    exported = re.search(r"exported: ([\w-]+)", build_record(folder, "estimation.csv", seed, "test.csv" if official else None)).group(1)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    rests = [simulated(folder / "out/study/study.fmu", rows, step)[GIVEN:] - rows[GIVEN:, 1] for rows in tests.values()]
    return [factor * np.sqrt(np.mean(rest**2)) for rest in rests], seconds, exported


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("record", nargs="*", metavar="RECORD", help=f"of {', '.join(RECORDS)}; all unless given")
    parser.add_argument("--data", required=True, type=Path, help="folder of the records")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--out", type=Path, default=Path("out/records"))
    options = parser.parse_args()
    for name in options.record or RECORDS:
        unit, listed = RECORDS[name][1], lambda errors: " / ".join(f"{error:.3g}" for error in errors)
        found = []
        for seed in range(1, options.seeds + 1):
            errors, seconds, exported = measure(name, options.data, seed, options.out.resolve())
            print(f"{name}, seed {seed}: {listed(errors)} {unit}, {seconds:.0f} s of processor time, {exported}", flush=True)
            found.append(errors)
        print(f"{name}, median: {listed(np.median(found, axis=0))} {unit}")


if __name__ == "__main__":
    main()
