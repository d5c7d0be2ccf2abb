#!/usr/bin/env python3
"""Draws docs/elements: for each element of mechanism files its geometry, its law, and a run of examples/mechanisms/elements/NAME.toml.

    .venv/bin/python scripts/drawings.py [--out docs/elements] [NAME]...

Runs come from `metafmu sample`. Circles are closed forms, or solutions by scipy of equations derived by hand. Needs
target/release/metafmu; scripts/venv.sh makes .venv.
"""

import argparse
import csv
import subprocess
import tempfile
import tomllib
from pathlib import Path

import numpy as np
from canvas import BLUE, FILL, GREEN, GREY, INK, ORANGE, SKY, Picture, around
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.linalg import expm
from scipy.optimize import brentq

ROOT = Path(__file__).resolve().parents[1]
METAFMU = ROOT / "target" / "release" / "metafmu"
MECHANISMS = ROOT / "examples" / "mechanisms" / "elements"
PICTURES = ROOT / "docs" / "elements"
GRAVITY = 9.81
# each draws into a picture; by the name of its files
ELEMENTS = {}


def element(name, alternative):
    """Registers a drawing with the sentence that stands for it where it is not shown."""

    def register(draw):
        ELEMENTS[name] = (alternative, draw)
        return draw

    return register


def mechanism(name):
    return tomllib.loads((MECHANISMS / f"{name}.toml").read_text(encoding="utf-8"))


def runs(name, rows, stop, step, replace=None):
    """Runs of a mechanism, one for each row of parameters: columns by name. `replace` is a pair of texts in the file."""
    text, described = (MECHANISMS / f"{name}.toml").read_text(encoding="utf-8"), mechanism(name)
    if replace:
        assert replace[0] in text, f"{name}.toml has no `{replace[0]}`"
        text = text.replace(*replace)
    parameters = {key: [row[key] for row in rows] for key in rows[0]}
    study = f'name = "{name}"\n[source]\nmechanism = "mechanism.toml"\n[time]\nstop = {stop}\nstep = {step}\n[parameters]\n'
    for key, values in parameters.items():
        # a plan needs a range, also for a single value
        high = max(values) if max(values) > min(values) else max(2 * values[0], values[0] + 1)
        study += f"{key} = {{ min = {min(values)}, max = {high} }}\n"
    study += "[outputs]\n" + "".join(f"{key} = {{}}\n" for key in described["outputs"])
    study += '[sampling]\nmethod = "list"\nfile = "rows.csv"\ntest_runs = 1\n'
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        (folder / "mechanism.toml").write_text(text, encoding="utf-8")
        (folder / "study.toml").write_text(study, encoding="utf-8")
        # a plan has two different runs or more
        points = rows if len(rows) > 1 else [*rows, {key: max(2 * value, value + 1) for key, value in rows[0].items()}]
        listed = [",".join(parameters), *(",".join(map(str, row.values())) for row in points)]
        (folder / "rows.csv").write_text("\n".join(listed) + "\n", encoding="utf-8")
        done = subprocess.run([METAFMU, "sample", "study.toml", "--out", "out"], cwd=folder, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"error: {name}.toml: {done.stderr}")
        with open(folder / "out" / "train.csv", newline="") as file:
            table = list(csv.DictReader(file))
    found = [[line for line in table if line["run"] == str(run)] for run in range(len(rows))]
    assert all(found), f"{name}: a run failed"
    return [{key: np.array([float(line[key]) for line in lines]) for key in lines[0]} for lines in found]


def solved(slope, start, times):
    """The first state of an ordinary differential equation, by scipy."""
    return solve_ivp(slope, (times[0], times[-1]), start, "DOP853", times, rtol=1e-10, atol=1e-12).y[0]


def rung(times, frequency, share):
    """Step response of a damped oscillator, from 0 to 1: angular frequency, damping ratio."""
    damped = frequency * np.sqrt(1 - share**2)
    return 1 - np.exp(-share * frequency * times) * (np.cos(damped * times) + share * frequency / damped * np.sin(damped * times))


def heading(p, panel, text):
    p.text(320 * panel + 16, 24, text, size=13, bold=True)


def axes(p, panel, title, x, y, top=60, height=176, **options):
    """The axes of the panel of the law, 1, or of the run, 2."""
    if title:
        heading(p, panel, title)
    return p.axes(320 * panel + 54, top, 252, height, x, y, **options)


def toothed(p, x, y, radius, teeth, phase):
    """A gear; the phase is the angle of a tooth."""
    pitch = 360 / teeth
    outline = []
    for k in range(teeth):
        middle = phase + k * pitch
        for share, height in ((-0.32, -4), (-0.14, 4), (0.14, 4), (0.32, -4)):
            outline.append(around(x, y, radius + height, middle + share * pitch))
    p.line(*outline, closed=True, fill=FILL, width=1.2)


def rail(p, x0, x1, y):
    """A horizontal guide below a block."""
    p.ground(x0, y, x1, y)


@element("gear", "A pinion that turns a wheel: angles, ratio, and speeds of both for two ratios")
def gear(p):
    heading(p, 0, "A pair of gears")
    toothed(p, 82, 170, 34, 14, 0)
    toothed(p, 184, 170, 68, 28, 180 / 28)
    p.hinge(82, 170)
    p.hinge(184, 170)
    p.text(82, 190, "`pinion`", anchor="middle")
    p.text(184, 190, "`wheel`", anchor="middle")
    p.turn(82, 170, 48, 60, 150, BLUE)
    p.text(16, 112, "`pinion.angle`", BLUE)
    p.turn(184, 170, 82, 50, 110, BLUE)
    p.text(192, 80, "`wheel.angle`", BLUE)
    p.turn(82, 170, 48, 200, 290)
    p.text(24, 234, "`motor`", ORANGE)
    p.turn(184, 170, 82, -65, -15)
    p.text(226, 254, "`gear.effort`", ORANGE)
    p.text(16, 276, "`follows = -pinion.angle/ratio`")
    a = axes(p, 1, "The wheel follows the pinion", (-10, 10), (-6, 6), x_label="`pinion.angle`, rad", y_label="`wheel.angle`, rad")
    for ratio, color in ((2, BLUE), (4, ORANGE)):
        a.line([-10, 10], [10 / ratio, -10 / ratio], color)
    a.key(1, 5, ("`ratio` = 2", "line", BLUE), ("`ratio` = 4", "line", ORANGE))
    a.text(-9.4, -5, "slope −1/`ratio`")
    found = runs("gear", [{"ratio": 2}, {"ratio": 4}], 4, 0.05)
    a = axes(p, 2, "A constant torque of the motor", (0, 4), (-40, 100), x_label="time, s", y_label="angular velocity, rad/s")
    for run, color in zip(found, (BLUE, ORANGE), strict=True):
        n, t = run["ratio"][0], run["time"]
        closed = 0.2 / 0.05 * n**2 * (1 - np.exp(-t * 0.05 / n**2 / (0.001 + 0.05 / n**2)))
        for curve, exact in ((run["pinion"], closed), (run["wheel"], -closed / n)):
            a.line(t, curve, color)
            a.compare(t, curve, exact, every=8)
    a.key(0.15, 89, ("`ratio` = 2", "line", BLUE), ("`ratio` = 4", "line", ORANGE))
    a.key(2.2, 89, ("closed form", "circle", INK))
    a.text(3.9, 34, "`pinion.angular_velocity`", anchor="end")
    a.text(3.9, -32, "`wheel.angular_velocity`", anchor="end")


