#!/usr/bin/env python3
"""Compares the recipe of the examples and of `metafmu new` with the one before it, on every kind of source.

    cargo build --release --locked && cargo build --release --locked --example step_time
    .venv/bin/python scripts/compare-recipes.py [--seeds 3] [--only NAME ...] [--out out/recipes]

Before: two hidden layers (of the double pendulum four), a cosine from 3e-3 over fixed epochs, runs inside the ranges up to the stop time.
Now: the studies as they are. Both are measured on 2,000 unseen random runs of the source. A job has one thread; two run side by side. Processor
seconds are those of `sample` and `train`. Then the recipe of now gets a half, a quarter and an eighth of its runs.

Prints the tables of docs/training.md; figures.json in the folder of results keeps every figure, and a job that is in there
is not run again.
"""

import argparse
import json
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
METAFMU = ROOT / "target" / "release" / "metafmu"
STEP_TIME = ROOT / "target" / "release" / "examples" / "step_time"
TEST_RUNS = 2000
SHARES = [0.5, 0.25, 0.125]
SEEDS = [1, 2, 3]
MECHANISMS = ROOT / "examples" / "mechanisms"
# hidden layers, epochs and, where it was another one, the number of runs before
SYSTEMS = {
    "single-pendulum": ([128, 128], 150, 1331),
    "double-pendulum": ([64] * 4, 16, 4096),
    "slider-crank": ([128, 128], 60, 1331),
}
OF_MECHANISMS = {
    "single-pendulum": ([128, 128], 100),
    "double-pendulum": ([128, 128], 100),
    "slider-crank": ([64, 64], 100),
    "four-bar": ([64, 64], 200),
    "quarter-car": ([128, 128], 100),
    "scotch-yoke": ([128, 128], 100),
}
OTHERS = ([128, 128], 150)


def run(*command, cwd=None):
    """Runs a command on one thread; its output and its processor seconds."""
    environment = {**os.environ, "RAYON_NUM_THREADS": "1"}
    command = [str(part) for part in command]
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        process = subprocess.Popen(command, cwd=cwd, env=environment, stdout=out, stderr=err)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        texts = []
        for file in (out, err):
            file.seek(0)
            texts.append(file.read())
    # 1: the surrogate is rejected, which is a figure like any other
    if process.returncode not in (0, 1):
        sys.exit(f"{command}: {texts[1]}")
    return texts[0], usage.ru_utime + usage.ru_stime


def with_key(text, key, value):
    """The study with another value of a key, which it must have once."""
    text, count = re.subn(rf"(?m)^{key} = [^#\n]*", f"{key} = {value} ", text)
    assert count == 1, (key, count)
    return text


def without(text, *keys):
    for key in keys:
        text = re.sub(rf"(?m)^{key} = .*\n", "", text)
    return text


def made(study, **others):
    """The text of a study for these jobs: no bounds, no baselines, any accuracy."""
    text = re.sub(r"(?m)^\[bounds\][^\[]*", "", study)
    text += "\n[accept]\nr2 = -inf\nbaseline_factor = inf\nangle_error = inf\n[baselines]\nbuild = []\n"
    for key, value in others.items():
        text = with_key(text, key, value)
    return text


def before(text, hidden, epochs, runs=None):
    """The same by the recipe before."""
    text = without(text, "margin", "faces", "enough")
    text = with_key(with_key(text, "hidden", hidden), "epochs", epochs)
    text = with_key(with_key(text, "learning_rate", 0.003), "schedule", '"cosine"')
    return with_key(text, "runs", runs) if runs else text


def sources(folder):
    """Name of each source, its study, and hidden layers, epochs and runs before."""
    found = {}
    for name, recipe in SYSTEMS.items():
        found[name] = (made((ROOT / "examples" / f"{name}.toml").read_text(), test_runs=TEST_RUNS), recipe)
    for name, recipe in OF_MECHANISMS.items():
        text = (MECHANISMS / f"{name}-study.toml").read_text()
        text = with_key(text, "mechanism", f'"{MECHANISMS / name}.toml"')
        found[f"mechanism {name}"] = (made(text, test_runs=TEST_RUNS), recipe)
    found["FMU van-der-pol"] = (fmu_study(folder), OTHERS)
    found["table four-bar"] = (table_study(folder), OTHERS)
    return found


def fmu_study(folder):
    sys.path.insert(0, str(ROOT / "examples" / "fmu-source"))
    import make_fmus

    fmu = folder / "van_der_pol.fmu"
    make_fmus.build_c(ROOT / "examples" / "fmu-source" / "van-der-pol" / "van_der_pol.c", fmu)
    study = folder / "fmu.toml"
    study.unlink(missing_ok=True)
    run(METAFMU, "new", "fmu", "--fmu", fmu, cwd=folder)
    return made(study.read_text(), test_runs=TEST_RUNS)


