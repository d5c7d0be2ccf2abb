"""Compares what two builds of metafmu make of the same models: for changes that must not change results.

Each program builds and exports a model of every kind: equations of motion as sums and as networks, with friction, and a state space. Further
kinds are a network, a network for each time point, regressions, graphs in both precisions, a discrete model and a recurrent cell.

The FMUs, of FMI 3.0, are compared at random points of their ranges: outputs, derivatives of states, directional and adjoint derivatives,
and a run of 25 steps. Differences are relative to the largest value over the points. The texts are compared as well: modelDescription.xml,
C sources, model card, and the ONNX model if there is one; versions, dates and tokens do not count. Ends with 1 if a number differs by more
than --limit, or XML or card at all. Needs the packages of the tests.

Usage: .venv/bin/python scripts/measure golden BEFORE AFTER [--folder FOLDER] [--limit 1e-12] [MODEL ...]
"""

import argparse
import ctypes
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from zipfile import ZipFile

import fmpy
import numpy as np
import onnx
import precision as built
from fmpy.fmi3 import FMU3Model, FMU3Slave
from onnx_layers import Layers

POINTS, STEPS = 7, 25
IMPORTED = ["residual-double", "residual-single", "steps", "cell"]
MODELS = [
    "single-pendulum-quick", "single-pendulum-fixed", *built.REGRESSIONS, "graph", *IMPORTED, "pendulum", "crane", "quarter-car", "slider-crank",
    "pendulum-net", "bouc-wen", "friction-pendulum", "dc-motor",
]  # fmt: skip
CHANGES = [
    (re.compile(rb"\{[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}\}|[0-9a-f]{64}"), b"TOKEN"),
    (re.compile(rb"\d{4}-\d{2}-\d{2}T\d{2}:\d{2}:\d{2}Z|\d{4}-\d{2}-\d{2}"), b"DATE"),
    (re.compile(rb"metafmu \d+\.\d+\.\d+"), b"metafmu VERSION"),
]


def onnx_model(name):
    """Layers of random weights as another tool has them."""
    layers = Layers(np.float32 if name == "residual-single" else np.float64)
    node, dense, tensor = layers.node, layers.dense, layers.tensor
    value = node("Tanh", dense("x", 3, 24))
    for _ in range(3):
        value = node("Add", value, node("Tanh", dense(value, 24, 24)))
    if name == "steps":
        value = node("LayerNormalization", value, tensor((24,), 1.0), tensor((24,), 0.1))
        value = node("Mul", node("Softmax", dense(value, 24, 24)), node("Sigmoid", value))
        value = node("Max", node("Softplus", value), node("Sqrt", node("Exp", dense(value, 24, 24))))
    return layers.model(name, 3, dense(value, 24, 2), 2)


def exported(name, folder):
    """Folder of the results of a model, which is built there by `built.METAFMU`."""
    out = folder / "golden" / name
    if out.exists():
        return out
    if name in IMPORTED:
        model = onnx_model("steps" if name == "cell" else name)
        onnx.save(model, folder / f"{name}.onnx")
        result = model.graph.output[0].name
        ports = ["h", "b", "c"] if name == "cell" else ["a", "b", "c"]
        text = f'name = "{name}"\n[time]\nstep = 0.05\nstop = 2.0\n' + ("sample = 0.05\n" if name == "cell" else "")
        for column, port in enumerate(ports):
            if port == "h":
                text += f'[states.h]\ncolumn = "x[0]"\nnext = "{result}[0]"\nstart = 0.2\n'
            else:
                text += f'[inputs.{port}]\ncolumn = "x[{column}]"\ncausality = "input"\nmin = -1.0\nmax = 1.5\n'
        text += f'[outputs.y]\ncolumn = "{result}[0]"\n[outputs.z]\ncolumn = "{result}[1]"\n'
        (folder / f"{name}.toml").write_text(text)
        built.run(built.METAFMU, "import", f"{name}.onnx", "--interface", f"{name}.toml", cwd=folder)
        study, options, results = folder / f"{name}.safetensors", [], None
    elif name == "dc-motor":
        motor = built.EXAMPLES / "dynamics" / "dc-motor"
        built.run("pythonfmu", "build", "-f", motor / "motor.py", "-d", folder)
        study = folder / "dc-motor.toml"
        study.write_text((motor / "dc-motor.toml").read_text().replace("epochs = 300", "epochs = 20"))
        results = folder / "out" / name
        subprocess.run([built.METAFMU, "build", study, "--out", results], cwd=folder, capture_output=True)
        options = []
    else:
        of = "single-pendulum-quick" if name in [*built.REGRESSIONS, "graph"] else name
        if name == "graph":
            built.exported("graph", folder)
            study, options, results = folder / "graph.safetensors", [], None
        else:
            study, results = built.built(of, folder)
            options = ["--model", name] if name in built.REGRESSIONS else []
    # what is exported replaces what is there
    unfinished = folder / "golden" / f"unfinished-{name}"
    if results:
        subprocess.run(["cp", "-r", results, unfinished], check=True)
    built.run(built.METAFMU, "export", study, "--out", unfinished, "--fmi", "3", "--sources", *options)
    subprocess.run([built.METAFMU, "export", study, "--out", unfinished, "--onnx", unfinished / "model.onnx", *options], capture_output=True)
    unfinished.rename(out)
    return out


