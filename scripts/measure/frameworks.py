"""Prints the largest differences between models and their frameworks: the table of docs/python.md.

The tests of python/tests that compare models of JAX, Keras, scikit-learn, XGBoost, LightGBM, CatBoost and PyTorch run against the package in a
wheel. A row has all models of a framework that the tests compare in one precision.

Usage: .peers/bin/python scripts/measure frameworks WHEEL
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from common import METAFMU, ROOT

TESTS = ["test_jax", "test_keras", "test_sklearn", "test_boosting", "test_torch"]
# of tests whose framework their file does not tell
BOOSTED = {"1e-06": "XGBoost, and one of LightGBM", "1e-12": "LightGBM, CatBoost"}
LABELS = {"test_jax": "JAX", "test_keras": "Keras", "test_sklearn": "scikit-learn", "test_torch": "PyTorch"}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("wheel", type=Path, help="metafmu's wheel")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps", "--target", folder, options.wheel]
        subprocess.run(pip, check=True)
        files = [f"{name}.py" for name in TESTS]
        command = [sys.executable, "-m", "pytest", "-q", "-s", "-p", "no:cacheprovider", *files]
        # some models run in processes of the command
        environment = {**os.environ, "PYTHONPATH": folder, "PATH": os.pathsep.join([str(METAFMU.parent), os.environ["PATH"]])}
        done = subprocess.run(command, cwd=ROOT / "python" / "tests", env=environment, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"error: {done.stdout[-3000:]}{done.stderr}")
    found = {}
    for file, allowed, _, difference in re.findall(r"LARGEST (\w+) tolerance (\S+) (.*) (\S+)$", done.stdout, re.M):
        found.setdefault((TESTS.index(file), allowed), []).append(float(difference))
    print("| framework | precision | models | largest difference of the range | allowed |\n|---|---|---|---|---|")
    for (file, allowed), differences in sorted(found.items(), key=lambda item: (item[0][0], -float(item[0][1]))):
        label = LABELS.get(TESTS[file], BOOSTED.get(allowed))
        precision = "single" if float(allowed) > 1e-9 else "double"
        print(f"| {label} | {precision} | {len(differences)} | {max(differences):.1e} | {allowed} |")


if __name__ == "__main__":
    main()
