"""Repeats the tables, figures and claims of Choi et al. 2021: docs/paper.md with its pictures.

    .venv/bin/python scripts/measure paper                     # 20 minutes on two idle cores
    .venv/bin/python scripts/measure paper --full              # also what takes hours
    .venv/bin/python scripts/measure paper --only samples      # parts of it; the rest of the page stays

scripts/measure/paper.toml lists what the paper has. The values of each part are kept in docs/paper/results.json with their commit and date, from
which the page is written: a part that was never measured has none. Trainings that were stopped continue. Needs target/release/metafmu.
"""

import argparse
import datetime
import json
import os
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import paper_models as models
import paper_page as page
import paper_pictures as pictures
from common import ROOT
from paper_models import CASES, Model, Runs, default, recipe, trained
from paper_pictures import Shown

sys.path.append(str(ROOT / "scripts"))
from figures import commit, replace

# `theta`, `thetad` of the paper's table of S_full at t = 0, 0.01, 0.02, printed for L = 0.0, 0.1, 0.2 and c = 0, 0.05, 0.1
PRINTED_FULL = [
    [(1.57080, 0.00000), (1.56589, -0.98100), (1.55118, -1.96192)],
    [(1.57080, 0.00000), (1.56590, -0.97936), (1.55122, -1.95540)],
    [(1.57080, 0.00000), (1.56590, -0.97773), (1.55126, -1.94890)],
]
# the same of its table of S_fixed
PRINTED_FIXED = [
    [(1.57080, 0.00000), (1.56589, -0.98100), (1.55118, -1.96192)],
    [(1.57080, 0.00000), (1.57080, 0.00000), (1.55122, -1.95540)],
    [(1.57080, 0.00000), (1.56590, -0.97773), (1.55126, -1.94890)],
]
# parameters with which these rows were computed
PRINTED_CASES = [(0.1, 0.00, 0.0), (0.1, 0.01, 0.0), (0.1, 0.02, 0.0)]


NAMES = ["theta", "thetad", "thetadd"]


class Bench:
    """Folders of the trainings and of the page."""

    def __init__(self, out, docs):
        self.out, self.docs = out.resolve(), docs.resolve()
        self.results = self.docs / "paper" / "results.json"

    def known(self):
        return json.loads(self.results.read_text(encoding="utf-8")) if self.results.exists() else {}

    def draw(self, name, svg):
        (self.docs / "paper" / f"{name}.svg").write_text(svg, encoding="utf-8", newline="\n")

    def model(self, name, text):
        trained(self.out / name, text)
        return Model(self.out / name)


