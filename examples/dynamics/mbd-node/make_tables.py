"""Writes the tables of the studies beside it: one motion each of a spring, three masses and a double pendulum, 400 rows.

The systems are those of "MBD-NODE: physics-informed data-driven modeling and simulation of constrained multibody systems" (arXiv
2407.08664). They are a mass of 10 kg on a hardening spring, a chain of 100, 10 and 1 kg attached to a wall, and a double pendulum in
absolute angles.

Usage: python make_tables.py FOLDER [--single] [--noise SIGMA]
"""

import argparse
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

ROWS = 400


def spring(_, state):
    x, v = state
    return [v, (-50 * x - 0.1 * x**3 - 2 * v) / 10]


def triple_mass(_, state):
    x, v = np.asarray(state[:3]), np.asarray(state[3:])
    # forces in the springs and dampers, from the wall on
    pulls = 50 * np.diff(x, prepend=0) + 2 * np.diff(v, prepend=0)
    return [*v, *((np.append(pulls[1:], 0) - pulls) / [100, 10, 1])]


def double_pendulum(_, state, gravity=9.8):
    (a, b), (wa, wb) = state[:2], state[2:]
    sine, cosine = np.sin(b - a), np.cos(b - a)
    mass = 2 - cosine**2
    first = wb**2 * sine - 2 * gravity * np.sin(a)
    second = -(wa**2) * sine - gravity * np.sin(b)
    return [wa, wb, (first - cosine * second) / mass, (2 * second - cosine * first) / mass]


# equations, start, time of the last row, and the states' columns
SYSTEMS = {
    "spring": (spring, [1, 0], 3.99, ["x [m]", "v [m/s]"]),
    "triple-mass": (triple_mass, [1, 2, 3, 0, 0, 0], 3.99, [f"x{k} [m]" for k in (1, 2, 3)] + [f"v{k} [m/s]" for k in (1, 2, 3)]),
    "double-pendulum": (
        double_pendulum,
        [np.pi / 2, np.pi / 4, 0, 0],
        4.0,
        ["theta1 [rad]", "theta2 [rad]", "omega1 [rad/s]", "omega2 [rad/s]"],
    ),
}


def motion(name):
    """Times and states, shape `[rows, states]`."""
    rates, start, stop, _ = SYSTEMS[name]
    times = np.linspace(0, stop, ROWS)
    solution = solve_ivp(rates, (0, stop), start, method="DOP853", t_eval=times, rtol=1e-13, atol=1e-14)
    assert solution.success, solution.message
    return times, solution.y.T


def write(folder, single=False, noise=0.0):
    """The tables, in single precision as the authors' arrays are if `single`, and with normal noise in every state."""
    for name, (*_, columns) in SYSTEMS.items():
        times, states = motion(name)
        states = states.astype(np.float32).astype(float) if single else states
        states = states + noise * np.random.default_rng(1).normal(size=states.shape)
        lines = [",".join(map(repr, map(float, (time, *state)))) for time, state in zip(times, states)]
        (Path(folder) / f"{name}.csv").write_text("\n".join([",".join(["time [s]", *columns]), *lines]) + "\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--single", action="store_true", help="states rounded to single precision")
    parser.add_argument("--noise", type=float, default=0.0, metavar="SIGMA", help="standard deviation of normal noise in every state")
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    write(arguments.folder, arguments.single, arguments.noise)


if __name__ == "__main__":
    main()
