"""Counts how many points of fresh runs lie within a surrogate's error bounds: scripts/measure bounds STUDY... [--runs N]

The study must have been built with `[bounds]`. Fresh runs are those of the same study with other seeds; they are predicted by
the network in numpy, from the model file alone.
"""

import argparse
import re
import subprocess
import tempfile
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
from common import METAFMU, ROOT
from model_file import evaluate, load


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("study", type=Path, nargs="+")
    parser.add_argument("--runs", type=int, default=500, help="fresh runs for each seed")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1001, 1002, 1003])
    parser.add_argument("--out", type=Path, default=ROOT / "out", help="where `metafmu build` wrote its results")
    options = parser.parse_args()
    print("| study | output | bound | within, % of the points of fresh runs |\n|---|---|---|---|")
    for study in options.study:
        name = tomllib.loads(study.read_text())["name"]
        if not (model := options.out / name / f"{name}.safetensors").is_file():
            parser.error(f"{model} is missing: expected a study that was built (metafmu build {study}), or --out with the folder of its results")
        metadata, tensors = load(model)
        if "bounds" not in metadata:
            parser.error(f"{study} was built without [bounds]")
        outputs, half_widths = metadata["outputs"], metadata["bounds"]["half_widths"]
        shares = [coverage(study, seed, options.runs, metadata, tensors) for seed in options.seeds]
        for output, half_width, *within in zip(outputs, half_widths, *shares):
            found = ", ".join(f"{100 * share:.2f}" for share in within)
            print(f"| {name} | {output['name']} | {half_width:.3e} {output.get('unit', '')} | {found} |", flush=True)


def coverage(study: Path, seed: int, runs: int, metadata: dict, tensors: dict) -> np.ndarray:
    text = re.sub(r"(?m)^seed = \d+", f"seed = {seed}", study.read_text())
    text = re.sub(r"(?m)^test_runs = \d+", f"test_runs = {runs}", text)
    # training runs are not needed here, but a study has some
    text = re.sub(r"(?m)^runs = \d+", "runs = 20", text)
    with tempfile.TemporaryDirectory() as folder:
        # files that the study names are beside it
        fresh = Path(tempfile.mkstemp(suffix=".toml", prefix=".fresh-", dir=study.parent)[1])
        fresh.write_text(text)
        command = [METAFMU, "sample", fresh, "--out", folder]
        try:
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        finally:
            fresh.unlink()
        large = Path(folder) / "test.parquet"
        table = pd.read_parquet(large) if large.exists() else pd.read_csv(Path(folder) / "test.csv")
    inputs = table[[column["name"] for column in metadata["inputs"]]].to_numpy()
    predictions = evaluate(tensors, encoded(inputs, metadata["inputs"]))
    errors = np.abs(predictions - table[[column["name"] for column in metadata["outputs"]]].to_numpy())
    return np.mean(errors <= metadata["bounds"]["half_widths"], axis=0)


def encoded(rows: np.ndarray, inputs: list) -> np.ndarray:
    """The columns that the inputs' values become."""
    columns = []
    for x, column in zip(rows.T, inputs):
        encoding = column.get("encoding", "plain")
        if encoding == "plain":
            columns.append(x)
        elif encoding == "periodic":
            angle = 2 * np.pi * (x - column["min"]) / (column["max"] - column["min"])
            columns += [np.sin(angle), np.cos(angle)]
        else:
            columns += [(x == value).astype(float) for value in encoding["nominal"]]
    return np.stack(columns, axis=1)


if __name__ == "__main__":
    main()
