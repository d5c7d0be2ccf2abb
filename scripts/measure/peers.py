"""Compares a surrogate learned from inputs and outputs only with jax-sysid and an LSTM in PyTorch, on the same runs.

The runs are those of examples/dynamics/bouc-wen/make_table.py: the same for training, and ten unseen ones, which are simulated from rest.
metafmu builds the FMU from the command line, and fmpy steps it. The others get as much processor time (user and system, that of
compiling included) for training as the build has taken, or --minutes; the LSTM on one thread, where it needs the least of it:

- jax-sysid: states of the next sample from a linear part, which its LinearModel finds first, and a network; Adam, then L-BFGS, as in its
  documentation. The runs are experiments from x0 = 0.
- LSTM: standardized force and position, windows of the runs, Adam with a cosine schedule over the budget; the weights that are best in
  simulations of held-out runs.

Two sizes of each are tried, each with the whole budget; the table has all. Needs target/release/metafmu; scripts/venv.sh --peers installs the other
programs.

Usage: .peers/bin/python scripts/measure peers [--minutes M] [--only metafmu|jax-sysid|lstm]
"""

import argparse
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import peer_models
from common import METAFMU, ROOT

EXAMPLE = ROOT / "examples" / "dynamics" / "bouc-wen"
sys.path.insert(0, str(EXAMPLE))
import make_table  # noqa: E402

# of the LSTM: runs that choose the best weights, rows of a window, those that do not count, and updates between two choices
HELD_OUT, WINDOW, WASHOUT, LOOK = 2, 300, 100, 50


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


def standardized(runs):
    forces, positions = runs
    return forces / forces.std(), positions / positions.std(), positions.std()


def jax_sysid(runs, unseen, budget, states, nodes):
    (forces, positions, scale), force_scale = standardized(runs), runs[0].std()
    columns = [(force[:, None], position[:, None]) for force, position in zip(forces, positions)]
    model, seconds = peer_models.state_space(columns, budget, (states, nodes), 1, True, (100, 100, 200), 1e-8)
    found = [np.array(model.predict(np.zeros(states), (force / force_scale)[:, None])[0]).ravel() * scale for force in unseen[0]]
    return error(np.array(found), unseen[1]), seconds


def lstm(runs, unseen, budget, nodes):
    (forces, positions, scale), force_scale = standardized(runs), runs[0].std()

    def window(random):
        run, row = random.integers(0, len(forces) - HELD_OUT), random.integers(0, forces.shape[1] - WINDOW)
        return forces[run, row : row + WINDOW], positions[run, row : row + WINDOW]

    held_out = forces[-HELD_OUT:], positions[-HELD_OUT:]
    simulated, seconds = peer_models.lstm(window, held_out, budget, nodes, 1, WASHOUT, LOOK)
    return error(simulated(unseen[0] / force_scale) * scale, unseen[1]), seconds


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, help="processor time of the others; that of the build unless given")
    parser.add_argument("--only", choices=["metafmu", "jax-sysid", "lstm"], help="no others")
    args = parser.parse_args()
    runs, unseen = make_table.runs(1, 22), make_table.runs(2, 10)
    budget = 60.0 * args.minutes if args.minutes else None
    print("| | RMS error of the position, m | of the standard deviation | processor time, s |\n|---|---|---|---|")

    def row(name, result):
        (rms, relative), seconds = result
        print(f"| {name} | {rms:.2e} | {100 * relative:.2f} % | {seconds:.0f} |", flush=True)
        return seconds

    if args.only in (None, "metafmu"):
        seconds = row("metafmu", metafmu(unseen))
        budget = budget or seconds
    if args.only in (None, "jax-sysid"):
        for states, nodes in [(4, 16), (4, 32)]:
            row(f"jax-sysid, {states} states, {nodes} nodes", jax_sysid(runs, unseen, budget, states, nodes))
    if args.only in (None, "lstm"):
        for nodes in [32, 64]:
            row(f"LSTM, {nodes} nodes", lstm(runs, unseen, budget, nodes))


if __name__ == "__main__":
    main()
