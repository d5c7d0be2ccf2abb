"""Steps the tanh network of examples/single-pendulum.toml as several FMUs, in turn, and prints a table: see run.sh."""

import argparse
import os
import re
import shutil
import statistics
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import onnx
import onnxruntime
from onnx import TensorProto, helper, numpy_helper

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "measure"))
from model_file import load, network
WORK = Path("target/step-latency")
METAFMU = Path("target/release/metafmu")
# the parameters step.c sets, at the end of its run
POINT = np.array([0.12, 0.05, 2.5, 2.0])


def build_ours(precision):
    """The FMU of the pendulum's example, hardly trained: that takes as long to step. Its folder, unpacked, and model file."""
    study = Path("examples/single-pendulum.toml").read_text()
    study = re.sub(r"(?m)^epochs = \d+", "epochs = 1", study)
    study = re.sub(r'(?m)^precision = "\w+"', f'precision = "{precision}"', study)
    path, folder = WORK / f"{precision}.toml", WORK / precision
    path.write_text(study)
    # 1: so little training is rejected
    done = subprocess.run([METAFMU, "build", path, "--out", folder], capture_output=True, text=True)
    if done.returncode not in (0, 1):
        sys.exit(done.stderr)
    unpack(folder / "single-pendulum.fmu", folder / "unpacked")
    return folder / "unpacked", folder / "single-pendulum.safetensors"


def unpack(fmu, folder):
    shutil.rmtree(folder, ignore_errors=True)
    with zipfile.ZipFile(fmu) as archive:
        archive.extractall(folder)


def layers_of(model):
    """Weights, inputs by outputs, and biases, with the scaling of inputs and outputs folded in."""
    (input_mean, input_scale), layers, (output_mean, output_scale) = network(load(model)[1])
    layers = [[weight.T, bias] for weight, bias in layers]
    first, last = layers[0], layers[-1]
    first[0] = first[0] / input_scale[:, None]
    first[1] = first[1] - input_mean @ first[0]
    last[0], last[1] = last[0] * output_scale, last[1] * output_scale + output_mean
    return layers


def forward(layers, x):
    for weight, bias in layers[:-1]:
        x = np.tanh(x @ weight + bias)
    return x @ layers[-1][0] + layers[-1][1]


def compile_c(source, target, *options):
    subprocess.run(["cc", "-std=gnu11", "-O3", "-Wall", "-Wextra", *options, HERE / source, "-o", target, "-ldl", "-lm"], check=True)


def build_bare(layers, name, number, *options):
    folder = WORK / f"bare-{name}"
    folder.mkdir(exist_ok=True)
    values = [array.astype(number).ravel() for layer in layers for array in layer]
    np.concatenate(values).tofile(folder / f"bare.{name}")
    library = folder / "bare.so"
    size = [f"-DHIDDEN={layers[0][0].shape[1]}", f"-DLAYERS={len(layers) - 1}"]
    compile_c("bare.c", library, "-march=native", "-shared", "-fPIC", *size, *options)
    return [library, "-", folder, 0, 4]


def build_onnx(layers):
    folder = WORK / "onnx"
    folder.mkdir(exist_ok=True)
    nodes, constants, x = [], [], "x"
    for i, (weight, bias) in enumerate(layers):
        last = i + 1 == len(layers)
        constants += [numpy_helper.from_array(weight.astype(np.float32), f"weight{i}")]
        constants += [numpy_helper.from_array(bias.astype(np.float32), f"bias{i}")]
        nodes.append(helper.make_node("Gemm", [x, f"weight{i}", f"bias{i}"], ["y" if last else f"z{i}"]))
        if not last:
            x = f"a{i}"
            nodes.append(helper.make_node("Tanh", [f"z{i}"], [x]))
    values = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, size]) for name, size in (("x", 4), ("y", 3))]
    graph = helper.make_graph(nodes, "network", values[:1], values[1:], constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model)
    onnx.save(model, folder / "model.onnx")
    [runtime] = (Path(onnxruntime.__file__).parent / "capi").glob("libonnxruntime.so.*")
    link = folder / "libonnxruntime.so"
    link.unlink(missing_ok=True)
    link.symlink_to(runtime.resolve())
    compile_c("onnx.c", folder / "onnx.so", "-shared", "-fPIC")
    return [folder / "onnx.so", "-", folder, 0, 4]