@element("rack", "A pinion that moves a rack against a spring: angle, position, radius, and the motion for two radii")
def rack(p):
    heading(p, 0, "Rack and pinion")
    teeth = 18
    toothed(p, 120, 128, 44, teeth, 270)
    p.hinge(120, 128)
    p.text(120, 109, "`pinion`", anchor="middle")
    pitch = 2 * np.pi * 44 / teeth
    top = [(40, 172)]
    for k in range(-5, 6):
        middle = 120 + (k + 0.5) * pitch
        top += [(middle + share * pitch, 172 + height) for share, height in ((-0.32, 4), (-0.14, -4), (0.14, -4), (0.32, 4))]
    top = [point for point in top if 40 <= point[0] <= 204]
    p.line(*top, (204, 176), (204, 196), (40, 196), closed=True, fill=FILL, width=1.2)
    rail(p, 30, 250, 197)
    p.text(50, 190, "`rail`")
    p.spring(204, 186, 272, 186)
    p.ground(272, 206, 272, 166)
    p.dimension(120, 128, 164, 128)
    p.text(144, 144, "`r`", anchor="middle")
    p.turn(120, 128, 58, 30, 110, BLUE)
    p.text(146, 72, "`shaft.angle`", BLUE)
    p.turn(120, 128, 58, 130, 210)
    p.text(14, 92, "`motor`", ORANGE)
    p.arrow(60, 226, 130, 226, BLUE)
    p.text(138, 230, "`slide.position`", BLUE)
    p.arrow(60, 246, 130, 246)
    p.text(138, 250, "`rack.effort`, on the rack", ORANGE)
    p.text(16, 276, "`follows = r*shaft.angle`")
    a = axes(p, 1, "The rack follows the pinion", (-4, 4), (-0.4, 0.4), x_label="`shaft.angle`, rad", y_label="`slide.position`, m")
    a.line([-4, 4], [-0.4, 0.4], BLUE)
    a.line([-4, 4], [-0.2, 0.2], ORANGE)
    a.key(-3.7, 0.33, ("`r` = 0.1 m", "line", BLUE), ("`r` = 0.05 m", "line", ORANGE))
    a.text(3.8, -0.34, "slope `r`", anchor="end")
    found = runs("rack", [{"r": 0.1}, {"r": 0.05}], 2.5, 0.02)
    a = axes(p, 2, "A torque of 2 N·m from rest", (0, 2.5), (0, 0.5), x_label="time, s", y_label="`slide.position`, m")
    for run, color in zip(found, (BLUE, ORANGE), strict=True):
        r, t = run["r"][0], run["time"]
        a.line(t, run["position"], color)
        closed = 2 / (r * 200) * (1 - np.cos(t * np.sqrt(200 * r**2 / (0.02 + 2 * r**2))))
        a.compare(t, run["position"], closed, every=5)
    a.key(0.1, 0.46, ("`r` = 0.1 m", "line", BLUE), ("`r` = 0.05 m", "line", ORANGE))
    a.key(1.4, 0.46, ("closed form", "circle", INK))


@element("cam", "A cam that lifts a follower: its table of lift, and the force between both at two speeds")
def cam(p):
    lift = mechanism("cam")["tables"]["lift"]
    spline = CubicSpline(lift["x"], lift["values"], bc_type="periodic")
    heading(p, 0, "Cam and follower")
    x, y, turned = 140, 194, 2.5
    radius = lambda angle: 30 + 4200 * spline(turned + np.pi / 2 - angle)
    p.line(*(around(x, y, radius(angle), np.degrees(angle)) for angle in np.linspace(0, 2 * np.pi, 73)[:-1]), closed=True, fill=FILL)
    p.hinge(x, y)
    p.text(x - 2, y + 19, "`disk`", anchor="middle")
    tip = y - radius(np.pi / 2)
    p.line((x, tip), (x + 7, tip - 12), (x + 7, 68), (x - 7, 68), (x - 7, tip - 12), closed=True, fill=FILL)
    p.ground(x + 8, 118, x + 8, 98)
    p.ground(x - 8, 98, x - 8, 118)
    p.line((x - 16, 92), (x + 16, 92), width=3)
    p.ground(x + 22, 48, x - 22, 48)
    p.spring(x, 48, x, 92, coils=4, half=13)
    p.text(x - 22, 86, "`valve`", anchor="end")
    p.arrow(x + 38, 94, x + 38, 56, BLUE)
    p.text(x + 46, 74, "`follower.position`", BLUE)
    p.arrow(x + 26, 136, x + 26, 100)
    p.text(x + 34, 122, "`cam.effort`", ORANGE)
    p.turn(x, y, 60, 180, 240, BLUE)
    p.text(16, 266, "`camshaft.angle`", BLUE)
    p.text(112, 283, "`follows = lift(camshaft.angle)`")
    a = axes(
        p,
        1,
        "A periodic table of the lift",
        (0, 4 * np.pi),
        (0, 12),
        x_label="`camshaft.angle`, rad",
        y_label="`follower.position`, mm",
        x_ticks=[(k * np.pi, text) for k, text in enumerate(("0", "π", "2π", "3π", "4π"))],
    )
    angles = np.linspace(0, 4 * np.pi, 121)
    a.line(angles, 1000 * spline(angles))
    a.dots(lift["x"], 1000 * np.array(lift["values"]))
    a.text(2 * np.pi, 10.9, "knots of `lift`; the table repeats itself", anchor="middle")
    a = axes(
        p,
        2,
        "Force of the cam on the follower",
        (0, 4 * np.pi),
        (-6, 14),
        x_label="`camshaft.angle`, rad",
        y_label="`cam.effort`, N",
        x_ticks=[(k * np.pi, text) for k, text in enumerate(("0", "π", "2π", "3π", "4π"))],
    )
    for omega, color in ((20, BLUE), (60, ORANGE)):
        (run,) = runs("cam", [{"omega": omega}], 4 * np.pi / omega, 4 * np.pi / omega / 120)
        angle = omega * run["time"]
        a.line(angle, run["effort"], color)
        closed = 0.2 * (spline(angle, 2) * omega**2 + GRAVITY) + 100 * (spline(angle) + 0.005)
        a.compare(angle, run["effort"], closed, every=5)
    a.key(0.4, 12.6, ("`omega` = 20 rad/s", "line", BLUE), ("`omega` = 60 rad/s", "line", ORANGE))
    a.key(7.6, 12.6, ("closed form", "circle", INK))
    a.text(2 * np.pi, -3.6, "below 0 a valve", anchor="middle")
    a.text(2 * np.pi, -3.6, "would leave the cam", anchor="middle", dy=14)


