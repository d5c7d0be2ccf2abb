#!/usr/bin/env python3
"""Builds the surrogates of docs/gallery.md, draws their pictures and writes the page.

    .venv/bin/python scripts/gallery.py [--folder out/gallery] [NAME]...      # with MuJoCo and the wheel for the arm

Each picture has a sketch, and two outputs in the unseen run with the largest error: the source and the FMU as `metafmu predict` computes it.
With NAME only these are built; with --built none is, and the results in the folder are drawn. Needs target/release/metafmu.
"""

import argparse
import csv
import json
import math
import os
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

from canvas import BLUE, FILL, GREEN, GREY, INK, ORANGE, SKY, Picture, around

ROOT = Path(__file__).resolve().parents[1]
METAFMU = ROOT / "target" / "release" / "metafmu"
PAGE = ROOT / "docs" / "gallery.md"
PICTURES = ROOT / "docs" / "gallery"
# below this distance in pixels a point of a curve is left out
FLAT = 0.15
INTRODUCTION = """# Gallery

This page shows eight surrogates, each with the commands that build it in a checkout.

Pictures show the unseen run with the largest error of a shown output: the source in gray, the FMU in blue. Points of the table are rows that
the model was not fitted to. Errors are the largest at any row of any unseen run, relative to the range of the output.
`scripts/gallery.py` builds the surrogates, draws the pictures and writes this page.
"""


@dataclass
class Surrogate:
    """An entry of the page: what the reader pastes in the root of a checkout, and what is drawn of the result."""

    title: str
    about: str
    commands: tuple
    folder: str
    # outputs, each with the label of its axis
    outputs: dict
    sketch: object


def pendulum(p):
    p.ground(50, 50, 130, 50)
    p.line((90, 50), (140, 150), width=2)
    p.line((90, 50), (90, 120), color=GREY, dash="4 4", width=1)
    p.turn(90, 50, 52, 270, 297, BLUE)
    p.text(84, 118, "`theta`", BLUE, anchor="end")
    p.hinge(90, 50)
    p.circle(140, 150, 12)
    p.text(124, 92, "`L`")


def slider_crank(p):
    p.ground(14, 153, 186, 153)
    p.bar(50, 120, 78, 82, width=9)
    p.bar(78, 82, 158, 137, width=9)
    p.box(158, 137, 34, 26)
    p.turn(50, 120, 24, 10, 110, BLUE)
    for x, y in ((50, 120), (78, 82), (158, 137)):
        p.hinge(x, y)
    p.text(58, 76, "`theta`", BLUE, anchor="end")
    p.text(158, 182, "`xB`", BLUE, anchor="middle")


def crane(p):
    p.ground(186, 62, 14, 62)
    p.box(90, 74, 46, 20)
    p.line((90, 84), (136, 158), width=1.5)
    p.line((90, 84), (90, 150), color=GREY, dash="4 4", width=1)
    p.turn(90, 84, 50, 270, 301, BLUE)
    p.text(84, 148, "`theta`", BLUE, anchor="end")
    p.circle(136, 158, 11)
    p.arrow(114, 74, 158, 74)
    p.text(146, 96, "`force`", ORANGE)
    p.text(60, 96, "`x`", BLUE, anchor="end")


def quarter_car(p):
    p.box(100, 62, 92, 28)
    p.text(100, 66, "`body`", BLUE, anchor="middle")
    p.spring(80, 76, 80, 118)
    p.damper(120, 118, 120, 76)
    p.box(100, 128, 68, 20)
    p.text(100, 132, "`wheel`", BLUE, anchor="middle")
    p.spring(100, 138, 100, 172, coils=5)
    p.line(*((20 + k * 4, 176 - 5 * math.sin(k / 5)) for k in range(41)), width=2)
    p.text(182, 166, "`road`", ORANGE, anchor="end")


