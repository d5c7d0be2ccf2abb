"""Compares a surrogate learned from inputs and outputs only with jax-sysid and an LSTM in PyTorch, on the same runs.

The runs are those of examples/dynamics/bouc-wen/make_table.py: the same for training, and ten unseen ones, which are simulated from rest.
metafmu builds the FMU from the command line, and fmpy steps it. The others get as much processor time (user and system, that of
compiling included) for training as the build has taken, or --minutes, on as many threads as they want:

- jax-sysid: states of the next sample from a linear part, which its LinearModel finds first, and a network; Adam, then L-BFGS, as in its
  documentation. The runs are experiments from x0 = 0.
- LSTM: standardised force and position, windows of the runs, Adam with a cosine schedule over the budget; the weights that are best in
  simulations of held-out runs.

Several sizes of each are tried, each with the whole budget; the table has all. Needs target/release/metafmu, and fmpy, torch, jax-sysid:

    pip install torch==2.15.0 jax-sysid==1.1.0 fmpy

Usage: python3 scripts/measure peers [--minutes M] [--only metafmu|jax-sysid|lstm]
"""

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from common import METAFMU, ROOT

EXAMPLE = ROOT / "examples" / "dynamics" / "bouc-wen"
sys.path.insert(0, str(EXAMPLE))
import make_table  # noqa: E402

# of the LSTM: runs that choose the best weights; learning rate, windows of a batch, their rows, and those that do not count
HELD_OUT = 2
RATE, BATCH, WINDOW, WASHOUT = 1e-2, 32, 300, 100


def error(found, truth):
    """RMS error of all unseen runs, and the same relative to the standard deviation."""
    rms = float(np.sqrt(np.mean((found - truth) ** 2)))
    return rms, rms / truth.std()


