"""Compares one network of which the time is an input (S_full) with one network for each instant (S_fixed) on the single pendulum.

    .venv/bin/python scripts/measure structures [--epochs-share 1] [--epochs 150] [--out out/structures]

Both structures get the same runs, by two recipes: that of Choi et al. 2021, and ours. Prints the tables of docs/structures.md
and writes its figure, docs/structures.svg. Needs target/release/metafmu and .venv, which scripts/venv.sh makes. All jobs run one after the other; processor seconds are those of the child processes.

Smoothness: the root mean square of the second differences of the prediction's error, e(t-h) - 2 e(t) + e(t+h), over all unseen
runs, relative to that of the truth. Zero is as smooth as the truth; a prediction whose second differences are pure noise of
the truth's size has 1.
"""

import argparse
import csv
import json
import resource
import subprocess
import time
from pathlib import Path

import numpy as np
from common import ROOT
from model_file import evaluate, load
from paper_models import at_time_points, changed, r2, roughness, speed

OUTPUTS = ["theta", "thetad", "thetadd"]
PARAMETERS = ["L", "c", "thetad0"]
# of 0.01 s: the truth between the instants
FINER = 4
# the first named test case of Choi et al. 2021
CASE = (0.1911, 0.055, 3.78)
PAPER = (ROOT / "examples" / "paper" / "single-pendulum.toml").read_text()


def ours(epochs):
    """The example's runs, but inside the ranges and the time, and a recipe that both structures can have."""
    text = (ROOT / "examples" / "single-pendulum.toml").read_text()
    lines = [line for line in text.splitlines() if not line.startswith(("margin = ", "faces = ", "enough = "))]
    return changed("\n".join(lines), hidden="[128, 128]", learning_rate=0.003, schedule='"cosine"', epochs=epochs)


def metafmu(*arguments):
    """Processor seconds and seconds that the command took."""
    command = [ROOT / "target" / "release" / "metafmu", *map(str, arguments)]
    usage, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    subprocess.run(command, check=True, cwd=ROOT, stdout=subprocess.DEVNULL)
    now = resource.getrusage(resource.RUSAGE_CHILDREN)
    return now.ru_utime + now.ru_stime - usage.ru_utime - usage.ru_stime, time.monotonic() - began


def predict(tensors, parameters, times):
    """[runs, times, outputs]"""
    rows = np.column_stack([np.repeat(parameters, len(times), axis=0), np.tile(times, len(parameters))])
    return evaluate(tensors, rows).reshape(len(parameters), len(times), -1)


def truth(path):
    """Parameters [runs, parameters], times, and outputs [runs, times, outputs] of a table."""
    with open(path) as file:
        header = next(csv.reader(file))
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    runs = int(rows[-1, header.index("run")]) + 1
    rows = rows.reshape(runs, -1, len(header))
    of = lambda names: rows[..., [header.index(name) for name in names]]
    return of(PARAMETERS)[:, 0], rows[0, :, header.index("time")], of(OUTPUTS)


class Result:
    """A structure trained by a recipe, and measured."""

    def __init__(self, folder, name, study, unseen):
        folder = folder / name
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / "study.toml"
        path.write_text(study)
        metafmu("sample", path, "--out", folder)
        self.cost, self.seconds = metafmu("train", path, "--out", folder)
        metafmu("evaluate", path, "--out", folder)
        metafmu("export", path, "--out", folder)
        self.size, self.fmu_size = ((folder / f"single-pendulum.{kind}").stat().st_size for kind in ("safetensors", "fmu"))
        self.step, self.instantiation = speed(folder / "single-pendulum.fmu", OUTPUTS)
        _, self.model = load(folder / "single-pendulum.safetensors")
        parameters, times, expected = unseen
        found = predict(self.model, parameters, times)
        on = (found[:, ::FINER], expected[:, ::FINER])
        between = np.arange(len(times)) % FINER != 0
        self.on, self.off = r2(*on), r2(found[:, between], expected[:, between])
        self.rough_on, self.rough_off = roughness(*on), roughness(found, expected)
        # what is computed here is what the tool evaluates
        metrics = json.loads((folder / "metrics.json").read_text())["outputs"]
        np.testing.assert_allclose(self.on, [metrics[output]["r2"] for output in OUTPUTS], rtol=0, atol=1e-9)


