"""Times a step of an FMU with the library inside and with its C sources compiled: scripts/measure sources [--flags FLAGS]...

Networks of random weights are imported and exported: a chain of six hidden layers of 64 nodes, and the same layers with residual
connections, in double and in single precision (with -DMETAFMU_SINGLE). Library and compiled sources step in turn, each in a separate
process. Prints the minimum and the median processor time of a step and their ratios. Needs a C compiler and the packages of the tests.

Usage: .venv/bin/python scripts/measure sources [--flags=FLAGS]... [--rounds N] [--models NAME ...]
"""

import argparse
import os
import statistics
import subprocess
import tempfile
from pathlib import Path

import fmpy
import numpy as np
import onnx
from common import METAFMU, ROOT
from onnx_layers import Layers

STEP = ROOT / "scripts" / "step-latency" / "step.c"
MODELS = ["chain", "chain-single", "residual", "residual-single"]
WIDTH, LAYERS = 64, 6
STEPS, REPETITIONS = 4000, 3


def run(*command, cwd=None):
    return subprocess.run(list(map(str, command)), check=True, cwd=cwd, capture_output=True, text=True).stdout


def network(name, activation):
    """Four columns, of which one is the time, and three outputs: what step.c sets and reads."""
    layers = Layers(np.float32 if name.endswith("single") else np.float64)
    value = layers.node(activation, layers.dense("x", 4, WIDTH))
    for _ in range(LAYERS - 1):
        layer = layers.node(activation, layers.dense(value, WIDTH, WIDTH))
        value = layers.node("Add", value, layer) if name.startswith("residual") else layer
    return layers.model(name, 4, layers.dense(value, WIDTH, 3), 3)


def exported(name, activation, folder):
    """The unpacked FMU of a network, with its sources."""
    model = network(name, activation)
    result = model.graph.output[0].name
    onnx.save(model, folder / f"{name}.onnx")
    text = f'name = "{name}"\n[time]\nstep = 0.001\nstop = 2.0\n'
    for column, port in enumerate("abc"):
        text += f'[inputs.{port}]\ncolumn = "x[{column}]"\ncausality = "parameter"\nmin = -5.0\nmax = 5.0\n'
    text += '[inputs.t]\ncolumn = "x[3]"\ncausality = "time"\nmin = 0.0\nmax = 2.0\n'
    for column, port in enumerate("uvw"):
        text += f'[outputs.{port}]\ncolumn = "{result}[{column}]"\n'
    (folder / f"{name}.toml").write_text(text)
    run(METAFMU, "import", f"{name}.onnx", "--interface", f"{name}.toml", cwd=folder)
    run(METAFMU, "export", f"{name}.safetensors", "--fmi", "2", "--sources", cwd=folder)
    fmpy.extract(str(folder / f"{name}.fmu"), str(folder / name))
    return folder / name


def candidate(unpacked, library):
    description = fmpy.read_model_description(str(unpacked))
    references = {variable.name: variable.valueReference for variable in description.modelVariables}
    assert [references[name] - references["a"] for name in "abc"] == [0, 1, 2] and references["v"] == references["u"] + 1, references
    return [library, description.guid, (unpacked / "resources").as_uri(), references["a"], references["u"]]


def step(folder, arguments):
    """Processor time of a step in ns, and the last outputs."""
    lines = run(folder / "step", *arguments, REPETITIONS, STEPS).splitlines()
    outputs = next(line.split()[1:] for line in lines if line.startswith("outputs"))
    return min(float(line.split()[0]) for line in lines[:REPETITIONS]), np.array(outputs, dtype=float)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flags", action="append", help="options of the compiler, several sets of them: -O3 unless given")
    parser.add_argument("--rounds", type=int, default=15, help="how often library and sources are measured in turn")
    parser.add_argument("--activation", default="Tanh", help="operator of ONNX")
    parser.add_argument("--models", nargs="+", choices=MODELS, default=MODELS)
    arguments = parser.parse_args()
    compiler = os.environ.get("CC", "cc")
    print(f"{run(compiler, '--version').splitlines()[0]}\n")
    all_flags = arguments.flags or ["-O3"]
    first, *others = (f"`{flags}`" for flags in all_flags)
    print(f"| {' | '.join(['model', 'library, ns', f'ratio with {first}: min, median', *others])} |\n{'|---' * (2 + len(all_flags))}|")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        run(compiler, "-std=gnu11", "-O2", STEP, "-o", folder / "step", "-ldl", "-lm")
        for name in arguments.models:
            unpacked = exported(name, arguments.activation, folder)
            precision = ["-DMETAFMU_SINGLE"] if name.endswith("single") else []
            candidates = [candidate(unpacked, next((unpacked / "binaries").rglob("*.so")))]
            for index, flags in enumerate(all_flags):
                library = folder / f"{name}-{index}.so"
                sources = sorted((unpacked / "sources").glob("*.c"))
                run(compiler, *flags.split(), *precision, "-fPIC", "-shared", *sources, "-o", library, "-lm")
                candidates.append(candidate(unpacked, library))
            times = [[] for _ in candidates]
            for _ in range(arguments.rounds):
                values = []
                for of, each in zip(times, candidates):
                    time, outputs = step(folder, each)
                    of.append(time)
                    values.append(outputs)
                for outputs in values[1:]:
                    np.testing.assert_allclose(outputs, values[0], rtol=1e-3 if precision else 1e-9)
            least, middle = ([reduced(of) for of in times] for reduced in (min, statistics.median))
            ratios = [f"{fastest / least[0]:.2f}, {median / middle[0]:.2f}" for fastest, median in zip(least[1:], middle[1:])]
            print(f"| {' | '.join([name.replace('-', ', '), f'{least[0]:.0f}', *ratios])} |", flush=True)


if __name__ == "__main__":
    main()
