#!/usr/bin/env python3
"""Compares encoded with plain parameters on the single pendulum: .venv/bin/python scripts/compare-encodings.py [--runs 512]

Periodic: the initial angle over the full circle, as sine and cosine or as the number it is. Nominal: the mass, one of 0.1, 0.3
and 1 kg, one-hot or as a number. Both sides of a comparison have the same runs. Prints the tables of docs/training.md: 1 - R² on
unseen runs, for some seeds of runs and weights. Needs target/release/metafmu.
"""

import argparse
import json
import shutil
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
OUTPUTS = ["thetad", "thetadd"]
STUDY = """
name = "encoding"
seed = SEED
[source]
system = "single-pendulum"
[time]
stop = 2.0
step = 0.02
[parameters]
L = { min = 0.1, max = 0.2 }
c = { min = 0.0, max = 0.15 }
thetad0 = { min = 0.0, max = 5.0 }
PARAMETER
[outputs]
thetad = {}
thetadd = {}
[sampling]
method = "sobol"
runs = RUNS
test_runs = 200
[network]
hidden = [64, 64]
[training]
optimizer = "soap"
learning_rate = 0.003
batch = 256
epochs = EPOCHS
validation = 0.05
"""
CIRCLE = "theta0 = { min = -3.141592653589793, max = 3.141592653589793PERIODIC }"
# the plain study's runs are those of the nominal one, which it reads from its tables
COMPARISONS = {
    "theta0 on the full circle": {
        "plain": CIRCLE.replace("PERIODIC", ""),
        "sine and cosine": CIRCLE.replace("PERIODIC", ", periodic = true"),
    },
    "m one of 0.1, 0.3, 1 kg": {
        "plain": "m = { min = 0.1, max = 1.0 }",
        "one-hot": "m = { values = [0.1, 0.3, 1.0] }",
    },
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=512)
    parser.add_argument("--epochs", type=int, default=30)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "encodings")
    options = parser.parse_args()
    for parameter, encodings in COMPARISONS.items():
        print(f"\n| {parameter} | " + " | ".join(f"{output}, seed {seed}" for output in OUTPUTS for seed in options.seeds))
        for encoding, text in encodings.items():
            found = [errors(options, seed, text, encoding, encodings) for seed in options.seeds]
            print(f"| {encoding} | " + " | ".join(f"{each[output]:.1e}" for output in OUTPUTS for each in found), flush=True)


def errors(options, seed, parameter, encoding, encodings):
    folder = options.out / f"{encoding.replace(' ', '-')}-{parameter.split()[0]}-{seed}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    study = folder / "study.toml"
    values = {"SEED": seed, "RUNS": options.runs, "EPOCHS": options.epochs}
    text = STUDY
    for key, value in values.items():
        text = text.replace(key, str(value))
    if encoding == "plain" and "one-hot" in encodings:
        # the runs of the nominal study, as points of a list and as its tests
        return plain_of_nominal(folder, text, parameter, encodings["one-hot"])
    study.write_text(text.replace("PARAMETER", parameter))
    for verb in ("sample", "train", "evaluate"):
        run(verb, study, folder)
    return read(folder)


def plain_of_nominal(folder, text, plain, nominal):
    study = folder / "study.toml"
    study.write_text(text.replace("PARAMETER", nominal))
    run("sample", study, folder)
    tables = {name: (folder / f"{name}.csv").read_bytes() for name in ("train", "test")}
    study.write_text(text.replace("PARAMETER", plain))
    run("sample", study, folder)
    # the same names and columns: what was sampled between the values is not used
    for name, table in tables.items():
        (folder / f"{name}.csv").write_bytes(table)
    for verb in ("train", "evaluate"):
        run(verb, study, folder)
    return read(folder)


def run(verb, study, folder):
    command = [ROOT / "target" / "release" / "metafmu", verb, study, "--out", folder]
    subprocess.run(command, check=True, capture_output=True)


def read(folder):
    metrics = json.loads((folder / "metrics.json").read_text())["outputs"]
    return {output: 1 - metrics[output]["r2"] for output in OUTPUTS}


if __name__ == "__main__":
    main()
