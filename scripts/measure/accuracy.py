"""Prints the accuracy of the paper's three systems: the table of docs/training.md.

Builds each study of STUDIES into the folder of --out, and continues there if a build was stopped. Seconds are those of the training. Needs
target/release/metafmu.

Usage: .venv/bin/python scripts/measure accuracy [--out FOLDER]
"""

import argparse
import json
import subprocess
import tomllib
from pathlib import Path

from common import METAFMU, ROOT

# of a study in examples/: 1 - R² in the paper, and the folder of the build
STUDIES = {
    "single-pendulum": ("3e-3", "single-pendulum"),
    "slider-crank": ("1e-3", "slider-crank"),
    "double-pendulum": ("3e-3", "double-pendulum"),
    "quick/single-pendulum": ("", "quick"),
    "quick/slider-crank": ("", "quick-slider-crank"),
    "quick/double-pendulum": ("", "quick-double-pendulum"),
}


def row(name, folder):
    study, (published, place) = ROOT / "examples" / f"{name}.toml", STUDIES[name]
    # what is rejected is measured as well
    done = subprocess.run([METAFMU, "build", study, "--out", folder / place, "--resume"], capture_output=True, text=True)
    if done.returncode not in (0, 1):
        raise SystemExit(f"error: {study}: {done.stderr}")
    found = lambda file: json.loads((folder / place / f"{file}.json").read_text())
    hidden, metrics, seconds = tomllib.loads(study.read_text())["network"]["hidden"], found("metrics"), found("training")["train_seconds"]
    outputs = metrics["outputs"].values()
    worst, largest = max(1 - output["r2"] for output in outputs), max(output["relative_max_error"] for output in outputs)
    size = f"{len(hidden)} x {hidden[0]}"
    print(f"| `examples/{name}.toml` | {metrics['train_runs']} | {size} | {worst:.1e} | {100 * largest:.2g} % | {seconds:.0f} | {published} |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "accuracy", help="folder for the builds")
    options = parser.parse_args()
    print("| study | runs | network | largest 1 - R² | largest error, of the range | training, s | the paper's 1 - R² |\n|---|---|---|---|---|---|---|")
    for name in STUDIES:
        row(name, options.out)


if __name__ == "__main__":
    main()
