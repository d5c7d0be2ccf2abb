"""One trained network as an FMU of several tools: cost of packaging, and the resulting FMUs.

    scripts/packagers/compare.py dist/metafmu-*.whl

Each tool gets a fresh virtual environment and packages target/packagers/network.onnx: 4 inputs, six hidden layers of 64 tanh nodes, 3
outputs, single precision. One C program then steps all FMUs in turn, and their outputs are compared with numpy's. Needs a C compiler, and
numpy and onnx in the environment of this script; onnx2fmu downloads ONNX Runtime's C library where it has not before.
"""

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import sysconfig
import time
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

HERE = Path(__file__).resolve().parent
WORK = Path("target/packagers").resolve()
INPUTS, OUTPUTS, HIDDEN = 4, 3, [64] * 6


def network():
    """Weights, inputs by outputs, and biases."""
    random = np.random.default_rng(1)
    sizes = [INPUTS, *HIDDEN, OUTPUTS]
    weight = lambda a, b: random.normal(0.0, a**-0.5, (a, b)).astype(np.float32)
    return [(weight(a, b), random.normal(0.0, 0.1, b).astype(np.float32)) for a, b in zip(sizes, sizes[1:])]


def expected(layers, step):
    """The outputs at the inputs that host.c sets in this step."""
    x = np.sin(0.37 * step + np.arange(INPUTS))
    for weight, bias in layers[:-1]:
        x = np.tanh(x @ weight + bias)
    return x @ layers[-1][0] + layers[-1][1]


def write_network(layers):
    nodes, constants, x = [], [], "x"
    for i, (weight, bias) in enumerate(layers):
        last = i + 1 == len(layers)
        constants += [numpy_helper.from_array(weight, f"weight{i}"), numpy_helper.from_array(bias, f"bias{i}")]
        nodes.append(helper.make_node("Gemm", [x, f"weight{i}", f"bias{i}"], ["y" if last else f"z{i}"]))
        if not last:
            x = f"a{i}"
            nodes.append(helper.make_node("Tanh", [f"z{i}"], [x]))
    values = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, size]) for name, size in (("x", INPUTS), ("y", OUTPUTS))]
    graph = helper.make_graph(nodes, "network", values[:1], values[1:], constants)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), WORK / "network.onnx")
    arrays = {f"{name}{i}": array for i, layer in enumerate(layers) for name, array in zip(("weight", "bias"), layer)}
    np.savez(WORK / "network.npz", **arrays)


def run(*command, **options):
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, **options)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(map(str, command))}: {(done.stdout + done.stderr)[-800:]}")


class Tool:
    """Packaging of a network as an FMU, in a separate environment."""

    name: str
    packages: list
    # enough that the median is one of a second or more
    steps: int
    # value references of the first input and of the first output
    first: tuple
    # false: the process may crash at its end, after the results
    ends_well = True

    def __init__(self, *packages):
        self.packages = [*packages, *self.packages]
        self.folder = WORK / type(self).__name__
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)

    def set_up(self):
        run(sys.executable, "-m", "venv", self.folder / "venv")
        run(self.folder / "venv/bin/python", "-m", "pip", "install", "--quiet", "--no-cache-dir", *self.packages)

    def command(self, *words):
        bin = self.folder / "venv/bin"
        run(bin / words[0], *words[1:], cwd=self.folder, env={**os.environ, "PATH": f"{bin}:{os.environ['PATH']}"})

    def environment(self):
        return os.environ


class Metafmu(Tool):
    name, packages, steps, first = "metafmu", [], 1_000_000, (1, INPUTS + 1)

    def export(self):
        inputs = "".join(f'[inputs.x{i}]\ncolumn = "x[{i}]"\ncausality = "input"\nmin = -1.0\nmax = 1.0\n' for i in range(INPUTS))
        outputs = "".join(f'[outputs.y{i}]\ncolumn = "y[{i}]"\n' for i in range(OUTPUTS))
        (self.folder / "interface.toml").write_text(f'name = "network"\n[time]\nstep = 0.001\nstop = 1.0\n{inputs}{outputs}')
        self.command("metafmu", "import", WORK / "network.onnx", "--interface", "interface.toml", "--out", "network.safetensors")
        self.command("metafmu", "export", "network.safetensors", "--out", ".")
        return self.folder / "network.fmu"


