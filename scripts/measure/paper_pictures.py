"""Pictures of docs/paper.md: those of Choi et al. 2021, drawn from our runs. Gray is the truth; they are legible at 390 pixels."""

import math
import sys
from dataclasses import dataclass

import numpy as np
from common import ROOT

sys.path.append(str(ROOT / "scripts"))
from canvas import BLUE, GREEN, INK, ORANGE, SKY, Picture, round_steps
from gallery import limits, pendulum, slider_crank, thinned
from paper_page import short

TRUTH, PINK = "#C4C4C4", "#B3478C"
COLORS = [BLUE, ORANGE, GREEN, PINK, SKY]
WIDTH, LEFT, FRAME, GAP, HEIGHT, ROW = 480, 50, 172, 54, 112, 152
# of a scatter plot: enough to see every cluster
POINTS = 500


def column(number):
    return LEFT + number * (FRAME + GAP)


def ticks(axis_limits, most=4):
    """Round numbers inside the limits."""
    return round_steps(*axis_limits, most=most)


def panel(p, place, x, y, x_label="", y_label=""):
    """Axes in a column and row of the picture."""
    across, down = place
    options = {"x_ticks": ticks(x), "y_ticks": ticks(y), "x_label": x_label, "y_label": y_label}
    return p.axes(column(across), 44 + ROW * down, FRAME, HEIGHT, x, y, **options)


@dataclass
class Curve:
    """A line of a panel, and a note above the panel."""

    x: np.ndarray
    y: np.ndarray
    color: str
    width: float
    note: str = ""

    def draw(self, axes):
        points = [axes.at(float(x), float(y)) for x, y in zip(self.x, self.y, strict=True)]
        axes.picture.line(*thinned(points), color=self.color, width=self.width)


def of_equal_scale(x, y):
    """Limits that contain both, with as many pixels for a unit in each direction."""
    unit = max((x[1] - x[0]) / FRAME, (y[1] - y[0]) / HEIGHT)
    around = lambda ends, size: (sum(ends) / 2 - unit * size / 2, sum(ends) / 2 + unit * size / 2)
    return around(x, FRAME), around(y, HEIGHT)


def pair(title, columns, labels, draw, x_label="", key="", is_plane=False):
    """A picture with a column for each structure and a row for each label. `draw`: curves of a column and a row."""
    p = Picture(title, width=WIDTH, height=44 + ROW * len(labels) + 26)
    for across, name in enumerate(columns):
        p.text(column(across) + FRAME, 18, name, anchor="end", bold=True, size=13)
    for down, label in enumerate(labels):
        curves = [draw(name, down) for name in columns]
        x = limits([float(value) for of in curves for curve in of for value in curve.x])
        y = limits([float(value) for of in curves for curve in of for value in curve.y])
        x, y = of_equal_scale(x, y) if is_plane else (x, y)
        for across, of in enumerate(curves):
            axes = panel(p, (across, down), x, y, x_label if down == len(labels) - 1 else "", label)
            p.text(column(across) + FRAME, 37 + ROW * down, of[0].note, anchor="end", size=11)
            for curve in of:
                curve.draw(axes)
    p.text(LEFT, 44 + ROW * len(labels) + 18, key, size=11.5)
    return p.svg()


@dataclass
class Shown:
    """Truth and predictions [runs, times, outputs] of a structure, at its times."""

    runs: object
    predicted: np.ndarray


def in_time(title, columns, outputs, cases):
    """Outputs over time, and the error of the last one. `columns`: what is shown by the name of a structure. `outputs`: column by label."""
    labels = list(outputs)

    def draw(name, down):
        runs, predicted = columns[name].runs, columns[name].predicted
        output = outputs[labels[min(down, len(labels) - 1)]]
        errors = predicted[..., output] - runs.outputs[..., output]
        if down == len(labels):
            return [Curve(runs.times, errors[case], COLORS[number], 1) for number, case in enumerate(cases)]
        note = f"MSE {short((errors[cases] ** 2).mean())}".replace("-", "−")
        truth = [Curve(runs.times, runs.outputs[case, :, output], TRUTH, 4, note) for case in cases]
        return truth + [Curve(runs.times, predicted[case, :, output], COLORS[number], 1.3) for number, case in enumerate(cases)]

    key = "gray: truth; blue: prediction" if len(cases) == 1 else "gray: truth; colored: predictions, a color for each case"
    return pair(title, list(columns), [*labels, f"error, {labels[-1]}"], draw, x_label="time, s", key=key)


