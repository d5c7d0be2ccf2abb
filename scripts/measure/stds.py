"""Measures predicted standard deviations of static maps: how many further rows are within two of them, and what they cost.

Rows are uniform random points of functions of the literature, with normal noise or none. The share is that of 5,000 further rows with such noise. Beside it is
scikit-learn's GaussianProcessRegressor with a length for each input and noise, fitted to the same rows. Its standard deviation is that of a further row as
well. Seconds are those of 20,000 rows by `metafmu predict` on one core, with and without standard deviations: medians of five.

Usage: python3 scripts/measure stds [--rows 50,200] [--noise 0,0.1] [--seeds 3] [--no-peer] [FUNCTION...]
"""

import argparse
import json
import os
import subprocess
import tempfile
import warnings
from pathlib import Path

import numpy as np
from common import METAFMU
from functions import FUNCTIONS, TEST_POINTS
from plans import run, write

# rows of which the prediction is timed, and how often
TIMED, TIMES = 20_000, 5


def study(folder, columns, std):
    inputs = "".join(f"x{column} = {{ min = 0, max = 1 }}\n" for column in range(columns))
    text = f'name = "s"\nstructure = "static"\n[source]\ntable = "points.csv"\n[inputs]\n{inputs}[outputs]\ny = {{}}\n'
    (folder / "s.toml").write_text(text + f'[static]\nmodel = "gaussian-process"\nstd = {str(std).lower()}\n')


def predicted(folder):
    lines = run(folder, "predict", "s.toml", "unseen.csv").splitlines()[1:]
    return np.array([[float(cell) for cell in line.split(",")[:2]] for line in lines]).T


def seconds(folder):
    """Seconds of evaluation for a row."""
    one = {**os.environ, "RAYON_NUM_THREADS": "1"}
    command = [METAFMU, "predict", "s.toml", "timed.csv", "--out", "found.csv", "--json"]
    found = [json.loads(subprocess.run(command, cwd=folder, env=one, capture_output=True, text=True, check=True).stdout) for _ in range(TIMES)]
    return np.median([result["evaluate_seconds"] for result in found]) / TIMED


def peer(x, y, unseen):
    """Prediction and standard deviation by scikit-learn."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    kernel = ConstantKernel() * RBF(np.ones(x.shape[1]), (1e-2, 1e3)) + WhiteKernel(1e-3, (1e-12, 1e1))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = GaussianProcessRegressor(kernel, normalize_y=True, n_restarts_optimizer=2, random_state=0).fit(x, y)
    return model.predict(unseen, return_std=True)


def share(truth, found, std):
    return np.mean(np.abs(truth - found) <= 2 * std)


def measured(function, rows, noise, seed, has_peer):
    of, columns = FUNCTIONS[function]
    random = np.random.default_rng(seed)
    x, unseen = random.random((rows, columns)), random.random((TEST_POINTS, columns))
    deviation = of(unseen).std() * noise
    y, truth = of(x) + deviation * random.normal(size=rows), of(unseen) + deviation * random.normal(size=TEST_POINTS)
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        write(folder, "points.csv", x, y)
        write(folder, "unseen.csv", unseen, truth)
        write(folder, "timed.csv", np.tile(unseen, (TIMED // TEST_POINTS, 1)), np.tile(truth, TIMED // TEST_POINTS))
        costs = []
        for std in (False, True):
            study(folder, columns, std)
            run(folder, "train", "s.toml")
            costs.append(1e6 * seconds(folder))
        found, std = predicted(folder)
    error = np.sqrt(np.mean((found - truth) ** 2))
    cells = [share(truth, found, std), np.sqrt(np.mean(std**2)) / error]
    return [*cells, *costs, share(truth, *peer(x, y, unseen)) if has_peer else np.nan]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("function", nargs="*", metavar="FUNCTION", help=f"of {', '.join(FUNCTIONS)}; branin and borehole unless given")
    parser.add_argument("--rows", default="50,200", help="numbers of rows, separated by commas")
    parser.add_argument("--noise", default="0,0.1", help="standard deviations of the noise relative to that of the function, separated by commas")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--no-peer", action="store_true", help="without scikit-learn")
    options = parser.parse_args()
    print("| function | rows | noise | within 2 std | scikit-learn | RMS std / RMSE | µs without std | µs with std |")
    print("|---|---|---|---|---|---|---|---|")
    for function in options.function or ["branin", "borehole"]:
        for rows in map(int, options.rows.split(",")):
            for noise in map(float, options.noise.split(",")):
                found = [measured(function, rows, noise, seed, not options.no_peer) for seed in range(1, options.seeds + 1)]
                within, ratio, without, cost, of_peer = np.median(found, axis=0)
                other = "-" if np.isnan(of_peer) else f"{100 * of_peer:.1f} %"
                of = f"{function.capitalize() if function == 'branin' else function}, {FUNCTIONS[function][1]} inputs"
                level = f"{100 * noise:g} %" if noise else "none"
                print(f"| {of} | {rows} | {level} | {100 * within:.1f} % | {other} | {ratio:.2f} | {without:.1f} | {cost:.1f} |", flush=True)


if __name__ == "__main__":
    main()
