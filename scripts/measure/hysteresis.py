"""Builds both surrogates of a mass on a spring with hysteresis in examples/dynamics/bouc-wen: a table of docs/discrete.md.

One is learned from a table, the other one from an FMU of PythonFMU. Errors are those of simulations of unseen runs, relative to the standard
deviation. Needs target/release/metafmu, and pythonfmu on the path.

Usage: .venv/bin/python scripts/measure hysteresis [--out FOLDER]
"""

import argparse
import json
import resource
import subprocess
import sys
from pathlib import Path

from common import ROOT, run

EXAMPLES = ROOT / "examples" / "dynamics" / "bouc-wen"
STUDIES = {"bouc-wen": "`bouc-wen.toml`, the table", "hysteresis": "`hysteresis.toml`, an FMU whose damping is a parameter"}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/hysteresis"), help="folder of the builds")
    folder = parser.parse_args().out.resolve()
    subprocess.run([sys.executable, EXAMPLES / "make_table.py"], check=True, stdout=sys.stderr)
    subprocess.run(["pythonfmu", "build", "-f", EXAMPLES / "hysteresis.py", "-d", EXAMPLES], check=True, stdout=sys.stderr)
    print("| | runs | relative RMS error: median, 90 % | processor time, s |\n|---|---|---|---|")
    for name, label in STUDIES.items():
        spent = lambda: sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])
        before = spent()
        run(EXAMPLES, "build", f"{name}.toml", "--out", folder / name)
        metrics = json.loads((folder / name / "metrics.json").read_text())
        last = metrics["roll_outs"]["horizons"][-1]
        errors = ", ".join(f"{100 * last[which]:.2f} %" for which in ("median", "q90"))
        print(f"| {label} | {metrics['test_runs']} | {errors} | {spent() - before:.0f} |", flush=True)


if __name__ == "__main__":
    main()
