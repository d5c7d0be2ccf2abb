"""Models of Choi et al. 2021: their studies, their trainings, and what the models predict."""

import csv
import json
import os
import shutil
import subprocess
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from common import METAFMU, ROOT
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from model_file import evaluate, load

EXAMPLES = ROOT / "examples"
# double pendulum without --full: epochs of S_full out of 400, and the time in s from one network of S_fixed to the next
FEW_EPOCHS, LONG_STEP = 10, 0.1
# epochs of the networks whose shapes and activations are compared, and of the grids whose cost is measured, out of 400
COMPARED_EPOCHS, TIMED_EPOCHS = 40, 2
# combinations of the layers, nodes and batches that the paper's table of S_fixed has
GRID = [([nodes] * layers, batch) for layers in (2, 3, 4) for nodes in (128, 256) for batch in (64, 128)]
# of one hidden layer, two and four: about as many weights and biases
SHAPES = {"1 x 2192": [2192], "2 x 128": [128, 128], "4 x 75": [75, 75, 75, 75]}


# named cases of the paper, by the parameters of the studies
CASES = {
    "single-pendulum": [(0.1911, 0.055, 3.78), (0.123, 0.055, 2.53), (0.1583, 0.055, 0.52), (0.1758, 0.109, 0.52), (0.1911, 0.109, 4.52)],
    # the last one is in the picture of the paths alone
    "double-pendulum": [
        (1.010, 2.130, 0.0, 0.300),
        (1.500, 2.410, 0.03, 0.330),
        (1.620, 2.560, 0.044, 0.384),
        (1.330, 2.820, 0.062, 0.412),
        (1.980, 2.940, 0.087, 0.470),
        (1.400, 2.500, 0.060, 0.380),
    ],
    # a list has two points at least: the second one is not the paper's and is not shown
    "slider-crank": [(1.780, 1.360, 3.050), (1.5, 2.0, 3.0)],
}


def changed(text, **values):
    """The study with other values of some keys, which it must have."""
    lines = text.splitlines()
    for key, value in values.items():
        [place] = [number for number, line in enumerate(lines) if line.startswith(f"{key} = ")]
        lines[place] = f"{key} = {value}"
    return "\n".join(lines) + "\n"


def recipe(system, **values):
    """The study of the paper."""
    return changed((EXAMPLES / "paper" / f"{system}.toml").read_text(encoding="utf-8"), **values)


def default(system):
    """The study that `metafmu new` writes."""
    return (EXAMPLES / f"{system}.toml").read_text(encoding="utf-8")


def at_time_points(text):
    """The study with a network for each time point: S_fixed."""
    return text.replace("[network]\n", '[network]\nstructure = "fixed"\n')


