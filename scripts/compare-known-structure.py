#!/usr/bin/env python3
"""Compares outputs learned as they are with known structure: .venv/bin/python scripts/compare-known-structure.py [--epochs 30]

- initial value: an output that begins at a known value y0 is y0 + t * network, so that it is exact at t = 0;
- derivatives: only positions are learned, velocities and accelerations are exact derivatives of the network by time.

Both sides have the same runs, network and epochs. Prints the tables of docs/training.md: 1 - R² on 200 unseen runs, for some
seeds of runs and weights. Needs target/release/metafmu.
"""

import argparse
import hashlib
import importlib.util
import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pandas as pd

ROOT = Path(__file__).resolve().parents[1]
SPECIFICATION = importlib.util.spec_from_file_location("check_bounds", ROOT / "scripts" / "check-bounds.py")
check_bounds = importlib.util.module_from_spec(SPECIFICATION)
SPECIFICATION.loader.exec_module(check_bounds)

# for each system: outputs that begin at a known value, and outputs that are derivatives (of which output, of which order)
SYSTEMS = {
    "single-pendulum": {
        "initial": {"theta": lambda runs: np.pi / 2, "thetad": lambda runs: runs["thetad0"]},
        "derivatives": {"thetad": ("theta", 1), "thetadd": ("theta", 2)},
    },
    "slider-crank": {
        "initial": {"theta": lambda runs: 0.0, "phi": lambda runs: 0.0, "phid": lambda runs: 0.0,
                    "xB": lambda runs: runs["r"] * (1 + runs["L_over_r"]), "xBd": lambda runs: 0.0},
        "derivatives": {"phid": ("phi", 1), "phidd": ("phi", 2), "xBd": ("xB", 1), "xBdd": ("xB", 2)},
    },
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--epochs", type=int, default=30)
    parser.add_argument("--runs", type=int, default=1331)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "known-structure")
    options = parser.parse_args()
    for system, known in SYSTEMS.items():
        for kind, train in {"as they are": plain, "initial value": initial_value, "derivatives": derivatives}.items():
            found = [train(options, system, seed, known) for seed in options.seeds]
            for output in found[0]:
                print(f"| {system} | {output} | {kind} | " + ", ".join(f"{each[output]:.1e}" for each in found) + " |", flush=True)


def plain(options, system, seed, known):
    folder, study = sampled(options, system, seed, "plain", ())
    truth, inputs, predict = trained(folder, study)
    return one_minus_r2(truth, predict(inputs))


def initial_value(options, system, seed, known):
    folder, study = sampled(options, system, seed, "initial", ())
    original = {name: pd.read_csv(folder / f"{name}.csv") for name in ("train", "test")}
    for name, table in original.items():
        table = table.copy()
        for output, value in known["initial"].items():
            table[output] = rate(table, output, value(table))
        replace(folder, name, table)
    _, inputs, predict = trained(folder, study)
    table = original["test"]
    found = predict(inputs)
    for output, value in known["initial"].items():
        found[output] = value(table) + table["time"] * found[output]
    return one_minus_r2(table, found)


def replace(folder, name, table):
    """Puts another table in the place of a sampled one, and its digest in the record, without which the change is refused."""
    path, record = folder / f"{name}.csv", folder / "samples.json"
    table.to_csv(path, index=False)
    samples = json.loads(record.read_text())
    samples["tables"][name] = hashlib.sha256(path.read_bytes()).hexdigest()
    record.write_text(json.dumps(samples))


def rate(table, output, initial):
    """(y - y0) / t, and at t = 0 its limit, by the parabola through the next three instants."""
    time = table["time"].to_numpy()
    begins = (table[output] - initial)[time == 0]
    assert np.abs(begins).max() < 1e-9, f"{output} does not begin at the value supposed"
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = ((table[output] - initial) / time).to_numpy().copy()
    for row in np.flatnonzero(time == 0):
        rates[row] = 3 * rates[row + 1] - 3 * rates[row + 2] + rates[row + 3]
    return rates


def derivatives(options, system, seed, known):
    folder, study = sampled(options, system, seed, "derivatives", known["derivatives"])
    full = pd.read_csv(options.out / f"{system}-plain-{seed}" / "test.csv")
    _, inputs, predict = trained(folder, study)
    found = predict(inputs)
    # central differences in double precision, of order 6: the network's own derivative but for 1e-9
    h = 2e-3
    shifted = {}
    for steps in (-3, -2, -1, 1, 2, 3):
        moved = inputs.copy()
        moved["time"] += steps * h
        shifted[steps] = predict(moved)
    for output, (base, order) in known["derivatives"].items():
        y = {steps: table[base] for steps, table in shifted.items()}
        if order == 1:
            found[output] = (45 * (y[1] - y[-1]) - 9 * (y[2] - y[-2]) + (y[3] - y[-3])) / (60 * h)
        else:
            outer = 270 * (y[1] + y[-1]) - 27 * (y[2] + y[-2]) + 2 * (y[3] + y[-3])
            found[output] = (outer - 490 * found[base]) / (180 * h * h)
    return one_minus_r2(full, found)


def sampled(options, system, seed, kind, without):
    folder = options.out / f"{system}-{kind}-{seed}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    text = (ROOT / "examples" / f"{system}.toml").read_text()
    for key, value in {"seed": seed, "runs": options.runs, "epochs": options.epochs}.items():
        text = re.sub(rf"(?m)^{key} = \d+", f"{key} = {value}", text, count=1)
    # the same number of epochs for all, inside the ranges and the time
    text = re.sub(r"(?m)^(margin|faces|enough) = .*\n", "", text)
    for key, value in {"hidden": "[128, 128]", "learning_rate": "0.003", "schedule": '"cosine"'}.items():
        text = re.sub(rf"(?m)^{key} = .*$", f"{key} = {value}", text)
    text = re.sub(r"(?ms)^\[bounds\].*?\n\n", "", text)
    for output in without:
        text = re.sub(rf"(?m)^{output} = .*\n", "", text)
    study = folder / "study.toml"
    study.write_text(text)
    run("sample", study, folder)
    return folder, study


def trained(folder, study):
    """The table of test runs, its inputs, and the network in numpy."""
    run("train", study, folder)
    [model] = folder.glob("*.safetensors")
    metadata, predict = check_bounds.network(model)
    names = [column["name"] for column in metadata["inputs"]]
    outputs = [column["name"] for column in metadata["outputs"]]
    truth = pd.read_csv(folder / "test.csv")
    return truth, truth[names], lambda inputs: pd.DataFrame(predict(inputs.to_numpy()), columns=outputs)


def one_minus_r2(truth, found):
    def of(output):
        y = truth[output]
        return float(((y - found[output]) ** 2).sum() / ((y - y.mean()) ** 2).sum())
    return {output: of(output) for output in found.columns}


def run(verb, study, folder):
    command = [ROOT / "target" / "release" / "metafmu", verb, study, "--out", folder]
    subprocess.run(command, check=True, capture_output=True)


if __name__ == "__main__":
    main()
