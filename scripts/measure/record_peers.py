"""Simulates the test rows of the public records by jax-sysid and an LSTM in PyTorch, trained in as much processor time as metafmu's build takes.

Rows, splits, the 50 measured samples before a simulation and the errors are those of `records`. Both have the rows for estimation, in parts:

- jax-sysid: states of the next sample from a linear part, which its LinearModel finds first, and a network; Adam, then L-BFGS. The states at the
  start of a part are fitted, those of a test by `learn_x0` from its measured samples.
- LSTM: windows of the rows, Adam with a cosine schedule over the budget; the weights that are best on the last tenth of the rows. In a test it has seen
  the inputs of the measured samples.

FOLDER has cascaded-tanks.csv and silverbox.csv (nonlinearbenchmark.org). Needs numpy, and

    pip install torch==2.15.0 jax-sysid==1.1.0

Usage: python scripts/measure record-peers --data FOLDER --seconds S [--seeds 3] [--only jax-sysid|lstm] RECORD...
"""

import argparse
import time
from pathlib import Path

import numpy as np

GIVEN = 50
# rows of a part, states and nodes of jax-sysid; rows of a window of the LSTM, those that do not count, and nodes
SIZES = {"cascaded-tanks": (1024, 3, 6, 150, 50, 24), "silverbox": (2048, 2, 8, 300, 50, 24)}
# of the LSTM: learning rate, windows of a batch, and updates between two looks at the last rows
RATE, BATCH, LOOK = 1e-2, 32, 25


def jax_sysid(training, tests, seconds, seed, sizes):
    """States `x+ = A x + B u + W3 tanh(W1 x + W2 u + b1)`, output `y = C x + d`."""
    began = time.process_time()
    import jax
    import jax.numpy as jnp
    from jax_sysid.models import LinearModel, Model

    jax.config.update("jax_enable_x64", True)
    rows, states, nodes = sizes[:3]
    count = max(len(training) // rows, 1)
    parts = np.array_split(training[: count * rows], count)
    U, Y = [part[:, :1] for part in parts], [part[:, 1:] for part in parts]
    linear = LinearModel(states, 1, 1, feedthrough=False)
    linear.loss(rho_x0=1e-3, rho_th=1e-6)
    linear.optimization(adam_epochs=200, lbfgs_epochs=100, iprint=-1)
    linear.fit(list(Y), list(U))
    A, B, C = (np.array(matrix) for matrix in linear.ssdata()[:3])

    def state_fcn(x, u, params):
        A, B, W1, W2, b1, W3, _, _ = params
        return A @ x + B @ u + W3 @ jnp.tanh(W1 @ x + W2 @ u + b1)

    def output_fcn(x, u, params):
        return params[-2] @ x + params[-1]

    random = np.random.default_rng(seed)
    draw = lambda *shape: 0.1 * random.standard_normal(shape)
    parameters = [A, B, draw(nodes, states), draw(nodes, 1), np.zeros(nodes), 0.1 * draw(states, nodes), C, np.zeros(1)]
    first, best = True, None
    # Adam, then L-BFGS, in parts as long as there is time
    while best is None or time.process_time() - began < seconds:
        model = Model(states, 1, 1, state_fcn=state_fcn, output_fcn=output_fcn)
        model.init(params=[jnp.array(value) for value in parameters])
        model.loss(rho_x0=1e-3, rho_th=1e-6)
        model.optimization(adam_eta=1e-3, adam_epochs=300 if first else 0, lbfgs_epochs=0 if first else 100, iprint=-1)
        model.fit(list(Y), list(U))
        parameters, first, best = [np.array(value) for value in model.params], False, model
    spent = time.process_time() - began

    def simulated(test):
        start = best.learn_x0(test[:GIVEN, :1], test[:GIVEN, 1:])
        return np.array(best.predict(start, test[:, :1])[0]).ravel()

    return [simulated(test) for test in tests], spent


def lstm(training, tests, seconds, seed, sizes):
    """A layer of LSTM cells, and a linear one."""
    began = time.process_time()
    import torch

    torch.manual_seed(seed)
    window, washout, nodes = sizes[3:]
    single = lambda values: torch.tensor(np.array(values), dtype=torch.float32)[..., None]

    class Network(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.lstm = torch.nn.LSTM(1, nodes, batch_first=True)
            self.output = torch.nn.Linear(nodes, 1)

        def forward(self, u):
            return self.output(self.lstm(u)[0])

    network = Network()
    optimizer = torch.optim.Adam(network.parameters(), lr=RATE)
    held_out = training[-len(training) // 10 :]
    seen = training[: len(training) - len(held_out) + washout]
    random = np.random.default_rng(seed)
    best, kept, updates = np.inf, None, 0
    while kept is None or time.process_time() - began < seconds:
        share = min((time.process_time() - began) / seconds, 1)
        for group in optimizer.param_groups:
            group["lr"] = RATE * 0.5 * (1 + np.cos(np.pi * share))
        starts = random.integers(0, len(seen) - window, BATCH)
        u, y = (single([seen[start : start + window, column] for start in starts]) for column in (0, 1))
        optimizer.zero_grad()
        torch.mean((network(u) - y)[:, washout:] ** 2).backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        updates += 1
        if updates % LOOK == 0:
            with torch.no_grad():
                now = float(torch.mean((network(single([held_out[:, 0]])) - single([held_out[:, 1]]))[:, washout:] ** 2))
            if now < best:
                best, kept = now, {name: value.clone() for name, value in network.state_dict().items()}
    spent = time.process_time() - began
    network.load_state_dict(kept)
    with torch.no_grad():
        return [network(single([test[:, 0]])).numpy().ravel() for test in tests], spent


METHODS = {"jax-sysid": jax_sysid, "lstm": lstm}


def main():
    from records import RECORDS

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("record", nargs="+", metavar="RECORD", choices=list(RECORDS), help=f"of {', '.join(RECORDS)}")
    parser.add_argument("--data", required=True, type=Path, help="folder of the records")
    parser.add_argument("--seconds", required=True, type=float, help="processor time of each training")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--only", choices=list(METHODS), help="no others")
    options = parser.parse_args()
    for name in options.record:
        read, unit, factor, _ = RECORDS[name]
        _, training, tests = read(options.data / f"{name}.csv")
        mean, scale = training.mean(axis=0), training.std(axis=0)
        standardised = [(test - mean) / scale for test in tests.values()]
        for method in [options.only] if options.only else METHODS:
            found, spent = [], []
            for seed in range(1, options.seeds + 1):
                outputs, seconds = METHODS[method]((training - mean) / scale, standardised, options.seconds, seed, SIZES[name])
                errors = [(output - test[:, 1])[GIVEN:] for output, test in zip(outputs, standardised)]
                found.append([factor * scale[1] * np.sqrt(np.mean(error**2)) for error in errors])
                spent.append(seconds)
                print(f"{name}, {method}, seed {seed}: {' / '.join(f'{error:.3g}' for error in found[-1])} {unit}, {seconds:.0f} s", flush=True)
            print(f"{name}, {method}, median: {' / '.join(f'{error:.3g}' for error in np.median(found, axis=0))} {unit}, {np.median(spent):.0f} s")


if __name__ == "__main__":
    main()
