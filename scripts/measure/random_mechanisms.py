"""Compares both formulations of random mechanisms, and an independent integration, run by run.

Each seed gives a mechanism file: a tree of 1 to 8 bodies with up to two loops. It has revolute, prismatic and fixed joints, springs,
dampers, bushings, stops, couplings, drivers, actuators, friction, tables and actuator states. It is simulated in both formulations at its
defaults and at corners of its parameters and inputs.

The formulations agree if no position or speed differs by more than ALLOWED tolerances of the largest value of its kind. The limit of
accelerations and forces is STEEP times as large, with stops STOPS times that. To each limit is added the change up to this row by
perturbations of the start by 1e-9. Rows after a perturbation has grown to 1e-5 are not compared: there, rounding decides the motion. An
integration in Cartesian coordinates by scipy (planar.py) is the third opinion. A formulation may refuse a mechanism with a message that
names a part.

Usage: .venv/bin/python scripts/measure random-mechanisms [--count 50] [--seed 1] [--independent 25] [--out FOLDER]
It ends with exit code 1 if runs differ, or a message names nothing; FOLDER then has their files.
"""

import argparse
import csv
import json
import math
import os
import random
import re
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

# two runs at a time leave no core for more threads
for variable in ["OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS"]:
    os.environ[variable] = "1"

import numpy as np
import planar
from common import METAFMU

STOP, STEP = 3.0, 0.02
TIMES = np.arange(round(STOP / STEP) + 1) * STEP
# of the integration, and how many of them formulations may differ by: errors of some thousands of steps, at each of which motions through stops and
# friction amplify the errors before it
TOLERANCE, ALLOWED = 1e-13, 1e5
# how many times as much accelerations and forces may differ: they are positions and speeds times the slopes of stops and friction
STEEP = 10.0
# how many times as much mechanisms with stops may differ: no step ends where a stop begins, and a smaller tolerance hardly reduces that error
STOPS = 30.0
PERTURBATION, CHAOTIC = 1e-9, 1e-5
PERTURBATIONS = ["place", "speed"]
# scipy's own tolerance, how many of them add up, and how many times the perturbation they are: a hundredth of it in each of a thousand steps
INDEPENDENT, ALLOWED_INDEPENDENT, GROWTH = 1e-11, 1e5, 10.0
TIME_LIMIT = 30.0
# smallest share of a gradient that is independent of the others
INDEPENDENCE = 0.05
PARAMETERS = {"m": (0.8, 1.25), "l": (0.97, 1.03), "k": (0.7, 1.4)}
FORMULATIONS = ["augmented", "embedding"]


def toml(value):
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {toml(of)}" for key, of in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value) if isinstance(value, (str, bool)) else repr(float(value))


def written(description):
    """A description as a mechanism file: keys of the top, then a line for each part."""
    lines = [f"{key} = {toml(value)}" for key, value in description.items() if not isinstance(value, dict)]
    for section, parts in description.items():
        if isinstance(parts, dict) and parts:
            lines += ["", f"[{section}]", *(f"{name} = {toml(part)}" for name, part in parts.items())]
    return "\n".join(lines) + "\n"


def turned(angle, x, y):
    c, s = math.cos(angle), math.sin(angle)
    return c * x - s * y, s * x + c * y


