"""Prints the tables of docs/dynamics-measurements.md: surrogates with states of the mechanisms in examples/dynamics/, as exported and by networks alone.

For each, `metafmu new --structure dynamics` writes a study, in which only `stop` and `step` are changed, and `metafmu build` does the rest.
For networks alone, `[dynamics]` asks for them. Needs target/release/metafmu.

Usage: python3 scripts/measure dynamics [--networks] [MECHANISM ...]
"""

import argparse
import json
import resource
import subprocess
import tempfile
from pathlib import Path

from common import METAFMU, ROOT

MECHANISMS = ["pendulum", "crane", "servo-crane", "double-pendulum", "quarter-car", "slider-crank", "four-bar"]


HORIZONS = "10 s: median, 90 % (start perturbed by 1e-9) | 60 s"
HEADINGS = {
    False: f"| mechanism | products: equations + positions | error at unseen configurations | {HORIZONS} | energy | build, s of processor time |",
    True: f"| mechanism | accelerations at unseen states | {HORIZONS} | energy |",
}


def row(name, folder, networks):
    """The line of a mechanism."""
    mechanism = ROOT / "examples" / "dynamics" / f"{name}.toml"
    subprocess.run([METAFMU, "new", name, "--mechanism", mechanism, "--structure", "dynamics"], cwd=folder, check=True, capture_output=True)
    study = folder / f"{name}.toml"
    text = study.read_text()
    for old, new in [("stop = 10.0 ", "stop = 60.0 "), ("step = 0.02 ", "step = 0.05 ")]:
        assert old in text, (name, old)
        text = text.replace(old, new, 1)
    if networks:
        # however poor they are
        text += "\n[dynamics]\nmodel = \"network\"\n\n[accept]\nr2 = -inf\nbaseline_factor = inf\nangle_error = inf\n"
    study.write_text(text)
    before = processor_time()
    subprocess.run([METAFMU, "build", study.name], cwd=folder, check=True, capture_output=True)
    seconds = processor_time() - before
    metrics = json.loads((folder / "out" / name / "metrics.json").read_text())
    motion, roll_outs = metrics["motion"], metrics["roll_outs"]
    horizons = [f"{h['median']:.0e}, {h['q90']:.0e} ({h['sensitivity'][0]:.0e}, {h['sensitivity'][1]:.0e})" for h in roll_outs["horizons"]]
    drift = roll_outs.get("energy_drift")
    energy = "-" if drift is None else f"{drift:.0e}"
    if networks:
        error = next(candidate["error"] for candidate in motion["candidates"] if candidate["name"] == "network")
        return f"| {name} | {error:.0e} | {horizons[0]} | {horizons[1]} | {energy} |"
    products = " + ".join(str(count) for count in motion["products"])
    return f"| {name} | {products} | {motion['error']:.0e} | {horizons[0]} | {horizons[1]} | {energy} | {seconds:.0f} |"


def processor_time():
    """Processor time of all finished commands, in s: other work on the machine changes it less than the wall time."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mechanisms", nargs="*", default=MECHANISMS, metavar="MECHANISM", help="all unless given")
    parser.add_argument("--networks", action="store_true", help="by networks alone")
    options = parser.parse_args()
    heading = HEADINGS[options.networks]
    print(heading)
    print("|---" * (heading.count("|") - 1) + "|", flush=True)
    for name in options.mechanisms:
        with tempfile.TemporaryDirectory() as folder:
            print(row(name, Path(folder), options.networks), flush=True)


if __name__ == "__main__":
    main()
