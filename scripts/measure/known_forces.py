"""Replaces mechanisms with known forces by their FMUs: the table of docs/dynamics-measurements.md.

Each mechanism of examples/dynamics/known-forces becomes an FMU by the study that `metafmu new` writes, and `metafmu swap` simulates its system
with both. Differences are those of the worst output, relative to its range. Needs target/release/metafmu.

Usage: .venv/bin/python scripts/measure known-forces [--out FOLDER]
"""

import argparse
import json
import subprocess
from pathlib import Path

from common import METAFMU, ROOT, run

EXAMPLES = ROOT / "examples" / "dynamics" / "known-forces"
# of a mechanism: its forces, and its component in the system
FORCES = {"friction": ("tanh friction", "pendulum"), "drag": ("drag", "pendulum"), "tables": ("tables", "shaft")}


def row(name, folder):
    forces, component = FORCES[name]
    (folder / f"{name}.toml").unlink(missing_ok=True)
    run(folder, "new", name, "--mechanism", EXAMPLES / f"{name}.toml", "--structure", "dynamics")
    run(folder, "build", f"{name}.toml")
    fmu = folder / "out" / name / f"{name}.fmu"
    command = [METAFMU, "swap", EXAMPLES / f"{name}.ssd", "--component", component, "--with", fmu, "--step-size", "0.01", "--json"]
    found = json.loads(subprocess.run(command, cwd=folder, check=True, text=True, stdout=subprocess.PIPE).stdout)
    difference, step = max(output["relative_max"] for output in found["outputs"]), found["component_step"]
    times = [", ".join(f"{1e6 * step[which][what]:.1f}" for what in ("median", "minimum")) for which in ("source", "surrogate")]
    print(f"| {forces} | {100 * difference:.1e} % | {' | '.join(times)} | {step['speed_up']:.2g} |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/known-forces"), help="folder for studies and builds")
    options = parser.parse_args()
    folder = options.out.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    print("| forces | largest difference, of the range | µs a step, mechanism: median, minimum | FMU | speed-up |\n|---|---|---|---|---|")
    for name in FORCES:
        row(name, folder)


if __name__ == "__main__":
    main()
