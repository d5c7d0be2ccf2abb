"""Prints how exact the surrogate of Andrews' squeezing mechanism is: the FMU of examples/dynamics/andrews-study.toml in fmpy.

First against the published solution (test set for IVP solvers, recomputed to 1e-12), then, at stiffnesses of its spring that it has not
seen, against the mechanism integrated at 1e-13. Needs target/release/metafmu and fmpy.

Usage: .venv/bin/python scripts/measure andrews [--network]
"""

import argparse
import csv
import subprocess
import tempfile
import time
from pathlib import Path
from shutil import copy

import numpy as np
from common import METAFMU, ROOT
from fmpy import simulate_fmu

STOP, STEP = 0.03, 1.5e-5
OUTPUTS = ["beta", "K3", "K5", "K7"]
# at the stop, for 4530 N/m, in rad
REFERENCE = {"beta": 15.810771195153, "K3": 0.040822240120, "K5": 0.524409965880, "K7": 1.048080741042}
STIFFNESSES = [4000.0, 4137.0, 4321.5, 4512.0, 4688.8, 4871.0, 5000.0]
MECHANISM = f"""name = "truth"
[source]
mechanism = "{(ROOT / 'examples' / 'dynamics' / 'andrews.toml').as_posix()}"
[time]
stop = {STOP}
step = {STEP}
[parameters]
c0 = {{ min = 4000, max = 5000 }}
[outputs]
{"".join(f"{name} = {{}}" + chr(10) for name in OUTPUTS)}[sampling]
method = "list"
file = "stiffnesses.csv"
test_runs = 1
"""


def mechanism(folder):
    """Angles of the mechanism at each stiffness, integrated at 1e-13: shape `[stiffnesses, rows, outputs]`."""
    (folder / "truth.toml").write_text(MECHANISM)
    (folder / "stiffnesses.csv").write_text("c0\n" + "".join(f"{stiffness}\n" for stiffness in STIFFNESSES))
    subprocess.run([METAFMU, "sample", "truth.toml", "--out", "truth"], cwd=folder, check=True, capture_output=True)
    with open(folder / "truth" / "train.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    key = {name.split(" ")[0]: name for name in rows[0]}
    values = np.array([[float(row[key[name]]) for name in OUTPUTS] for row in rows])
    return values.reshape(len(STIFFNESSES), -1, len(OUTPUTS))


def angles(fmu, stiffness, **options):
    """Angles of the FMU in co-simulation, from its start values: shape `[rows, outputs]`."""
    values = {"c0": stiffness, "mom": 0.033}
    result = simulate_fmu(fmu, fmi_type="CoSimulation", start_values=values, output=OUTPUTS, stop_time=STOP, **options)
    return np.column_stack([result[name] for name in OUTPUTS])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--network", action="store_true", help="by a network alone, instead of sums of sines, cosines and powers")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        began = time.monotonic()
        examples, study = ROOT / "examples" / "dynamics", folder / "andrews-study.toml"
        copy(examples / "andrews.toml", folder)
        text = (examples / study.name).read_text()
        if options.network:
            # however poor, it is exported
            text += '\n[dynamics]\nmodel = "network"\n\n[accept]\nr2 = -inf\nbaseline_factor = inf\nangle_error = inf\n'
        study.write_text(text)
        subprocess.run([METAFMU, "build", study, "--out", folder / "out"], check=True, capture_output=True)
        print(f"built in {time.monotonic() - began:.0f} s\n\n| | largest error of the crank's angle, rad | of the other three angles |\n|---|---|---|")
        by = "by a network alone: " if options.network else ""

        def row(label, errors):
            print(f"| {by}{label} | {errors[0]:.1e} | {errors[1:].max():.1e} |", flush=True)

        fmu = str(folder / "out" / "andrews.fmu")
        exact = np.array([REFERENCE[name] for name in OUTPUTS])
        for what, method in [("to the reference", {}), ("with a tolerance of 1e-12", {"relative_tolerance": 1e-12})]:
            row(f"after {STOP} s, 4530 N/m, {what}", np.abs(angles(fmu, 4530.0, output_interval=STEP, **method)[-1] - exact))
        truths = mechanism(folder)
        errors = [np.abs(angles(fmu, stiffness, output_interval=STEP) - truth).max(axis=0) for stiffness, truth in zip(STIFFNESSES, truths)]
        label = f"at any of {len(truths[0])} rows, {len(STIFFNESSES)} unseen stiffnesses, to the mechanism integrated at 1e-13"
        row(label, np.max(errors, axis=0))


if __name__ == "__main__":
    main()
