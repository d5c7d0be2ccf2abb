"""Compares the FMUs of a pendulum with friction, a rack and a levitated magnet with MuJoCo: results, and time at the same error.

MuJoCo has no such forces. They are a callback in C here, compiled with its headers, so that Python costs nothing in a step. The rack's mass is inertia of its
pinion (`armature`), as MuJoCo's couplings are soft. The reference is the mechanism file, integrated by scipy at 1e-12 (planar.py). MuJoCo's step is halved
from 5 ms until its largest error is that of the FMU, down to 20 µs. Times are those of a simulated second, the median and the minimum of alternating repetitions, both driven from Python in
steps of 10 ms; the FMU's outputs are read after each.

Usage: .venv/bin/python scripts/measure mujoco-parts [--out FOLDER] [PART]...
It needs `pip install mujoco fmpy` and a C compiler. FMUs that FOLDER has are not built again.
"""

import argparse
import ctypes
import statistics
import subprocess
import time
from pathlib import Path

import numpy as np
import planar
from common import ROOT, run
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave

PARTS = ROOT / "examples" / "dynamics" / "parts"
STOP, STEP = 2.0, 0.01
LONGEST, SHORTEST = 5e-3, 2e-5
REPETITIONS = 5
FRICTION = """description = "Pendulum with a motor and Coulomb friction"
gravity = [0, -9.81]

[parameters]
mc = { default = 0.15, min = 0.05, max = 0.3, unit = "N.m", description = "torque of the friction" }
m = { default = 1.0, min = 0.5, max = 2.0, unit = "kg" }

[inputs]
T = { min = -4, max = 4, unit = "N.m" }

[bodies]
rod = { mass = "m", inertia = "0.02*m", position = [0, -0.3], points = { o = [0, 0.3] } }

[joints]
pivot = { type = "revolute", between = ["ground", "rod.o"] }

[actuators]
motor = { coordinate = "pivot.angle", effort = "T" }
friction = { coordinate = "pivot.angle", effort = "-mc*tanh(pivot.angular_velocity/0.02)" }

[initial]
pivot = { angle = 0.5 }

[outputs]
q = { measure = "pivot.angle" }
w = { measure = "pivot.angular_velocity" }
"""
# forces along the joint, of values that the mechanism's parameters and inputs set in `user`
CALLBACK = """#include <math.h>
#include <mujoco/mujoco.h>

static double stop(double x, double v, double low, double high, double stiffness, double damping) {
  double below = fmax(low - x, 0) * fmax(1 - damping * v, 0), above = fmax(x - high, 0) * fmax(1 + damping * v, 0);
  return stiffness * (below - above);
}

void friction(const mjModel* m, mjData* d) {
  d->qfrc_passive[0] += d->userdata[0] - d->userdata[1] * tanh(d->qvel[0] / 0.02);
}

void rack(const mjModel* m, mjData* d) {
  double r = d->userdata[1], x = r * d->qpos[0], v = r * d->qvel[0];
  d->qfrc_passive[0] += d->userdata[0] - 0.05 * d->qvel[0] + r * stop(x, v, -0.5, 0.5, 2e4, 0.2);
}

void magnet(const mjModel* m, mjData* d) {
  double y = d->qpos[0], v = d->qvel[0], gap = 0.002 - y, current = d->userdata[0];
  d->qfrc_passive[0] += 1e-4 * current * current / (gap * gap) - 0.5 * v + stop(y, v, -0.03, -0.004, 1e5, 0.5);
}
"""


def hinge(mass, inertia, place, armature=0.0):
    turns = " ".join([repr(inertia)] * 3)
    return f"""<joint type="hinge" axis="0 -1 0" armature="{armature!r}"/><inertial pos="0 0 {-place}" mass="{mass!r}" diaginertia="{turns}"/>"""


def slide(mass):
    return f'<joint type="slide" axis="0 0 1"/><inertial pos="0 0 0" mass="{mass!r}" diaginertia="1e-3 1e-3 1e-3"/>'


# mechanism, names of the coordinate, its rate and their outputs; joint and values of the callback of a point; points of parameters, inputs and the start
CASES = {
    "friction": (
        FRICTION, ("pivot.angle", "pivot.angular_velocity"), ("q", "w"), lambda p: (hinge(p["m"], 0.02 * p["m"], 0.3), [p["T"], p["mc"]]),
        [({"m": 1.0, "mc": 0.15, "T": 1.0}, [0.5, 0.0]), ({"m": 0.5, "mc": 0.3, "T": -1.0}, [1.0, 1.0])],
    ),
    "rack": (
        None, ("shaft.angle", "shaft.angular_velocity"), ("x", "speed"), lambda p: (hinge(1.0, 0.3, 0.0, p["m"] * p["r"] ** 2), [p["torque"], p["r"]]),
        [({"r": 0.1, "m": 8.0, "torque": 2.0}, [0.5, 3.0]), ({"r": 0.3, "m": 3.0, "torque": -2.0}, [-1.0, -4.0])],
    ),
    "magnet": (
        None, ("guide.position", "guide.velocity"), ("y", "speed"), lambda p: (slide(p["m"]), [p["current"]]),
        [({"m": 0.4, "current": 0.0}, [-0.005, 0.3]), ({"m": 0.6, "current": 4.0}, [-0.025, -0.3])],
    ),
}  # fmt: skip


