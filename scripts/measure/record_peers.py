"""The peers of `records`: jax-sysid and an LSTM in PyTorch, trained in as much processor time as metafmu's build takes.

Both have the rows for estimation, in parts:

- jax-sysid: states of the next sample from a linear part, which its LinearModel finds first, and a network; Adam, then L-BFGS. The states at the
  start of a part are fitted, those of a test by `learn_x0` from its measured samples.
- LSTM: windows of the rows, Adam with a cosine schedule over the budget; the weights that are best on the last tenth of the rows. In a test it has seen
  the inputs of the measured samples.
"""

import numpy as np
import peer_models

GIVEN = 50
# rows of a part, states and nodes of jax-sysid; rows of a window of the LSTM, those that do not count, and nodes
SIZES = {"cascaded-tanks": (1024, 3, 6, 150, 50, 24), "silverbox": (2048, 2, 8, 300, 50, 24)}
# updates of the LSTM between two choices
LOOK = 25


def jax_sysid(training, tests, seconds, seed, sizes):
    rows, *sizes = sizes[:3]
    count = max(len(training) // rows, 1)
    parts = [(part[:, :1], part[:, 1:]) for part in np.array_split(training[: count * rows], count)]
    model, spent = peer_models.state_space(parts, seconds, sizes, seed, False, (200, 100, 100), 1e-6)

    def simulated(test):
        start = model.learn_x0(test[:GIVEN, :1], test[:GIVEN, 1:])
        return np.array(model.predict(start, test[:, :1])[0]).ravel()

    return [simulated(test) for test in tests], spent


def lstm(training, tests, seconds, seed, sizes):
    rows, washout, nodes = sizes[3:]
    held_out = training[-(len(training) // 10) :]
    seen = training[: -len(held_out)]

    def window(random):
        start = random.integers(0, len(seen) - rows)
        return seen[start : start + rows].T

    simulated, spent = peer_models.lstm(window, held_out.T[:, None], seconds, nodes, seed, washout, LOOK)
    return [simulated(test[None, :, 0])[0] for test in tests], spent


METHODS = {"jax-sysid": jax_sysid, "LSTM": lstm}


def errors(method, name, training, tests, seconds, seed):
    """Root mean square errors of the tests, in the unit of the record, after a training of `seconds` of processor time."""
    mean, scale = training.mean(axis=0), training.std(axis=0)
    standardized = [(test - mean) / scale for test in tests]
    outputs, _ = METHODS[method]((training - mean) / scale, standardized, seconds, seed, SIZES[name])
    rests = [(output - test[:, 1])[GIVEN:] for output, test in zip(outputs, standardized)]
    return [scale[1] * np.sqrt(np.mean(rest**2)) for rest in rests]
