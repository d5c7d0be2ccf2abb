"""Times `metafmu predict` beside pandas with numpy or onnxruntime: .venv/bin/python scripts/measure predict MODEL [--rows N]

MODEL is a model file of a tanh network, for instance out/single-pendulum-quick/single-pendulum-quick.safetensors. The table has random
points in the training ranges. Every way reads and writes files. The ways take turns, and the round with the least processor time counts for
each. metafmu reads while it evaluates. onnxruntime, in single precision, takes part if it is installed, with onnx. Needs
target/release/metafmu.
"""

import argparse
import json
import resource
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
from common import METAFMU
from model_file import load, network

# rows at a time: small enough for the cache
BLOCK = 4096


class Network:
    def __init__(self, path):
        description, tensors = load(path)
        self.inputs, self.outputs = description["inputs"], [output["name"] for output in description["outputs"]]
        inputs, layers, outputs = network(tensors)
        self.scaling = [*inputs, *outputs]
        self.layers = [(weight.T.copy(), bias) for weight, bias in layers]

    def by_numpy(self, x):
        mean, scale, output_mean, output_scale = self.scaling
        x = (x - mean) / scale
        for weight, bias in self.layers[:-1]:
            x = np.tanh(x @ weight + bias)
        return (x @ self.layers[-1][0] + self.layers[-1][1]) * output_scale + output_mean

    def onnx_session(self):
        import onnxruntime
        from onnx import TensorProto, helper, numpy_helper

        nodes, constants, x = [], [], "x"
        for i, layer in enumerate(self.layers):
            last = i + 1 == len(self.layers)
            constants += [numpy_helper.from_array(array.astype(np.float32), f"{name}{i}") for name, array in zip("wb", layer)]
            nodes.append(helper.make_node("Gemm", [x, f"w{i}", f"b{i}"], ["y" if last else f"z{i}"]))
            if not last:
                x = f"a{i}"
                nodes.append(helper.make_node("Tanh", [f"z{i}"], [x]))
        sizes = ("x", len(self.inputs)), ("y", len(self.outputs))
        values = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [None, size]) for name, size in sizes]
        graph = helper.make_graph(nodes, "network", values[:1], values[1:], constants)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        return onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])

    def by_onnx(self, session, x):
        mean, scale, output_mean, output_scale = self.scaling
        [y] = session.run(None, {"x": ((x - mean) / scale).astype(np.float32)})
        return y * output_scale + output_mean


def by_pandas(network, evaluate, table, out):
    """Seconds to read, evaluate, write, and for all of it."""
    times = [time.perf_counter()]
    read = pd.read_csv if table.suffix == ".csv" else pd.read_parquet
    x = read(table)[[variable["name"] for variable in network.inputs]].to_numpy()
    times.append(time.perf_counter())
    y = np.concatenate([evaluate(x[start : start + BLOCK]) for start in range(0, len(x), BLOCK)])
    times.append(time.perf_counter())
    result = pd.DataFrame(y, columns=network.outputs)
    result.to_csv(out, index=False) if out.suffix == ".csv" else result.to_parquet(out)
    times.append(time.perf_counter())
    return np.append(np.diff(times), times[-1] - times[0])


def processor_time():
    """Processor time of this process and of those that it has started, on all cores."""
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def by_metafmu(model, table, out):
    command = [METAFMU, "predict", model, table, "--out", out, "--json"]
    start = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    seconds, summary = time.perf_counter() - start, json.loads(done.stdout)
    return np.array([*(summary[f"{part}_seconds"] for part in ("read", "evaluate", "write")), seconds])


def main():
    parser = argparse.ArgumentParser(description=__doc__.split(":")[0])
    parser.add_argument("model", type=Path)
    parser.add_argument("--rows", type=int, default=10_000_000, help="%(default)s unless given")
    parser.add_argument("--rounds", type=int, default=3, help="%(default)s unless given")
    options = parser.parse_args()
    network = Network(options.model)
    random = np.random.default_rng(0)
    points = {v["name"]: random.uniform(v["min"], v["max"], options.rows) for v in network.inputs}
    ways = {"metafmu": None, "pandas, numpy": network.by_numpy}
    try:
        session = network.onnx_session()
        ways["pandas, onnxruntime (single)"] = lambda x: network.by_onnx(session, x)
    except ImportError:
        print("onnxruntime and onnx are not installed")
    with tempfile.TemporaryDirectory() as folder:
        tables = [Path(folder, "in.csv"), Path(folder, "in.parquet")]
        pd.DataFrame(points).to_csv(tables[0], index=False)
        pd.DataFrame(points).to_parquet(tables[1])
        least = {}
        for _ in range(options.rounds):
            for table in tables:
                for way, evaluate in ways.items():
                    out = Path(folder, f"out{table.suffix}")
                    before = processor_time()
                    times = by_metafmu(options.model, table, out) if evaluate is None else by_pandas(network, evaluate, table, out)
                    times, key = np.append(times, processor_time() - before), (table.suffix[1:], way)
                    least[key] = min(least.get(key, times), times, key=lambda times: times[-1])
    print(f"{options.rows:,} rows, seconds\n")
    print("| table | with | read | evaluate | write | all | processor time |\n|---|---|---|---|---|---|---|")
    for (kind, way), times in least.items():
        print(f"| {kind} | {way} | {' | '.join(f'{seconds:.1f}' for seconds in times)} |")


if __name__ == "__main__":
    main()
