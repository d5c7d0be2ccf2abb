"""Compares points of `metafmu plan` with random ones: errors of static maps of as many rows, on functions of the literature.

Adaptive rows begin with a third of the points, which fill the ranges, and follow in batches of a tenth, planned beside the rows before them. Beside them are a
Latin hypercube, which `plan` makes of all points at once, and uniform random points. The model is a Gaussian process; errors are relative RMSEs at 5,000
other points, relative to the standard deviation there: medians over the seeds, and the largest.

Usage: python3 scripts/measure plans [--points 30,60] [--seeds 3] [FUNCTION...]
"""

import argparse
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from common import METAFMU
from functions import FUNCTIONS, TEST_POINTS



def run(folder, *arguments):
    done = subprocess.run([METAFMU, *arguments], cwd=folder, capture_output=True, text=True)
    # a map of few points may be rejected, and is measured as well
    if done.returncode not in (0, 1):
        raise SystemExit(f"error: metafmu {' '.join(arguments)}: {done.stderr}")
    return done.stdout


def study(folder, columns, seed):
    inputs = "".join(f"x{column} = {{ min = 0, max = 1 }}\n" for column in range(columns))
    text = f'name = "s"\nstructure = "static"\nseed = {seed}\n[source]\ntable = "points.csv"\n[inputs]\n{inputs}[outputs]\ny = {{}}\n'
    (folder / "s.toml").write_text(text + '[static]\nmodel = "gaussian-process"\n')


def planned(folder, points):
    lines = run(folder, "plan", "s.toml", "--points", str(points)).splitlines()[1:]
    return np.array([[float(cell) for cell in line.split(",")[:-1]] for line in lines])


def write(folder, name, x, y):
    header = ",".join([*(f"x{column}" for column in range(x.shape[1])), "y"])
    rows = [",".join(map(repr, map(float, row))) for row in np.column_stack([x, y])]
    (folder / name).write_text("\n".join([header, *rows]) + "\n")


def adaptive(folder, of, points):
    x = planned(folder, max(2, points // 3))
    while len(x) < points:
        write(folder, "points.csv", x, of(x))
        x = np.vstack([x, planned(folder, min(max(1, points // 10), points - len(x)))])
    return x


def random(folder, seed, points, columns):
    return np.random.default_rng(seed).random((points, columns))


def error(folder, of, x, columns):
    unseen = np.random.default_rng(99).random((TEST_POINTS, columns))
    truth = of(unseen)
    write(folder, "points.csv", x, of(x))
    write(folder, "unseen.csv", unseen, truth)
    run(folder, "train", "s.toml")
    lines = run(folder, "predict", "s.toml", "unseen.csv").splitlines()
    found = np.array([float(line.split(",")[0]) for line in lines[1:]])
    return np.sqrt(np.mean((found - truth) ** 2)) / truth.std()


def measured(function, points, seed):
    """Errors of adaptive points, of a Latin hypercube, and of random points."""
    of, columns = FUNCTIONS[function]
    made = [adaptive, lambda folder, of, points: planned(folder, points), lambda folder, of, points: random(folder, seed, points, columns)]
    errors = []
    for make in made:
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            study(folder, columns, seed)
            errors.append(error(folder, of, make(folder, of, points), columns))
    return errors


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("function", nargs="*", metavar="FUNCTION", help=f"of {', '.join(FUNCTIONS)}; branin and borehole unless given")
    parser.add_argument("--points", default="30,60", help="numbers of points, separated by commas")
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    print("| function | points | adaptive | one Latin hypercube by `plan` | uniform random |\n|---|---|---|---|---|")
    for function in options.function or ["branin", "borehole"]:
        for points in map(int, options.points.split(",")):
            errors = np.array([measured(function, points, seed) for seed in range(1, options.seeds + 1)])
            cells = [f"{median:.1e} ({worst:.1e})" for median, worst in zip(np.median(errors, axis=0), errors.max(axis=0))]
            of = f"{function.capitalize() if function == 'branin' else function}, {FUNCTIONS[function][1]} inputs"
            print(f"| {of} | {points} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