class Generator:
    """A mechanism that is closed at its start."""

    def __init__(self, seed):
        self.random = random.Random(seed)
        self.places = {"ground": (0.0, 0.0, 0.0)}
        slope = self.random.uniform(-1, 1) if self.random.random() < 0.5 else 0.0
        size = self.random.choice([9.81, 9.81, 1.62, 0.0])
        parameters = {name: {"default": 1.0, "min": low, "max": high} for name, (low, high) in PARAMETERS.items()}
        self.file = {
            "description": f"Random mechanism of seed {seed}",
            "gravity": [size * math.sin(slope), -size * math.cos(slope)],
            "parameters": parameters | {name: {"default": 0.0, "min": 0.0, "max": 1e-6} for name in PERTURBATIONS},
            "inputs": {"u": {"start": 0.3, "min": -1.0, "max": 1.0}},
            **{section: {} for section in ("tables", "variables", "states", "ground", "bodies", "joints", "couplings", "drivers", "springs")},
            **{section: {} for section in ("bushings", "stops", "forces", "actuators", "initial", "outputs")},
        }
        self.file["ground"]["points"] = {}
        self.free, self.slides = [], {}
        self.make()

    def chance(self, share):
        return self.random.random() < share

    def number(self, low, high, digits=3):
        return round(self.random.uniform(low, high), digits)

    def attach(self, owner, place, is_scaled=False):
        """A point of a body, or of the ground, at a place; its name."""
        x, y, angle = self.places[owner]
        local = turned(-angle, place[0] - x, place[1] - y)
        points = (self.file["ground"] if owner == "ground" else self.file["bodies"][owner])["points"]
        name = f"p{len(points)}"
        points[name] = [f"{component!r}*l" for component in local] if is_scaled else list(local)
        return f"{owner}.{name}"

    def place(self, owner, low=0.1, high=0.5):
        x, y, _ = self.places[owner]
        reach, angle = self.number(low, high), self.number(-math.pi, math.pi)
        return x + reach * math.cos(angle), y + reach * math.sin(angle)

    def join(self, name, kind, one, other, place, is_scaled=False):
        """A joint that two bodies meet in as they are placed."""
        if self.chance(0.5):
            one, other = other, one
        joint = {"type": kind, "between": [self.attach(one, place, is_scaled)]}
        if kind == "prismatic":
            angle, by = self.number(-math.pi, math.pi), self.number(-0.2, 0.2)
            axis = turned(angle, 1.0, 0.0)
            joint["axis"] = [self.number(0.5, 2) * component for component in axis]
            size = math.hypot(*joint["axis"])
            axis = turned(self.places[one][2], *(component / size for component in joint["axis"]))
            place = place[0] + by * axis[0], place[1] + by * axis[1]
            self.slides[f"{name}.position"] = by
        joint["between"].append(self.attach(other, place))
        if kind != "revolute":
            joint["angle"] = self.places[other][2] - self.places[one][2]
        self.file["joints"][name] = joint

    def value(self, coordinate):
        """Value of a joint's coordinate at the start."""
        if coordinate in self.slides:
            return self.slides[coordinate]
        owner, what = coordinate.rsplit(".", 1)
        if owner in self.file["bodies"]:
            return self.places[owner][("x", "y", "angle").index(what)]
        ends = [end.split(".")[0] for end in self.file["joints"][owner]["between"]]
        return self.places[ends[1]][2] - self.places[ends[0]][2]

    def rate(self, coordinate):
        owner, what = coordinate.rsplit(".", 1)
        return f"{owner}.{ {'angle': 'angular_velocity', 'position': 'velocity', 'x': 'vx', 'y': 'vy'}[what] }"

    def make(self):
        file = self.file
        for index in range(self.random.randint(1, 8)):
            self.body(f"b{index + 1}")
        file["joints"] = dict(file["joints"])
        for index in range(self.random.choice([0, 0, 1, 1, 2])):
            self.tried("joints", f"c{index + 1}", self.close)
        self.free = self.coordinates()
        if self.chance(0.3):
            self.tried("couplings", "gear", self.couple)
        if self.chance(0.2):
            self.tried("drivers", "drive", self.drive)
        self.act()
        self.begin()
        self.show()
        self.file = {key: value for key, value in file.items() if value or not isinstance(value, dict)}

    def body(self, name):
        file, owners = self.file, list(self.places)
        parent = self.random.choice(owners[-2:]) if self.chance(0.7) else self.random.choice(owners)
        kind = self.random.choices(["revolute", "prismatic", "fixed", "none"], [66, 20, 7, 7])[0]
        mass = self.number(0.3, 3)
        file["bodies"][name] = {"mass": f"{mass}*m", "inertia": f"{round(mass * self.number(0.01, 0.08), 4)}*m", "points": {}}
        if parent == "ground":
            self.places["ground"] = self.number(-0.5, 0.5), self.number(-0.5, 0.5), 0.0
        place = self.place(parent, 0.0 if parent == "ground" else 0.1)
        self.places["ground"] = (0.0, 0.0, 0.0)
        angle, reach, turn = self.number(-math.pi, math.pi), self.number(0.1, 0.4), self.number(-math.pi, math.pi)
        self.places[name] = place[0] + reach * math.cos(angle), place[1] + reach * math.sin(angle), turn
        file["bodies"][name] |= {"position": list(self.places[name][:2]), "angle": turn}
        if kind == "none":
            ends = [self.attach(parent, place), self.attach(name, place)]
            stiffness, damping = [f"{self.number(50, 500)}*k", self.number(50, 500), self.number(1, 20)], [self.number(0, 5) for _ in range(3)]
            file["bushings"][f"m{name[1:]}"] = {"between": ends, "stiffness": stiffness, "damping": damping, "angle": self.number(-3, 3)}
        else:
            self.join(f"j{name[1:]}", kind, parent, name, place, is_scaled=self.chance(0.3) and kind == "revolute")

    def close(self, name):
        owners = list(self.places)
        if len(owners) < 3:
            return
        one, other = self.random.sample(owners, 2)
        self.join(name, "revolute" if self.chance(0.85) else "prismatic", one, other, self.place(one))

    def couple(self, name):
        if len(self.free) < 2:
            return
        held, leader = self.random.sample(self.free, 2)
        at, ratio = self.value(leader), self.number(0.3, 1.5) * self.random.choice([-1, 1])
        follows = f"{self.value(held)!r} + {ratio}*({leader} - ({at!r}))"
        if self.chance(0.4):
            follows += f" + 0.1*sin({leader} - ({at!r}))"
        elif self.chance(0.4):
            self.file["tables"]["cam"] = {
                "x": [-math.pi, -1.5, 0.0, 1.5, math.pi], "values": [0.0, 0.1, 0.15, 0.1, 0.0], "interpolation": "cubic", "extrapolation": "periodic",
            }  # fmt: skip
            follows = f"{self.value(held)!r} - 0.15 + cam({leader} - ({at!r}))"
        self.file["couplings"][name] = {"coordinate": held, "follows": follows}

    def drive(self, name):
        if not self.free:
            return
        coordinate = self.random.choice(self.free)
        at, rate = self.value(coordinate), self.number(0.5, 4)
        if self.chance(0.5):
            motion = self.random.choice([f"0.4*sin({rate}*time)", f"{rate}*time", "0.5*smooth(time/2)", "0.2*time^2/(1 + time)"])
            self.file["drivers"][name] = {"coordinate": coordinate, "motion": f"{at!r} + {motion}"}
        else:
            acceleration = f"{5 * rate}*({at!r} + 0.3*u - {coordinate}) - {rate}*{self.rate(coordinate)}"
            self.file["drivers"][name] = {"coordinate": coordinate, "acceleration": acceleration}

    def coordinates(self):
        """Coordinates of the joints."""
        what = {"revolute": "angle", "prismatic": "position"}
        return [f"{name}.{what[joint['type']]}" for name, joint in self.file["joints"].items() if joint["type"] in what]

    def gradients(self):
        """State at the start and gradients of the constraints, with a row for each driver of an acceleration."""
        mechanism = planar.Planar(written(self.file))
        q = np.array([place for name, place in self.places.items() if name != "ground"]).ravel()
        state = planar.State(mechanism, 0.0, np.concatenate([q, 0 * q, [0.0] * len(self.file["states"])]))
        rows = [row.gradient for _, row in state.constraints()]
        rows += [state.coordinate(driver["coordinate"]).gradient for driver in self.file["drivers"].values() if "acceleration" in driver]
        return state, np.array(rows).reshape(-1, len(q))

    def tried(self, section, name, make):
        """Adds a part, unless it depends on the others or leaves nothing free."""
        slides = dict(self.slides)
        make(name)
        _, rows = self.gradients()
        if name in self.file[section] and (len(rows) >= rows.shape[1] or remainder(rows) < INDEPENDENCE):
            del self.file[section][name]
            self.slides = slides

    def act(self):
        """Springs, dampers, stops and actuators."""
        file = self.file
        for index, coordinate in enumerate(self.free):
            rate, at = self.rate(coordinate), self.value(coordinate)
            if self.chance(0.35):
                rest = self.number(-1, 1) if coordinate.endswith("angle") else self.number(-0.2, 0.2)
                file["springs"][f"s{index}"] = {"coordinate": coordinate, "stiffness": f"{self.number(2, 60)}*k", "damping": self.number(0, 1), "rest": rest}
            elif self.chance(0.3):
                file["springs"][f"s{index}"] = {"coordinate": coordinate, "damping": self.number(0.05, 1)}
            if self.chance(0.12):
                limits = {"min": at - self.number(0.1, 0.6), "max": at + self.number(0.1, 0.6)}
                if self.chance(0.3):
                    del limits[self.random.choice(["min", "max"])]
                file["stops"][f"e{index}"] = {"coordinate": coordinate, **limits, "stiffness": self.number(500, 5000), "damping": self.number(0, 0.5)}
            if self.chance(0.3):
                efforts = [f"2*u*cos({self.number(1, 5)}*time)", f"-0.5*tanh({rate}/0.1)", f"u - 3*({coordinate} - target) - 0.4*{rate}"]
                efforts += [f"grip({rate})", f"push({rate}, u)", "3*z1", f"max(-1, min(1, 5*(u - {coordinate})))", f"-0.3*{rate}*abs({rate})"]
                effort = self.random.choice(efforts)
                self.provide(effort, coordinate)
                file["actuators"][f"a{index}"] = {"coordinate": coordinate, "effort": effort}
        owners = list(self.places)
        for index in range(self.random.choice([0, 0, 1, 2])):
            one, other = self.random.sample(owners, 2)
            ends = [self.attach(one, self.place(one)), self.attach(other, self.place(other))]
            spring = {"between": ends, "stiffness": f"{self.number(5, 80)}*k", "damping": self.number(0, 2), "rest": self.number(0.05, 0.5)}
            if self.chance(0.3):
                spring["force"] = f"2*u - 0.2*f{index}.velocity*abs(f{index}.velocity)"
            file["springs"][f"f{index}"] = spring
        if self.chance(0.3):
            body = self.random.choice(list(file["bodies"]))
            force = ["2*u", f"-0.2*{body}.vy"] if self.chance(0.5) else [f"sin({self.number(1, 5)}*time)", "0.5*u^2"]
            file["forces"]["gust"] = {"point": self.attach(body, self.place(body)), "force": force}
        if self.chance(0.1):
            body = self.random.choice(list(file["bodies"]))
            file["actuators"]["lift"] = {"coordinate": f"{body}.y", "effort": f"5*sin(2*{body}.angle)"}

    def provide(self, effort, coordinate):
        """Adds the parts that an effort names."""
        file, rate = self.file, self.rate(coordinate)
        if "target" in effort:
            file["variables"]["target"] = f"{self.value(coordinate)!r} + 0.2*sin(time)"
        if "grip" in effort:
            file["tables"]["grip"] = {"x": [-2, -0.7, 0, 0.7, 2], "values": [1.2, 0.5, 0, -0.6, -1.7], "interpolation": "cubic", "extrapolation": "linear"}
            if self.chance(0.4):
                file["tables"]["grip"] |= {"interpolation": "linear", "extrapolation": "hold"}
        if "push" in effort:
            values = [[-1, 0.5, 1.5], [-0.8, 0.2, 1.1], [-0.9, 0, 0.9], [-1, -0.2, 0.7]]
            file["tables"]["push"] = {"x": [-3, -1, 1, 3], "y": [-1, 0, 1], "values": values, "interpolation": "cubic", "extrapolation": "linear"}
        if "z1" in effort:
            file["states"]["z1"] = {"rate": f"(u - z1 - 0.2*{rate})/0.05", "start": 0.1}
            if self.chance(0.5):
                file["states"]["z2"] = {"rate": f"{rate} - 0.5*z2"}

    def begin(self):
        """A condition for each degree of freedom: the start then follows from them."""
        state, rows = self.gradients()
        mechanism = planar.Planar(written(self.file))
        rows = rows[: len(rows) - sum("acceleration" in driver for driver in self.file["drivers"].values())]
        bodies = [f"{name}.{what}" for name in self.file["bodies"] for what in ("angle", "x", "y")]
        initial = self.file["initial"]
        for coordinate in [*self.free, *bodies]:
            if len(rows) == mechanism.count:
                break
            with_it = np.array([*rows, state.coordinate(coordinate).gradient])
            if remainder(with_it) < INDEPENDENCE:
                continue
            rows = with_it
            owner, what = coordinate.rsplit(".", 1)
            at = state.coordinate(coordinate).value
            rate = self.rate(coordinate).rsplit(".", 1)[1]
            initial.setdefault(owner, {})[what] = f"{at!r} {self.random.choice('+-')} place"
            initial[owner][rate] = f"{self.number(-1, 1) if self.chance(0.7) else 0.0} {self.random.choice('+-')} speed"

    def show(self):
        file, measures = self.file, []
        for coordinate in self.free:
            accelerations = {"angle": "angular_acceleration", "position": "acceleration"}
            owner, what = coordinate.rsplit(".", 1)
            measures += [coordinate, self.rate(coordinate), f"{owner}.{accelerations[what]}"]
        for name, joint in file["joints"].items():
            measures += [f"{name}.fx", f"{name}.fy"] + ([f"{name}.moment"] if joint["type"] != "revolute" else [])
        for name in file["bodies"]:
            measures += [f"{name}.{what}" for what in ("x", "y", "angle", "vx", "ay")]
        measures += [f"{name}.{what}" for name in file["bushings"] for what in ("fx", "fy", "moment", "x", "angular_velocity")]
        measures += [f"{name}.force" for name in file["springs"]]
        measures += [f"{name}.effort" for name in [*file["couplings"], *file["drivers"]]]
        measures += [*file["states"], "kinetic_energy"]
        file["outputs"] = {f"o{index}": {"measure": measure} for index, measure in enumerate(measures)}
        self.measures = measures