def searched(outputs, one, more):
    """S_fixed with searched options: the first case on the left, the others on the right."""
    columns, labels = {"Figure 5": one, "Figure 6": more}, list(outputs)

    def draw(name, down):
        shown, output = columns[name], outputs[labels[down]]
        note = f"MSE {short(((shown.predicted - shown.runs.outputs)[..., output] ** 2).mean())}".replace("-", "−")
        truth = [Curve(shown.runs.times, values[:, output], TRUTH, 4, note) for values in shown.runs.outputs]
        return truth + [Curve(shown.runs.times, values[:, output], COLORS[number], 1.3) for number, values in enumerate(shown.predicted)]

    title = "Pendulum, five cases: S_fixed with options that were searched at each time point"
    return pair(title, list(columns), labels, draw, x_label="time, s", key="gray: truth; colored: predictions, a color for each case")


def phases(title, columns, pairs, case):
    """Outputs over another output. `pairs`: columns of both by the label of the panel."""
    shown = list(pairs.values())

    def draw(name, down):
        x, y = shown[down]
        of = lambda values, color, width: Curve(values[case, :, x], values[case, :, y], color, width)
        return [of(columns[name].runs.outputs, TRUTH, 4), of(columns[name].predicted, BLUE, 1.3)]

    return pair(title, list(columns), list(pairs), draw, key="gray: truth; blue: prediction")


def paths(title, columns, cases):
    """Paths of both masses of the double pendulum, whose first two parameters are its rods."""

    def positions(rods, outputs):
        x, y = rods[0] * np.sin(outputs[:, 0]), -rods[0] * np.cos(outputs[:, 0])
        return [(x, y), (x + rods[1] * np.sin(outputs[:, 1]), y - rods[1] * np.cos(outputs[:, 1]))]

    def draw(name, down):
        case, runs = cases[down], columns[name].runs
        truth = [Curve(x, y, TRUTH, 4) for x, y in positions(runs.parameters[case], runs.outputs[case])]
        predicted = zip(positions(runs.parameters[case], columns[name].predicted[case]), (BLUE, ORANGE))
        return truth + [Curve(x, y, color, 1.3) for (x, y), color in predicted]

    rods = next(iter(columns.values())).runs.parameters
    labels = [f"`L1` {rods[case, 0]:g} m, `L2` {rods[case, 1]:g} m" for case in cases]
    key = "y over x, in m. Gray: truth; blue: upper mass; orange: lower mass"
    return pair(title, list(columns), labels, draw, key=key, is_plane=True)


def scatter(title, predicted, truth, outputs, scores):
    """Predictions over labels of evenly chosen unseen rows, a panel for each output with its R²."""
    rows = math.ceil(len(outputs) / 2)
    p = Picture(title, width=WIDTH, height=44 + ROW * rows + 10)
    every = max(1, truth[..., 0].size // POINTS)
    for number, label in enumerate(outputs):
        xs, ys = (values[..., number].ravel()[::every] for values in (truth, predicted))
        ends = limits([float(value) for value in (*xs, *ys)])
        axes = panel(p, (number % 2, number // 2), ends, ends, y_label=label)
        axes.line(ends, ends, color=TRUTH, width=1)
        axes.cloud(xs, ys)
        p.text(column(number % 2) + FRAME, 37 + ROW * (number // 2), f"R² {scores[number]}", anchor="end", size=11)
    p.text(LEFT, 20, "prediction over label, unseen rows", size=12)
    return p.svg()


def double_pendulum(p):
    p.ground(50, 50, 130, 50)
    p.line((90, 50), (90, 168), color="#888888", dash="4 4", width=1)
    p.line((90, 50), (128, 96), width=2)
    p.line((128, 96), (148, 160), width=2)
    p.line((128, 96), (128, 168), color="#888888", dash="4 4", width=1)
    p.hinge(90, 50)
    p.circle(128, 96, 10)
    p.circle(148, 160, 10)
    p.text(118, 70, "`L1`")
    p.text(150, 128, "`L2`")
    p.turn(90, 50, 40, 270, 308, BLUE)
    p.text(84, 96, "`theta1`", BLUE, anchor="end")
    p.turn(128, 96, 46, 270, 286, BLUE)
    p.text(122, 152, "`theta2`", BLUE, anchor="end")


def systems():
    """Sketches of the three systems, one beside the other."""
    p = Picture("The pendulum, the double pendulum and the slider crank", width=WIDTH, height=196)
    scale = WIDTH / 600
    for number, (sketch, about) in enumerate([(pendulum, "pendulum"), (double_pendulum, "double pendulum"), (slider_crank, "slider crank")]):
        p.parts.append(f'<g transform="translate({number * WIDTH / 3:g} 20) scale({scale:g})">')
        sketch(p)
        p.parts.append("</g>")
        p.text(WIDTH / 3 * (number + 0.5), 18, about, anchor="middle", bold=True, size=13, color=INK)
    return p.svg()