def measured(model, test, cases):
    """Figures of a model on unseen runs and on the named cases."""
    predicted, of_cases = model.predict(test), model.predict(cases)
    halves = [slice(0, len(test.times) // 5), slice(-(len(test.times) // 5), None)]
    early, late = (models.size_of_second_differences(predicted[:, part] - test.outputs[:, part]) for part in halves)
    return {
        "r2": models.r2(predicted, test.outputs).tolist(),
        "mse": models.mse(predicted, test.outputs).tolist(),
        "roughness": models.roughness(predicted, test.outputs).tolist(),
        "late": (late / early).tolist(),
        "cases_mse": ((of_cases - cases.outputs) ** 2).mean(1).tolist(),
    }


def every(runs, step):
    """Runs at every so-manieth time."""
    return Runs(runs.parameters, runs.times[::step], runs.outputs[:, ::step])


def samples(bench):
    """Tables of the paper that describe its data."""
    cases = models.cases_of(bench.out / "samples", "single-pendulum", PRINTED_CASES)
    found = cases.outputs[:, :3, :2]
    off = lambda printed: np.abs(np.array(printed) - found).max(2)
    values = {
        "table-1": float(off(PRINTED_FULL).max()),
        "table-2": int((off(PRINTED_FIXED) < 5.1e-6).sum()),
        "rows": {},
    }
    for system in CASES:
        study = bench.out / f"{system}.toml"
        study.write_text(recipe(system), encoding="utf-8")
        runs = models.output("sample", study, "--dry-run").count("\ntrain,")
        times = models.times_of(recipe(system))
        values["rows"][system] = {"runs": runs, "times": times, "rows": runs * times}
    bench.draw("systems", pictures.systems())
    return values


def tests_of(folder, system):
    return models.runs_of(folder / "test.csv", recipe(system))


def single_pendulum(bench):
    system, outputs = "single-pendulum", {"`theta`, rad": 0, "`thetad`, rad/s": 1, "`thetadd`, rad/s²": 2}
    full = bench.model(f"{system}-full", recipe(system))
    fixed = bench.model(f"{system}-fixed", models.at_time_points(recipe(system)))
    ours = bench.model(f"{system}-default", default(system))
    test, cases = tests_of(full.folder, system), models.cases_of(bench.out / f"{system}-cases", system, CASES[system])
    values = {name: measured(model, test, cases) for name, model in (("full", full), ("fixed", fixed), ("default", ours))}
    values["step_us"] = {"full": models.step_time(full, NAMES), "default": models.step_time(ours, NAMES)}
    columns = {"S_fixed": Shown(cases, fixed.predict(cases)), "S_full": Shown(cases, full.predict(cases))}
    bench.draw("single-scatter", scatter("Pendulum", full, test, outputs, values["full"]["r2"]))
    bench.draw("single-case", pictures.in_time("Pendulum, one case: S_fixed and S_full", columns, outputs, [0]))
    bench.draw("single-cases", pictures.in_time("Pendulum, four cases: S_fixed and S_full", columns, outputs, [1, 2, 3, 4]))
    return values


def scatter(name, model, test, outputs, r2):
    title = f"{name}: predictions over labels of unseen rows"
    return pictures.scatter(title, model.predict(test), test.outputs, list(outputs), [page.score(value) for value in r2])


SLIDER = ["`theta`, rad", "`phi`, rad", "`phid`, rad/s", "`phidd`, rad/s²", "`xB`, m", "`xBd`, m/s", "`xBdd`, m/s²"]


def of_slider(bench, fixed):
    """S_full by the paper's recipe, the unseen runs, the cases, and figures of it, of our default and of S_fixed if there is one."""
    system = "slider-crank"
    full, ours = bench.model(f"{system}-full", recipe(system)), bench.model(f"{system}-default", default(system))
    test, cases = tests_of(full.folder, system), models.cases_of(bench.out / f"{system}-cases", system, CASES[system])
    return full, test, cases, {name: measured(model, test, cases) for name, model in {"full": full, "default": ours, **fixed}.items()}


def slider_crank(bench):
    full, test, _, values = of_slider(bench, {})
    bench.draw("slider-scatter", scatter("Slider crank", full, test, SLIDER, values["full"]["r2"]))
    return values


def slider_crank_fixed(bench):
    fixed = bench.model("slider-crank-fixed", models.at_time_points(recipe("slider-crank")))
    full, _, cases, values = of_slider(bench, {"fixed": fixed})
    columns = {"S_fixed": Shown(cases, fixed.predict(cases)), "S_full": Shown(cases, full.predict(cases))}
    slider = {SLIDER[number]: number for number in (4, 5, 6)}
    bench.draw("slider-case", pictures.in_time("Slider crank, one case in time: S_fixed and S_full", columns, slider, [0]))
    rod = {"`phid` over `phi`": (1, 2), "`phidd` over `phi`": (1, 3)}
    bench.draw("slider-rod", pictures.phases("Slider crank: derivatives of phi over phi", columns, rod, 0))
    positions = {"`xBd` over `xB`": (4, 5), "`xBdd` over `xB`": (4, 6)}
    bench.draw("slider-slider", pictures.phases("Slider crank: derivatives of xB over xB", columns, positions, 0))
    return values


def double_pendulum(bench, is_full=False):
    system, step = "double-pendulum", 1 if is_full else round(models.LONG_STEP / 0.01)
    outputs = {"`theta1`, rad": 0, "`theta2`, rad": 1, "`theta1d`, rad/s": 2, "`theta2d`, rad/s": 3}
    name = f"{system}-all" if is_full else system
    full = bench.model(f"{name}-full", recipe(system) if is_full else recipe(system, epochs=models.FEW_EPOCHS))
    fixed = bench.model(f"{name}-fixed", models.at_time_points(recipe(system) if is_full else recipe(system, step=models.LONG_STEP)))
    ours = bench.model(f"{system}-default", default(system))
    test, cases = tests_of(full.folder, system), models.cases_of(bench.out / f"{system}-cases", system, CASES[system])
    values = {kind: measured(model, test, cases) for kind, model in (("full", full), ("default", ours))}
    coarse = every(test, step), every(cases, step)
    values["fixed"] = measured(fixed, *coarse)
    # at the same times as S_fixed
    for kind, model in (("full", full), ("default", ours)):
        values[kind] |= {key: measured(model, *coarse)[key] for key in ("roughness", "late")}
    if is_full or "double-pendulum-full" not in bench.known():
        draw_double(bench, outputs, full, fixed, test, cases, coarse[1], values)
    return values


def draw_double(bench, outputs, full, fixed, test, cases, coarse, values):
    columns = {"S_fixed": Shown(coarse, fixed.predict(coarse)), "S_full": Shown(cases, full.predict(cases))}
    bench.draw("double-scatter", scatter("Double pendulum", full, test, outputs, values["full"]["r2"]))
    for name, mass, shown in (("double-upper", "upper", (0, 2)), ("double-lower", "lower", (1, 3))):
        title = f"Double pendulum, {mass} mass in five cases: S_fixed and S_full"
        labels = {label: number for label, number in outputs.items() if number in shown}
        bench.draw(name, pictures.in_time(title, columns, labels, [0, 1, 2, 3, 4]))
    bench.draw("double-paths", pictures.paths("Double pendulum, paths of both masses: S_fixed and S_full", columns, [1, 4, 5]))


def choices(bench):
    """Activations, shapes and batches of the pendulum's recipe after a tenth of its epochs."""
    text = recipe("single-pendulum", epochs=models.COMPARED_EPOCHS)
    studies = {f"shape {name}": models.changed(text, hidden=hidden) for name, hidden in models.SHAPES.items()}
    studies |= {f"activation {name}": models.changed(text, activation=f'"{name}"') for name in ("tanh", "sigmoid", "relu")}
    values = {}
    for name, study in studies.items():
        # the same study twice: ReLU, and two layers
        model = bench.model(f"choices-{name.replace(' ', '-') if study != text else 'recipe'}", study)
        test = tests_of(model.folder, "single-pendulum")
        values[name] = float((1 - models.r2(model.predict(test), test.outputs)).max())
    seconds = {}
    for batch in (64, 1024):
        folder = bench.out / f"choices-batch-{batch}"
        seconds[batch] = trained(folder, recipe("single-pendulum", epochs=models.TIMED_EPOCHS, batch=batch), threads=1)
    values["batch"] = page.ratio(seconds[1024], seconds[64])
    return values


def searched(bench, epochs):
    """Trains both structures with every combination of the grid, and returns processor seconds of each by structure."""
    jobs = {}
    for number, (hidden, batch) in enumerate(models.GRID):
        text = recipe("single-pendulum", hidden=hidden, batch=batch, epochs=epochs)
        for structure, study in (("full", text), ("fixed", models.at_time_points(text))):
            jobs[structure, number] = (bench.out / f"search-{epochs}" / f"{structure}-{number}", study)
    with ThreadPoolExecutor(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()) as pool:
        seconds = dict(zip(jobs, pool.map(lambda job: trained(*job, threads=1), jobs.values())))
    return {structure: [seconds[structure, number] for number in range(len(models.GRID))] for structure in ("full", "fixed")}


def cost_of(seconds):
    """Processor seconds of S_fixed over those of S_full, None if a training was interrupted."""
    parts = [*seconds["full"], *seconds["fixed"]]
    return None if None in parts else sum(seconds["fixed"]) / sum(seconds["full"])


def search(bench):
    """Cost of the grid searches of both structures, from the first epochs of each training."""
    return {"epochs": models.TIMED_EPOCHS, "trials": len(models.GRID), "cost": cost_of(searched(bench, models.TIMED_EPOCHS))}


def search_full(bench):
    """Grid searches with all epochs: the best network of each time point, and of S_full."""
    system, epochs = "single-pendulum", 400
    cost = cost_of(searched(bench, epochs))
    folder = bench.out / f"search-{epochs}"
    judges = models.changed(recipe(system, levels=2), seed=2)
    models.sampled(bench.out / "judges", judges)
    judge = models.runs_of(bench.out / "judges" / "test.csv", judges)
    test, cases = tests_of(folder / "full-0", system), models.cases_of(bench.out / f"{system}-cases", system, CASES[system])
    networks = [Model(folder / f"fixed-{number}") for number in range(len(models.GRID))]
    # 1 - R² of each time point, the mean over outputs that vary
    errors = np.array([models.error_at_times(network.predict(judge), judge.outputs) for network in networks])
    best = errors.argmin(0)
    picked = lambda runs: np.stack([network.predict(runs) for network in networks])[best, :, np.arange(len(best))].swapaxes(0, 1)
    of_full = [models.r2(Model(folder / f"full-{number}").predict(judge), judge.outputs).mean() for number in range(len(models.GRID))]
    predicted, of_cases = picked(test), picked(cases)
    outputs = {"`theta`, rad": 0, "`thetad`, rad/s": 1, "`thetadd`, rad/s²": 2}
    one, more = Runs(cases.parameters[:1], cases.times, cases.outputs[:1]), Runs(cases.parameters[1:], cases.times, cases.outputs[1:])
    bench.draw("single-searched", pictures.searched(outputs, Shown(one, of_cases[:1]), Shown(more, of_cases[1:])))
    return {
        "epochs": epochs,
        "trials": len(models.GRID),
        "cost": cost,
        "full": models.GRID[int(np.argmax(of_full))],
        "chosen": [models.GRID[int(number)] for number in best],
        "searched": {
            "r2": models.r2(predicted, test.outputs).tolist(),
            "mse": models.mse(predicted, test.outputs).tolist(),
            "roughness": models.roughness(predicted, test.outputs).tolist(),
            "cases_mse": ((of_cases - cases.outputs) ** 2).mean(1).tolist(),
        },
    }


PARTS = {
    "samples": samples,
    "single-pendulum": single_pendulum,
    "slider-crank": slider_crank,
    "slider-crank-fixed": slider_crank_fixed,
    "double-pendulum": double_pendulum,
    "choices": choices,
    "search": search,
}
FULL_PARTS = {"double-pendulum-full": lambda bench: double_pendulum(bench, is_full=True), "search-full": search_full}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", metavar="PART", choices=[*PARTS, *FULL_PARTS], help=", ".join([*PARTS, *FULL_PARTS]))
    parser.add_argument("--full", action="store_true", help="also the parts that take hours")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "paper", help="folder of the trainings [default: out/paper]")
    parser.add_argument("--docs", type=Path, default=ROOT / "docs", help="folder of the page [default: docs]")
    options = parser.parse_args()
    bench = Bench(options.out, options.docs)
    bench.results.parent.mkdir(parents=True, exist_ok=True)
    bench.out.mkdir(parents=True, exist_ok=True)
    available = PARTS | FULL_PARTS
    for name in options.only or (available if options.full else PARTS):
        print(f"{name} ...", flush=True)
        values = available[name](bench)
        known = bench.known() | {name: {"commit": commit(), "date": f"{datetime.date.today()}", **values}}
        replace(bench.results, json.dumps({key: known[key] for key in available if key in known}, indent=1) + "\n")
        replace(bench.docs / "paper.md", page.document(known))
    print(page.tables(bench.known()))


if __name__ == "__main__":
    main()
