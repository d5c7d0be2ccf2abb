"""Measures surrogates of public records of measurements: Cascaded Tanks and Silverbox, by the studies that `metafmu new` writes.

The FMU of the rows for estimation simulates the official test rows in fmpy, from 50 measured samples; errors are root mean squares of what follows.
The study of Cascaded Tanks has the official test rows as its tests, so all 1024 rows for estimation are for training.

jax-sysid and an LSTM in PyTorch (record_peers.py; scripts/venv.sh --peers) are trained on the same rows, in the processor time of the build.
FOLDER has cascaded-tanks.csv and silverbox.csv (nonlinearbenchmark.org); results are written to out/.

Usage: .peers/bin/python scripts/measure records --data FOLDER [--seeds 2] [--out FOLDER] [RECORD...]
"""

import argparse
import resource
from pathlib import Path

import numpy as np
import record_peers
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


# unit, its factor, and the test rows that are those of the study; as the page names the record, and its best published results
RECORDS = {"silverbox": (silverbox, "mV", 1e3, None), "cascaded-tanks": (tanks, "V", 1, "test")}
LABELS = {
    "silverbox": ("Silverbox: multisine / arrow / arrow without extrapolation, mV", "SUBNET 0.36 / 1.4 / 0.32"),
    "cascaded-tanks": ("Cascaded Tanks, V", "NLSS2 0.34, GRU 0.40, polynomial NARX 0.41"),
}


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


def measure(name, rows, seed, folder):
    """Errors of the FMU and the processor seconds of its build."""
    official = RECORDS[name][3]
    step, training, tests = rows
    folder = folder / f"{name}-{seed}"
    folder.mkdir(parents=True, exist_ok=True)
    write(folder / "estimation.csv", training, step)
    if official:
        write(folder / "test.csv", tests[official], step)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    build_record(folder, "estimation.csv", seed, "test.csv" if official else None)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    rests = [simulated(folder / "out/study/study.fmu", rows, step)[GIVEN:] - rows[GIVEN:, 1] for rows in tests.values()]
    return [np.sqrt(np.mean(rest**2)) for rest in rests], seconds


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("record", nargs="*", metavar="RECORD", help=f"of {', '.join(RECORDS)}; all unless given")
    parser.add_argument("--data", required=True, type=Path, help="folder of the records")
    parser.add_argument("--seeds", type=int, default=2, help="of our builds")
    parser.add_argument("--out", type=Path, default=Path("out/records"))
    options = parser.parse_args()
    print("| record | metafmu | processor time of the build, s | jax-sysid | LSTM | published |\n|---|---|---|---|---|---|")
    for name in options.record or RECORDS:
        read, _, factor, _ = RECORDS[name]
        rows, spent = read(options.data / f"{name}.csv"), []
        listed = lambda errors: " / ".join(f"{factor * error:.3g}" for error in errors)
        label, published = LABELS[name]
        found = {"metafmu": []} | {method: [] for method in record_peers.METHODS}
        for seed in range(1, options.seeds + 1):
            errors, seconds = measure(name, rows, seed, options.out.resolve())
            found["metafmu"].append(listed(errors))
            spent.append(seconds)
            for method in record_peers.METHODS:
                found[method].append(listed(record_peers.errors(method, name, rows[1], rows[2].values(), seconds, seed)))
        own, *others = (", ".join(of) for of in found.values())
        times = ", ".join(f"{seconds:.0f}" for seconds in spent)
        print(f"| {label} | {own} | {times} | {' | '.join(others)} | {published} |", flush=True)


if __name__ == "__main__":
    main()
