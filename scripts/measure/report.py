"""How long the report of a study with 7.3 million rows takes, and how large it is.

    cargo build --release && .venv/bin/python scripts/measure report

Two studies of examples/paper/double-pendulum.toml with hardly any training, which does not matter here:
- training: its 14,641 runs (7,335,141 rows) are for training, 200 are test runs. A report reads the test runs only.
- test: 81 runs are for training, 14,641 (7,335,141 rows) are test runs, all of which a report reads and predicts.

Takes 3 GB of disk and a few minutes.
"""

import argparse
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from common import METAFMU, ROOT

ROUNDS = 3
VARIANTS = {
    "training": {"levels": 11, "test_runs": 200, "epochs": 1},
    "test": {"levels": 3, "test_runs": 14641, "epochs": 20},
}


def run(*arguments):
    result = subprocess.run([METAFMU, *map(str, arguments)], capture_output=True, text=True)
    if result.returncode != 0:
        sys.exit(result.stderr)
    return result.stdout


def report(study, folder):
    """Wall seconds, resources used, and what was written."""
    begin = time.monotonic()
    process = subprocess.Popen([METAFMU, "report", study, "--out", folder, "--json"], stdout=subprocess.PIPE)
    output = process.stdout.read()
    _, status, usage = os.wait4(process.pid, 0)
    assert status == 0
    return time.monotonic() - begin, usage, json.loads(output)


def main():
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    if not METAFMU.exists():
        sys.exit("run `cargo build --release` first")
    print(f"{'7,335,141 rows for':<20} {'seconds, median':>16} {'all':<22} {'CPU seconds':>12} {'MB':>6} {'figures':>8} {'peak GB':>8}")
    for name, keys in VARIANTS.items():
        with tempfile.TemporaryDirectory() as folder:
            text = (ROOT / "examples" / "paper" / "double-pendulum.toml").read_text()
            for key, value in keys.items():
                text, count = re.subn(rf"(?m)^{key} = \d+", f"{key} = {value}", text)
                assert count == 1, key
            study = Path(folder) / "study.toml"
            study.write_text(text)
            run("sample", study, "--out", folder)
            run("train", study, "--out", folder)
            samples = json.loads((Path(folder) / "samples.json").read_text())
            assert 7_335_141 in (samples["train_rows"], samples["test_rows"]), samples
            rounds = [report(study, folder) for _ in range(ROUNDS)]
            seconds, usage, written = zip(*rounds)
            each = ", ".join(f"{value:.1f}" for value in seconds)
            cpu = statistics.median(used.ru_utime + used.ru_stime for used in usage)
            size, figures, peak = written[0]["bytes"] / 1e6, written[0]["figures"], usage[0].ru_maxrss / 1e6
            print(f"{name:<20} {statistics.median(seconds):>16.1f} {each:<22} {cpu:>12.1f} {size:>6.2f} {figures:>8} {peak:>8.2f}")


if __name__ == "__main__":
    main()