@element("stop", "A block between two stops: force over position and speed, and the motion with and without damping")
def stop(p):
    heading(p, 0, "Stops of a joint's coordinate")
    rail(p, 14, 306, 190)
    p.line((160, 136), (160, 222), color=GREY, width=1, dash="3 3")
    p.box(160, 168, 48, 44)
    p.text(160, 172, "`block`", anchor="middle")
    for x, side, name in ((44, -1, "min"), (276, 1, "max")):
        wall, limit = x + side * 16, x - side * 36
        p.ground(wall, 190 if side > 0 else 126, wall, 126 if side > 0 else 190)
        p.spring(wall, 168, x - side * 10, 168, coils=3, half=6)
        p.line((x - side * 11, 152), (x - side * 11, 184), width=3)
        p.box(limit, 168, 48, 44, fill="none", color=GREY, dash="4 4")
        p.line((limit, 152), (limit, 222), color=GREY, width=1, dash="3 3")
        p.text(limit, 236, f"`{name}`", anchor="middle")
    p.text(160, 236, "0", anchor="middle")
    p.arrow(160, 130, 222, 130, BLUE)
    p.text(160, 118, "`rail.position`", BLUE)
    p.text(16, 66, "beyond a limit by d, the force back is")
    p.text(16, 84, "`stiffness` d (1 + `damping` d′), or 0")
    p.text(16, 268, "`coordinate = rail.position`")
    a = axes(
        p,
        1,
        "Force of the stops on the block",
        (-0.36, 0.36),
        (-120, 120),
        x_label="`rail.position`, m",
        y_label="force, N",
        x_ticks=[(-0.3, "`min`"), (0, "0"), (0.3, "`max`")],
    )
    for rate, color in ((1.5, ORANGE), (0, BLUE), (-1.5, GREEN)):
        slope = 1000 * (1 + 0.5 * rate)
        a.line([-0.36, -0.3, 0.3, 0.36], [0.06 * slope, 0, 0, -0.06 * slope], color)
    a.key(
        -0.2,
        100,
        ("d′ = 1.5 m/s, into the stop", "line", ORANGE),
        ("d′ = 0: slope `stiffness`", "line", BLUE),
        ("d′ = −1.5 m/s, out of it", "line", GREEN),
    )
    found = runs("stop", [{"damping": 0}, {"damping": 0.5}], 3, 0.01)
    a = axes(
        p,
        2,
        "A block that starts with 1.5 m/s",
        (0, 3),
        (-0.6, 0.6),
        x_label="time, s",
        y_label="`rail.position`, m",
        y_ticks=[(-0.3, "`min`"), (0, "0"), (0.3, "`max`")],
    )
    # free flight, and half a period of mass and spring
    t, frequency, reach = found[0]["time"], np.sqrt(1000), 0.3 / 1.5
    half = 2 * reach + np.pi / frequency
    phase, side = np.mod(t + reach, half), np.where(np.mod(t + reach, 2 * half) < half, 1, -1)
    closed = side * np.where(phase < 2 * reach, 1.5 * (phase - reach), 0.3 + 1.5 / frequency * np.sin(frequency * (phase - 2 * reach)))
    for level in (-0.3, 0.3):
        a.line([0, 3], [level, level], GREY, width=1)
    a.line(t, found[0]["position"], BLUE)
    a.line(t, found[1]["position"], ORANGE)
    a.compare(t, found[0]["position"], closed, every=5)
    a.key(0.1, 0.5, ("without `damping`", "line", BLUE), ("`damping` = 0.5 s/m", "line", ORANGE))
    a.key(1.75, 0.5, ("closed form", "circle", INK))


@element("contact", "A disc on the ground: friction over the sliding speed, and the disc's speeds until it rolls")
def contact(p):
    heading(p, 0, "A circle on the left of a line")
    p.ground(24, 196, 296, 196)
    for x, name in ((44, "left"), (276, "right")):
        p.mark(x, 196)
        p.text(x, 224, f"`{name}`", anchor="middle")
    p.circle(160, 146, 50)
    p.mark(160, 146)
    p.text(166, 162, "`disc`")
    p.line((160, 146), (125, 111), color=GREY, width=1)
    p.text(114, 154, "`radius`", GREY)
    p.arrow(160, 262, 160, 202, ORANGE)
    p.text(168, 250, "`floor.fy`", ORANGE)
    p.arrow(160, 196, 222, 196, ORANGE)
    p.text(216, 186, "`floor.fx`", ORANGE)
    p.arrow(212, 84, 262, 84, BLUE)
    p.text(232, 102, "`floor.vx`", BLUE)
    p.turn(160, 146, 62, 40, 140, BLUE)
    p.text(84, 66, "`floor.angular_velocity`", BLUE)
    p.text(16, 282, "`line = [\"ground.left\", \"ground.right\"]`")
    limit = 0.3 * 2 * 9.81
    a = axes(
        p,
        1,
        "Friction, with a normal force of 19.6 N",
        (-0.4, 0.4),
        (-10, 10),
        x_label="`vx + radius*angular_velocity`, m/s",
        y_label="`floor.fx`, N",
        y_ticks=[(-limit, "−`friction` `fy`"), (0, "0"), (limit, "`friction` `fy`")],
    )
    speeds = np.linspace(-0.4, 0.4, 161)
    for slip, color in ((0.05, BLUE), (0.15, ORANGE)):
        a.line(speeds, -limit * np.tanh(speeds / slip), color)
    a.key(-0.02, 9, ("`slip` = 0.05 m/s", "line", BLUE), ("`slip` = 0.15 m/s", "line", ORANGE))
    found = runs("contact", [{"friction": 0.3}, {"friction": 0.15}], 0.8, 0.005)
    a = axes(p, 2, "A disc that is pushed with 2 m/s", (0, 0.8), (0, 2.4), x_label="time, s", y_label="speed, m/s")
    for run, friction, dash in ((found[0], 0.3, None), (found[1], 0.15, "6 3")):
        # the sliding speed s alone decides: s' = -3 friction g tanh(s/slip), of which v takes a third
        t = run["time"]
        start, decay = 2 / 0.05, 3 * friction * 9.81 * t / 0.05
        # arsinh(sinh(start) exp(-decay)) without overflow
        power = start - decay - np.log(2)
        sliding = 0.05 * np.where(power > 20, power + np.log(2), np.arcsinh(np.exp(np.minimum(power, 20)) * (1 - np.exp(-2 * start))))
        a.line(t, run["speed"], BLUE, dash=dash)
        a.line(t, -0.2 * run["spin"], ORANGE, dash=dash)
        a.compare(t, run["speed"], 2 - (2 - sliding) / 3, every=8)
        a.compare(t, -0.2 * run["spin"], (2 - sliding) * 2 / 3, every=8)
    a.key(0.2, 2.25, ("`disc.vx`", "line", BLUE), ("−`r*disc.angular_velocity`", "line", ORANGE), ("closed form", "circle", INK))
    a.text(0.24, 0.3, "dashed: half the friction", GREY)