def metafmu(unseen):
    """The FMU in fmpy, and the processor time of its build."""
    from fmpy import simulate_fmu

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_table.write(folder / "bouc-wen.csv", *make_table.runs(1, 22))
        (folder / "bouc-wen.toml").write_text((EXAMPLE / "bouc-wen.toml").read_text())
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([METAFMU, "build", folder / "bouc-wen.toml", "--out", folder / "out"], check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        found = []
        for forces in unseen[0]:
            # held between two rows: a jump at each
            times = np.arange(forces.size) * make_table.STEP
            signal = np.array(list(zip(times, forces)), dtype=[("time", float), ("force", float)])
            result = simulate_fmu(
                str(folder / "out" / "bouc-wen.fmu"), input=signal, output=["position"], stop_time=times[-1],
                output_interval=make_table.STEP, fmi_type="CoSimulation",
            )
            found.append(result["position"])
    return error(np.array(found), unseen[1]), seconds


def standardised(runs):
    forces, positions = runs
    return forces / forces.std(), positions / positions.std(), positions.std()


def jax_sysid(runs, unseen, budget, states, nodes):
    """States `x+ = A x + B u + W3 tanh(W1 x + W2 u + b1)`, output `y = C x`."""
    began = time.process_time()
    import jax
    import jax.numpy as jnp
    from jax_sysid.models import LinearModel, Model

    jax.config.update("jax_enable_x64", True)
    (forces, positions, scale), force_scale = standardised(runs), runs[0].std()
    U, Y = [force[:, None] for force in forces], [position[:, None] for position in positions]
    linear = LinearModel(states, 1, 1, feedthrough=False)
    linear.loss(rho_x0=1e-3, rho_th=1e-6, train_x0=False)
    linear.optimization(adam_epochs=100, lbfgs_epochs=100, iprint=-1)
    linear.fit(list(Y), list(U))
    A, B, C = (np.array(matrix) for matrix in linear.ssdata()[:3])

    def state_fcn(x, u, params):
        A, B, W1, W2, b1, W3, _ = params
        return A @ x + B @ u + W3 @ jnp.tanh(W1 @ x + W2 @ u + b1)

    def output_fcn(x, u, params):
        return params[-1] @ x

    random = np.random.default_rng(1)
    draw = lambda *shape: 0.1 * random.standard_normal(shape)
    parameters = [A, B, draw(nodes, states), draw(nodes, 1), np.zeros(nodes), 0.1 * draw(states, nodes), C]
    best, first = None, True
    # Adam, then L-BFGS, in parts as long as there is time
    while time.process_time() - began < budget:
        model = Model(states, 1, 1, state_fcn=state_fcn, output_fcn=output_fcn)
        model.init(params=[jnp.array(value) for value in parameters], x0=jnp.zeros(states))
        model.loss(rho_x0=1e-3, rho_th=1e-8, train_x0=False)
        model.optimization(adam_eta=1e-3, adam_epochs=300 if first else 0, lbfgs_epochs=0 if first else 200, iprint=-1)
        model.fit(list(Y), list(U))
        parameters, first, best = [np.array(value) for value in model.params], False, model
    found = []
    for force in unseen[0]:
        found.append(np.array(best.predict(np.zeros(states), (force / force_scale)[:, None])[0]).ravel() * scale)
    return error(np.array(found), unseen[1]), time.process_time() - began


def lstm(runs, unseen, budget, nodes):
    began = time.process_time()
    import torch

    torch.manual_seed(1)
    (forces, positions, scale), force_scale = standardised(runs), runs[0].std()
    u, y = (torch.tensor(values, dtype=torch.float32)[:, :, None] for values in (forces, positions))

    class Network(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.lstm = torch.nn.LSTM(1, nodes, batch_first=True)
            self.output = torch.nn.Linear(nodes, 1)

        def forward(self, u):
            return self.output(self.lstm(u)[0])

    network = Network()
    optimizer = torch.optim.Adam(network.parameters(), lr=RATE)
    held_out = np.arange(len(u) - HELD_OUT, len(u))
    random = np.random.default_rng(1)
    best, kept, updates = np.inf, None, 0
    while (share := (time.process_time() - began) / budget) < 1:
        for group in optimizer.param_groups:
            group["lr"] = RATE * 0.5 * (1 + np.cos(np.pi * share))
        # windows of the runs from a state of zero, of which the first rows do not count
        drawn = random.integers(0, len(u) - HELD_OUT, BATCH), random.integers(0, u.shape[1] - WINDOW, BATCH)
        x, target = (torch.stack([values[run, row : row + WINDOW] for run, row in zip(*drawn)]) for values in (u, y))
        optimizer.zero_grad()
        torch.mean((network(x) - target)[:, WASHOUT:] ** 2).backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        updates += 1
        if updates % 50 == 0:
            with torch.no_grad():
                now = float(torch.mean((network(u[held_out]) - y[held_out]) ** 2))
            if now < best:
                best, kept = now, {name: value.clone() for name, value in network.state_dict().items()}
    network.load_state_dict(kept)
    with torch.no_grad():
        found = network(torch.tensor(unseen[0] / force_scale, dtype=torch.float32)[:, :, None])[:, :, 0].numpy() * scale
    return error(found, unseen[1]), time.process_time() - began


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, help="processor time of the others; that of the build unless given")
    parser.add_argument("--only", choices=["metafmu", "jax-sysid", "lstm"], help="no others")
    args = parser.parse_args()
    runs, unseen = make_table.runs(1, 22), make_table.runs(2, 10)
    budget = 60.0 * args.minutes if args.minutes else None
    print("| | RMS error, m | of the standard deviation | processor time, s |\n|---|---|---|---|")

    def row(name, result):
        (rms, relative), seconds = result
        print(f"| {name} | {rms:.2e} | {relative:.2%} | {seconds:.0f} |", flush=True)
        return seconds

    if args.only in (None, "metafmu"):
        seconds = row("metafmu", metafmu(unseen))
        budget = budget or seconds
    if args.only in (None, "jax-sysid"):
        for states, nodes in [(4, 16), (4, 32), (6, 16)]:
            row(f"jax-sysid, {states} states, {nodes} nodes", jax_sysid(runs, unseen, budget, states, nodes))
    if args.only in (None, "lstm"):
        for nodes in [16, 32, 64]:
            row(f"LSTM, {nodes} nodes", lstm(runs, unseen, budget, nodes))


if __name__ == "__main__":
    main()
