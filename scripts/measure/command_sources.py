"""Builds surrogates of the programs in examples/commands: the table of docs/command-sources.md.

Programs without a study have the one that `metafmu new` proposes, with 300 runs for training and 50 for tests. Seconds are those of
`metafmu build`. The error is the largest one of any output in unseen runs, relative to its range. Needs target/release/metafmu, mujoco,
exudyn, scipy and awk.

Usage: .venv/bin/python scripts/measure command-sources [--out FOLDER] [NAME...]
"""

import argparse
import json
import re
import time
from pathlib import Path

from common import ROOT, run

EXAMPLES = ROOT / "examples" / "commands"
# of a study or a program: its words in the table
SOURCES = {
    "arm/arm.toml": "3 joints, 3 motors, a cable, MuJoCo",
    "arm/fall.toml": "the arm falls onto the floor",
    "arm/driven.toml": "the arm is driven onto the floor",
    "cable.toml": "a clamped cable with a mass, Exudyn",
    "spring_pendulum.py": "scipy",
    "shell/oscillation.toml": "awk",
}


def study_of(source, folder):
    if source.endswith(".toml"):
        return EXAMPLES / source
    name = Path(source).stem
    study = folder / f"{name}.toml"
    study.unlink(missing_ok=True)
    run(folder, "new", name, "--command", "python", EXAMPLES / source)
    text = re.sub(r"(?m)^runs = .*", "runs = 300", study.read_text())
    study.write_text(re.sub(r"(?m)^test_runs = .*", "test_runs = 50", text))
    return study


def row(source, folder):
    study = study_of(source, folder)
    out, began = folder / "out" / study.stem, time.monotonic()
    run(folder, "build", study, "--out", out)
    seconds = time.monotonic() - began
    found = re.search(r'(?m)^structure = "(\w+)"', study.read_text())
    structure = found[1] if found else "response"
    metrics = json.loads((out / "metrics.json").read_text())
    error, speed = max(output.get("relative_max_error", 0) for output in metrics["outputs"].values()), metrics["speed"]
    times = f"{1e3 * speed['surrogate']:.2g}, {1e3 * speed['source']:.2g}"
    print(f"| `{source}`: {SOURCES[source]} | {structure} | {seconds:.0f} | {100 * error:.2g} % | {times} | {speed['speed_up']:.3g} |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(SOURCES)}; all unless given")
    parser.add_argument("--out", type=Path, default=Path("out/command-sources"), help="folder for studies and builds")
    options = parser.parse_args()
    folder = options.out.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    print("| example | structure | build, s | error, worst output | a simulated second, ms: surrogate, source | ratio |\n|---|---|---|---|---|---|")
    for source in options.names or SOURCES:
        row(source, folder)


if __name__ == "__main__":
    main()
