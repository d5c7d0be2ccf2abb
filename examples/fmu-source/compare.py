"""Surrogates of this folder's FMUs, each made by two commands: their errors against the originals and what a step costs.

Usage: compare.py METAFMU STEP_TIME FOLDER [--runs N]

METAFMU and STEP_TIME are the release builds of the command and of the example `step_time`; FOLDER gets the FMUs, studies and
surrogates. Prints the table in docs/fmu-source.md.
"""

import argparse
import json
import subprocess
from pathlib import Path

from make_fmus import HERE, activated, build_c, build_python, python_environment


def make(folder):
    """Each FMU with the time of a run and of a step in seconds, its outputs, and what a host needs to load it."""
    van_der_pol = build_c(HERE / "van-der-pol" / "van_der_pol.c", folder / "van_der_pol.fmu")
    chain = build_c(HERE / "chain" / "chain.c", folder / "chain.fmu")
    pendulum = build_python(HERE / "pendulum.py", folder)
    angles = ["upper.angle", "lower.angle", "upper.velocity", "lower.velocity"]
    positions = [f"position[{index}]" for index in (1, 2, 3)]
    return {
        "double pendulum, MuJoCo in PythonFMU": (pendulum, 2.0, 0.01, angles, angles, python_environment()),
        "Van der Pol's oscillator, C": (van_der_pol, 5.0, 0.02, ["x0", "x1"], ["x0", "x1"], None),
        "chain of masses, C, FMI 3.0": (chain, 2.0, 0.01, ["position", "energy"], [*positions, "energy"], None),
    }


def run(*arguments, **options):
    return subprocess.run(list(map(str, arguments)), check=True, text=True, capture_output=True, **options).stdout


def times(*command, environment=None):
    """Microseconds of a step and of an instance."""
    done = subprocess.run(list(map(str, command)), text=True, capture_output=True, env=environment)
    # the interpreter in an FMU of PythonFMU may crash when its host ends, after the result
    if done.returncode and not (environment and done.stdout):
        raise SystemExit(f"error: {done.args}: {done.stderr}")
    return map(float, done.stdout.split())


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("metafmu", type=Path)
    parser.add_argument("step_time", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--runs", type=int, help="training runs, instead of those that `metafmu new` proposes")
    arguments = parser.parse_args()
    folder = arguments.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    metafmu, step_time = arguments.metafmu.resolve(), arguments.step_time.resolve()

    print("| FMU | sampling, s | training, s | 1 - R², largest | largest error | step, us | surrogate's step, us | ratio | instance, us |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name, (fmu, stop, step, outputs, columns, environment) in make(folder).items():
        study = folder / f"{fmu.stem}-surrogate.toml"
        study.unlink(missing_ok=True)
        run(metafmu, "new", study.stem, "--fmu", fmu.name, cwd=folder)
        if arguments.runs:
            study.write_text(study.read_text().replace("runs = 1000", f"runs = {arguments.runs}"))
        out = folder / study.stem
        run(metafmu, "build", study.name, "--out", out, cwd=folder, env=activated())
        metrics = json.loads((out / "metrics.json").read_text())
        training = json.loads((out / "training.json").read_text())
        samples = json.loads((out / "samples.json").read_text())
        accuracies = {column: metrics["outputs"][column] for column in columns}
        worst = min(accuracies.values(), key=lambda accuracy: accuracy["r2"])
        largest = max(accuracies, key=lambda column: accuracies[column]["max_abs_error"])
        error = f"{accuracies[largest]['max_abs_error']:.2g} of {largest}"
        theirs, instance = times(step_time, fmu, stop, step, *outputs, environment=environment)
        (surrogate,) = out.glob("*.fmu")
        ours, _ = times(step_time, surrogate, stop, step, *columns)
        seconds = f"{samples['sample_seconds']:.1f} | {training['train_seconds']:.0f}"
        ratio = f"{theirs / ours:.0f}" if theirs > 10 * ours else f"{theirs / ours:.2f}"
        costs = f"{theirs:.3g} | {ours:.3g} | {ratio} | {instance:.3g}"
        print(f"| {name} | {seconds} | {1 - worst['r2']:.1e} | {error} | {costs} |", flush=True)


main()