@element("bushing", "An engine on a bushing: its three springs, their forces, and how the engine sags and comes to rest")
def bushing(p):
    heading(p, 0, "A bushing between two points")
    p.box(150, 112, 220, 70)
    p.text(44, 142, "`engine`")
    p.ground(60, 238, 268, 238)
    # in parallel between the frame and the engine's foot
    p.line((150, 112), (150, 196), color=INK)
    p.line((104, 196), (206, 196), width=2.5)
    p.spring(188, 196, 188, 238, coils=4, half=6)
    p.damper(206, 238, 206, 196, half=6)
    p.spring(104, 196, 60, 196, coils=3, half=5)
    p.ground(60, 238, 60, 180)
    p.spiral(140, 218, 3, 12)
    p.line((140, 196), (140, 206))
    p.line((140, 229), (140, 238))
    p.mark(150, 112)
    p.text(142, 110, "`engine.foot`", anchor="end")
    p.arrow(150, 112, 194, 112)
    p.text(176, 130, "`mount.fx`", ORANGE)
    p.arrow(150, 112, 150, 62)
    p.text(142, 66, "`mount.fy`", ORANGE, anchor="end")
    p.turn(150, 112, 34, 20, 70)
    p.text(166, 66, "`mount.moment`", ORANGE)
    p.arrow(240, 216, 284, 216, BLUE)
    p.arrow(240, 216, 240, 178, BLUE)
    p.text(306, 208, "`mount.x`", BLUE, anchor="end")
    p.text(240, 172, "`mount.y`", BLUE)
    p.text(16, 274, "`between = [ground.frame, engine.foot]`")
    a = axes(p, 1, "Forces on the second body", (-10, 10), (-1200, 1200), x_label="`mount.x`, `mount.y`, mm", y_label="`mount.fx`, `mount.fy`, N")
    for stiffness, damping, color in ((1e5, 800, ORANGE), (5e4, 400, BLUE)):
        a.line([-10, 10], [0.01 * stiffness, -0.01 * stiffness], color)
        a.line([-10, 10], [0.01 * stiffness - 0.2 * damping, -0.01 * stiffness - 0.2 * damping], color, width=1.2, dash="5 4")
    a.key(-0.6, 1030, ("`fx`: −`stiffness[0]`", "line", BLUE), ("`fy`: −`stiffness[1]`", "line", ORANGE), ("at 0.2 m/s", "dash", GREY))
    a.text(-9.6, -760, "`moment`: −`stiffness[2]`")
    a.text(-9.6, -760, "over `mount.angle`", dy=16)
    found = runs("bushing", [{"damping": 1}], 0.6, 0.004)[0]
    t = found["time"]
    a = axes(p, 2, "An engine that sags onto its mount", (0, 0.6), (-16, 24), x_label="time, s", y_label="`x`, `y` in mm, `angle` in mrad")
    sag, closed = -1e3 * 80 * GRAVITY / 1e5, lambda inertia, k, c: rung(t, np.sqrt(k / inertia), c / 2 / np.sqrt(k * inertia))
    for key, exact, color in (
        ("x", 8 * (1 - closed(80, 5e4, 400)), BLUE),
        ("y", sag * closed(80, 1e5, 800), ORANGE),
        ("angle", 10 * (1 - closed(4, 3e3, 20)), GREEN),
    ):
        a.line(t, 1e3 * found[key], color)
        a.compare(t, 1e3 * found[key], exact, every=5)
    a.key(0.12, 21, ("`mount.angle`", "line", GREEN), ("closed form", "circle", INK))
    a.key(0.4, 21, ("`mount.x`", "line", BLUE), ("`mount.y`", "line", ORANGE))


@element("spring-force", "A body on a strut: the curve of its damper, and the motion with and without it")
def spring_force(p):
    table = mechanism("spring-force")["tables"]["damper"]
    spline = CubicSpline(table["x"], table["values"])
    heading(p, 0, "A spring with a force curve")
    p.ground(90, 250, 210, 250)
    p.line((120, 108), (180, 108), width=2)
    p.spring(132, 250, 132, 120)
    p.damper(168, 250, 168, 120, half=9)
    p.line((132, 120), (132, 108))
    p.line((168, 120), (168, 108))
    p.box(150, 86, 96, 44)
    p.text(150, 104, "`load`", anchor="middle")
    p.mark(150, 86)
    p.mark(150, 250)
    p.text(158, 244, "`base`")
    p.dimension(40, 250, 40, 86)
    p.line((36, 86), (150, 86), color=GREY, width=1, dash="3 3")
    p.text(16, 74, "`strut.length`", BLUE)
    p.text(120, 184, "`stiffness`", anchor="end")
    p.text(184, 184, "`force`")
    p.arrow(214, 98, 214, 60)
    p.text(222, 76, "`strut.force`,", ORANGE)
    p.text(222, 91, "makes it longer", ORANGE)
    p.text(16, 281, "`force = -damper(strut.velocity)`")
    a = axes(p, 1, "The curve beside the stiffness", (-1.2, 1.2), (-1800, 1200), x_label="`strut.velocity`, m/s", y_label="`force`, N")
    speeds = np.linspace(-1.2, 1.2, 121)
    at = np.clip(speeds, -1, 1)
    curve = lambda v, at: spline(at) + (v - at) * spline(at, 1)
    a.line(speeds, -curve(speeds, at))
    a.dots(table["x"], -np.array(table["values"]))
    a.text(-1.12, -1350, "knots of `damper`, a spline")
    a.text(-1.12, -1350, "between them, tangents beyond", dy=15)
    damped, free = runs("spring-force", [{"share": 1}, {"share": 0}], 2, 0.01)
    t = damped["time"]
    slope = lambda _, state: [state[1], (-2e4 * (state[0] - 0.5) - curve(state[1], np.clip(state[1], -1, 1))) / 200 - GRAVITY]
    a = axes(p, 2, "A load that is set on the strut", (0, 2), (0.25, 0.6), x_label="time, s", y_label="`strut.length`, m")
    a.line(t, free["length"], GREY, width=1.5, dash="5 4")
    a.line(t, damped["length"])
    a.compare(t, damped["length"], solved(slope, [0.5, 0], t), every=5)
    a.key(0.1, 0.573, ("without `force`", "dash", GREY), ("with `force`", "line", BLUE))
    a.key(1.2, 0.573, ("scipy", "circle", INK))


@element("torsion-spring", "A flap on a torsion spring: angle, rest, torque, and the motion with and without damping")
def torsion_spring(p):
    heading(p, 0, "A spring along an angle")
    x, y = 70, 196
    rest = np.degrees(0.8)
    p.line((x, y), around(x, y, 176, rest), color=GREY, width=1, dash="5 4")
    p.text(*around(x, y, 182, rest + 1), "`rest`")
    p.line((x, y), (x + 210, y), color=GREY, width=1, dash="3 3")
    p.bar(x, y, *around(x, y, 165, 20))
    p.wall_hinge(x, y)
    p.text(*around(x, y + 22, 112, 20), "`flap`")
    p.turn(x, y, 188, 0, 20, BLUE)
    p.text(226, 214, "`hinge.angle`", BLUE)
    p.turn(x, y, 66, 54, 112)
    p.text(30, 122, "torque", ORANGE)
    p.text(16, 270, "`coordinate = hinge.angle`")
    a = axes(
        p,
        1,
        "Torque of the spring",
        (-0.4, 2),
        (-3, 3),
        x_label="`hinge.angle`, rad",
        y_label="torque on `flap`, N·m",
        x_ticks=[(0, "0"), (0.8, "`rest`"), (2, "2")],
    )
    angles = np.array([-0.4, 2])
    a.line(angles, -2 * (angles - 0.8), BLUE)
    a.line(angles, -2 * (angles - 0.8) - 0.03 * 15, ORANGE, width=1.5, dash="5 4")
    a.key(0.62, 2.5, ("slope −`stiffness`", "line", BLUE), ("at 15 rad/s, lower", "dash", ORANGE))
    a.text(0.62, 2.5, "by `damping`·15 rad/s", dx=26, dy=32)
    found = runs("torsion-spring", [{"damping": 0}, {"damping": 0.03}], 4, 0.02)
    a = axes(p, 2, "A flap that starts at 0", (0, 4), (0, 2.2), x_label="time, s", y_label="`hinge.angle`, rad", y_ticks=[0, (0.8, "`rest`"), 1.6])
    for run, color, dash in ((found[0], GREY, "5 4"), (found[1], BLUE, None)):
        inertia = 0.6 * 0.4**2 / 3
        closed = 0.8 * rung(run["time"], np.sqrt(2 / inertia), run["damping"][0] / 2 / np.sqrt(2 * inertia))
        a.line(run["time"], run["angle"], color, dash=dash, width=1.5 if dash else 2)
        if not dash:
            a.compare(run["time"], run["angle"], closed, every=5)
    a.key(0.15, 2.03, ("without `damping`", "dash", GREY), ("with `damping`", "line", BLUE))
    a.key(2.35, 2.03, ("closed form", "circle", INK))