def remainder(rows):
    """Smallest share of a row that is outside the span of those before it, by QR."""
    if not len(rows):
        return 1.0
    if len(rows) > rows.shape[1]:
        return 0.0
    norms = np.linalg.norm(rows, axis=1)
    if norms.min() == 0:
        return 0.0
    return np.abs(np.diag(np.linalg.qr((rows / norms[:, None]).T)[1])).min()


@dataclass
class Case:
    """A mechanism with values of its parameters and its input."""

    text: str
    measures: list
    point: dict
    input: float

    def in_formulation(self, formulation):
        text = re.sub(r'(?m)^u = .*$', f'u = {{ start = {self.input!r}, min = -1.0, max = 1.0 }}', self.text)
        return f'formulation = "{formulation}"\n{text}'


def simulate(case, formulation):
    """Outputs of metafmu without and with each perturbation, shape `[3, times, outputs]`, or its message."""
    names = [*PARAMETERS, *PERTURBATIONS]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "mechanism.toml").write_text(case.in_formulation(formulation))
        # the test run, which a study cannot be without, is one of the same mechanism
        ranges = [f"{name} = {{ min = {low}, max = {high} }}\n" for name, (low, high) in [*PARAMETERS.items(), *((name, (0.0, 1e-6)) for name in PERTURBATIONS)]]
        study = f"""name = "runs"
[source]
mechanism = "mechanism.toml"
tolerance = {TOLERANCE}
time_limit = {TIME_LIMIT}
max_failed = 0.0
[time]
stop = {STOP}
step = {STEP}
[parameters]
{"".join(ranges)}
[outputs]
{"".join(f"o{index} = {{}}" + chr(10) for index in range(len(case.measures)))}[sampling]
method = "list"
file = "points.csv"
test_runs = 1
"""
        (folder / "study.toml").write_text(study)
        points = [[*(case.point[name] for name in PARAMETERS), *by] for by in ([0.0, 0.0], [PERTURBATION, 0.0], [0.0, PERTURBATION])]
        rows = [",".join(map(repr, point)) for point in points]
        (folder / "points.csv").write_text("\n".join([",".join(names), *rows]) + "\n")
        done = subprocess.run([METAFMU, "sample", "study.toml", "--out", "out"], cwd=folder, text=True, capture_output=True)
        if done.returncode:
            return (done.stdout + done.stderr).strip() or f"exit code {done.returncode} without a message"
        with open(folder / "out" / "train.csv", newline="") as file:
            header, *lines = csv.reader(file)
    columns = [next(k for k, name in enumerate(header) if name.split(" ")[0] == f"o{index}") for index in range(len(case.measures))]
    return np.array(lines)[:, columns].astype(float).reshape(len(points), len(TIMES), -1)