def run(*arguments):
    """Processor seconds of the command; a rejected surrogate is measured as well."""
    process = subprocess.Popen([METAFMU, *map(str, arguments)], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    printed = process.stdout.read()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode and "\nrejected: " not in printed:
        raise SystemExit(f"error: metafmu {' '.join(map(str, arguments))}: {printed}")
    return usage.ru_utime + usage.ru_stime


def output(*arguments):
    """Text that the command prints."""
    return subprocess.run([METAFMU, *map(str, arguments)], cwd=ROOT, check=True, capture_output=True, text=True).stdout


def sampled(folder, text):
    """Writes a study into its folder, and samples it unless that is done."""
    study = folder / "study.toml"
    if study.exists() and study.read_text(encoding="utf-8") != text:
        shutil.rmtree(folder)
    folder.mkdir(parents=True, exist_ok=True)
    study.write_text(text, encoding="utf-8")
    if not (folder / "samples.json").exists():
        run("sample", study, "--out", folder)
    return study


def trained(folder, text, threads=None):
    """Trains a study, and continues if that was stopped. Processor seconds are None then."""
    study, done = sampled(folder, text), folder / "done.json"
    if not done.exists():
        is_new = not any(folder.glob("unfinished-networks.bin")) and not (folder / "checkpoint.safetensors").exists()
        options = [] if threads is None else ["--threads", threads]
        seconds = run("train", study, "--out", folder, "--resume", *options)
        done.write_text(json.dumps({"processor_seconds": seconds if is_new else None}))
    return json.loads(done.read_text())["processor_seconds"]


@dataclass
class Runs:
    """Parameters [runs, parameters], times, and outputs [runs, times, outputs]."""

    parameters: np.ndarray
    times: np.ndarray
    outputs: np.ndarray


def runs_of(table, study):
    """Runs of a table of samples, in the order of the study's names."""
    of = tomllib.loads(study)
    with open(table, encoding="utf-8") as file:
        header = next(csv.reader(file))
    rows = np.loadtxt(table, delimiter=",", skiprows=1)
    count = int(rows[-1, header.index("run")]) + 1
    rows = rows.reshape(count, -1, len(header))
    columns = lambda names: rows[..., [header.index(name) for name in names]]
    return Runs(columns(of["parameters"])[:, 0], rows[0, :, header.index("time")], columns(of["outputs"]))


def cases_of(folder, system, cases):
    """Truth of named cases."""
    lines = [line for line in recipe(system).splitlines() if not line.startswith("levels = ")]
    text = changed("\n".join(lines), method='"list"\nfile = "cases.csv"', test_runs=1)
    folder.mkdir(parents=True, exist_ok=True)
    names = tomllib.loads(text)["parameters"]
    table = ",".join(names) + "\n" + "".join(",".join(map(str, case)) + "\n" for case in cases)
    if not (folder / "cases.csv").exists() or (folder / "cases.csv").read_text(encoding="utf-8") != table:
        shutil.rmtree(folder)
        folder.mkdir(parents=True)
        (folder / "cases.csv").write_text(table, encoding="utf-8")
    sampled(folder, text)
    return runs_of(folder / "train.csv", text)


class Model:
    """A trained network, or the networks of all time points."""

    def __init__(self, folder):
        self.folder = Path(folder)
        name = tomllib.loads((self.folder / "study.toml").read_text(encoding="utf-8"))["name"]
        self.file = self.folder / f"{name}.safetensors"
        self.tensors = load(self.file)[1]

    def predict(self, runs):
        """Outputs [runs, times, outputs]."""
        times = np.tile(runs.times, len(runs.parameters))
        rows = np.column_stack([np.repeat(runs.parameters, len(runs.times), axis=0), times])
        return evaluate(self.tensors, rows).reshape(len(runs.parameters), len(runs.times), -1)


def r2(predicted, truth):
    """Coefficient of determination of each output over all runs and times."""
    return 1 - ((predicted - truth) ** 2).sum((0, 1)) / ((truth - truth.mean((0, 1))) ** 2).sum((0, 1))


def mse(predicted, truth):
    """Mean squared error of each output over all runs and times, in squares of its unit."""
    return ((predicted - truth) ** 2).mean((0, 1))


def size_of_second_differences(values):
    """Root mean square of y(t-h) - 2 y(t) + y(t+h) of each output."""
    return np.sqrt((np.diff(values, 2, axis=1) ** 2).mean((0, 1)))


def roughness(predicted, truth):
    """Size of the second differences in time of the error, over that of the truth: 0 is as smooth as the truth."""
    return size_of_second_differences(predicted - truth) / size_of_second_differences(truth)


def error_at_times(predicted, truth):
    """1 - R² at each time, the mean over the outputs that vary there."""
    spread = ((truth - truth.mean(0)) ** 2).sum(0)
    varies = spread > 1e-12 * spread.max(0)
    error = np.where(varies, ((predicted - truth) ** 2).sum(0) / np.where(varies, spread, 1.0), 0.0)
    return error.sum(1) / varies.sum(1)


def times_of(study):
    """Number of rows of a run."""
    time = tomllib.loads(study)["time"]
    return round(time["stop"] / time["step"]) + 1


def speed(fmu, outputs):
    """Processor time of a step with its outputs through fmpy in µs, and of an instantiation in ms: the least of 40."""
    description, folder = read_model_description(fmu), extract(fmu)
    references = [variable.valueReference for variable in description.modelVariables if variable.name in outputs]
    steps, instantiations = [], []
    for _ in range(40):
        began = time.process_time()
        identifier = description.coSimulation.modelIdentifier
        instance = FMU2Slave(
            guid=description.guid, unzipDirectory=folder, modelIdentifier=identifier, instanceName="timed"
        )
        instance.instantiate()
        instantiations.append(time.process_time() - began)
        instance.setupExperiment(startTime=0.0)
        instance.enterInitializationMode()
        instance.exitInitializationMode()
        began = time.process_time()
        # of a size that does not meet the instants
        for step in range(600):
            instance.doStep(0.0033 * step, 0.0033)
            instance.getReal(references)
        steps.append((time.process_time() - began) / 600)
        instance.terminate()
        instance.freeInstance()
    shutil.rmtree(folder)
    return 1e6 * min(steps), 1e3 * min(instantiations)


def step_time(model, outputs):
    """Microseconds of a step of the FMU with its outputs, through fmpy."""
    run("export", model.folder / "study.toml", "--out", model.folder)
    return speed(model.file.with_suffix(".fmu"), outputs)[0]