@element("friction", "A block that slides: friction as a hyperbolic tangent of its speed, and how the block comes to rest")
def friction(p):
    heading(p, 0, "Friction as a formula")
    rail(p, 30, 290, 190)
    p.box(150, 160, 90, 58)
    p.text(150, 158, "`block`", anchor="middle")
    p.arrow(150, 118, 220, 118, BLUE)
    p.text(92, 106, "`rail.position`, `rail.velocity`", BLUE)
    p.arrow(195, 190, 262, 190, width=2.5)
    p.text(222, 180, "`friction`", ORANGE)
    p.arrow(110, 131, 110, 186, GREY, width=1.5)
    p.text(98, 146, "`load`", anchor="end")
    p.text(16, 248, "`effort = -mu*load`")
    p.text(80, 266, "`*tanh(rail.velocity/width)`")
    a = axes(
        p,
        1,
        "Force on the block",
        (-1.2, 1.2),
        (-9, 9),
        x_label="`rail.velocity`, m/s",
        y_label="`friction`, N",
        y_ticks=[(-5.886, "`-mu*load`"), (0, "0"), (5.886, "`mu*load`")],
    )
    speeds = np.linspace(-1.2, 1.2, 161)
    for width, color in ((0.1, BLUE), (0.5, ORANGE)):
        a.line(speeds, -5.886 * np.tanh(speeds / width), color)
    a.key(0.0, 7.3, ("`width` = 0.1 m/s", "line", BLUE), ("`width` = 0.5 m/s", "line", ORANGE))
    rows = [{"mu": 0, "width": 0.1}, {"mu": 0.3, "width": 0.1}, {"mu": 0.3, "width": 0.5}]
    free, narrow, wide = runs("friction", rows, 1.6, 0.01)
    a = axes(p, 2, "A block that starts with 2 m/s", (0, 1.6), (0, 2.4), x_label="time, s", y_label="`rail.velocity`, m/s")
    a.line(free["time"], free["velocity"], GREY, dash="5 4", width=1.5)
    for run, color in ((narrow, BLUE), (wide, ORANGE)):
        t, width = run["time"], run["width"][0]
        a.line(t, run["velocity"], color)
        a.compare(t, run["velocity"], width * np.arcsinh(np.sinh(2 / width) * np.exp(-0.3 * GRAVITY * t / width)), every=6)
    a.text(0.08, 2.1, "without friction", GREY)
    a.key(0.62, 1.7, ("`width` = 0.1 m/s", "line", BLUE), ("`width` = 0.5 m/s", "line", ORANGE), ("closed form", "circle", INK))


@element("saturation", "A motor of limited force that moves a block to a target: force over demand, and the motion with and without the limit")
def saturation(p):
    heading(p, 0, "A motor of limited force")
    rail(p, 30, 290, 190)
    p.box(90, 162, 70, 54)
    p.text(90, 166, "`block`", anchor="middle")
    p.arrow(125, 162, 185, 162)
    p.text(150, 152, "`motor`", ORANGE)
    p.arrow(90, 120, 150, 120, BLUE)
    p.text(90, 108, "`rail.position`", BLUE)
    p.line((244, 196), (244, 124), color=GREY, width=1, dash="3 3")
    p.line((244, 124), (264, 131), (244, 138), closed=True, fill=GREEN, color=GREEN, width=1)
    p.text(244, 216, "0.5 m", anchor="middle")
    p.text(16, 66, "`u = 50*(0.5 - rail.position)`")
    p.text(42, 82, "`- 14*rail.velocity`")
    p.text(16, 258, "`effort = min(max(u, -limit), limit)`")
    a = axes(
        p,
        1,
        "Force over the controller's demand",
        (-10, 10),
        (-10, 10),
        x_label="`u`, N",
        y_label="`effort`, N",
        x_ticks=[(-4, "`-limit`"), (4, "`limit`")],
        y_ticks=[(-4, "`-limit`"), (0, "0"), (4, "`limit`")],
    )
    a.line([-10, 10], [-10, 10], GREY, dash="5 4", width=1.5)
    a.line([-10, -4, 4, 10], [-4, -4, 4, 4])
    a.text(-9.4, 7.6, "without the limit", GREY)
    limited, free = runs("saturation", [{"limit": 4}, {"limit": 100}], 2, 0.01)
    t = limited["time"]
    exact = 0.5 * rung(t, np.sqrt(50), 14 / 2 / np.sqrt(50))
    slope = lambda _, state: [state[1], np.clip(50 * (0.5 - state[0]) - 14 * state[1], -4, 4)]
    a = axes(p, 2, "Motion to the target", (0, 2), (0, 0.6), top=60, height=70, y_label="`rail.position`, m", y_ticks=[0, 0.5], x_ticks=[])
    a.line(t, free["position"], GREY, dash="5 4", width=1.5)
    a.line(t, limited["position"])
    a.compare(t, limited["position"], solved(slope, [0, 0], t), every=10)
    a.compare(t, free["position"], exact, GREY, every=10)
    a.key(1.06, 0.3, ("`limit` = 4 N", "line", BLUE), ("without the limit", "dash", GREY))
    a = axes(
        p, 2, "", (0, 2), (-10, 28), top=160, height=76, x_label="time, s", y_label="`effort`, N", y_ticks=[(-4, "`-limit`"), (4, "`limit`"), 25]
    )
    a.line(t, free["effort"], GREY, dash="5 4", width=1.5)
    a.line(t, limited["effort"])
    a.key(1.06, 20, ("scipy", "circle", INK), ("closed form", "circle", GREY))


