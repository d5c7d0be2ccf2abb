"""Measures the way from a table to an FMU on functions of the literature, beside SMT's kriging and scikit-learn's network.

For each seed a table of a Latin hypercube becomes an FMU by `metafmu new` and `metafmu build`. `metafmu predict` evaluates the FMU at 5,000
other points. Errors are RMSEs relative to the standard deviation there; the table has medians over the seeds, and processor seconds.

`FMU` is the model that the study chooses, `network` an FMU of a study with model = "network", and `kriging` SMT's KRG. `MLP` is
scikit-learn's MLPRegressor with L-BFGS on standardized columns, the best of three sizes by cross-validation. Each result is added to the
file of --results, and results in this file are not measured again. scripts/venv.sh --peers installs the other programs.

Usage: .peers/bin/python scripts/measure functions --results FILE.json [--method FMU,network,kriging,MLP] [--rows 50,200] [--seeds 3] [FUNCTION...]
"""

import argparse
import json
import os
import resource
import subprocess
import tempfile
import time
from pathlib import Path

for variable in ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS"]:
    os.environ[variable] = "1"

import numpy as np
from common import METAFMU

METHODS = ["FMU", "network", "kriging", "MLP"]
TEST_POINTS = 5000


def scaled(u, ranges):
    """Columns in their ranges."""
    low, high = np.array(ranges, dtype=float).T
    return (low + u * (high - low)).T


def branin(u):
    x, y = scaled(u, [(-5, 10), (0, 15)])
    return (y - 5.1 / (4 * np.pi**2) * x**2 + 5 / np.pi * x - 6) ** 2 + 10 * (1 - 1 / (8 * np.pi)) * np.cos(x) + 10


def borehole(u):
    ranges = [(0.05, 0.15), (100, 50000), (63070, 115600), (990, 1110), (63.1, 116), (700, 820), (1120, 1680), (9855, 12045)]
    well, influence, upper, upper_head, lower, lower_head, length, conductivity = scaled(u, ranges)
    logarithm = np.log(influence / well)
    flow = 2 * np.pi * upper * (upper_head - lower_head)
    return flow / (logarithm * (1 + 2 * length * upper / (logarithm * well**2 * conductivity) + upper / lower))


def otl(u):
    """Mid-point voltage of an output transformerless push-pull circuit."""
    b1, b2, f, c1, c2, beta = scaled(u, [(50, 150), (25, 70), (0.5, 3), (1.2, 2.5), (0.25, 1.2), (50, 300)])
    voltage, gain = 12 * b2 / (b1 + b2), beta * (c2 + 9)
    return (voltage + 0.74) * gain / (gain + f) + 11.35 * f / (gain + f) + 0.74 * f * gain / ((gain + f) * c1)


def wing_weight(u):
    ranges = [(150, 200), (220, 300), (6, 10), (-10, 10), (16, 45), (0.5, 1), (0.08, 0.18), (2.5, 6), (1700, 2500), (0.025, 0.08)]
    area, fuel, aspect, sweep, pressure, taper, thickness, load, weight, paint = scaled(u, ranges)
    cosine = np.cos(np.deg2rad(sweep))
    of_wing = 0.036 * area**0.758 * fuel**0.0035 * (aspect / cosine**2) ** 0.6 * pressure**0.006 * taper**0.04
    return of_wing * (100 * thickness / cosine) ** -0.3 * (load * weight) ** 0.49 + area * paint


def robot_arm(u):
    """Distance of the hand of an arm with four segments."""
    angles, lengths = np.cumsum(2 * np.pi * u[:, :4], axis=1), u[:, 4:]
    return np.hypot((lengths * np.cos(angles)).sum(axis=1), (lengths * np.sin(angles)).sum(axis=1))


def torsion(u):
    """Lowest frequency of two disks on three shafts."""
    # of each shaft: diameter, length, shear modulus; of each disk: diameter, thickness, density
    shafts = [(1.8, 2.2), (9, 11), (1.053e7, 1.287e7), (1.6425, 2.0075), (10.8, 13.2), (5.58e6, 6.82e6), (2.025, 2.475), (7.2, 8.8), (3.51e6, 4.29e6)]
    disks = [(10.8, 13.2), (2.7, 3.3), (0.252, 0.308), (12.6, 15.4), (3.6, 4.4), (0.09, 0.11)]
    columns = scaled(u, shafts + disks)
    stiffness = [np.pi * modulus * diameter / (32 * length) for diameter, length, modulus in (columns[:3], columns[3:6], columns[6:9])]
    inertia = [density * np.pi * thickness * diameter / (4 * 9.80665) * diameter**2 / 8 for diameter, thickness, density in (columns[9:12], columns[12:])]
    sum_of = (stiffness[0] + stiffness[1]) / inertia[0] + (stiffness[1] + stiffness[2]) / inertia[1]
    product = (stiffness[0] * stiffness[1] + stiffness[1] * stiffness[2] + stiffness[2] * stiffness[0]) / (inertia[0] * inertia[1])
    return np.sqrt((sum_of - np.sqrt(sum_of**2 - 4 * product)) / 2) / (2 * np.pi)


FUNCTIONS = {"branin": (branin, 2), "borehole": (borehole, 8), "otl": (otl, 6), "wing-weight": (wing_weight, 10), "robot-arm": (robot_arm, 8), "torsion": (torsion, 15)}
LABELS = {"branin": "Branin", "borehole": "borehole", "otl": "OTL circuit", "wing-weight": "wing weight", "robot-arm": "robot arm", "torsion": "torsion"}


