"""Writes recorded runs of an oscillator with hysteresis: a mass on a spring with a Bouc-Wen element, pushed by a random force.

    m y'' + c y' + k y + z = F,    z' = a y' - b (g |y'| z + d y' |z|)

The constants are those of the nonlinear system identification benchmark of Noel and Schoukens. `z` is not recorded. The force has a flat
spectrum from 5 to 150 Hz and a different level in each run. It is constant between two rows, 1.25 ms apart. bouc-wen.csv has 22 runs of 2 s
from rest. unseen.csv has ten more, for tests with other programs. Needs numpy.

Usage: python3 make_table.py [FOLDER]       # next to this file unless given
"""

import argparse
from pathlib import Path

import numpy as np

M, C, K, A, B, G, D = 2.0, 10.0, 5e4, 5e4, 1e3, 0.8, -1.1
STEP, ROWS = 0.00125, 1601
BAND, LEVELS = (5.0, 150.0), (20.0, 60.0)
SUBSTEPS = 25


def rates(state, force):
    y, v, z = state
    return np.array([v, (force - C * v - K * y - z) / M, A * v - B * (G * abs(v) * z + D * v * abs(z))])


def simulate(forces):
    """Positions at the rows of each run, `[runs, rows]`, by Runge-Kutta steps. The forces have the same shape and are constant between two
    rows."""
    state, h = np.zeros((3, len(forces))), STEP / SUBSTEPS
    positions = np.zeros_like(forces)
    for row in range(forces.shape[1]):
        positions[:, row] = state[0]
        for _ in range(SUBSTEPS):
            k1 = rates(state, forces[:, row])
            k2 = rates(state + h / 2 * k1, forces[:, row])
            k3 = rates(state + h / 2 * k2, forces[:, row])
            k4 = rates(state + h * k3, forces[:, row])
            state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return positions


def random_forces(random, runs):
    frequencies = np.fft.rfftfreq(ROWS, STEP)
    is_inside = (frequencies >= BAND[0]) & (frequencies <= BAND[1])
    forces = np.fft.irfft(is_inside * np.exp(2j * np.pi * random.random((runs, frequencies.size))), ROWS, axis=1)
    levels = random.uniform(*LEVELS, (runs, 1))
    return forces / forces.std(axis=1, keepdims=True) * levels


def runs(seed, count):
    forces = random_forces(np.random.default_rng(seed), count)
    return forces, simulate(forces)


def write(path, forces, positions):
    rows = [
        f"{run},{round(row * STEP, 5)!r},{float(force)!r},{float(position)!r}"
        for run, pairs in enumerate(zip(forces, positions))
        for row, (force, position) in enumerate(zip(*pairs))
    ]
    path.write_text("run,time [s],force [N],position [m]\n" + "\n".join(rows) + "\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", default=Path(__file__).parent, help="where to; next to this file unless given")
    folder = parser.parse_args().folder
    write(folder / "bouc-wen.csv", *runs(1, 22))
    write(folder / "unseen.csv", *runs(2, 10))


if __name__ == "__main__":
    main()