@element("table", "Tables with the same knots, linear and cubic: drag over speed, and the run-down of a flywheel")
def table(p):
    tables = mechanism("table")["tables"]
    x, values = map(np.array, (tables["drag"]["x"], tables["drag"]["values"]))
    spline = CubicSpline(x, values)
    linear = lambda v: np.interp(v, x, values)
    cubic = lambda v: spline(np.clip(v, x[0], x[-1])) + (v - np.clip(v, x[0], x[-1])) * spline(np.clip(v, x[0], x[-1]), 1)
    heading(p, 0, "A torque by its values")
    p.circle(130, 150, 66)
    p.circle(130, 150, 52, fill="none", width=1)
    p.hinge(130, 150)
    p.text(130, 178, "`flywheel`", anchor="middle")
    p.turn(130, 150, 80, 20, 100, BLUE)
    p.text(152, 64, "`shaft.angular_velocity`", BLUE)
    p.turn(130, 150, 80, 200, 280)
    p.text(20, 232, "`drag`", ORANGE)
    p.text(16, 262, "`effort = -drag(shaft.angular_velocity)`")
    a = axes(p, 1, "The same knots in two tables", (-25, 25), (-4, 4), x_label="speed, rad/s", y_label="table, N·m")
    speeds = np.linspace(-25, 25, 201)
    a.line(speeds, linear(speeds), ORANGE)
    a.line(speeds, cubic(speeds), BLUE)
    a.dots(x, values)
    a.key(-23, 3.3, ('`"linear"`, `"hold"`', "line", ORANGE), ('`"cubic"`, `"linear"`', "line", BLUE))
    a.text(6, -3.3, "`x`, `values`: knots")
    found = runs("table", [{"cubic": 0}, {"cubic": 1}], 6, 0.04)
    a = axes(p, 2, "Run-down from 25 rad/s", (0, 6), (0, 30), x_label="time, s", y_label="`shaft.angular_velocity`, rad/s")
    for run, drag, color in zip(found, (linear, cubic), (ORANGE, BLUE), strict=True):
        t = run["time"]
        a.line(t, run["speed"], color)
        a.compare(t, run["speed"], solved(lambda _, state, drag=drag: [-float(drag(state[0])) / 0.2], [25], t), every=6)
    a.key(3.2, 26, ('`"linear"`', "line", ORANGE), ('`"cubic"`', "line", BLUE), ("scipy", "circle", INK))


@element("periodic-table", "A rotor with cogging: the periodic table of its torque, and how the rotor is caught in a pole")
def periodic_table(p):
    cogging = mechanism("periodic-table")["tables"]["cogging"]
    spline = CubicSpline(cogging["x"], cogging["values"], bc_type="periodic")
    period = cogging["x"][-1]
    heading(p, 0, "Cogging of a motor")
    x, y = 130, 156
    for k in range(6):
        p.line((x, y), around(x, y, 82, 60 * k), color=GREY, width=1, dash="3 3")
    p.circle(x, y, 46)
    for k in range(6):
        middle = 60 * k + 14
        p.line(*(around(x, y, r, middle + d) for r, d in ((46, -12), (58, -10), (58, 10), (46, 12))), fill=SKY if k % 2 else "#F3C9B0", width=1.2)
    p.hinge(x, y)
    p.text(x, y + 22, "`rotor`", anchor="middle")
    p.turn(x, y, 92, 0, 14, BLUE)
    p.text(x + 98, y - 14, "`shaft.angle`", BLUE)
    p.turn(x, y, 72, 104, 150)
    p.text(x - 66, y - 74, "`magnets`", ORANGE, anchor="middle")
    p.text(16, 266, "`effort = cogging(shaft.angle)`")
    marks = [(k * period, text) for k, text in enumerate(("0", "π/3", "2π/3", "π", "4π/3", "5π/3", "2π"))]
    a = axes(
        p, 1, "A table that repeats itself", (0, 3 * period), (-0.1, 0.1), x_label="`shaft.angle`, rad", y_label="`cogging`, N·m", x_ticks=marks[:4]
    )
    angles = np.linspace(0, 3 * period, 121)
    a.line(angles, spline(angles))
    a.dots(cogging["x"], cogging["values"])
    a.text(0.1, 0.084, "knots `x` of one period, ends equal")
    caught, free = runs("periodic-table", [{"share": 1}, {"share": 0}], 2, 0.01)
    t = caught["time"]
    slope = lambda _, state: [state[1], (float(spline(state[0])) - 0.004 * state[1]) / 0.002]
    a = axes(p, 2, "A rotor that starts with 12 rad/s", (0, 2), (0, 7.5), x_label="time, s", y_label="`shaft.angle`, rad", y_ticks=marks)
    a.line(t, free["angle"], GREY, dash="5 4", width=1.5)
    a.line(t, caught["angle"])
    a.compare(t, caught["angle"], solved(slope, [0, 12], t), every=5)
    a.compare(t, free["angle"], 6 * (1 - np.exp(-2 * t)), GREY, every=10)
    a.key(0.9, 2.9, ("with the table", "line", BLUE), ("without it", "dash", GREY), ("scipy", "circle", INK), ("closed form", "circle", GREY))


@element("two-arguments", "A motor whose torque is a table of speed and throttle: its curves, and the speed with three throttles")
def two_arguments(p):
    torque = mechanism("two-arguments")["tables"]["torque"]
    x, y, values = (np.array(torque[key]) for key in ("x", "y", "values"))

    def surface(speed, throttle):
        """A spline through three knots is a parabola."""
        across = np.array([np.polyval(np.polyfit(y, row, 2), throttle) for row in values])
        return np.polyval(np.polyfit(x, across, 2), speed)

    heading(p, 0, "A torque over two quantities")
    p.ground(36, 196, 110, 196)
    p.box(73, 150, 74, 90)
    p.text(73, 172, "motor", anchor="middle")
    p.box(150, 150, 80, 8)
    p.box(206, 150, 34, 96)
    p.text(206, 216, "`rotor`", anchor="middle")
    p.arrow(73, 66, 73, 102, GREEN)
    p.text(82, 72, "`throttle`", GREEN)
    p.turn(146, 150, 26, -60, 70, BLUE)
    p.text(118, 96, "`shaft.angular_velocity`", BLUE)
    p.turn(238, 150, 26, -60, 60)
    p.text(250, 190, "`motor`", ORANGE)
    p.text(16, 252, "`effort =`")
    p.text(28, 270, "`torque(shaft.angular_velocity, throttle)`")
    a = axes(p, 1, "A list of values for each speed", (0, 200), (-15, 60), x_label="`x`: `shaft.angular_velocity`, rad/s", y_label="`torque`, N·m")
    speeds = np.linspace(0, 200, 61)
    for throttle, color in ((1, ORANGE), (0.5, BLUE), (0.25, GREEN), (0, GREY)):
        a.line(speeds, [surface(speed, throttle) for speed in speeds], color, dash="5 4" if throttle == 0.25 else None)
    for k in range(3):
        a.dots(x, values[:, k])
    a.text(106, 49.5, "`throttle` = 1", ORANGE)
    a.text(60, 27, "0.5", BLUE)
    a.text(30, 13.5, "0.25, between knots", GREEN)
    a.text(30, -11, "0", GREY)
    found = runs("two-arguments", [{"throttle": 1}, {"throttle": 0.5}, {"throttle": 0.25}], 8, 0.05)
    a = axes(p, 2, "Speed with a fan as load", (0, 8), (0, 240), x_label="time, s", y_label="`shaft.angular_velocity`, rad/s")
    for run, color in zip(found, (ORANGE, BLUE, GREEN), strict=True):
        t, throttle = run["time"], run["throttle"][0]
        a.line(t, run["speed"], color)
        slope = lambda _, state, throttle=throttle: [(surface(state[0], throttle) - 8e-4 * state[0] ** 2) / 0.3]
        a.compare(t, run["speed"], solved(slope, [50], t), every=8)
    a.text(4, 208, "`throttle` = 1", ORANGE)
    a.text(4, 160, "0.5", BLUE)
    a.text(4, 76, "0.25", GREEN)
    a.key(5.2, 24, ("scipy", "circle", INK))


