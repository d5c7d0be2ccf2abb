"""Prints the table of docs/using-the-fmu.md: effect of single precision in the C sources of each kind of surrogate.

Studies of the examples are built, or given by --built. Their sources are compiled twice, with and without -DMETAFMU_SINGLE, and fmpy steps
both libraries through the first test runs of the study. Errors are root mean squares of a run relative to the standard deviation in the
run, for the output where they are largest. They compare single with double precision, and double precision with the truth of the test runs.
Operations are those that model_data.h states. Where the sources refuse single precision, the measurement removes the refusal. Needs
target/release/metafmu, a C compiler as `cc`, fmpy, and pythonfmu3 for the FMU.

Usage: python3 scripts/measure precision [--runs N] [--built FOLDER] [MODEL ...]
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from ctypes import c_double, c_int, c_uint
from pathlib import Path
from zipfile import ZipFile

import fmpy
import numpy as np
from common import METAFMU, ROOT
from fmpy.fmi2 import FMU2Slave

EXAMPLES = ROOT / "examples"
MECHANISMS = ["pendulum", "crane", "quarter-car", "slider-crank", "four-bar"]
# of a mechanism, by networks alone
NETWORKS = ["pendulum-net", "crane-net"]
REGRESSIONS = ["polynomial", "decision-tree", "svr"]
# a network for each of 201 instants
FIXED = [('"mesh"', '"sobol"'), ("levels = 11 ", "runs = 300 "), ("hidden = [128, 128]", "hidden = [32]"), ('"relu"', '"tanh"'), ("epochs = 400", "epochs = 100")]
REFUSAL = re.compile(r"#error .*\n")


def run(*command, **more):
    subprocess.run([*map(str, command)], check=True, capture_output=True, **more)


def replaced(path, changes):
    text = path.read_text()
    for old, new in changes:
        assert old in text, (path, old)
        text = text.replace(old, new, 1)
    return text


def built(name, folder):
    """Builds the study of a model in a folder, unless it is there, and returns its results."""
    out = folder / "out" / name
    study = folder / f"{name}.toml"
    if (out / "metrics.json").exists():
        return study, out
    if name in [*MECHANISMS, *NETWORKS]:
        mechanism = EXAMPLES / "dynamics" / f"{name.removesuffix('-net')}.toml"
        run(METAFMU, "new", name, "--mechanism", mechanism, "--structure", "dynamics", cwd=folder)
        study.write_text(replaced(study, [("stop = 10.0 ", "stop = 60.0 "), ("step = 0.02 ", "step = 0.05 ")]))
    elif name == "friction-pendulum":
        run("pythonfmu3", "build", "-f", EXAMPLES / "dynamics" / "fmu" / "friction_pendulum.py", "-d", folder)
        shutil.copy(EXAMPLES / "dynamics" / "fmu" / "friction-pendulum-study.toml", study)
    elif name == "bouc-wen":
        run(sys.executable, EXAMPLES / "dynamics" / "bouc-wen" / "make_table.py", folder)
        shutil.copy(EXAMPLES / "dynamics" / "bouc-wen" / "bouc-wen.toml", study)
    elif name == "single-pendulum-fixed":
        study.write_text(replaced(EXAMPLES / "paper" / "single-pendulum-fixed.toml", FIXED))
    else:
        shutil.copy(EXAMPLES / "quick" / "single-pendulum.toml", study)
    if name in NETWORKS:
        study.write_text(study.read_text() + '\n[dynamics]\nmodel = "network"\n')
    study.write_text(study.read_text() + "\n[accept]\nr2 = -inf\nbaseline_factor = inf\nangle_error = inf\n")
    run(METAFMU, "build", study, "--out", out, cwd=folder)
    return study, out


def exported(name, folder):
    """The FMU of a model with its sources, and the table of the test runs."""
    of = "single-pendulum-quick" if name in [*REGRESSIONS, "graph"] else name
    study, out = built(of, folder)
    if name == "graph":
        # a polynomial as another tool would give it
        fmu, table = exported("polynomial", folder)
        run(METAFMU, "export", fmu, "--onnx", folder / "graph.onnx")
        rows = np.genfromtxt(table, delimiter=",", names=True)
        inputs = {"L": "parameter", "c": "parameter", "thetad0": "parameter", "time": "time"}
        interface = 'name = "graph"\n[time]\nstep = 0.01\nstop = 2.0\n'
        for column, (name_of, causality) in enumerate(inputs.items()):
            interface += f'[inputs.{name_of}]\ncolumn = "inputs[{column}]"\ncausality = "{causality}"\n'
            interface += f"min = {rows[name_of].min()}\nmax = {rows[name_of].max()}\n"
        for column, name_of in enumerate(["theta", "thetad", "thetadd"]):
            interface += f'[outputs.{name_of}]\ncolumn = "outputs[{column}]"\n'
        (folder / "graph.toml").write_text(interface)
        run(METAFMU, "import", "graph.onnx", "--interface", "graph.toml", cwd=folder)
        run(METAFMU, "export", "graph.safetensors", "--sources", cwd=folder)
        return folder / "graph.fmu", table
    # what is exported replaces what is there
    copy = folder / "exported" / name
    shutil.copytree(out, copy, dirs_exist_ok=True)
    run(METAFMU, "export", study, "--out", copy, "--sources", *(["--model", name] if name in REGRESSIONS else []))
    fmu = copy / (f"{of}-{name}.fmu" if name in REGRESSIONS else f"{of}.fmu")
    return fmu, out / "test.csv"


def compiled(fmu, folder, flags):
    """The unpacked FMU with a library of its sources."""
    fmpy.extract(str(fmu), str(folder))
    library = next((folder / "binaries").rglob("*.so"))
    sources = sorted((folder / "sources").glob("*.c"))
    data = folder / "sources" / "model_data.c"
    data.write_text(REFUSAL.sub("", data.read_text()))
    run("cc", "-std=c99", "-O2", "-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Wdouble-promotion", "-Werror", *flags,
        "-fPIC", "-shared", *sources, "-o", library, "-lm")
    return folder


def rolled_out(unpacked, run, inputs, outputs):
    """Outputs of a run of the table at its times: inputs are linear between two rows, or held by a model of samples."""
    times = run["time"]
    description = fmpy.read_model_description(str(unpacked))
    references = {variable.name: variable.valueReference for variable in description.modelVariables}
    parameters = [v.name for v in description.modelVariables if v.causality == "parameter" and v.name in run.dtype.names]
    interface = description.coSimulation
    fmu = FMU2Slave(guid=description.guid, unzipDirectory=str(unpacked), modelIdentifier=interface.modelIdentifier)
    fmu.instantiate()
    fmu.setupExperiment(startTime=0.0)
    fmu.setReal([references[name] for name in parameters], [run[name][0] for name in parameters])
    driven, shown = ([references[name] for name in names] for names in (inputs, outputs))
    result = np.empty((len(outputs), len(times)))
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    for row, time in enumerate(times):
        if driven:
            fmu.setReal(driven, [run[name][row] for name in inputs])
        result[:, row] = fmu.getReal(shown)
        if row + 1 < len(times):
            step = times[row + 1] - time
            if driven and interface.canInterpolateInputs:
                rates = [(run[name][row + 1] - run[name][row]) / step for name in inputs]
                count = len(driven)
                fmu.fmi2SetRealInputDerivatives(
                    fmu.component, (c_uint * count)(*driven), count, (c_int * count)(*[1] * count), (c_double * count)(*rates)
                )
            fmu.doStep(time, step)
    fmu.terminate()
    fmu.freeInstance()
    return result


def errors(found, expected):
    rms = np.sqrt(np.mean((found - expected) ** 2, axis=1))
    return float(np.max(rms / np.maximum(expected.std(axis=1), 1e-300)))


def operations(fmu):
    with ZipFile(fmu) as archive:
        text = archive.read("sources/model_data.h").decode()
    remark = text[text.index("at worst"):].replace(" multiplications, additions and divisions", "").replace(" of a network's nodes", "")
    return ", ".join(f"{int(float(count)):,}{what}" for count, what in re.findall(r"\* +([0-9.e+]+)(.*?)(?:, by activation.c)?\n", remark))


def row(name, folder, runs):
    fmu, table = exported(name, folder)
    description = fmpy.read_model_description(str(fmu))
    rows = np.genfromtxt(table, delimiter=",", names=True, deletechars="", encoding="utf-8")
    inputs = [v.name for v in description.modelVariables if v.causality == "input" and v.name in rows.dtype.names]
    outputs = [v.name for v in description.modelVariables if v.causality == "output" and v.name in rows.dtype.names]
    with tempfile.TemporaryDirectory() as name_of:
        libraries = [compiled(fmu, Path(name_of) / str(index), flags) for index, flags in enumerate([[], ["-DMETAFMU_SINGLE"]])]
        refused = " (refused)" if REFUSAL.search(ZipFile(fmu).read("sources/model_data.c").decode()) else ""
        of_single, of_model = [], []
        for number in np.unique(rows["run"])[:runs]:
            truth = rows[rows["run"] == number]
            double, single = (rolled_out(library, truth, inputs, outputs) for library in libraries)
            of_single.append(errors(single, double))
            of_model.append(errors(double, np.array([truth[output] for output in outputs])))
    return f"| {name} | {operations(fmu)} | {np.median(of_single):.0e}, {max(of_single):.0e}{refused} | {np.median(of_model):.0e}, {max(of_model):.0e} |"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    models = [*MECHANISMS, *NETWORKS, "friction-pendulum", "bouc-wen", "single-pendulum-quick", "single-pendulum-fixed", *REGRESSIONS, "graph"]
    parser.add_argument("models", nargs="*", default=models, metavar="MODEL", help="all unless given")
    parser.add_argument("--runs", type=int, default=5, metavar="N", help="number of test runs to compare; 5 unless given")
    parser.add_argument("--built", type=Path, metavar="FOLDER", help="where studies are, or are built and stay")
    options = parser.parse_args()
    # fmpy's and pythonfmu3's commands are beside this Python
    os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    print("| model | operations in the worst case (+, -, ×, / and others) | single against double precision: median, largest | double precision against the truth |")
    print("|---|---|---|---|", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        folder = options.built or Path(folder)
        folder.mkdir(exist_ok=True, parents=True)
        for name in options.models:
            print(row(name, folder.resolve(), options.runs), flush=True)


if __name__ == "__main__":
    main()
