"""Measures what noise does to a surrogate of a record: a linear system of order four, with white noise of 5 % of the output's deviation.

The record for estimation and another one for the test begin at rest. The table has root mean square errors of simulations of the test record, as
multiples of the noise's deviation: the system itself would have 1. Beside the surrogate of the study that `metafmu new` writes there is an ARX model of
order four by least squares.

Usage: .venv/bin/python scripts/measure noise [--rows 2000] [--noise 0.05] [--seeds 3] [--out FOLDER]
"""

import argparse
from pathlib import Path

import numpy as np
from common import build_record, run
from scipy.signal import cont2discrete, dlsim

STEP = 0.05
# two modes: frequency in rad/s, damping ratio, and gain
MODES = [(2.0, 0.1, 1.0), (7.0, 0.05, 4.0)]
ORDER = 4


def system():
    a, b, c = np.zeros((4, 4)), np.zeros((4, 1)), np.zeros((1, 4))
    for mode, (frequency, damping, gain) in enumerate(MODES):
        place = slice(2 * mode, 2 * mode + 2)
        a[place, place] = [[0, 1], [-(frequency**2), -2 * damping * frequency]]
        b[2 * mode + 1], c[0, 2 * mode] = 1, gain
    return cont2discrete((a, b, c, np.zeros((1, 1))), STEP)


def record(random, rows):
    """Inputs that are held over a few samples, and outputs without noise."""
    u = np.repeat(random.uniform(-1, 1, rows // 5 + 1), 5)[:rows]
    u[0] = 0
    return u, dlsim(system(), u)[1][:, 0]


def arx(u, y, unseen):
    """Simulation of unseen inputs by an ARX model of the right order."""
    past = lambda signal: np.column_stack([signal[ORDER - 1 - lag : len(signal) - 1 - lag] for lag in range(ORDER)])
    weights = np.linalg.lstsq(np.column_stack([past(y), past(u)]), y[ORDER:], rcond=None)[0]
    found = np.zeros(len(unseen))
    for k in range(ORDER - 1, len(unseen) - 1):
        found[k + 1] = weights @ np.concatenate([found[k - ORDER + 1 : k + 1][::-1], unseen[k - ORDER + 1 : k + 1][::-1]])
    return found


def measure(rows, noise, seed, folder):
    random = np.random.default_rng(seed)
    (u, y), (unseen, truth) = record(random, rows), record(random, rows)
    deviation = noise * y.std()
    noisy, measured = (signal + deviation * random.standard_normal(rows) for signal in (y, truth))
    folder.mkdir(parents=True, exist_ok=True)
    times = np.arange(rows) * STEP

    def write(name, header, *columns):
        np.savetxt(folder / name, np.column_stack([times, *columns]), fmt="%.12g", delimiter=",", header=header, comments="")

    write("record.csv", "time,u,y", u, noisy)
    write("inputs.csv", "time,u,y_start", unseen, np.zeros(rows))
    build_record(folder, "record.csv", seed)
    (folder / "found.csv").unlink(missing_ok=True)
    run(folder, "predict", "study.toml", "inputs.csv", "--out", "found.csv")
    found = np.genfromtxt(folder / "found.csv", delimiter=",", names=True)["y"]
    error = lambda values: np.sqrt(np.mean((values - measured) ** 2)) / deviation
    return error(truth), error(found), error(arx(u, noisy, unseen))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=2000)
    parser.add_argument("--noise", type=float, default=0.05)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--out", type=Path, default=Path("out/noise"))
    options = parser.parse_args()
    print("| seed | the true system | metafmu | ARX of order four, least squares |\n|---|---|---|---|")
    for seed in range(1, options.seeds + 1):
        errors = measure(options.rows, options.noise, seed, options.out.resolve() / str(seed))
        print(f"| {seed} | {' | '.join(f'{error:.3f}' for error in errors)} |", flush=True)


if __name__ == "__main__":
    main()