@element("motion", "A table that a driver shakes under a mass on a spring: the prescribed motion with its derivatives, and the motion of the mass")
def motion(p):
    heading(p, 0, "A prescribed motion")
    x = 130
    p.box(x, 216, 150, 18)
    p.text(x, 221, "`table`", anchor="middle")
    p.spring(x, 207, x, 134)
    p.box(x, 110, 70, 46)
    p.text(x, 114, "`mass`", anchor="middle")
    for y in (216, 110):
        p.line((x - 36 if y == 110 else x - 76, y), (40, y), color=GREY, width=1, dash="3 3")
    p.ground(40, 70, 40, 244)
    p.arrow(x + 50, 110, x + 50, 66, BLUE)
    p.text(x + 58, 84, "`guide.position`", BLUE)
    p.arrow(x + 88, 216, x + 88, 176, BLUE)
    p.text(x + 60, 168, "`lift.position`", BLUE)
    p.arrow(x, 262, x, 228)
    p.text(x + 8, 252, "`shaker.effort`", ORANGE)
    p.text(16, 281, "`motion = h*sin(omega*time)`")
    a = axes(
        p,
        1,
        "The motion and its exact derivatives",
        (0, 2 * np.pi / 6),
        (-0.016, 0.016),
        x_label="`time`, s",
        y_label="`motion` of `lift.position`, m",
        x_ticks=[0, 0.25, 0.5, 0.75, 1],
        y_ticks=[(-0.01, "−`h`"), (0, "0"), (0.01, "`h`")],
    )
    t = np.linspace(0, 2 * np.pi / 6, 81)
    for curve, color, dash in ((np.sin(6 * t), BLUE, None), (np.cos(6 * t), ORANGE, "5 4"), (-np.sin(6 * t), GREEN, "2 3")):
        a.line(t, 0.01 * curve, color, dash=dash)
    a.text(0.24, 0.0118, "`motion`", BLUE)
    a.text(0.52, -0.0125, "velocity / `omega`", ORANGE, anchor="middle")
    a.text(0.57, 0.0118, "acceleration / `omega`²", GREEN)
    (found,) = runs("motion", [{"h": 0.01}], 4, 0.02)
    t = found["time"]
    a = axes(p, 2, "A table that starts to shake", (0, 4), (-35, 45), x_label="time, s", y_label="displacement, mm")
    a.line(t, 1e3 * found["table"], GREY, dash="5 4", width=1.5)
    a.line(t, 1e3 * (found["mass"] - 0.2))
    a.compare(t, 1e3 * (found["mass"] - 0.2), 10 / (1 - 0.36) * (np.sin(6 * t) - 0.6 * np.sin(10 * t)), every=5)
    a.key(0.15, 39, ("`table`, driven", "dash", GREY), ("`mass`", "line", BLUE))
    a.key(2.3, 39, ("closed form", "circle", INK))


@element("acceleration", "A servo drive under a trolley with a load: its acceleration over speed, and speed and force with two loads")
def acceleration(p):
    heading(p, 0, "A prescribed acceleration")
    p.ground(290, 112, 30, 112)
    p.line((30, 112), (290, 112), width=2)
    p.box(130, 130, 80, 28)
    p.text(130, 134, "`trolley`", anchor="middle")
    for x in (104, 156):
        p.circle(x, 114, 4, fill="#FFFFFF")
    hook = around(130, 144, 84, 292)
    p.line((130, 144), (130, 244), color=GREY, width=1, dash="3 3")
    p.line((130, 144), hook)
    p.hinge(130, 144)
    p.circle(*hook, 15)
    p.text(hook[0] + 22, hook[1] + 6, "`weight`")
    p.turn(130, 144, 60, 270, 292, BLUE)
    p.text(122, 206, "`rope.angle`", BLUE, anchor="end")
    p.arrow(130, 80, 200, 80, BLUE)
    p.text(92, 68, "`rail.position`, `rail.velocity`", BLUE)
    p.arrow(170, 130, 232, 130)
    p.text(180, 152, "`servo.effort`", ORANGE)
    p.text(16, 274, "`acceleration = (speed - rail.velocity)/tau`")
    a = axes(
        p,
        1,
        "The drive decides the acceleration",
        (0, 2),
        (-4, 5),
        x_label="`rail.velocity`, m/s",
        y_label="`acceleration`, m/s²",
        x_ticks=[(0, "0"), (1, "`speed`"), (2, "2")],
        y_ticks=[(-2, "−2"), (0, "0"), (2, "2"), (1 / 0.3, "`speed/tau`")],
    )
    a.line([0, 2], [1 / 0.3, -1 / 0.3])
    a.text(0.62, 2.0, "slope −1/`tau`", BLUE)
    light, heavy = runs("acceleration", [{"load": 1}, {"load": 5}], 3, 0.02)
    t = light["time"]
    a = axes(
        p,
        2,
        "The load changes the force alone",
        (0, 3),
        (0, 1.2),
        top=60,
        height=70,
        y_label="`rail.velocity`, m/s",
        y_ticks=[0, (1, "`speed`")],
        x_ticks=[],
    )
    a.line(t, heavy["velocity"], ORANGE, width=4)
    a.line(t, light["velocity"], BLUE, width=1.5)
    a.compare(t, light["velocity"], 1 - np.exp(-t / 0.3), every=8)
    a.key(1.75, 0.62, ("`load` = 1 kg", "line", BLUE), ("`load` = 5 kg", "line", ORANGE), ("closed form", "circle", INK))
    a = axes(p, 2, "", (0, 3), (-15, 30), top=160, height=76, x_label="time, s", y_label="`servo.effort`, N", y_ticks=[-10, 0, 10, 20])
    a.line(t, heavy["effort"], ORANGE)
    a.line(t, light["effort"])


