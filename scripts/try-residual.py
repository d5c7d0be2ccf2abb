"""Whether residual connections earn their place: the same network with and without them, on the runs of a study.

    .venv/bin/pip install -r scripts/bench-requirements.txt
    metafmu sample examples/single-pendulum.toml --out out/residual
    .venv/bin/python scripts/try-residual.py out/residual --parameters 3

Trains in PyTorch with an independent SOAP (the package pytorch_optimizer) and the schedule of `metafmu train`. A hidden layer after
the first computes tanh(W x + b), with a residual connection x + tanh(W x + b) or, over two layers, x + tanh(W2 tanh(W1 x + b1) + b2).
"""

import argparse
import math
import time

import numpy as np
import pandas as pd


def network(inputs, outputs, depth, width, span):
    """`span`: hidden layers that a residual connection skips; 0: there are none."""
    import torch

    class Net(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.first = torch.nn.Linear(inputs, width)
            self.hidden = torch.nn.ModuleList(torch.nn.Linear(width, width) for _ in range(depth - 1))
            self.last = torch.nn.Linear(width, outputs)

        def forward(self, x):
            x = kept = torch.tanh(self.first(x))
            for number, layer in enumerate(self.hidden, 1):
                x = torch.tanh(layer(x))
                if span and number % span == 0:
                    x = kept = kept + x
            return self.last(x)

    return Net()


def rows(file, parameters):
    table = pd.read_csv(file)
    columns = ["time", *table.columns[2 : 2 + parameters]]
    return table[columns].to_numpy(), table[table.columns[2 + parameters :]].to_numpy()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder")
    parser.add_argument("--parameters", type=int, required=True, help="how many columns after `run,time` are parameters")
    parser.add_argument("--width", type=int, default=64)
    parser.add_argument("--depths", type=int, nargs="+", default=[6, 10])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--steps", type=int, default=5000)
    parser.add_argument("--rate", type=float, default=5e-3)
    parser.add_argument("--batch", type=int, default=1024)
    arguments = parser.parse_args()
    # not above, as --help needs none of them
    import torch
    from pytorch_optimizer import SOAP

    x, y = rows(f"{arguments.folder}/train.csv", arguments.parameters)
    x_test, y_test = rows(f"{arguments.folder}/test.csv", arguments.parameters)
    mean, scale, y_mean, y_scale = x.mean(0), x.std(0), y.mean(0), y.std(0)
    tensor = lambda values: torch.tensor(values, dtype=torch.float32)
    x, y = tensor((x - mean) / scale), tensor((y - y_mean) / y_scale)
    x_test = tensor((x_test - mean) / scale)

    for depth in arguments.depths:
        for span in (0, 1, 2):
            found = []
            for seed in range(arguments.seeds):
                torch.manual_seed(seed)
                net = network(x.shape[1], y.shape[1], depth, arguments.width, span)
                optimizer = SOAP(net.parameters(), lr=arguments.rate, betas=(0.95, 0.95), weight_decay=0.0)
                begin = time.process_time()
                for step in range(arguments.steps):
                    batch = torch.randint(len(x), (arguments.batch,))
                    rise = min(1.0, (step + 1) / (0.03 * arguments.steps))
                    rate = rise * 0.5 * (1 + math.cos(math.pi * step / arguments.steps))
                    for group in optimizer.param_groups:
                        group["lr"] = arguments.rate * max(rate, 1e-4)
                    optimizer.zero_grad()
                    torch.nn.functional.mse_loss(net(x[batch]), y[batch]).backward()
                    optimizer.step()
                seconds = time.process_time() - begin
                with torch.no_grad():
                    predicted = net(x_test).double().numpy() * y_scale + y_mean
                unexplained = ((y_test - predicted) ** 2).mean(0) / y_test.var(0)
                largest = (abs(y_test - predicted).max(0) / np.ptp(y_test, 0)).max()
                found.append((unexplained.max(), largest, seconds))
            text = ", ".join(f"{u:.2e} {l:.1e} {s:.0f} s" for u, l, s in found)
            print(f"{depth} x {arguments.width}, residual over {span}: largest 1 - R2, largest error of the range: {text}", flush=True)


if __name__ == "__main__":
    main()
