"""Simulates the test rows of the public records by jax-sysid and an LSTM in PyTorch, trained in as much processor time as metafmu's build takes.

Rows, splits, the 50 measured samples before a simulation and the errors are those of `records`. Both have the rows for estimation, in parts:

- jax-sysid: states of the next sample from a linear part, which its LinearModel finds first, and a network; Adam, then L-BFGS. The states at the
  start of a part are fitted, those of a test by `learn_x0` from its measured samples.
- LSTM: windows of the rows, Adam with a cosine schedule over the budget; the weights that are best on the last tenth of the rows. In a test it has seen
  the inputs of the measured samples.

FOLDER has cascaded-tanks.csv and silverbox.csv (nonlinearbenchmark.org). Needs

    pip install torch==2.15.0 jax-sysid==1.1.0 fmpy

Usage: python scripts/measure record-peers --data FOLDER --seconds S [--seeds 3] [--only jax-sysid|lstm] RECORD...
"""

import argparse
from pathlib import Path

import numpy as np
import peer_models

GIVEN = 50
# rows of a part, states and nodes of jax-sysid; rows of a window of the LSTM, those that do not count, and nodes
SIZES = {"cascaded-tanks": (1024, 3, 6, 150, 50, 24), "silverbox": (2048, 2, 8, 300, 50, 24)}
# updates of the LSTM between two choices
LOOK = 25


def jax_sysid(training, tests, seconds, seed, sizes):
    rows, *sizes = sizes[:3]
    count = max(len(training) // rows, 1)
    parts = [(part[:, :1], part[:, 1:]) for part in np.array_split(training[: count * rows], count)]
    model, spent = peer_models.state_space(parts, seconds, sizes, seed, False, (200, 100, 100), 1e-6)

    def simulated(test):
        start = model.learn_x0(test[:GIVEN, :1], test[:GIVEN, 1:])
        return np.array(model.predict(start, test[:, :1])[0]).ravel()

    return [simulated(test) for test in tests], spent


def lstm(training, tests, seconds, seed, sizes):
    rows, washout, nodes = sizes[3:]
    held_out = training[-(len(training) // 10) :]
    seen = training[: -len(held_out)]

    def window(random):
        start = random.integers(0, len(seen) - rows)
        return seen[start : start + rows].T

    simulated, spent = peer_models.lstm(window, held_out.T[:, None], seconds, nodes, seed, washout, LOOK)
    return [simulated(test[None, :, 0])[0] for test in tests], spent


METHODS = {"jax-sysid": jax_sysid, "lstm": lstm}


def main():
    from records import RECORDS

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("record", nargs="+", metavar="RECORD", choices=list(RECORDS), help=f"of {', '.join(RECORDS)}")
    parser.add_argument("--data", required=True, type=Path, help="folder of the records")
    parser.add_argument("--seconds", required=True, type=float, help="processor time of each training")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--only", choices=list(METHODS), help="no others")
    options = parser.parse_args()
    for name in options.record:
        read, unit, factor, _ = RECORDS[name]
        _, training, tests = read(options.data / f"{name}.csv")
        mean, scale = training.mean(axis=0), training.std(axis=0)
        standardized = [(test - mean) / scale for test in tests.values()]
        for method in [options.only] if options.only else METHODS:
            found, spent = [], []
            for seed in range(1, options.seeds + 1):
                outputs, seconds = METHODS[method]((training - mean) / scale, standardized, options.seconds, seed, SIZES[name])
                errors = [(output - test[:, 1])[GIVEN:] for output, test in zip(outputs, standardized)]
                found.append([factor * scale[1] * np.sqrt(np.mean(error**2)) for error in errors])
                spent.append(seconds)
                print(f"{name}, {method}, seed {seed}: {' / '.join(f'{error:.3g}' for error in found[-1])} {unit}, {seconds:.0f} s", flush=True)
            print(f"{name}, {method}, median: {' / '.join(f'{error:.3g}' for error in np.median(found, axis=0))} {unit}, {np.median(spent):.0f} s")


if __name__ == "__main__":
    main()