@element("equilibrium", "A flap on a torsion spring: its guess, the balance of torques, and runs that start in the equilibrium or at the guess")
def equilibrium(p):
    heading(p, 0, "From the guess to the balance")
    x, y = 70, 120
    rest = brentq(lambda q: 4 * q + 0.2 * GRAVITY * np.cos(q), -1.5, 0)
    p.bar(x, y, x + 200, y, fill="#FFFFFF", color=GREY, dash="5 4")
    p.text(x + 100, y - 14, "guess: `angle` = 0", color=GREY)
    p.bar(x, y, *around(x, y, 200, np.degrees(rest)))
    p.wall_hinge(x, y)
    middle = around(x, y, 100, np.degrees(rest))
    p.mark(*middle)
    p.text(258, 216, "`flap`")
    p.arrow(*middle, middle[0], middle[1] + 56)
    p.text(middle[0] + 8, middle[1] + 54, "weight", ORANGE)
    p.turn(x, y, 150, 0, np.degrees(rest), BLUE)
    p.text(228, 148, "`hinge.angle`", BLUE)
    p.text(228, 164, "is negative", BLUE)
    p.turn(x, y, 44, 55, 125)
    p.text(x - 20, 64, "`torsion`", ORANGE)
    p.text(16, 266, "`equilibrium = true`")
    a = axes(
        p,
        1,
        "Torques about the hinge",
        (-1.5, 0.5),
        (-1, 4),
        x_label="`hinge.angle`, rad",
        y_label="torque about `hinge`, N·m",
        x_ticks=[-1.5, -1, -0.5, 0, 0.5],
    )
    angles = np.linspace(-1.5, 0.5, 61)
    a.line([-1, 0.25], [4, -1], BLUE)
    a.line(angles, 0.2 * GRAVITY * np.cos(angles), ORANGE)
    a.circle(rest, -4 * rest, radius=5)
    a.text(-0.76, 3.3, "spring, counterclockwise", BLUE)
    a.text(-0.36, 2.2, "weight, clockwise", ORANGE)
    a.text(rest, -4 * rest, "balance", anchor="end", dx=-9, dy=0)
    balanced = runs("equilibrium", [{"k": 4}], 4, 0.02)[0]
    free = runs("equilibrium", [{"k": 4}], 4, 0.02, ("equilibrium = true", "equilibrium = false"))[0]
    a = axes(p, 2, "Runs from the guess", (0, 4), (-1, 0.5), x_label="time, s", y_label="`hinge.angle`, rad")
    a.line(free["time"], free["angle"], GREY, dash="5 4", width=1.5)
    a.line(balanced["time"], balanced["angle"])
    a.compare(balanced["time"], balanced["angle"], np.full(len(balanced["time"]), rest), every=20)
    a.key(0.15, 0.38, ("`equilibrium` = false", "dash", GREY), ("`equilibrium` = true", "line", BLUE))
    a.key(2.55, 0.38, ("balance", "circle", INK))


@element("actuator-states", "A motor with a PI controller: its circuit, its loop, and the speed with and without the integral")
def actuator_states(p):
    heading(p, 0, "A motor and its current")
    top, bottom, left, right = 84, 196, 46, 176
    p.line((left, top), (64, top))
    p.box(82, top, 36, 14, fill="#FFFFFF")
    p.text(82, top + 24, "`R`", anchor="middle")
    p.line((100, top), (114, top))
    coil = [around(120 + 12 * k, top, 6, angle) for k in range(4) for angle in range(180, -1, -30)]
    p.line(*coil)
    p.text(138, top + 24, "`L`", anchor="middle")
    p.line((162, top), (right, top), (right, 118))
    p.circle(right, 140, 22)
    p.line((right, 162), (right, bottom), (left, bottom), (left, 158))
    p.line((left, top), (left, 122))
    p.circle(left, 140, 18, fill="#FFFFFF")
    p.text(left, 136, "+", anchor="middle")
    p.text(left, 152, "−", anchor="middle")
    p.text(70, 144, "`voltage`")
    p.arrow(106, 66, 142, 66, GREEN)
    p.text(98, 58, "`current`", GREEN)
    p.text(right, 144, "motor", anchor="middle", size=11)
    p.box(214, 140, 32, 8)
    p.box(246, 140, 32, 84)
    p.text(246, 200, "`rotor`", anchor="middle")
    p.turn(268, 140, 24, -60, 60)
    p.text(306, 88, "`k*current`", ORANGE, anchor="end")
    p.text(16, 232, "`current`:", GREEN)
    p.text(28, 248, "`rate = (voltage - R*current`")
    p.text(54, 264, "`- k*shaft.angular_velocity)/L`")
    p.text(16, 282, "`integral`:", GREEN)
    p.text(90, 282, "`rate = error`")
    heading(p, 1, "The loop of the controller")

    def block(x, y, text, color=INK, width=58):
        p.box(x, y, width, 28, fill="#FFFFFF", color=color)
        p.text(x, y + 4, text, color=color, anchor="middle")

    y, split, total = 120, 428, 520
    p.arrow(336, y, 370, y, INK, width=1.5)
    p.text(332, y - 10, "`speed`")
    p.circle(380, y, 10, fill="#FFFFFF")
    p.text(367, y + 24, "−", anchor="middle")
    p.text(389, y - 14, "`error`")
    p.line((390, y), (split, y))
    for row in (92, 152):
        p.line((split, y), (split, row), (split + 12, row))
    block(462, 92, "`kp`", width=44)
    block(468, 152, "`ki` ∫ dt", GREEN, width=56)
    p.line((split, 92), (440, 92))
    p.arrow(484, 92, total - 8, y - 6, INK, width=1.5)
    p.arrow(496, 152, total - 7, y + 8, INK, width=1.5)
    p.circle(total, y, 10, fill="#FFFFFF")
    p.text(total, y + 4, "+", anchor="middle")
    p.arrow(total + 10, y, 572, y, INK, width=1.5)
    p.text(524, y - 14, "`voltage`")
    block(600, y, "motor", width=56)
    p.text(594, y + 36, "`current`", GREEN, anchor="end")
    p.text(594, y + 56, "`k*current`", ORANGE, anchor="end")
    p.arrow(600, y + 14, 600, 198, INK, width=1.5)
    block(600, 212, "`rotor`", width=56)
    p.line((572, 212), (380, 212))
    p.arrow(380, 212, 380, 130, INK, width=1.5)
    p.text(394, 230, "`shaft.angular_velocity`", BLUE)
    p.text(336, 268, "green: the states `current` and `integral`", GREEN)
    found = runs("actuator-states", [{"ki": 8}, {"ki": 0}], 2, 0.01)
    a = axes(
        p,
        2,
        "A set point of 4 rad/s from rest",
        (0, 2),
        (0, 6),
        x_label="time, s",
        y_label="`shaft.angular_velocity`, rad/s",
        y_ticks=[0, 1, 2, 3, (4, "`speed`"), 5],
    )
    for run, color in zip(found, (BLUE, ORANGE), strict=True):
        t, ki = run["time"], run["ki"][0]
        # speed, current, integral, 1
        matrix = np.array(
            [[-0.05 / 0.02, 0.2 / 0.02, 0, 0], [-(0.2 + 0.8) / 0.02, -1 / 0.02, ki / 0.02, 0.8 * 4 / 0.02], [-1, 0, 0, 4], [0, 0, 0, 0]]
        )
        a.line(t, run["omega"], color)
        a.compare(t, run["omega"], [(expm(matrix * at) @ [0, 0, 0, 1])[0] for at in t], every=8)
    a.key(0.1, 5.5, ("with the integral", "line", BLUE), ("`ki` = 0", "line", ORANGE))
    a.key(1.12, 5.5, ("closed form", "circle", INK))


def drawn(name):
    """The picture of an element."""
    alternative, draw = ELEMENTS[name]
    picture = Picture(alternative)
    draw(picture)
    return picture.svg()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"{', '.join(ELEMENTS)}; all unless given")
    parser.add_argument("--out", type=Path, default=PICTURES, help="folder of the pictures [default: docs/elements]")
    options = parser.parse_args()
    if unknown := set(options.names) - set(ELEMENTS):
        parser.error(f"no {', '.join(sorted(unknown))}, expected some of {', '.join(ELEMENTS)}")
    options.out.mkdir(parents=True, exist_ok=True)
    for name in options.names or ELEMENTS:
        (options.out / f"{name}.svg").write_text(drawn(name), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