def kriging(x, y):
    from smt.surrogate_models import KRG

    model = KRG(print_global=False)
    model.set_training_values(x, y)
    model.train()
    return lambda x: model.predict_values(x)[:, 0]


def perceptron(x, y):
    from sklearn.compose import TransformedTargetRegressor
    from sklearn.model_selection import cross_val_score
    from sklearn.neural_network import MLPRegressor
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    def of_size(hidden):
        network = make_pipeline(StandardScaler(), MLPRegressor(hidden_layer_sizes=hidden, solver="lbfgs", max_iter=5000, random_state=0))
        return TransformedTargetRegressor(network, transformer=StandardScaler())

    best = max([(8, 8), (32, 32), (64, 64)], key=lambda hidden: cross_val_score(of_size(hidden), x, y, cv=5).mean())
    return of_size(best).fit(x, y).predict


def points(function, rows, seed):
    """A Latin hypercube to fit to, and other points."""
    from scipy.stats import qmc

    columns = FUNCTIONS[function][1]
    return qmc.LatinHypercube(columns, rng=seed).random(rows), np.random.default_rng(99).random((TEST_POINTS, columns))


def write(path, columns, names):
    rows = [",".join(map(repr, map(float, row))) for row in columns]
    path.write_text("\n".join([",".join(names), *rows]) + "\n")


def run(folder, *arguments):
    done = subprocess.run([METAFMU, *arguments], cwd=folder, capture_output=True, text=True)
    # a map of few points may be rejected, and is measured as well
    if done.returncode not in (0, 1):
        raise SystemExit(f"error: metafmu {' '.join(arguments)}: {done.stderr}")
    return done.stdout


def of_fmu(method, x, y, unseen):
    """Predictions by an FMU of the rows, processor seconds, and its kind of model."""
    names = [f"x{column}" for column in range(x.shape[1])]
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        write(folder / "points.csv", np.column_stack([x, y]), [*names, "y"])
        write(folder / "unseen.csv", unseen, names)
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        run(folder, "new", "s", "--table", "points.csv")
        if method == "network":
            study = folder / "s.toml"
            study.write_text(study.read_text().replace("# model =", "model ="))
        run(folder, "build", "s.toml")
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        lines = run(folder, "predict", "out/s/s.fmu", "unseen.csv").splitlines()
        training = json.loads((folder / "out" / "s" / "training.json").read_text())
    found = np.array([float(line.split(",")[0]) for line in lines[1:]])
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return found, seconds, training["static_map"]["exported"]


def measured(method, function, rows, seed):
    of = FUNCTIONS[function][0]
    x, unseen = points(function, rows, seed)
    truth = of(unseen)
    if method in ("FMU", "network"):
        found, seconds, model = of_fmu(method, x, of(x), unseen)
    else:
        begin = time.process_time()
        predict = {"kriging": kriging, "MLP": perceptron}[method](x, of(x))
        found, seconds, model = predict(unseen), time.process_time() - begin, method
    return {"error": float(np.sqrt(np.mean((found - truth) ** 2)) / truth.std()), "seconds": seconds, "model": model}


def table(results):
    """Medians of all results."""
    print("| function | points | FMU | exported | FMU of a network | SMT's kriging | MLPRegressor | FMU of kriging |")
    print("|---" * 8 + "|")
    kinds = {}
    for key, result in results.items():
        function, rows, method, _ = key.split(" ")
        kinds.setdefault((function, int(rows)), {}).setdefault(method, []).append(result)
    ratios = []
    for (function, rows), found in sorted(kinds.items(), key=lambda item: (list(FUNCTIONS).index(item[0][0]), item[0][1])):
        median = lambda method, of: float(np.median([result[of] for result in found[method]])) if method in found else float("nan")
        cells = [f"{median(method, 'error'):.1e}, {median(method, 'seconds'):.2g} s" if method in found else "-" for method in METHODS]
        ratio = median("FMU", "error") / median("kriging", "error")
        ratios += [ratio] if np.isfinite(ratio) else []
        exported = ", ".join(sorted({str(result["model"]) for result in found.get("FMU", [])}))
        print(f"| {LABELS[function]}, {FUNCTIONS[function][1]} inputs | {rows} | {cells[0]} | {exported} | {' | '.join(cells[1:])} | {ratio:.2f} |")
    if ratios:
        print(f"\nRatios to kriging: median {np.median(ratios):.2f}, largest {max(ratios):.2f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("function", nargs="*", metavar="FUNCTION", help=f"of {', '.join(FUNCTIONS)}; all unless given")
    parser.add_argument("--results", type=Path, required=True, help="file of all results")
    parser.add_argument("--method", default=",".join(METHODS), help="methods separated by commas; all unless given; empty: only print the table")
    parser.add_argument("--rows", default="50,200", help="numbers of points, separated by commas")
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    results = json.loads(options.results.read_text()) if options.results.exists() else {}
    for rows in map(int, options.rows.split(",")):
        for function in options.function or FUNCTIONS:
            for method in filter(None, options.method.split(",")):
                for seed in range(options.seeds):
                    key = f"{function} {rows} {method} {seed}"
                    if key not in results:
                        results[key] = measured(method, function, rows, seed)
                        options.results.write_text(json.dumps(results, indent=1))
    table(results)


if __name__ == "__main__":
    main()