def cam(p):
    outline = [around(96, 140, 26 + 18 * max(0.0, math.cos(math.radians(k - 60))) ** 2, k) for k in range(0, 360, 6)]
    p.line(*outline, closed=True, fill=FILL)
    p.hinge(96, 140)
    p.turn(96, 140, 56, 200, 290)
    p.text(46, 186, "`torque`", ORANGE)
    p.box(96, 86, 34, 36)
    p.text(120, 92, "`lift`", BLUE)
    p.spring(96, 68, 96, 32, coils=5)
    p.ground(130, 32, 62, 32)


def magnet(p):
    p.box(100, 52, 60, 30)
    for x in (80, 90, 100, 110, 120):
        p.line((x, 37), (x, 67), color=ORANGE, width=3)
    p.text(138, 56, "`current`", ORANGE)
    p.dimension(72, 70, 72, 116)
    p.text(66, 98, "`y`", BLUE, anchor="end")
    p.circle(100, 132, 17)
    p.arrow(100, 114, 100, 82, BLUE)
    p.ground(60, 170, 140, 170)


def table(p):
    for row in range(6):
        for column in range(4):
            p.box(46 + 36 * column, 58 + 20 * row, 36, 20, fill=SKY if row == 0 else "#FFFFFF" if column < 3 else FILL)
    for column, text in enumerate(("`rw`", "`r`", "…", "`flow`")):
        p.text(46 + 36 * column, 62, text, anchor="middle", size=11)


def arm(p):
    p.ground(30, 170, 110, 170)
    p.box(70, 158, 34, 24)
    p.bar(70, 146, 96, 84, width=12)
    p.bar(96, 84, 152, 104, width=10)
    p.hinge(70, 146)
    p.hinge(96, 84)
    p.circle(158, 118, 9)
    p.line((152, 104), (158, 110))
    p.mark(152, 104, BLUE)
    p.text(150, 92, "`tip`", BLUE)
    p.turn(70, 146, 26, 20, 70)
    p.text(102, 142, "motors", ORANGE)


def of_mechanism(name, file):
    return (f"metafmu new {name} --mechanism {file} --structure dynamics", f"metafmu build {name}.toml")


SURROGATES = {
    "pendulum": Surrogate(
        "A pendulum", "A response surrogate: length, damping and initial speed are parameters, the time is an input of one network. It plays back two seconds, more slowly than its source, which solves two equations: it shows the method.",
        ("metafmu build examples/quick/single-pendulum.toml",), "single-pendulum-quick", {"theta": "rad", "thetad": "rad/s"}, pendulum,
    ),
    "slider-crank": Surrogate(
        "A slider crank", "A closed loop, driven from rest by an angular acceleration whose frequency is a parameter. One network has seven outputs.",
        ("metafmu build examples/quick/slider-crank.toml",), "slider-crank-quick", {"xB": "m", "phidd": "rad/s2"}, slider_crank,
    ),
    "crane": Surrogate(
        "A crane", "A component with states: a force drives the trolley, the load swings and may turn over. Its equations of motion are learned, not its runs.",
        ("metafmu build examples/dynamics/crane-study.toml",), "crane", {"x": "m", "theta": "rad"}, crane,
    ),
    "quarter-car": Surrogate(
        "A quarter car", "Suspension and tire are formulas of the mechanism file, which the FMU keeps. The height of the road is an input.",
        of_mechanism("quarter-car", "examples/dynamics/quarter-car.toml"), "quarter-car", {"body": "m", "wheel": "m"}, quarter_car,
    ),
    "cam": Surrogate(
        "A cam and a valve", "The lift is a periodic cubic table, which the equations contain exactly with its first two derivatives.",
        of_mechanism("cam", "examples/dynamics/parts/cam.toml"), "cam", {"speed": "rad/s", "lift": "m"}, cam,
    ),
    "magnet": Surrogate(
        "A levitated ball", "The force of the magnet grows with the square of current over gap; stops at both ends are stiff. Both are formulas.",
        of_mechanism("magnet", "examples/dynamics/parts/magnet.toml"), "magnet", {"y": "m", "speed": "m/s"}, magnet,
    ),
    "table": Surrogate(
        "A table of points", "A static map of eight inputs, from 200 points of the flow through a borehole. The best of three kinds of model is exported.",
        ("metafmu build examples/tables/borehole.toml",), "borehole", {"flow": "m3/yr"}, table,
    ),
    "arm": Surrogate(
        "A robot arm in MuJoCo", "The source is a Python program: three joints, three motors, a payload whose mass is a parameter, and a cable. It needs `pip install mujoco`.",
        ("metafmu build examples/commands/arm/arm.toml",), "arm", {"tip.x": "m", "tip.z": "m"}, arm,
    ),
}


