"""Time of an optimizer step beside PyTorch and JAX: scripts/measure training [--seconds S] [--rounds N] [--activation A]

The paper's three networks, Adam, mean squared error, the same rows in random order, one and two threads. Every tool takes its turn in every
round, in a separate process. The minimum and the median are over all samples of all rounds, each some 20 ms long ("jax epoch": an epoch).
The peak is that of the faster of numpy's and PyTorch's products of large square matrices, measured in the same rounds. scripts/venv.sh
--peers makes the environment .peers.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from common import ROOT

PEERS_PYTHON = ROOT / ".peers" / "bin" / "python"
NETWORKS = {
    "single-pendulum": ([4, 128, 128, 3], 64),
    "slider-crank": ([4, 128, 128, 7], 64),
    "double-pendulum": ([5, 64, 64, 64, 64, 4], 1024),
}
ROWS = 600_000  # more than the caches near the cores hold
PEERS = ["torch eager", "jax scan"]
# with the shuffling of all rows before each epoch compiled into it, as the training loops of JAX's documentation have it
OTHERS = ["jax epoch"]
SAMPLE = 0.02  # s
LABELS = {"metafmu": "metafmu", "torch eager": "PyTorch, fused Adam", "jax scan": "JAX, steps scanned", "jax epoch": "JAX, epoch with its shuffling scanned"}
ACTIVATIONS = ["relu", "tanh"]


def flop(sizes: list[int], batch: int) -> float:
    """Multiplications and additions of forward pass, backward pass and gradient; that of the inputs, which nobody needs,
    counts as well, as is usual."""
    return 6.0 * batch * sum(a * b for a, b in zip(sizes, sizes[1:]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=1.0, help="of measuring a tool, in each round")
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--activation", default="relu", choices=ACTIVATIONS)
    parser.add_argument("--python", default=None, help="an interpreter that has the packages, instead of that of .peers")
    options = parser.parse_args()
    python = options.python or PEERS_PYTHON
    build = ["cargo", "build", "--release", "--quiet", "--example", "training_speed"]
    subprocess.run(build, cwd=ROOT, check=True)
    with tempfile.TemporaryDirectory() as folder:
        measure(options, str(python), Path(folder))


def measure(options: argparse.Namespace, python: str, folder: Path) -> None:
    samples: dict[tuple[str, int, str], list[float]] = {}
    peaks: dict[int, list[float]] = {1: [], 2: []}
    for _ in range(options.rounds):
        for threads in (1, 2):
            peaks[threads] += worker(python, threads, "peak", "-", "-", options)
            for network in NETWORKS:
                rows = folder / f"{network}.f32"
                if not rows.exists():
                    run([python, __file__, "--worker", "rows", network, str(rows), "0", "-"], threads)
                for tool in LABELS:
                    found = worker(python, threads, tool, network, str(rows), options)
                    samples.setdefault((network, threads, tool), []).extend(found)
    report(samples, {threads: max(values) for threads, values in peaks.items()})


def worker(python: str, threads: int, tool: str, network: str, rows: str, options: argparse.Namespace) -> list[float]:
    arguments = [network, rows, str(options.seconds), options.activation]
    if tool == "metafmu":
        binary = ROOT / "target/release/examples/training_speed"
        return json.loads(run([str(binary), network, str(threads), *arguments[1:]], threads))
    return json.loads(run([python, __file__, "--worker", tool, *arguments], threads))


def run(command: list[str], threads: int) -> str:
    names = ["OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "BENCH_THREADS"]
    variables = os.environ | dict.fromkeys(names, str(threads))
    if threads == 1:
        variables["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    result = subprocess.run(command, env=variables, capture_output=True, text=True)
    if result.returncode != 0:
        sys.exit(f"{' '.join(command)} failed:\n{result.stderr}")
    return result.stdout.splitlines()[-1]


def report(samples: dict[tuple[str, int, str], list[float]], peaks: dict[int, float]) -> None:
    columns = [f"{name.replace('-', ' ')}, {'-'.join(map(str, sizes))}, batch {batch}" for name, (sizes, batch) in NETWORKS.items()]
    print(f"| µs a step, minimum (median) | {' | '.join(columns)} |\n{'|---' * (1 + len(columns))}|")
    shown = lambda value: f"{value:.3g}" if value < 1000 else f"{value:.0f}"
    of_threads = {1: "one thread", 2: "two threads"}
    for threads, named in of_threads.items():
        for tool, label in LABELS.items():
            times = [[1e6 * second for second in samples[network, threads, tool]] for network in NETWORKS]
            cells = [f"{shown(min(of))} ({shown(statistics.median(of))})" for of in times]
            print(f"| {label}, {named} | {' | '.join(cells)} |")
    for threads, named in of_threads.items():
        ours = [(flop(sizes, batch) / 1e9, samples[network, threads, "metafmu"]) for network, (sizes, batch) in NETWORKS.items()]
        print(f"| GFLOP/s of metafmu, {named} | {' | '.join(f'{work / min(times):.0f}' for work, times in ours)} |")
        print(f"| GFLOP/s of a large product, {named} |{f' {peaks[threads]:.0f} |' * len(ours)}")
    for threads, named in of_threads.items():
        cells = []
        for network in NETWORKS:
            # on two threads, of the peers on one or two
            ratios = [
                min(of(samples[network, number, peer]) for peer in PEERS for number in range(1, threads + 1)) / of(samples[network, threads, "metafmu"])
                for of in (min, statistics.median)
            ]
            cells.append(f"{ratios[0]:.2f} ({ratios[1]:.2f})")
        print(f"| time of the fastest peer without shuffling over ours, {named} | {' | '.join(cells)} |")


def work(tool: str, network: str, file: str, seconds: float, activation: str) -> None:
    """In the environment with the packages: prints a line of JSON with the seconds of each sample."""
    import numpy as np

    threads = int(os.environ["BENCH_THREADS"])
    if tool == "peak":
        print(json.dumps(peak(np, threads, seconds)))
        return
    sizes, batch = NETWORKS[network]
    if tool == "rows":
        random = np.random.default_rng(1)
        inputs = random.uniform(-1.7, 1.7, (ROWS, sizes[0]))
        outputs = np.sin(inputs @ random.normal(size=(sizes[0], sizes[-1])))
        np.hstack([inputs, outputs]).astype("<f4").tofile(file)
        print("[]")
        return
    rows = np.fromfile(file, "<f4").reshape(-1, sizes[0] + sizes[-1])
    inputs, targets = rows[:, : sizes[0]].copy(), rows[:, sizes[0] :].copy()
    order = np.random.default_rng(2).permutation(len(rows))
    order = order[: len(order) // batch * batch].reshape(-1, batch)
    make = jax_steps if tool.startswith("jax") else torch_steps
    steps = make(tool, threads, sizes, inputs, targets, order, activation)
    count = len(order)
    if tool not in OTHERS:
        steps(20)  # compiles
        count = max(1, round(SAMPLE / min(steps(20) for _ in range(5))))
    steps(count)
    times, end = [], time.perf_counter() + seconds
    while time.perf_counter() < end or not times:
        times.append(steps(count))
    print(json.dumps(times))


def peak(np, threads: int, seconds: float) -> list[float]:
    """GFLOP/s of products of square matrices, the best of each size."""
    import torch

    torch.set_num_threads(threads)
    best = []
    for size in (512, 1024, 2048):
        a, b = (np.random.default_rng(i).random((size, size), np.float32) for i in range(2))
        out = np.empty_like(a)
        ta, tb, tout = torch.from_numpy(a), torch.from_numpy(b), torch.from_numpy(out)
        for multiply in (lambda: np.matmul(a, b, out=out), lambda: torch.mm(ta, tb, out=tout)):
            times, end = [], time.perf_counter() + seconds / 6
            while time.perf_counter() < end or len(times) < 3:
                begin = time.perf_counter()
                multiply()
                times.append(time.perf_counter() - begin)
            best.append(2e-9 * size**3 / min(times))
    return best


def torch_steps(tool, threads, sizes, inputs, targets, order, activation):
    import torch

    torch.set_num_threads(threads)
    torch.manual_seed(0)
    layers = []
    for a, b in zip(sizes, sizes[1:]):
        layers += [torch.nn.Linear(a, b), torch.nn.ReLU() if activation == "relu" else torch.nn.Tanh()]
    network = torch.nn.Sequential(*layers[:-1])
    inputs, targets, order = torch.from_numpy(inputs), torch.from_numpy(targets), torch.from_numpy(order)
    optimizer = torch.optim.Adam(network.parameters(), lr=1e-3, fused=True)
    criterion = torch.nn.MSELoss()

    def loss(x, y):
        return criterion(network(x), y)

    position = 0

    def steps(count):
        nonlocal position
        begin = time.perf_counter()
        for _ in range(count):
            numbers = order[position % len(order)]
            optimizer.zero_grad(set_to_none=True)
            loss(inputs[numbers], targets[numbers]).backward()
            optimizer.step()
            position += 1
        return (time.perf_counter() - begin) / count

    return steps


def jax_steps(tool, threads, sizes, inputs, targets, order, activation):
    if threads == 1:
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    import jax
    import jax.numpy as jnp
    import optax

    function = jax.nn.relu if activation == "relu" else jnp.tanh
    parameters, key = [], jax.random.PRNGKey(0)
    for a, b in zip(sizes, sizes[1:]):
        key, other = jax.random.split(key)
        parameters.append((jax.random.uniform(other, (a, b), minval=-1, maxval=1) / a**0.5, jnp.zeros(b)))
    inputs, targets, order = jnp.asarray(inputs), jnp.asarray(targets), jnp.asarray(order)
    optimizer = optax.adam(1e-3)

    def loss(parameters, x, y):
        for weights, biases in parameters[:-1]:
            x = function(x @ weights + biases)
        return jnp.mean((x @ parameters[-1][0] + parameters[-1][1] - y) ** 2)

    def step(state, numbers):
        parameters, memory = state
        value, gradient = jax.value_and_grad(loss)(parameters, inputs[numbers], targets[numbers])
        updates, memory = optimizer.update(gradient, memory)
        return (optax.apply_updates(parameters, updates), memory), value

    @jax.jit
    def scan(state, batches):
        return jax.lax.scan(step, state, batches)

    @jax.jit
    def epoch(state, key):
        batches = jax.random.permutation(key, len(inputs))[: order.size].reshape(order.shape)
        return jax.lax.scan(step, state, batches)

    state, position = (parameters, optimizer.init(parameters)), 0

    def steps(count):
        nonlocal state, position, key
        if position + count > len(order):
            position = 0
        batches = jax.block_until_ready(order[position : position + count])
        position += count
        begin = time.perf_counter()
        if tool == "jax epoch":
            key, other = jax.random.split(key)
            state, values = epoch(state, other)
        else:
            state, values = scan(state, batches)
        values.block_until_ready()
        return (time.perf_counter() - begin) / count

    return steps


if __name__ == "__main__":
    if sys.argv[1:2] == ["--worker"]:
        tool, network, file, seconds, activation = sys.argv[2:]
        work(tool, network, file, float(seconds), activation)
    else:
        main()