def table_study(folder):
    """500 runs for training and 2,000 to be measured on, recorded at random points."""
    text = made((MECHANISMS / "four-bar-study.toml").read_text(), test_runs=1, runs=500 + TEST_RUNS, method='"random"')
    text = with_key(without(text, "margin", "faces"), "mechanism", f'"{MECHANISMS}/four-bar.toml"')
    (folder / "recorded.toml").write_text(text)
    run(METAFMU, "sample", folder / "recorded.toml", "--out", folder / "recorded")
    study = folder / "table.toml"
    study.unlink(missing_ok=True)
    run(METAFMU, "new", "table", "--table", folder / "recorded" / "train.csv", cwd=folder)
    return made(study.read_text(), test_runs=TEST_RUNS)


def measure(folder, text):
    """Figures of one study."""
    folder.mkdir(parents=True, exist_ok=True)
    study, out = folder / "study.toml", folder / "out"
    study.write_text(text)
    shutil.rmtree(out, ignore_errors=True)
    _, sampling = run(METAFMU, "sample", study, "--out", out)
    _, training = run(METAFMU, "train", study, "--out", out)
    run(METAFMU, "evaluate", study, "--out", out)
    run(METAFMU, "export", study, "--out", out)
    metrics = json.loads((out / "metrics.json").read_text())
    outputs = metrics["outputs"]
    (fmu,) = out.glob("*.fmu")
    stop, step = (float(re.search(rf"(?m)^{key} = ([^ #]+)", text)[1]) for key in ("stop", "step"))
    step_time = run(STEP_TIME, fmu, stop, step, *outputs)[0].split()[0]
    figures = {
        "unexplained": max(1 - output["r2"] for output in outputs.values()),
        "largest": max(output["relative_max_error"] for output in outputs.values()),
        "seconds": sampling + training,
        "epochs": metrics["epochs"],
        "step": float(step_time),
        "size": fmu.stat().st_size,
        "runs": metrics["train_runs"],
    }
    # of the double pendulum there are gigabytes
    shutil.rmtree(folder)
    return figures


def fewer(text, share):
    """The study with a share of its runs; of a table, whose runs are there already, more are left out."""
    runs = re.search(r"(?m)^runs = (\d+)", text)
    if runs:
        return with_key(text, "runs", round(share * int(runs[1])))
    return with_key(text, "test_runs", TEST_RUNS + round((1 - share) * 500))


def jobs(studies, seeds):
    """Each with its key; those that take longest first."""
    order = sorted(studies, key=lambda name: name != "double-pendulum")
    for name in order:
        study, recipe = studies[name]
        for seed in seeds:
            text = with_key(study, "seed", seed)
            yield f"{name}, now, {seed}", text
            yield f"{name}, before, {seed}", before(text, *recipe)
        for share in SHARES:
            yield f"{name}, {share} of the runs, {seeds[0]}", fewer(with_key(study, "seed", seeds[0]), share)


def three(values, form):
    return ", ".join(form(value) for value in values)


def table(names, figures, seeds):
    print("| source | recipe | largest 1 - R² | largest error, of the range | CPU s | step, µs | FMU, kB |")
    print("|---|---|---|---|---|---|---|")
    for name in names:
        for recipe in ("before", "now"):
            rows = [figures[f"{name}, {recipe}, {seed}"] for seed in seeds]
            column = lambda key, form: three([row[key] for row in rows], form)
            cells = [
                column("unexplained", lambda value: f"{value:.1e}"),
                column("largest", lambda value: f"{100 * value:.2g} %"),
                column("seconds", lambda value: f"{value:.0f}"),
                f"{min(row['step'] for row in rows):.2f}",
                f"{rows[0]['size'] / 1e3:.0f}",
            ]
            print(f"| {name if recipe == 'before' else ''} | {recipe} | {' | '.join(cells)} |")


def table_of_runs(names, figures, seed):
    print("\n| source | before | now | a half of the runs | a quarter | an eighth |")
    print("|---|---|---|---|---|---|")
    for name in names:
        keys = ["before", "now", *(f"{share} of the runs" for share in SHARES)]
        rows = [figures[f"{name}, {key}, {seed}"] for key in keys]
        cells = [f"{row['unexplained']:.1e}, {row['runs']} runs" for row in rows]
        print(f"| {name} | {' | '.join(cells)} |")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--only", nargs="+", help="sources")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "recipes")
    arguments = parser.parse_args()
    folder = arguments.out.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "figures.json"
    figures = json.loads(file.read_text()) if file.exists() else {}
    seeds = SEEDS[: arguments.seeds]
    studies = sources(folder)
    if arguments.only:
        studies = {name: studies[name] for name in arguments.only}
    waiting = [(key, text) for key, text in jobs(studies, seeds) if key not in figures]

    def job(key, text):
        figures[key] = measure(folder / re.sub(r"[ ,.]+", "-", key), text)
        file.write_text(json.dumps(figures, indent=1))
        print(key, json.dumps(figures[key]), file=sys.stderr, flush=True)

    with ThreadPoolExecutor(2) as pool:
        for done in [pool.submit(job, *item) for item in waiting]:
            done.result()
    table(studies, figures, seeds)
    table_of_runs(studies, figures, seeds[0])


if __name__ == "__main__":
    main()