class PythonFmu(Tool):
    name, packages, steps, first = "PythonFMU 0.7", ["pythonfmu==0.7.0", "numpy"], 100_000, (0, INPUTS)
    # its interpreter, where the FMU is unloaded
    ends_well = False

    def export(self):
        self.command("pythonfmu", "build", "-f", HERE / "slave.py", "-d", self.folder, WORK / "network.npz")
        return self.folder / "Network.fmu"

    def environment(self):
        library = Path(sysconfig.get_config_var("LIBDIR")) / (sysconfig.get_config_var("INSTSONAME") or "")
        if not library.is_file():
            raise RuntimeError(f"PythonFMU needs the shared library of {sys.base_prefix}: install libpython3-dev, or another Python")
        [modules] = (self.folder / "venv/lib").glob("python3*/site-packages")
        return {**os.environ, "LD_PRELOAD": str(library), "PYTHONHOME": sys.base_prefix, "PYTHONPATH": str(modules)}


class Onnx2Fmu(Tool):
    name, packages, steps, first = "onnx2fmu 0.3.3", ["onnx2fmu==0.3.3"], 200_000, (1, INPUTS + 1)

    def set_up(self):
        super().set_up()
        # downloads ONNX Runtime unless it did before, which later exports use again
        self.export()

    def export(self):
        variables = {"inputs": [{"name": "x", "description": "inputs"}], "outputs": [{"name": "y", "description": "outputs"}]}
        (self.folder / "network.json").write_text(json.dumps({"name": "network", "description": "network", "FMIVersion": "2.0", **variables}))
        self.command("onnx2fmu", "build", WORK / "network.onnx", "network.json", "target", "--destination", ".")
        return self.folder / "network.fmu"


class UniFmu(Tool):
    name, packages, steps, first = "UniFMU 0.0.3", ["unifmu==0.0.3", "lxml", "toml", "pyzmq", "numpy"], 10_000, (0, INPUTS)

    def export(self):
        folder = self.folder / "network"
        self.command("unifmu", "generate", "python", folder)
        shutil.copy(HERE / "model.py", folder / "resources")
        shutil.copy(WORK / "network.npz", folder / "resources")
        launch = (folder / "resources/launch.toml").read_text().replace('backend = "grpc"', 'backend = "zmq"')
        (folder / "resources/launch.toml").write_text(launch)
        description = ElementTree.parse(folder / "modelDescription.xml")
        variables, structure = description.find("ModelVariables"), description.find("ModelStructure")
        variables.clear()
        for of in structure:
            of.clear()
        for reference, name in enumerate([f"x{i}" for i in range(INPUTS)] + [f"y{i}" for i in range(OUTPUTS)]):
            is_input = reference < INPUTS
            causality = {"causality": "input"} if is_input else {"causality": "output", "initial": "calculated"}
            entry = {"name": name, "valueReference": str(reference), "variability": "continuous", **causality}
            variable = ElementTree.SubElement(variables, "ScalarVariable", entry)
            ElementTree.SubElement(variable, "Real", {"start": "0.0"} if is_input else {})
            for of in [] if is_input else structure:
                ElementTree.SubElement(of, "Unknown", {"index": str(reference + 1)})
        description.write(folder / "modelDescription.xml")
        fmu = shutil.make_archive(self.folder / "network", "zip", folder)
        return Path(fmu).rename(self.folder / "network.fmu")

    def environment(self):
        return {**os.environ, "PATH": f"{self.folder / 'venv/bin'}:{os.environ['PATH']}"}


