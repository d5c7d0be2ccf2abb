"""Measures surrogates of the mechanisms in examples/dynamics/parts, and of chains with other numbers of links.

Each is built from the study that `metafmu new` writes. The table has the products in the equations and the largest error of any output on
20 unseen runs relative to its range. Further columns are the processor time of both commands and the speedup of the surrogate over its
source.

Usage: .venv/bin/python scripts/measure parts [--chains 10] [--out FOLDER] [PART]...
"""

import argparse
import json
import re
import resource
from pathlib import Path

from common import ROOT, run

PARTS = ROOT / "examples" / "dynamics" / "parts"
# of more links than these, no parameter varies
MOST_LINKS = 10
LABELS = {"wishbone": "double wishbone with stops", "chain": "chain of 5 links", "chain10": "chain of 10 links"}


def chain(links):
    """The chain of the examples with another number of links."""
    text = (PARTS / "chain.toml").read_text()
    first, last = text.index("[bodies.link4]"), text.index("[bodies.link5]")
    link, rest = text[first:last], text[last:]
    position = float(re.search(r"position = \[0, (.*?)\]", link)[1])
    length = -position / 3.5

    def renumbered(text, number, before):
        text = re.sub(r"\b(link|j|s)(\d+)\b", lambda name: f"{name[1]}{int(name[2]) + number - before}", text)
        # what measures the first link stays
        text = text.replace(f"j{number - before + 1}.angle\" }}", "j1.angle\" }")
        return re.sub(r"position = \[0, .*?\]", f"position = [0, {-length * (number - 0.5):.6g}]", text)

    links_between = [renumbered(link, number, 4) for number in range(4, links)]
    text = text[:first] + "".join(links_between) + renumbered(rest, links, 5)
    return text if links <= MOST_LINKS else re.sub(r"(m = \{ default = [\d.]+), min = .*?, max = .*?,", r"\1,", text)


def measure(folder, name, mechanism):
    def spent():
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        return usage.ru_utime + usage.ru_stime

    (folder / f"{name}-mechanism.toml").write_text(mechanism)
    (folder / f"{name}.toml").unlink(missing_ok=True)
    before = spent()
    run(folder, "new", name, "--mechanism", f"{name}-mechanism.toml", "--structure", "dynamics")
    run(folder, "build", f"{name}.toml")
    metrics = json.loads((folder / "out" / name / "metrics.json").read_text())
    error = max(output["relative_max_error"] for output in metrics["outputs"].values())
    products = metrics["motion"]["products"][0]
    print(f"| {LABELS.get(name, name)} | {products} | {error:.1e} | {spent() - before:.0f} | {metrics['speed']['speed_up']:.0f} |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    names = sorted(file.stem for file in PARTS.glob("*.toml"))
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(names)}; all unless given")
    parser.add_argument("--chains", nargs="*", type=int, default=[], metavar="LINKS", help="numbers of links, 5 or more, of further chains")
    parser.add_argument("--out", type=Path, default=Path("out/parts"), help="folder for the builds")
    options = parser.parse_args()
    if unknown := set(options.parts) - set(names):
        parser.error(f"no {', '.join(sorted(unknown))}, expected some of {', '.join(names)}")
    options.out.mkdir(parents=True, exist_ok=True)
    heading = "mechanism | products | largest error of 20 unseen runs of 10 s, of the range | CPU s of `new` and `build` | times as fast as the source"
    print(f"| {heading} |\n|---|---|---|---|---|")
    for name in options.parts or names:
        measure(options.out, name, (PARTS / f"{name}.toml").read_text())
    for links in options.chains:
        measure(options.out, f"chain{links}", chain(links))


if __name__ == "__main__":
    main()
