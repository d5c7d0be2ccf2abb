"""Prints the tables of docs/baselines.md: .venv/bin/python scripts/measure baselines [STUDY...]

Builds each study (the paper's three systems unless given) if that is not done, runs `metafmu compare` and writes what it found as
Markdown. Needs target/release/metafmu.
"""

import argparse
import json
import subprocess
from pathlib import Path

from common import ROOT

STUDIES = [ROOT / "examples" / f"{name}.toml" for name in ("single-pendulum", "double-pendulum", "slider-crank")]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("study", type=Path, nargs="*", default=STUDIES)
    parser.add_argument("--out", type=Path, default=ROOT / "out", help="where `metafmu build` wrote its results")
    parser.add_argument("--model", action="append", default=[], help="compare only this model; may be given several times")
    options = parser.parse_args()
    for study in options.study:
        folder = options.out / study.stem
        if not (folder / f"{study.stem}.fmu").exists():
            metafmu("build", study, "--out", folder)
        models = [argument for model in options.model for argument in ("--model", model)]
        print(table(json.loads(metafmu("compare", study, "--out", folder, "--json", *models))), flush=True)


def metafmu(*arguments):
    command = [ROOT / "target" / "release" / "metafmu", *arguments]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


def table(comparison):
    outputs = list(comparison["models"][0]["outputs"])
    lines = [f"\n### {comparison['name']}\n", f"{comparison['test_runs']} unseen runs, {comparison['test_rows']} rows.\n"]
    head = ["1 - R² of", *outputs, "fit", "a prediction", "memory", "rows"]
    lines += [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for model in comparison["models"]:
        if not model["outputs"]:
            lines.append(f"| {model['model']} | {model['note']} |")
            continue
        errors = [f"{1 - model['outputs'][output]['r2']:.1e}" for output in outputs]
        cost = [f"{model['fit_seconds']:.2g} s", f"{1e6 * model['predict_seconds_per_point']:.2g} us",
                f"{model['memory_bytes'] / 1e3:.3g} kB", str(model["rows"])]
        lines.append(f"| {' | '.join([model['model'], *errors, *cost])} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