def numbers(fmu):
    """Outputs and derivatives of an FMU by what they are: rows of numbers."""
    random = np.random.default_rng(2)
    description = fmpy.read_model_description(str(fmu))
    of = lambda causality: [v for v in description.modelVariables if v.causality == causality and v.type == "Float64" and v.min is not None]
    parameters, inputs = of("parameter"), of("input")
    derivatives = [unknown.variable for unknown in description.derivatives or []]
    states = [derivative.derivative for derivative in derivatives]
    outputs = [v for v in description.modelVariables if v.causality == "output" and v.type == "Float64" and not v.dimensions]
    outputs = [v for v in outputs if v.name != "domain_distance" and not v.name.endswith("_bound")]
    within = lambda chosen: [random.uniform(float(v.min), float(v.max)) for v in chosen]
    references = lambda chosen: [v.valueReference for v in chosen]
    folder = fmpy.extract(str(fmu))
    found = {}

    def add(what, row):
        # of one interface there are more than of the other
        found.setdefault((what, len(row)), []).append(list(row))

    def instance(kind, interface):
        fmu = kind(guid=description.guid, unzipDirectory=folder, modelIdentifier=interface.modelIdentifier)
        fmu.instantiate()
        fmu.enterInitializationMode(startTime=0.0)
        return fmu

    def differentiated(fmu, unknowns, knowns):
        if not knowns:
            return
        unknowns, knowns = references(unknowns), references(knowns)
        seeds = list(random.uniform(-1.0, 1.0, len(knowns)))
        add("directional", list(fmu.getDirectionalDerivative(unknowns, knowns, seeds, len(unknowns))))
        seeds = list(random.uniform(-1.0, 1.0, len(unknowns)))
        add("adjoint", list(fmu.getAdjointDerivative(unknowns, knowns, seeds, len(knowns))))

    for _ in range(POINTS):
        if description.modelExchange:
            fmu = instance(FMU3Model, description.modelExchange)
            fmu.setFloat64(references(parameters), within(parameters))
            fmu.setFloat64(references(inputs), within(inputs)) if inputs else None
            fmu.exitInitializationMode()
            fmu.enterContinuousTimeMode()
            count = len(states)
            if count:
                near = random.standard_normal(count) * [0.5 * float(state.nominal or 1.0) for state in states]
                fmu.setContinuousStates((ctypes.c_double * count)(*near), count)
                to = (ctypes.c_double * count)()
                fmu.getContinuousStateDerivatives(to, count)
                add("derivatives", list(to))
            else:
                fmu.setTime(random.uniform(0.0, 2.0))
            add("outputs", fmu.getFloat64(references(outputs)))
            differentiated(fmu, [*outputs, *derivatives], [*inputs, *states])
            fmu.terminate()
            fmu.freeInstance()
        fmu = instance(FMU3Slave, description.coSimulation)
        fmu.setFloat64(references(parameters), within(parameters)) if parameters else None
        fmu.setFloat64(references(inputs), within(inputs)) if inputs else None
        differentiated(fmu, outputs, [v for v in [*parameters, *inputs] if not v.name.endswith("_start")])
        fmu.exitInitializationMode()
        step = float(description.defaultExperiment.stepSize or 0.01)
        for number in range(STEPS):
            add("run", fmu.getFloat64(references(outputs)))
            fmu.setFloat64(references(inputs), within(inputs)) if inputs else None
            fmu.doStep(number * step, step)
        fmu.terminate()
        fmu.freeInstance()
    assert ("run", len(outputs)) in found
    return {what: np.array(rows) for what, rows in found.items()}