class InMujoco:
    """A joint with a callback, at a point."""

    def __init__(self, library, name, point, start):
        self.callback, self.start = getattr(library, name), start
        self.joint, self.values = CASES[name][3](point)
        # of the position, for outputs of the pinion's rack
        self.factor = point["r"] if name == "rack" else 1.0

    def prepared(self, step):
        """Rows of both outputs at multiples of STEP, and a function that simulates the motion."""
        import mujoco

        options = f'<option integrator="RK4" timestep="{step!r}" gravity="0 0 -9.81"><flag contact="disable" constraint="disable"/></option>'
        compiler = '<compiler boundinertia="0" boundmass="0" balanceinertia="true"/>'
        size = f'<size nuserdata="{len(self.values)}"/>'
        model = mujoco.MjModel.from_xml_string(f"<mujoco>{compiler}{size}{options}<worldbody><body>{self.joint}</body></worldbody></mujoco>")
        data = mujoco.MjData(model)
        count, rows = round(STEP / step), round(STOP / STEP)

        def begin():
            mujoco.set_mjcb_passive(self.callback)
            mujoco.mj_resetData(model, data)
            data.qpos[0], data.qvel[0] = self.start
            data.userdata[:] = self.values

        def simulate():
            begin()
            for _ in range(rows):
                mujoco.mj_step(model, data, count)

        begin()
        found = []
        for _ in range(rows):
            mujoco.mj_step(model, data, count)
            found.append([self.factor * data.qpos[0], data.qvel[0]])
        return np.array(found), simulate


class Slave:
    """An FMU, driven step by step."""

    def __init__(self, path, outputs):
        description = read_model_description(path)
        self.references = {variable.name: variable.valueReference for variable in description.modelVariables}
        self.outputs = [self.references[name] for name in outputs]
        identifier = description.coSimulation.modelIdentifier
        self.slave = FMU2Slave(guid=description.guid, unzipDirectory=extract(path), modelIdentifier=identifier)
        self.slave.instantiate()

    def simulate(self, values):
        self.slave.reset()
        self.slave.setupExperiment()
        self.slave.setReal([self.references[name] for name in values], list(values.values()))
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()
        rows = []
        for row in range(round(STOP / STEP)):
            self.slave.doStep(row * STEP, STEP)
            rows.append(self.slave.getReal(self.outputs))
        return np.array(rows)


def compiled(folder):
    """The library of callbacks."""
    import mujoco

    source, library = folder / "callbacks.c", folder / "callbacks.so"
    source.write_text(CALLBACK)
    include = Path(mujoco.__file__).parent / "include"
    subprocess.run(["cc", "-O2", "-shared", "-fPIC", "-I", include, source, "-o", library, "-lm"], check=True)
    return ctypes.CDLL(str(library.resolve()))


def in_scipy(text, name, point, start):
    """Rows of both outputs at multiples of STEP."""
    coordinates, measures = CASES[name][1], {"rack": ("rail.position", "shaft.angular_velocity")}
    (owner, what), (_, rate) = (coordinate.rsplit(".", 1) for coordinate in coordinates)
    text = text.split("[initial]")[0].split("[outputs]")[0]
    mechanism = planar.Planar(f"{text}[initial]\n{owner} = {{ {what} = {start[0]}, {rate} = {start[1]} }}\n", point, point)
    times = np.arange(round(STOP / STEP) + 1) * STEP
    return planar.simulate(mechanism, times, measures.get(name, coordinates), 1e-12, 10**6)[1:]


def measure(folder, library, name):
    mechanism, coordinates, outputs, _, points = CASES[name]
    fmu = folder / "out" / name / f"{name}.fmu"
    if not fmu.exists():
        (folder / f"{name}-mechanism.toml").write_text(mechanism or (PARTS / f"{name}.toml").read_text())
        (folder / f"{name}.toml").unlink(missing_ok=True)
        run(folder, "new", name, "--mechanism", f"{name}-mechanism.toml", "--structure", "dynamics")
        run(folder, "build", f"{name}.toml")
    slave = Slave(str(fmu), outputs)
    for point, start in points:
        own = InMujoco(library, name, point, start)
        reference = in_scipy(mechanism or (PARTS / f"{name}.toml").read_text(), name, point, start)
        largest = lambda rows, reference=reference: (np.abs(rows - reference).max(axis=0) / np.ptp(reference, axis=0)).max()
        values = point | {f"{coordinate}_start": value for coordinate, value in zip(coordinates, start)}
        error = largest(slave.simulate(values))
        steps = round(STEP / LONGEST)
        while (reached := largest(own.prepared(STEP / steps)[0])) > error and STEP / steps > SHORTEST:
            steps *= 2
        _, simulate = own.prepared(STEP / steps)
        ways = {"FMU": lambda values=values: slave.simulate(values), "MuJoCo": simulate}
        times = {way: [] for way in ways}
        for _ in range(REPETITIONS):
            for way, of in ways.items():
                begin = time.perf_counter()
                of()
                times[way].append(1e3 * (time.perf_counter() - begin) / STOP)
        shown = " | ".join(f"{statistics.median(of):.3g} | {min(of):.3g}" for of in times.values())
        at = ", ".join(f"{key} = {value:g}" for key, value in point.items())
        print(f"| {name}, {at} | {error:.1e} | {reached:.1e} | {1e3 * STEP / steps:.3g} | {shown} |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(CASES)}; all unless given")
    parser.add_argument("--out", type=Path, default=Path("out/mujoco-parts"), help="folder of the builds")
    options = parser.parse_args()
    if unknown := [name for name in options.parts if name not in CASES]:
        raise SystemExit(f"error: no part `{unknown[0]}`, expected one of {', '.join(CASES)}")
    options.out.mkdir(parents=True, exist_ok=True)
    library = compiled(options.out)
    print("| part | error of FMU | of MuJoCo | its step, ms | FMU: median, ms | minimum, ms | MuJoCo: median, ms | minimum, ms |\n|---|---|---|---|---|---|---|---|")
    for name in options.parts or CASES:
        measure(options.out, library, name)


if __name__ == "__main__":
    main()