def table(recipe, results):
    """Prints the table of a recipe: S_full, S_fixed, and S_fixed over S_full."""
    full, fixed = results
    print(f"| {recipe} | S_full | S_fixed | S_fixed / S_full |\n|---|---|---|---|")

    def row(name, of, form):
        a, b = of(full), of(fixed)
        print(f"| {name} | {a:{form}} | {b:{form}} | {b / a:.3g} |")

    for index, output in enumerate(OUTPUTS):
        row(f"1 - R², `{output}`, at the time points", lambda result: 1 - result.on[index], ".2e")
    for index, output in enumerate(OUTPUTS):
        row(f"1 - R², `{output}`, between them", lambda result: 1 - result.off[index], ".2e")
    for index, output in enumerate(OUTPUTS):
        row(f"roughness, `{output}`, steps of 0.01 s", lambda result: result.rough_on[index], ".3f")
    for index, output in enumerate(OUTPUTS):
        row(f"roughness, `{output}`, steps of 0.0025 s", lambda result: result.rough_off[index], ".3f")
    row("training, processor seconds", lambda result: result.cost, ".0f")
    row("training, seconds", lambda result: result.seconds, ".0f")
    row("model file, kB", lambda result: result.size / 1000, ".0f")
    row("FMU, kB", lambda result: result.fmu_size / 1000, ".0f")
    row("a step through fmpy, µs", lambda result: result.step, ".1f")
    row("instantiation, ms", lambda result: result.instantiation, ".1f")
    print(flush=True)


def figure(results, unseen, path):
    """Time response of a case that is not in training, S_fixed left and S_full right, and what is missing to the truth."""
    import matplotlib.pyplot as plt

    parameters, times, expected = unseen
    full, fixed = results
    plt.rcParams.update({"svg.hashsalt": "structures", "font.size": 9, "axes.grid": True, "grid.alpha": 0.3})
    drawing, axes = plt.subplots(4, 2, figsize=(9, 9), sharex=True, height_ratios=(2, 2, 2, 1.5), layout="constrained")
    for column, (name, result) in enumerate([("S_fixed", fixed), ("S_full", full)]):
        found = predict(result.model, parameters, times)[0]
        for index, (output, unit) in enumerate(zip(OUTPUTS, ("rad", "rad/s", "rad/s²"))):
            axis = axes[index, column]
            axis.plot(times, expected[0, :, index], color="0.6", linewidth=3, label="truth")
            axis.plot(times, found[:, index], color="C0", linewidth=1, label=name)
            axis.set_ylabel(f"{output} [{unit}]")
        axes[0, column].set_title(name)
        axes[0, column].legend(loc="upper right")
        axes[3, column].plot(times, found[:, 2] - expected[0, :, 2], color="C3", linewidth=0.8)
        axes[3, column].set_ylabel("error of thetadd")
        axes[3, column].set_xlabel("time [s]")
    limit = max(abs(limit) for axis in axes[3] for limit in axis.get_ylim())
    for axis in axes[3]:
        axis.set_ylim(-limit, limit)
    drawing.suptitle(f"L = {CASE[0]} m, c = {CASE[1]} kg·m/s, thetad0 = {CASE[2]} rad/s")
    drawing.savefig(path, metadata={"Date": None})


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--epochs-share", type=float, default=1.0, help="of the paper's 400 epochs [default: 1]")
    parser.add_argument("--epochs", type=int, default=150, help="of our recipe [default: 150]")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "structures", help="folder of the trainings")
    arguments = parser.parse_args()
    # not above, as --help needs none; where it is missing that shows before the trainings
    import matplotlib

    matplotlib.use("svg")
    folder, epochs = arguments.out.resolve(), round(400 * arguments.epochs_share)

    # unseen runs at finer steps: the same as every study's test runs, which follow from the seed
    folder.mkdir(parents=True, exist_ok=True)
    finer = folder / "finer.toml"
    finer.write_text(changed(PAPER, levels=2, step=0.01 / FINER))
    metafmu("sample", finer, "--out", folder / "finer")
    unseen = truth(folder / "finer" / "test.csv")
    case = folder / "case.csv"
    case.write_text(",".join(PARAMETERS) + "\n" + ",".join(map(str, CASE)) + "\n0.15,0.05,1\n")
    of_case = changed(PAPER, levels=2, step=0.01 / FINER).replace('method = "mesh"', 'method = "list"\nfile = "case.csv"')
    of_case = "\n".join(line for line in of_case.splitlines() if not line.startswith("levels")) + "\n"
    (folder / "case.toml").write_text(of_case)
    metafmu("sample", folder / "case.toml", "--out", folder / "case")
    one_case = truth(folder / "case" / "train.csv")

    paper = changed(PAPER, epochs=epochs)
    print(f"The paper's recipe, {epochs} epochs (the paper has 400):\n")
    results = [Result(folder, f"paper-{name}", study, unseen) for name, study in (("full", paper), ("fixed", at_time_points(paper)))]
    table("the paper's recipe", results)
    figure(results, one_case, ROOT / "docs" / "structures.svg")

    print("Our recipe; S_fixed in batches of 64, as one of 1024 would be nearly all rows of an instant:\n")
    of_full, of_fixed = ours(arguments.epochs), at_time_points(changed(ours(arguments.epochs), batch=64))
    table("our recipe", [Result(folder, f"ours-{name}", study, unseen) for name, study in (("full", of_full), ("fixed", of_fixed))])


if __name__ == "__main__":
    main()
