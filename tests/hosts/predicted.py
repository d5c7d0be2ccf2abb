"""Predictions of `metafmu validate --hosts` beside what hosts of the package registry do: a table of FMU by host, and how many predictions are right.

    scripts/venv.sh --hosts && .hosts/bin/python tests/hosts/predicted.py FMU|FOLDER...

A cell is `runs` or `fails`, followed by `, predicted otherwise` where that is wrong. A host runs an FMU if it takes ten steps and shows all outputs,
whatever their values are. FMUs of other versions of FMI than 2.0 and 3.0 are left out.
"""

import argparse
import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from installed import HOSTS, column

METAFMU = Path(__file__).parents[2] / "target" / "release" / "metafmu"
# as `validate --hosts` calls them
NAMES = {"casadi": "CasADi"}
# effects with which a host runs the FMU to its end
RUNNING = ("runs", "limited", "wrong-values")


def predictions(fmu):
    """Expected success by host; none if the FMU is not of FMI 2.0 or 3.0."""
    command = [METAFMU, "validate", "--hosts", "--json", "--time-limit", "20", fmu]
    found = json.loads(subprocess.run(command, capture_output=True, text=True).stdout)
    return {host["host"]: host["effect"] in RUNNING for host in found["hosts"]} if "hosts" in found else None


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("fmus", type=Path, nargs="+", help="FMUs, or folders of FMUs")
    parser.add_argument("--host", nargs="+", choices=HOSTS, default=list(HOSTS), help="only these")
    options = parser.parse_args()
    fmus = [fmu for path in options.fmus for fmu in (sorted(path.glob("*.fmu")) if path.is_dir() else [path])]
    with ThreadPoolExecutor(2) as threads:
        expected = dict(zip(fmus, threads.map(predictions, fmus)))
        fmus = [fmu for fmu in fmus if expected[fmu] is not None]
        columns = dict(zip(options.host, threads.map(column, options.host, [fmus] * len(options.host))))
    right = dict.fromkeys(options.host, 0)
    print("| FMU | " + " | ".join(options.host) + " |")
    print("|---" * (1 + len(options.host)) + "|")
    for place, fmu in enumerate(fmus):
        row = []
        for host, cells in columns.items():
            runs = cells[place].has_run
            is_right = expected[fmu][NAMES.get(host, host)] == runs
            right[host] += is_right
            row.append(("runs" if runs else "fails") + ("" if is_right else f", predicted otherwise: {cells[place].text}"))
        print(f"| {fmu.stem} | {' | '.join(row)} |")
    print(f"| right of {len(fmus)} | {' | '.join(map(str, right.values()))} |")
    sys.exit(min(right.values()) < 0.95 * len(fmus))


if __name__ == "__main__":
    main()