@dataclass
class Outcome:
    seed: int
    corner: str
    kind: str
    detail: str = ""
    files: dict = field(default_factory=dict)


KINDS = [
    ("angle",), ("x", "y", "position"), ("angular_velocity",), ("vx", "vy", "velocity"), ("angular_acceleration",), ("ax", "ay", "acceleration"),
    ("fx", "fy", "moment", "force", "effort"),
]  # fmt: skip


def scales(values, measures):
    """Unit of differences of each output: the largest value of its kind, as rounding is relative to the largest term of the equations."""
    largest = np.abs(values).max(axis=0)
    kinds = [next((kind for kind in KINDS if name.rpartition(".")[2] in kind), name) for name in measures]
    sizes = [max(size for size, other in zip(largest, kinds) if other == kind) for kind in kinds]
    return np.array([max(size, 1e-3) * (STEEP if kind in KINDS[-3:] else 1.0) for size, kind in zip(sizes, kinds)])


def sensitivity(values):
    """Largest change by the perturbations in each row and output."""
    return np.abs(values[1:] - values[0]).max(axis=0)


def compared(case, values, other, allowed, times=1.0):
    """Largest difference to the first of `values` in what is allowed, and its row and output; only rows before chaos are compared."""
    values, growth = values[0], sensitivity(values)
    scale = scales(values, case.measures)
    change = np.maximum.accumulate(growth / scale, axis=0).max(axis=1)
    rows = int(np.argmax(change > CHAOTIC)) if (change > CHAOTIC).any() else len(change)
    excess = np.abs(other - values)[:rows] / scale / (allowed + times * change[:rows, None])
    if not np.isfinite(excess).all():
        return math.inf, np.unravel_index(np.argmin(np.isfinite(excess)), excess.shape), rows
    return excess.max(), np.unravel_index(np.argmax(excess), excess.shape), rows


