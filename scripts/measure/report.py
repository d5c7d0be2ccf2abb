"""How long the report of a study with 7.3 million rows takes, and how large it is.

    cargo build --release && .venv/bin/python scripts/measure report

Of the study examples/paper/double-pendulum.toml, with hardly any training, which does not matter here, 81 runs are for training, and 14,641
(7,335,141 rows) are test runs, all of which a report reads and predicts. Takes 3 GB of disk.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from common import METAFMU, ROOT

ROUNDS = 2
KEYS = {"levels": 3, "test_runs": 14641, "epochs": 20}


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
    with tempfile.TemporaryDirectory() as folder:
        text = (ROOT / "examples" / "paper" / "double-pendulum.toml").read_text()
        for key, value in KEYS.items():
            text, count = re.subn(rf"(?m)^{key} = \d+", f"{key} = {value}", text)
            assert count == 1, key
        study = Path(folder) / "study.toml"
        study.write_text(text)
        run("sample", study, "--out", folder)
        run("train", study, "--out", folder)
        samples = json.loads((Path(folder) / "samples.json").read_text())
        assert samples["test_rows"] == 7_335_141, samples
        seconds, usage, written = zip(*(report(study, folder) for _ in range(ROUNDS)))
    cpu = min(used.ru_utime + used.ru_stime for used in usage)
    size, figures, peak = written[0]["bytes"] / 1e6, written[0]["figures"], usage[0].ru_maxrss / 1e6
    print("| test rows | s, minimum | CPU s, minimum | MB | figures | peak of memory, GB |\n|---|---|---|---|---|---|")
    print(f"| {samples['test_rows']:,} | {min(seconds):.1f} | {cpu:.1f} | {size:.2f} | {figures} | {peak:.2f} |")


if __name__ == "__main__":
    main()