def build(name, folder):
    """Runs the commands of the page in a folder, which sees the examples of the checkout."""
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "examples").exists():
        (folder / "examples").symlink_to(ROOT / "examples")
    path = os.pathsep.join([str(METAFMU.parent), str(ROOT / ".venv" / "bin"), os.environ["PATH"]])
    for command in SURROGATES[name].commands:
        if command.startswith("metafmu new "):
            (folder / f"{command.split()[2]}.toml").unlink(missing_ok=True)
        done = subprocess.run(command.split(), cwd=folder, capture_output=True, text=True, env={**os.environ, "PATH": path})
        if done.returncode:
            raise SystemExit(f"error: {command}: {done.stderr}")


def columns(text):
    """Columns of a CSV table by name."""
    rows = list(csv.reader(text.splitlines()))
    return dict(zip(rows[0], zip(*rows[1:])))


def flat(values):
    return [float(value) for value in values]


def results(name, folder):
    """Columns of the unseen runs: labels or None, times, and truth and prediction of each output."""
    one, folder = SURROGATES[name], folder / "out" / SURROGATES[name].folder
    if (folder / "unseen.csv").exists():
        table = columns((folder / "unseen.csv").read_text(encoding="utf-8"))
        return None, None, {output: (flat(table[output]), flat(table[f"predicted {output}"])) for output in one.outputs}
    fmu = folder / f"{one.folder}.fmu"
    truth = columns((folder / "test.csv").read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "predicted.csv"
        subprocess.run([METAFMU, "predict", fmu, folder / "test.csv", "--out", out, "--outputs", ",".join(one.outputs)], check=True, capture_output=True)
        found = columns(out.read_text(encoding="utf-8"))
    return truth["run"], flat(truth["time"]), {output: (flat(truth[output]), flat(found[output])) for output in one.outputs}


def accuracy(name, folder):
    """Sentence on the errors in unseen runs or rows, from metrics.json."""
    metrics = json.loads((folder / "out" / SURROGATES[name].folder / "metrics.json").read_text(encoding="utf-8"))
    largest = max(of["relative_max_error"] for of in metrics["outputs"].values())
    runs = "rows" if metrics["test_rows"] == metrics["test_runs"] else "runs"
    kept = f"{100 * largest:.1g} %" if largest >= 1e-5 else "less than 0.001 %"
    return f"Largest error of all outputs in {metrics['test_runs']} unseen {runs}: {kept} of the range."


def thinned(points):
    """Points of a curve without those that are nearly on the line between others (Ramer, Douglas and Peucker)."""
    kept, pieces = {0, len(points) - 1}, [(0, len(points) - 1)]
    while pieces:
        first, last = pieces.pop()
        (x0, y0), (x1, y1) = points[first], points[last]
        length = math.hypot(x1 - x0, y1 - y0) or 1.0
        off = [(abs((x1 - x0) * (y0 - y) - (x0 - x) * (y1 - y0)) / length, at) for at, (x, y) in enumerate(points[first + 1 : last], first + 1)]
        distance, at = max(off, default=(0.0, 0))
        if distance > FLAT:
            kept.add(at)
            pieces += [(first, at), (at, last)]
    return [points[at] for at in sorted(kept)]


def worst_row(truth, predicted, runs):
    """Largest error relative to the range of the truth, and its run."""
    width = max(truth) - min(truth)
    return max((abs(a - b) / width, run) for a, b, run in zip(truth, predicted, runs, strict=True))


def limits(values):
    """Limits of an axis, a little wider than the values."""
    low, high = min(values), max(values)
    room = 0.06 * (high - low)
    return low - room, high + room


def drawn(name, folder):
    """The picture of a surrogate that was built in a folder."""
    one = SURROGATES[name]
    runs, times, found = results(name, folder)
    p = Picture(alternative(name), width=760, height=218)
    one.sketch(p)
    if runs is None:
        draw_rows(p, one, found)
        return p.svg()
    worst = max(worst_row(truth, predicted, runs) for truth, predicted in found.values())[1]
    rows = [at for at, run in enumerate(runs) if run == worst]
    for panel, (output, unit) in enumerate(one.outputs.items()):
        time, truth, predicted = ([values[at] for at in rows] for values in (times, *found[output]))
        axes = p.axes(250 + 272 * panel, 36, 222, 140, (time[0], time[-1]), limits([*truth, *predicted]), x_label="time, s", y_label=f"`{output}`, {unit}")
        for values, color, width in ((truth, "#BBBBBB", 5), (predicted, BLUE, 1.5)):
            p.line(*thinned([axes.at(*point) for point in zip(time, values, strict=True)]), color=color, width=width)
    p.line((250, 206), (270, 206), color="#BBBBBB", width=5)
    p.text(276, 210, "source", size=11.5)
    p.line((326, 206), (346, 206), color=BLUE)
    p.text(352, 210, "FMU", size=11.5)
    return p.svg()


def draw_rows(p, one, found):
    """Predictions of unseen rows over the truth, and their errors."""
    for output, unit in one.outputs.items():
        truth, predicted = found[output]
        ends = limits([*truth, *predicted])
        axes = p.axes(250, 36, 222, 140, ends, ends, x_label=f"`{output}` of the table, {unit}", y_label=f"predicted `{output}`, {unit}")
        axes.line(ends, ends, color=GREY, width=1)
        axes.dots(truth, predicted, BLUE, radius=2.4)
        errors = [b - a for a, b in zip(truth, predicted, strict=True)]
        axes = p.axes(522, 36, 222, 140, ends, limits([*errors, 0.0]), x_label=f"`{output}` of the table, {unit}", y_label=f"error, {unit}")
        axes.dots(truth, errors, GREEN, radius=2.4)


def alternative(name):
    """Sentence that stands for a picture where it is not shown."""
    one = SURROGATES[name]
    if name == "table":
        return f"{one.title}: predictions of unseen rows over the truth, on a line, and their errors"
    return f"{one.title}: {' and '.join(one.outputs)} in the worst unseen run; source and FMU lie on each other"


def document(accuracies):
    """The text of the page. `accuracies`: sentences by name."""
    text = INTRODUCTION
    for name, one in SURROGATES.items():
        commands = "".join(f"    {command}\n" for command in one.commands)
        text += f"\n## {one.title}\n\n{one.about} {accuracies[name]}\n\n![{alternative(name)}](gallery/{name}.svg)\n\n{commands}"
    return text + "\nMore: [what mechanisms can have](mechanisms.md), [programs as sources](command-sources.md).\n"


def accuracies_of(page):
    """Sentences on accuracy in a page, by name."""
    found = {}
    for name, one in SURROGATES.items():
        start = page.index(one.about) + len(one.about) + 1
        found[name] = page[start : page.index("\n", start)]
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"{', '.join(SURROGATES)}; all unless given")
    parser.add_argument("--folder", type=Path, default=ROOT / "out" / "gallery", help="where they are built [default: out/gallery]")
    parser.add_argument("--built", action="store_true", help="only draw what was built before")
    options = parser.parse_args()
    if unknown := set(options.names) - set(SURROGATES):
        parser.error(f"no {', '.join(sorted(unknown))}, expected some of {', '.join(SURROGATES)}")
    PICTURES.mkdir(exist_ok=True)
    accuracies = accuracies_of(PAGE.read_text(encoding="utf-8")) if options.names else {}
    for name in options.names or SURROGATES:
        if not options.built:
            build(name, options.folder)
        (PICTURES / f"{name}.svg").write_text(drawn(name, options.folder), encoding="utf-8", newline="\n")
        accuracies[name] = accuracy(name, options.folder)
    PAGE.write_text(document(accuracies), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