def examine(seed, with_independent):
    """Outcomes of a mechanism at its defaults and at a corner."""
    generator = Generator(seed)
    text, measures = written(generator.file), generator.measures
    corner = {name: generator.random.choice(ends) for name, ends in PARAMETERS.items()}
    points = {"defaults": (dict.fromkeys(PARAMETERS, 1.0), 0.3), "corner": (corner, generator.random.choice([-1.0, 1.0]))}
    outcomes = []
    for name, (point, level) in points.items():
        case = Case(text, measures, point, level)
        outcomes += examined(seed, name, case, with_independent)
    return outcomes


def difference(case, found, what):
    excess, (row, output), rows = found
    at = f"{case.measures[output]} at t = {TIMES[row]:.2f} s"
    return f"{what}: {excess:.2g} times what is allowed in {at}, {rows} of {len(TIMES)} rows compared"


def examined(seed, corner, case, with_independent):
    one = simulate(case, "augmented")
    other = simulate(case, "embedding")
    files = {f"{seed}-{corner}.toml": case.in_formulation("augmented")}
    refusals = [(kind, found) for kind, found in zip(FORMULATIONS, (one, other)) if isinstance(found, str)]
    for kind, message in refusals:
        if "took longer than" in message:
            return [Outcome(seed, corner, "too slow", f"{kind}: {message.splitlines()[-1]}", files)]
        # the name of a part, or of its key
        if not re.search(r"`[^`]+`|\b(joints|springs|bushings|drivers|couplings|stops|states|actuators)\.\w+", message) or "panicked" in message:
            return [Outcome(seed, corner, "unclear message", f"{kind}: {message}", files)]
    if refusals:
        kind = "both refused" if len(refusals) == 2 else f"{refusals[0][0]} refused"
        outcomes = [Outcome(seed, corner, kind, refusals[0][1].splitlines()[-1])]
    else:
        found = compared(case, one, other[0], ALLOWED * TOLERANCE * (STOPS if "[stops]" in case.text else 1.0))
        text = difference(case, found, "formulations")
        outcomes = [Outcome(seed, corner, "different" if found[0] > 1 else "agree", text, files)]
    if not with_independent or len(refusals) == 2:
        return outcomes
    base, kind = (one, "augmented") if not isinstance(one, str) else (other, "embedding")
    mechanism = planar.Planar(case.in_formulation("augmented"), case.point)
    try:
        own = planar.simulate(mechanism, TIMES, case.measures, INDEPENDENT)
    except (planar.OutOfTime, ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
        return [*outcomes, Outcome(seed, corner, "not integrated independently", str(error))]
    found = compared(case, base, own, ALLOWED_INDEPENDENT * INDEPENDENT, GROWTH)
    text = difference(case, found, f"{kind} and scipy")
    return [*outcomes, Outcome(seed, corner, "different from scipy" if found[0] > 1 else "agrees with scipy", text, files)]


WRONG = ("different", "unclear message", "different from scipy")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=50, help="number of mechanisms")
    parser.add_argument("--seed", type=int, default=1, help="of the first; the others follow")
    parser.add_argument("--independent", type=int, help="how many of them scipy integrates as well; half of them unless given")
    parser.add_argument("--out", type=Path, help="folder of mechanisms that differ")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    independent = options.count // 2 if options.independent is None else options.independent
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
    counts = {}
    with ThreadPoolExecutor(options.jobs) as pool:
        seeds = range(options.seed, options.seed + options.count)
        for outcomes in pool.map(lambda seed: examine(seed, seed - options.seed < independent), seeds):
            print(f"\rseed {outcomes[0].seed}", end="", file=sys.stderr, flush=True)
            for outcome in outcomes:
                counts.setdefault(outcome.kind, []).append(outcome)
                if outcome.kind not in ("agree", "agrees with scipy"):
                    print(f"seed {outcome.seed}, {outcome.corner}: {outcome.kind}: {outcome.detail}", flush=True)
                if options.out and outcome.kind in WRONG:
                    for name, text in outcome.files.items():
                        (options.out / name).write_text(text)
    for kind, outcomes in sorted(counts.items()):
        print(f"{kind}: {len(outcomes)}")
    sys.exit(1 if any(kind in counts for kind in WRONG) else 0)


if __name__ == "__main__":
    main()
