"""Compares models of tables with SMT's kriging and scikit-learn's network: metafmu.fit on functions of the literature.

Points are Latin hypercubes in the unit cube, one a seed; errors are relative RMSEs at 5,000 other points, relative to the standard deviation there.
The table has medians over the seeds: of `metafmu.fit` with its default, which chooses the kind of model, of a network by it, of SMT's kriging (KRG), and
of scikit-learn's MLPRegressor with L-BFGS on standardized columns, the best of three sizes by cross-validation; and processor seconds of each, on one thread. Needs the Python package, and

    pip install smt==2.15.0 scikit-learn==1.9.1 scipy

Usage: python3 scripts/measure fits [--rows 50,200,500] [--seeds 3] [FUNCTION...]
"""

import argparse
import os
import time

for variable in ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS"]:
    os.environ[variable] = "1"

import numpy as np

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


def kriging(x, y):
    from smt.surrogate_models import KRG

    model = KRG(print_global=False)
    model.set_training_values(x, y)
    model.train()
    return lambda x: model.predict_values(x)[:, 0]


def perceptron(x, y):
    from sklearn.compose import TransformedTargetRegressor
    from sklearn.neural_network import MLPRegressor
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    from sklearn.model_selection import cross_val_score

    def of_size(hidden):
        network = make_pipeline(StandardScaler(), MLPRegressor(hidden, solver="lbfgs", max_iter=5000, random_state=0))
        return TransformedTargetRegressor(network, transformer=StandardScaler())

    best = max([(8, 8), (32, 32), (64, 64)], key=lambda hidden: cross_val_score(of_size(hidden), x, y, cv=5).mean())
    return of_size(best).fit(x, y).predict


def ours(model):
    def fit(x, y):
        import metafmu

        surrogate = metafmu.fit(x, y, model=model)
        predict = lambda x: np.ravel(surrogate.predict(x))
        predict.model = surrogate.model
        return predict

    return fit


METHODS = {"metafmu.fit": ours(None), "its network": ours("network"), "SMT kriging": kriging, "scikit-learn MLP": perceptron}


def points(function, rows, seed):
    """A Latin hypercube to fit to, and other points."""
    from scipy.stats import qmc

    columns = FUNCTIONS[function][1]
    return qmc.LatinHypercube(columns, rng=seed).random(rows), np.random.default_rng(99).random((TEST_POINTS, columns))


def measured(fit, function, rows, seed):
    """Relative RMSE, processor seconds, and the kind of model that was chosen."""
    of = FUNCTIONS[function][0]
    x, unseen = points(function, rows, seed)
    begin = time.process_time()
    predict = fit(x, of(x))
    seconds = time.process_time() - begin
    truth = of(unseen)
    return np.sqrt(np.mean((predict(unseen) - truth) ** 2)) / truth.std(), seconds, getattr(predict, "model", "")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("function", nargs="*", metavar="FUNCTION", help=f"of {', '.join(FUNCTIONS)}; all unless given")
    parser.add_argument("--rows", default="50,200,500", help="numbers of points, separated by commas")
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    if unknown := [name for name in options.function if name not in FUNCTIONS]:
        parser.error(f"{unknown[0]} is not known, expected some of {', '.join(FUNCTIONS)}")
    print(f"| function | points | {' | '.join(METHODS)} | chosen | of kriging |")
    print("|---" * (len(METHODS) + 4) + "|")
    for function in options.function or FUNCTIONS:
        for rows in map(int, options.rows.split(",")):
            found = {name: [measured(fit, function, rows, seed) for seed in range(options.seeds)] for name, fit in METHODS.items()}
            median = lambda name, place: np.median([result[place] for result in found[name]])
            cells = [f"{median(name, 0):.1e}, {median(name, 1):.2g} s" for name in METHODS]
            chosen = " ".join(sorted({result[2] for result in found["metafmu.fit"]}))
            ratio = median("metafmu.fit", 0) / median("SMT kriging", 0)
            print(f"| {function} | {rows} | {' | '.join(cells)} | {chosen} | {ratio:.2f} |", flush=True)


if __name__ == "__main__":
    main()