def build_pythonfmu(layers):
    folder = WORK / "pythonfmu"
    folder.mkdir(exist_ok=True)
    arrays = {f"{name}{i}": array.astype(np.float32) for i, layer in enumerate(layers) for name, array in zip(("weight", "bias"), layer)}
    np.savez(folder / "network.npz", **arrays)
    command = [sys.executable, "-m", "pythonfmu", "build", "-f", HERE / "slave.py", "-d", folder, folder / "network.npz"]
    subprocess.run(command, check=True, capture_output=True)
    unpack(folder / "Network.fmu", folder / "unpacked")
    return candidate(folder / "unpacked", 0, 3)


def candidate(folder, first_parameter, first_output):
    """Arguments of step.c for an unpacked FMU."""
    description = ElementTree.parse(folder / "modelDescription.xml").getroot()
    identifier = description.find("CoSimulation").get("modelIdentifier")
    library = folder / "binaries" / "linux64" / f"{identifier}.so"
    return [library, description.get("guid"), (folder / "resources").resolve().as_uri(), first_parameter, first_output]


def python_environment():
    """Variables for a host that is not Python and runs FMUs of PythonFMU: this interpreter's library, and the path of its modules."""
    library = Path(sysconfig.get_config_var("LIBDIR")) / (sysconfig.get_config_var("INSTSONAME") or "")
    if not library.is_file():
        sys.exit(f"PythonFMU needs the shared library of {sys.base_prefix}: install libpython3-dev, or another Python")
    return {"LD_PRELOAD": library, "PYTHONHOME": sys.base_prefix, "PYTHONPATH": Path(np.__file__).parents[1]}


def measure(step, arguments, steps, environment):
    """Pairs of processor and wall time in nanoseconds, outputs, and milliseconds to instantiate, from one process."""
    command = [str(argument) for argument in (step, *arguments, 3, steps)]
    done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, **environment})
    if done.returncode != 0:
        sys.exit(f"{arguments[0]}: {done.stderr}")
    lines = done.stdout.split("\n")
    times = [tuple(map(float, line.split())) for line in lines[:3]]
    words = {line.split()[0]: [float(word) for word in line.split()[1:]] for line in lines[3:] if line}
    return times, words["outputs"], words["instantiate"][0]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=7, help="how often all are measured in turn")
    rounds = parser.parse_args().rounds
    double, model = build_ours("double")
    single, _ = build_ours("single")
    layers = layers_of(model)
    step = WORK / "step"
    compile_c("step.c", step)

    candidates = {
        "metafmu, `precision = \"double\"`": (candidate(double, 1, 5), 200_000),
        "metafmu, `precision = \"single\"`": (candidate(single, 1, 5), 200_000),
        f"ONNX Runtime {'.'.join(onnxruntime.__version__.split('.')[:2])}, single": (build_onnx(layers), 40_000),
        "PythonFMU 0.7 (numpy), single": (build_pythonfmu(layers), 10_000),
    }
    if "avx512dq" in Path("/proc/cpuinfo").read_text():
        candidates["the bare network in AVX-512 intrinsics, double"] = (build_bare(layers, "f64", np.float64, "-DDOUBLE"), 200_000)
        candidates["the bare network in AVX-512 intrinsics, single"] = (build_bare(layers, "f32", np.float32), 200_000)
    else:
        print("no bare C: it is written for AVX-512, which this processor does not have")

    expected = forward(layers, POINT)
    found = {name: ([], [], []) for name in candidates}
    for _ in range(rounds):
        for name, (arguments, steps) in candidates.items():
            environment = python_environment() if "PythonFMU" in name else {}
            times, outputs, instantiate = measure(step, arguments, steps, environment)
            # all of them compute the same function, or the times say nothing
            tolerance = 1e-12 if "double" in name else 1e-5
            if not np.allclose(outputs, expected, rtol=tolerance, atol=tolerance * np.abs(expected).max()):
                sys.exit(f"{name}: outputs {outputs}, expected {expected}")
            for values, new in zip(found[name], (*zip(*times), [instantiate])):
                values.extend(new)

    print("| FMU 2.0, `fmi2DoStep` + `fmi2GetReal` | CPU ns, min | median | instantiate, ms |")
    print("|---|---|---|---|")
    for name, (cpu, _, instantiate) in found.items():
        shown = "" if "bare" in name else f"{statistics.median(instantiate):.3g}"
        print(f"| {name} | {min(cpu):.0f} | {statistics.median(cpu):.0f} | {shown} |")
    for precision in ("double", "single"):
        ours = found[f'metafmu, `precision = "{precision}"`'][0]
        bare = found.get(f"the bare network in AVX-512 intrinsics, {precision}", [None])[0]
        if bare:
            print(f"{precision}: {min(ours) / min(bare):.2f} (min), {statistics.median(ours) / statistics.median(bare):.2f} (median) of bare C")


main()
