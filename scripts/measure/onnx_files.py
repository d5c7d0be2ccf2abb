"""Imports every ONNX file below some folders and says how many fit, and why the others do not.

Files of opsets before 7 are converted by onnx.version_converter, if it can. What is imported is compared with ONNX Runtime at random rows, to 1e-6 of the range (of a model in double precision 1e-12).

Usage: .venv/bin/python scripts/measure onnx-files [FOLDER...]    (the installed packages onnx and onnxruntime unless given)
"""

import argparse
import re
import subprocess
import sys
import tempfile
from collections import Counter
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import onnx
import onnx.version_converter
import onnxruntime
import pandas as pd
from common import METAFMU

ROWS = 20
# opset that metafmu reads
OLDEST = 7


def rows_of(model, names):
    """Random rows of a model's inputs as one table, and what ONNX Runtime gives for each."""
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4
    session = onnxruntime.InferenceSession(model.SerializeToString(), options)
    random, rows, results = np.random.default_rng(1), [], []
    known = {initializer.name for initializer in model.graph.initializer}
    for _ in range(ROWS):
        feeds, row = {}, []
        for given in session.get_inputs():
            if given.name in known:
                continue
            shape = [dim if isinstance(dim, int) and dim > 0 else 1 for dim in given.shape]
            kind = np.float32 if given.type == "tensor(float)" else np.float64
            feeds[given.name] = random.uniform(0.1, 0.9, shape).astype(kind)
            row.extend(feeds[given.name].ravel())
        rows.append(row)
        results.append(np.concatenate([np.ravel(result) for result in session.run(None, feeds)]))
    return pd.DataFrame(np.c_[np.array(rows, float), np.array(results, float)], columns=names)


def newer(path, folder):
    """The file, or one of opset 13 made by ONNX's own converter of one that is older than what is read."""
    model = onnx.load(path, load_external_data=False)
    opset = next((opset.version for opset in model.opset_import if opset.domain in ("", "ai.onnx")), 1)
    if opset >= OLDEST:
        return path
    try:
        converted = folder / "converted.onnx"
        onnx.save(onnx.version_converter.convert_version(model, 13), converted)
        return converted
    except Exception:
        return path


def import_of(path, folder):
    """Why a file does not fit; nothing if it does and gives what ONNX Runtime gives."""
    path = newer(path, folder)
    run = lambda *arguments: subprocess.run([METAFMU, "import", path, *arguments], capture_output=True, text=True, cwd=folder)
    interface = folder / "interface.toml"
    interface.unlink(missing_ok=True)
    started = run("--new", interface)
    if started.returncode != 0:
        return started.stderr
    names = re.findall(r'^\[(?:inputs|outputs)\."?(.*?)"?\]$', interface.read_text(), re.MULTILINE)
    try:
        table = rows_of(onnx.load(path), names)
    except Exception as error:
        return f"ONNX Runtime does not run it: {type(error).__name__}"
    table.to_csv(folder / "rows.csv", index=False, float_format="%.17g")
    is_double = table.shape[1] > 0 and "tensor(double)" in str(onnx.load(path).graph.input)
    tolerance = "1e-12" if is_double else "1e-6"
    made = run("--interface", interface, "--data", folder / "rows.csv", "--check", folder / "rows.csv", "--tolerance", tolerance, "--out", folder / "m.safetensors")
    return "" if made.returncode == 0 else made.stdout + made.stderr


def reason(message):
    """Without names of files, nodes and numbers."""
    first = message.strip().splitlines()[0] if message.strip() else "?"
    operators = sorted(set(re.findall(r"operator (`[^`]*`)", message)))
    if operators:
        return "operator " + ", ".join(operators)
    return re.sub(r"^error: .*?\.onnx: |`[^`]*`|\d[\d.e+-]*|\(\w+\)", "", first)[:90]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, nargs="*")
    parser.add_argument("--verbose", action="store_true", help="the message of each file that does not fit")
    arguments = parser.parse_args()
    folders = arguments.folder or [Path(find_spec(name).origin).parent for name in ("onnx", "onnxruntime")]
    paths = sorted(path for folder in folders for path in folder.rglob("*.onnx"))
    reasons, fitting = Counter(), 0
    with tempfile.TemporaryDirectory() as folder:
        for path in paths:
            message = import_of(path, Path(folder))
            if not message:
                fitting += 1
                continue
            reasons[reason(message)] += 1
            if arguments.verbose:
                print(f"{path}: {message.strip()[:300]}", file=sys.stderr)
    print(f"{fitting} of {len(paths)} files fit; the others:")
    for text, count in reasons.most_common():
        print(f"{count:5}  {text}")


if __name__ == "__main__":
    main()
