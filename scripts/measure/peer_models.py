"""The models of `peers` and `records`: a state space of jax-sysid, and an LSTM in PyTorch, trained in a given processor time."""

import time

import numpy as np

# of the LSTM: learning rate, windows of a batch
RATE, BATCH = 1e-2, 32


def state_space(runs, seconds, sizes, seed, from_rest, epochs, penalty):
    """States `x+ = A x + B u + W3 tanh(W1 x + W2 u + b1)`, output `y = C x`, with a constant unless runs begin at rest; and the seconds.

    `runs` are pairs of inputs and outputs, columns. LinearModel finds the linear part first; then Adam, then L-BFGS, in parts until the time is up.
    States at the start are 0 or fitted. `epochs` are those of LinearModel's Adam and L-BFGS and of a part of L-BFGS.
    """
    began = time.process_time()
    import jax
    import jax.numpy as jnp
    from jax_sysid.models import LinearModel, Model

    jax.config.update("jax_enable_x64", True)
    states, nodes = sizes
    U, Y = map(list, zip(*runs))
    starts = {"train_x0": False} if from_rest else {}
    linear = LinearModel(states, 1, 1, feedthrough=False)
    linear.loss(rho_x0=1e-3, rho_th=1e-6, **starts)
    linear.optimization(adam_epochs=epochs[0], lbfgs_epochs=epochs[1], iprint=-1)
    linear.fit(list(Y), list(U))
    A, B, C = (np.array(matrix) for matrix in linear.ssdata()[:3])

    def state_fcn(x, u, params):
        A, B, W1, W2, b1, W3 = params[:6]
        return A @ x + B @ u + W3 @ jnp.tanh(W1 @ x + W2 @ u + b1)

    def output_fcn(x, u, params):
        return sum(params[7:], params[6] @ x)

    random = np.random.default_rng(seed)
    draw = lambda *shape: 0.1 * random.standard_normal(shape)
    parameters = [A, B, draw(nodes, states), draw(nodes, 1), np.zeros(nodes), 0.1 * draw(states, nodes), C]
    parameters += [] if from_rest else [np.zeros(1)]
    first, best = True, None
    while best is None or time.process_time() - began < seconds:
        model = Model(states, 1, 1, state_fcn=state_fcn, output_fcn=output_fcn)
        model.init(params=[jnp.array(value) for value in parameters], **({"x0": jnp.zeros(states)} if from_rest else {}))
        model.loss(rho_x0=1e-3, rho_th=penalty, **starts)
        model.optimization(adam_eta=1e-3, adam_epochs=300 if first else 0, lbfgs_epochs=0 if first else epochs[2], iprint=-1)
        model.fit(list(Y), list(U))
        parameters, first, best = [np.array(value) for value in model.params], False, model
    return best, time.process_time() - began


def lstm(window, held_out, seconds, nodes, seed, washout, look):
    """A layer of LSTM cells and a linear one, as a function of inputs, and the seconds; Adam with a cosine schedule over the time.

    `window(random)` draws inputs and outputs of a window, of which the first `washout` rows do not count. The weights are those that are best on the
    inputs and outputs that are held out, shape `[runs, rows]`, which are simulated every `look` updates.
    """
    began = time.process_time()
    import torch

    # a second thread would cost more processor time than it saves in networks of this size
    torch.set_num_threads(1)
    torch.manual_seed(seed)
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
    unseen = [single(values) for values in held_out]
    random = np.random.default_rng(seed)
    best, kept, updates = np.inf, None, 0
    while kept is None or time.process_time() - began < seconds:
        share = min((time.process_time() - began) / seconds, 1)
        for group in optimizer.param_groups:
            group["lr"] = RATE * 0.5 * (1 + np.cos(np.pi * share))
        u, y = map(single, zip(*(window(random) for _ in range(BATCH))))
        optimizer.zero_grad()
        torch.mean((network(u) - y)[:, washout:] ** 2).backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        updates += 1
        if updates % look == 0:
            with torch.no_grad():
                now = float(torch.mean((network(unseen[0]) - unseen[1]) ** 2))
            if now < best:
                best, kept = now, {name: value.clone() for name, value in network.state_dict().items()}
    network.load_state_dict(kept)

    def simulated(u):
        with torch.no_grad():
            return network(single(u)).numpy()[..., 0]

    return simulated, time.process_time() - began