def stepped(tool, fmu):
    """Milliseconds to instantiate, nanoseconds within which half of the steps and 99.9 % of them are done, of one run; the outputs are checked."""
    folder = fmu.with_suffix(".unpacked")
    if not folder.exists():
        zipfile.ZipFile(fmu).extractall(folder)
    description = ElementTree.parse(folder / "modelDescription.xml").getroot()
    identifier = description.find("CoSimulation").get("modelIdentifier")
    library = folder / "binaries/linux64" / f"{identifier}.so"
    where = [library, description.get("guid"), (folder / "resources").as_uri(), tool.steps, tool.first[0], INPUTS, tool.first[1], OUTPUTS]
    # what UniFMU's process logs about each call goes to a file, as it would in a host without a terminal
    with open(tool.folder / "stderr.txt", "w") as log:
        words = [str(word) for word in (WORK / "host", *where)]
        done = subprocess.run(words, stdout=subprocess.PIPE, stderr=log, text=True, env=tool.environment(), timeout=900)
    if (done.returncode != 0 and tool.ends_well) or not done.stdout.strip():
        raise RuntimeError(f"host: {(tool.folder / 'stderr.txt').read_text()[-800:]}")
    instantiate, median, slow, _, *outputs = map(float, done.stdout.strip().splitlines()[-1].split())
    difference = np.abs(np.array(outputs) - expected(LAYERS, tool.steps - 1)).max()
    if difference > 1e-5:
        raise RuntimeError(f"outputs {outputs} are off by {difference:.1e}")
    return instantiate, median, slow


def has_derivatives(fmu):
    """Returns True if an FMU offers directional derivatives in co-simulation."""
    description = ElementTree.fromstring(zipfile.ZipFile(fmu).read("modelDescription.xml"))
    return description.find("CoSimulation").get("providesDirectionalDerivative") == "true"


LAYERS = network()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("wheel", type=Path, help="metafmu's wheel, as scripts/release.sh makes it")
    parser.add_argument("--rounds", type=int, default=3, help="how often all FMUs are stepped in turn")
    options = parser.parse_args()
    WORK.mkdir(parents=True, exist_ok=True)
    write_network(LAYERS)
    run("cc", "-std=c11", "-O2", "-Wall", "-Wextra", HERE / "host.c", "-o", WORK / "host", "-ldl", "-lm")

    made, problems = [], []
    for tool in (Metafmu(options.wheel.resolve()), Onnx2Fmu(), PythonFmu(), UniFmu()):
        try:
            begin = time.perf_counter()
            tool.set_up()
            ready = time.perf_counter()
            fmu = tool.export()
            exported = time.perf_counter()
            stepped(tool, fmu)
        except (RuntimeError, subprocess.TimeoutExpired) as error:
            problems.append(f"{tool.name}: {error}")
            continue
        installed = sum(path.stat().st_size for path in (tool.folder / "venv").rglob("*") if path.is_file() and not path.is_symlink())
        made.append((tool, fmu, ready - begin, installed, exported - ready, []))
    for _ in range(options.rounds):
        for tool, fmu, *_, runs in made:
            runs.append(stepped(tool, fmu))

    print("| tool | set-up, s | installed, MB | export, s | FMU, MB | instantiate, ms | step, ns: median | 99.9 % within |")
    print("|---|---|---|---|---|---|---|---|")
    for tool, fmu, set_up, installed, export, runs in made:
        instantiate, median, slow = (statistics.median(of) for of in zip(*runs))
        size = fmu.stat().st_size / 1e6
        print(f"| {tool.name} | {set_up:.1f} | {installed / 1e6:.0f} | {export:.2f} | {size:.2f} | {instantiate:.2f} "
              f"| {median:,.0f} | {slow:,.0f} |")
    offered = [tool.name for tool, fmu, *_ in made if has_derivatives(fmu)]
    print(f"\nDirectional derivatives are offered by {', '.join(offered)}.")
    for problem in problems:
        print(problem, file=sys.stderr)
    sys.exit(1 if problems else 0)


if __name__ == "__main__":
    main()
