"""Times reading the same runs as CSV and as Parquet: .venv/bin/python scripts/measure tables [RUNS]

Each run has 200 rows; the least of three times of `metafmu sample --dry-run`, which reads and checks every row. Needs
target/release/metafmu.
"""

import argparse
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
from common import METAFMU

STUDY = """name = "s"
source.table = "{file}"
time = {{ stop = 1, step = 0.01 }}
parameters = {{ a = {{ min = 0, max = 10 }}, b = {{ min = -1, max = 1 }} }}
outputs = {{ y = {{}}, z = {{}} }}
sampling.test_runs = 100
"""


def main():
    parser = argparse.ArgumentParser(description=__doc__.split(":")[0])
    parser.add_argument("runs", type=int, nargs="?", default=20_000, help="how many runs; %(default)s unless given")
    count, rows = parser.parse_args().runs, 200
    random = np.random.default_rng(0)
    t, a, b = np.tile(np.linspace(0, 1, rows), count), *(np.repeat(random.uniform(*ends, count), rows) for ends in [(0, 10), (-1, 1)])
    runs = pd.DataFrame({"run": np.repeat(np.arange(count), rows), "time": t, "a": a, "b": b, "y": np.sin(a * t) * b, "z": np.cos(a * t)})
    with tempfile.TemporaryDirectory() as folder:
        for file, write in [("runs.csv", runs.to_csv), ("runs.parquet", runs.to_parquet)]:
            write(Path(folder, file), index=False)
            Path(folder, "study.toml").write_text(STUDY.format(file=file))
            times = []
            for _ in range(3):
                start = time.perf_counter()
                subprocess.run([METAFMU, "sample", "study.toml", "--dry-run"], cwd=folder, check=True, stdout=subprocess.DEVNULL)
                times.append(time.perf_counter() - start)
            size = Path(folder, file).stat().st_size / 1e6
            print(f"{file}: {len(runs):,} rows, {size:.0f} MB, {min(times):.2f} s")


if __name__ == "__main__":
    main()
