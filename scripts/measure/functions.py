"""Measures the way from a table to an FMU on functions of the literature, beside SMT's kriging and scikit-learn's network.

For each seed a table of a Latin hypercube becomes an FMU by `metafmu new` and `metafmu build`, and `metafmu predict` evaluates the FMU at 5,000 other points.
Errors are relative RMSEs, relative to the standard deviation there; the table has medians over the seeds, and processor seconds of all threads. `FMU` is what
the study chooses, `network` an FMU of a study with model = "network". Each result is added to the file of --results, and what is there is not measured again: methods may
need different Python environments,

    pip install smt==2.15.0 scikit-learn==1.9.1 scipy

Usage: python3 scripts/measure functions --results FILE.json [--method FMU,network,kriging,MLP] [--rows 50,200,500] [--seeds 3] [FUNCTION...]
"""

import argparse
import json
import resource
import subprocess
import tempfile
import time
from pathlib import Path

import fits
import numpy as np
from common import METAFMU
from fits import FUNCTIONS

METHODS = ["FMU", "network", "kriging", "MLP"]


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
    x, unseen = fits.points(function, rows, seed)
    truth = of(unseen)
    if method in ("FMU", "network"):
        found, seconds, model = of_fmu(method, x, of(x), unseen)
    else:
        begin = time.process_time()
        predict = {"kriging": fits.kriging, "MLP": fits.perceptron}[method](x, of(x))
        found, seconds, model = predict(unseen), time.process_time() - begin, method
    return {"error": float(np.sqrt(np.mean((found - truth) ** 2)) / truth.std()), "seconds": seconds, "model": model}


def table(results):
    """Medians of all results."""
    print(f"| function | points | {' | '.join(METHODS)} | exported | FMU of kriging |")
    print("|---" * (len(METHODS) + 4) + "|")
    kinds = {}
    for key, result in results.items():
        function, rows, method, _ = key.split(" ")
        kinds.setdefault((function, int(rows)), {}).setdefault(method, []).append(result)
    ratios = []
    for (function, rows), found in sorted(kinds.items(), key=lambda item: (list(FUNCTIONS).index(item[0][0]), item[0][1])):
        median = lambda method, of: float(np.median([result[of] for result in found[method]])) if method in found else float("nan")
        cells = [f"{median(method, 'error'):.1e}, {median(method, 'seconds'):.2g} s" if method in found else "" for method in METHODS]
        ratio = median("FMU", "error") / median("kriging", "error")
        ratios += [ratio] if np.isfinite(ratio) else []
        exported = " ".join(sorted({str(result["model"]) for result in found.get("FMU", [])}))
        print(f"| {function} | {rows} | {' | '.join(cells)} | {exported} | {ratio:.2f} |")
    if ratios:
        print(f"\nRatios to kriging: median {np.median(ratios):.2f}, largest {max(ratios):.2f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("function", nargs="*", metavar="FUNCTION", help=f"of {', '.join(FUNCTIONS)}; all unless given")
    parser.add_argument("--results", type=Path, required=True, help="file of all results")
    parser.add_argument("--method", default="FMU,network", help=f"of {', '.join(METHODS)}, separated by commas; empty: only print the table")
    parser.add_argument("--rows", default="50,200,500", help="numbers of points, separated by commas")
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