def texts(out, fmu):
    """Texts of an FMU and its ONNX model, by kind and file name."""
    parts = {}
    with ZipFile(fmu) as archive:
        for name in archive.namelist():
            kind = {"modelDescription.xml": "XML"}.get(name) or ("C" if name.startswith("sources/") else "card" if name.endswith(".html") else None)
            if kind:
                parts.setdefault(kind, {})[name] = archive.read(name)
    path = out / "model.onnx"
    parts["ONNX"] = {path.name: path.read_bytes()} if path.exists() else {}
    for names in parts.values():
        for name, text in names.items():
            for pattern, instead in CHANGES:
                text = pattern.sub(instead, text)
            names[name] = text
    return parts


def difference(before, after):
    if before.shape != after.shape:
        return float("inf")
    if not before.size:
        return 0.0
    same = (before == after) | (np.isnan(before) & np.isnan(after))
    scale = np.maximum(np.nanmax(np.abs(before), axis=0), 1e-300)
    return float(np.max(np.where(same, 0.0, np.abs(after - before) / scale)))


def row(name, folders, programs):
    outs = []
    for folder, program in zip(folders, programs):
        built.METAFMU = program
        outs.append(exported(name, folder))
    fmus = [sorted(out.glob("*-fmi3.fmu"), key=lambda path: path.stat().st_mtime)[-1] for out in outs]
    before, after = (numbers(fmu) for fmu in fmus)
    far = {}
    for what in before | after:
        found = difference(before[what], after[what]) if what in before and what in after else float("inf")
        far[what[0]] = max(found, far.get(what[0], 0.0))
    texts_before, texts_after = (texts(out, fmu) for out, fmu in zip(outs, fmus))
    changed = {kind: sum(texts_after[kind].get(name) != text for name, text in names.items()) for kind, names in texts_before.items()}
    figures = " | ".join(f"{far[what]:.0e}" if what in far else "" for what in ("outputs", "derivatives", "directional", "adjoint", "run"))
    same = " | ".join(("same" if not changed.get(kind) else f"{changed[kind]} differ") if texts_before.get(kind) else "" for kind in ("XML", "card", "C", "ONNX"))
    print(f"| {name} | {figures} | {same} |", flush=True)
    return max(far.values()), changed.get("XML", 0) + changed.get("card", 0)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("programs", nargs=2, type=Path, metavar="PROGRAM", help="the two programs to compare")
    parser.add_argument("models", nargs="*", metavar="MODEL", help="all unless given")
    parser.add_argument("--folder", type=Path, help="where models are, or are built and stay")
    parser.add_argument("--limit", type=float, default=1e-12, help="largest difference of a number; 1e-12 unless given")
    options = parser.parse_intermixed_args()
    # fmpy's and pythonfmu3's commands are beside this Python
    os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    print("| model | outputs | derivatives of states | directional | adjoint | run | XML | card | C | ONNX |")
    print("|---|---|---|---|---|---|---|---|---|---|", flush=True)
    with tempfile.TemporaryDirectory() as temporary:
        base = (options.folder or Path(temporary)).resolve()
        folders = [base / which for which in ("before", "after")]
        [(folder / "golden").mkdir(parents=True, exist_ok=True) for folder in folders]
        programs = [program.resolve() for program in options.programs]
        results = [row(name, folders, programs) for name in options.models or MODELS]
    return int(any(far > options.limit or changed for far, changed in results))


if __name__ == "__main__":
    sys.exit(main())
