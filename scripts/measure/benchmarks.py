"""Times metafmu, Exudyn and MuJoCo at equal error on published benchmarks and on chains, in a Markdown table.

The benchmarks are A01 (pendulum), A02 (N-four-bar) and A03 (Andrews' squeezing mechanism) of the IFToMM library. Further cases are the car
axis of the test set for initial value problems, and damped chains of 10 and 20 links. Each program gets the loosest tolerance, or
the longest step, with an error of at most --error in m or rad at the end of the run. The tolerance of metafmu is a power of ten; those of
the others are halved.

Times are those of one run on one thread, the median and the minimum of --repetitions. They exclude the start of the process, reading the
model and building it. metafmu reports the seconds of its runs, which write their rows to a CSV file; the others are timed around the
solver. Exudyn has redundant coordinates (index 2, trapezoidal rule), and for chains also minimal coordinates (kinematic tree, Runge-Kutta
of order 7). MuJoCo has trees only here, as its loops are soft (Runge-Kutta of order 4).

Usage: .venv/bin/python scripts/measure benchmarks [--error 1e-6] [--repetitions 3] [CASE...]
It needs `pip install mujoco exudyn`.
"""

import argparse
import csv
import json
import math
import os
import statistics
import subprocess
import tempfile
import time
import warnings
from pathlib import Path

for variable in ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS"]:
    os.environ[variable] = "1"

import numpy as np
from common import METAFMU, ROOT

GRAVITY = 9.81
# of the car axis: x, y, x', y' of the left and of the right end after 3 s (test set for IVP solvers)
CAR_AXIS = {
    "xl": 0.0493455784275402809, "yl": 0.496989460230171154, "xr": 1.04174252488542152, "yr": 0.373911027265361257,
    "vxl": -0.0770583684040972358, "vyl": 0.00744686658723778553, "vxr": 0.0175568157537232223, "vyr": 0.770341043779251976,
}  # fmt: skip
# x and y of the bob of A01 by elliptic functions
A01 = {1: (0.9862917511319, -0.1650108531255), 2: (-0.7935661953433, -0.6084839304438), 5: (-0.9423054350438, -0.3347543384140), 10: (-0.2750874625761, -0.9614192050991)}
# angles in rad of K1, K3, K5 and K7 of Andrews' mechanism after 0.03 s, recomputed to 1e-12
ANDREWS = {"beta": 15.810771195153, "K3": 0.040822240120, "K5": 0.524409965880, "K7": 1.048080741042}
# a parameter that changes nothing, as a study needs one
UNUSED = "unused = { default = 0, min = 0, max = 1e-12 }\n"


def pendulum():
    """A01: a point mass of 1 kg at 1 m, released where it is level with its pivot."""
    return f"""gravity = [0, {-GRAVITY}]
[parameters]
{UNUSED}[bodies]
bob = {{ mass = 1, inertia = "unused", position = [-1, 0], points = {{ pivot = [1, 0] }} }}
[joints]
hinge = {{ type = "revolute", between = ["ground", "bob.pivot"] }}
[initial]
hinge = {{ angle = 0, angular_velocity = 0 }}
[outputs]
x = {{ measure = "bob.x" }}
y = {{ measure = "bob.y" }}
"""


def four_bars(count):
    """A02: bars of 1 m and 1 kg, `count` + 1 upright ones and a level one between each two, moving at 1 m/s at the top."""
    inertia = 1 / 12
    bodies, joints, points = [], [], []
    for k in range(count + 1):
        points.append(f"g{k} = [{k}, 0]")
        bodies.append(f"u{k} = {{ mass = 1, inertia = {inertia!r}, position = [{k}, 0.5], angle = {math.pi / 2!r}, points = {{ a = [-0.5, 0], b = [0.5, 0] }} }}")
        joints.append(f'a{k} = {{ type = "revolute", between = ["ground.g{k}", "u{k}.a"] }}')
    for k in range(count):
        bodies.append(f"l{k} = {{ mass = 1, inertia = {inertia!r}, position = [{k + 0.5}, 1], points = {{ a = [-0.5, 0], b = [0.5, 0] }} }}")
        joints.append(f'b{k} = {{ type = "revolute", between = ["u{k}.b", "l{k}.a"] }}')
        joints.append(f'c{k} = {{ type = "revolute", between = ["l{k}.b", "u{k + 1}.b"] }}')
    lines = lambda of: "\n".join(of)
    return f"""gravity = [0, {-GRAVITY}]
[parameters]
{UNUSED}[ground.points]
{lines(points)}
[bodies]
{lines(bodies)}
[joints]
{lines(joints)}
[initial]
a0 = {{ angle = "{math.pi / 2!r} + unused", angular_velocity = -1 }}
[outputs]
x = {{ measure = "u0.b.x" }}
y = {{ measure = "u0.b.y" }}
"""


def four_bar_rate(count):
    """`a` of the angle of the upright bars, `angle'' = -a cos(angle)`."""
    return GRAVITY * ((count + 1) / 2 + count) / ((count + 1) / 3 + count)


def andrews():
    text = (ROOT / "examples" / "dynamics" / "andrews.toml").read_text()
    return text.replace("[parameters]\n", f"[parameters]\n{UNUSED}", 1)


def car_axis():
    """The axle of a car on a bump: a road that turns about the left wheel, a mass that slides on the strut above it, and one at the other end of the axle."""
    return f"""gravity = [0, -1]
[parameters]
{UNUSED}[bodies]
road = {{ points = {{ wheel = [1, 0] }} }}
left = {{ mass = 5e-4, position = [0, 0.5] }}
axle = {{ mass = 5e-4, position = [1, 0.5], points = {{ left = [-1, 0] }} }}
[joints]
bump = {{ type = "revolute", between = ["ground", "road"] }}
strut = {{ type = "prismatic", between = ["road", "left"], axis = [0, 1] }}
hinge = {{ type = "revolute", between = ["left", "axle.left"] }}
[drivers]
drive = {{ coordinate = "road.angle", motion = "asin(0.1*sin(10*time))" }}
[springs]
first = {{ between = ["ground", "left"], stiffness = 1, rest = 0.5 }}
second = {{ between = ["road.wheel", "axle"], stiffness = 1, rest = 0.5 }}
[initial]
strut = {{ position = "0.5 + unused", velocity = 0 }}
axle = {{ angle = 0, angular_velocity = 0 }}
[outputs]
xl = {{ measure = "left.x" }}
yl = {{ measure = "left.y" }}
xr = {{ measure = "axle.x" }}
yr = {{ measure = "axle.y" }}
vxl = {{ measure = "left.vx" }}
vyl = {{ measure = "left.vy" }}
vxr = {{ measure = "axle.vx" }}
vyr = {{ measure = "axle.vy" }}
"""


# chains: m, kg, N.m.s/rad; initial angles from the ground, repeated along the chain
LINK, MASS, DAMPING = 0.2, 0.4, 0.05
BENT = [0.6 - math.pi / 2, 0.2 - math.pi / 2, 0.7 - math.pi / 2, 1.0 - math.pi / 2, 0.3 - math.pi / 2]


def link_places(count):
    """Centre and angle of each link."""
    x = y = 0.0
    for k in range(count):
        angle = BENT[k % len(BENT)]
        dx, dy = LINK * math.cos(angle), LINK * math.sin(angle)
        yield x + dx / 2, y + dy / 2, angle
        x, y = x + dx, y + dy


def chain(count):
    """Links with a damper in each hinge."""
    bodies, joints, springs, initial = [], [], [], []
    for k, (x, y, angle) in enumerate(link_places(count)):
        points = f"{{ a = [{-LINK / 2}, 0], b = [{LINK / 2}, 0] }}"
        bodies.append(f"k{k} = {{ mass = {MASS}, inertia = {MASS * LINK**2 / 12!r}, position = [{x!r}, {y!r}], angle = {angle!r}, points = {points} }}")
        joints.append(f'j{k} = {{ type = "revolute", between = ["{f"k{k - 1}.b" if k else "ground"}", "k{k}.a"] }}')
        springs.append(f'd{k} = {{ coordinate = "j{k}.angle", damping = {DAMPING} }}')
        initial.append(f'k{k} = {{ angle = "{angle!r} + unused", angular_velocity = 0 }}')
    lines = lambda of: "\n".join(of)
    return f"""gravity = [0, {-GRAVITY}]
[parameters]
{UNUSED}[bodies]
{lines(bodies)}
[joints]
{lines(joints)}
[springs]
{lines(springs)}
[initial]
{lines(initial)}
[outputs]
x = {{ measure = "k{count - 1}.b.x" }}
y = {{ measure = "k{count - 1}.b.y" }}
"""


def simulate(text, stop, step, tolerance=1e-13, formulation="augmented"):
    """Outputs by their names at every row, and the seconds of a run. A failure raises a `RuntimeError` with the message."""
    outputs = [line.split(" ")[0] for line in text[text.index("[outputs]") :].splitlines()[1:] if " = " in line]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "mechanism.toml").write_text(f'formulation = "{formulation}"\n{text}')
        (folder / "points.csv").write_text("unused\n0\n1e-12\n")
        (folder / "study.toml").write_text(f"""name = "run"
[source]
mechanism = "mechanism.toml"
tolerance = {tolerance}
[time]
stop = {stop}
step = {step}
[parameters]
unused = {{ min = 0, max = 1e-12 }}
[outputs]
{"".join(f"{name} = {{}}" + chr(10) for name in outputs)}[sampling]
method = "list"
file = "points.csv"
test_runs = 1
""")
        done = subprocess.run([METAFMU, "sample", "study.toml", "--out", "out", "--json"], cwd=folder, text=True, capture_output=True)
        if done.returncode:
            raise RuntimeError(done.stdout + done.stderr)
        counted = json.loads(done.stdout)
        with open(folder / "out" / "train.csv", newline="") as file:
            rows = [row for row in csv.DictReader(file) if row["run"] == "0"]
    values = {name: np.array([float(next(value for key, value in row.items() if key.split(" ")[0] == name)) for row in rows]) for name in outputs}
    return values, counted["sample_seconds"] / (counted["train_runs"] + counted["test_runs"])


class Exudyn:
    """A mechanism of rigid bodies in the plane."""

    def __init__(self):
        import exudyn

        warnings.filterwarnings("ignore", category=DeprecationWarning)
        self.exudyn, self.system = exudyn, exudyn.SystemContainer().AddSystem()

    def settings(self, step, stop):
        settings = self.exudyn.SimulationSettings()
        settings.timeIntegration.numberOfSteps, settings.timeIntegration.endTime = round(stop / step), stop
        settings.timeIntegration.verboseMode = 0
        settings.solutionSettings.writeSolutionToFile = False
        settings.parallel.numberOfThreads = 1
        return settings

    def solved(self, settings, kind):
        """Seconds of the solver."""
        self.system.Assemble()
        begin = time.perf_counter()
        self.system.SolveDynamic(settings, solverType=kind)
        return time.perf_counter() - begin


def exudyn_bodies(text, formulas=None):
    """A function of step and stop that simulates the bodies, revolute joints, gravity, springs and dampers of a mechanism file in Exudyn."""
    import planar

    mechanism = planar.Planar(text)
    q = planar.start(mechanism)
    file, number = mechanism.file, mechanism.number

    def simulate(step, stop):
        from exudyn import itemInterface as items

        own = Exudyn()
        exudyn, system = own.exudyn, own.system
        ground = system.AddObject(items.ObjectGround())
        bodies, nodes = {"ground": ground}, {}
        count = mechanism.count
        for k, (name, body) in enumerate(file["bodies"].items()):
            place, speed = [list(map(float, q[first + 3 * k : first + 3 * k + 3])) for first in (0, count)]
            nodes[name] = system.AddNode(items.NodeRigidBody2D(referenceCoordinates=place, initialVelocities=speed))
            mass, inertia = number(body.get("mass", 0)), number(body.get("inertia", 0))
            bodies[name] = system.AddObject(items.ObjectRigidBody2D(mass=mass, inertia=inertia, nodeNumber=nodes[name]))
            centre = system.AddMarker(items.MarkerBodyMass(bodyNumber=bodies[name]))
            system.AddLoad(items.LoadMassProportional(markerNumber=centre, loadVector=[*mechanism.gravity, 0]))

        def marker(point):
            _, x, y = mechanism.locals[point]
            return system.AddMarker(items.MarkerBodyRigid(bodyNumber=bodies[point.split(".")[0]], localPosition=[x, y, 0]))

        for joint in file["joints"].values():
            system.AddObject(items.RevoluteJoint2D(markerNumbers=[marker(end) for end in joint["between"]]))
        fixed = system.AddMarker(items.MarkerNodeCoordinate(nodeNumber=system.AddNode(items.NodePointGround()), coordinate=0))
        turn = lambda body: fixed if body == "ground" else system.AddMarker(items.MarkerNodeCoordinate(nodeNumber=nodes[body], coordinate=2))
        for spring in file.get("springs", {}).values():
            stiffness, damping, rest = (number(spring.get(key, 0)) for key in ("stiffness", "damping", "rest"))
            if "between" in spring:
                ends = [marker(end) for end in spring["between"]]
                system.AddObject(items.SpringDamper(markerNumbers=ends, stiffness=stiffness, damping=damping, referenceLength=rest))
            else:
                ends = file["joints"][spring["coordinate"].split(".")[0]]["between"]
                markers = [turn(end.split(".")[0]) for end in ends]
                system.AddObject(items.CoordinateSpringDamper(markerNumbers=markers, stiffness=stiffness, damping=damping, offset=rest))
        for actuator in file.get("actuators", {}).values():
            body = actuator["coordinate"].split(".")[0]
            effort = mechanism.evaluate(actuator["effort"], None)
            system.AddLoad(items.LoadTorqueVector(markerNumber=marker(body), loadVector=[0, 0, effort]))
        shown = {name: output["measure"].rsplit(".", 1) for name, output in file["outputs"].items()}
        shown = {name: (owner, what, marker(owner)) for name, (owner, what) in shown.items() if what in ("angle", "x", "y")}
        settings = own.settings(step, stop)
        settings.timeIntegration.newton.useModifiedNewton = True
        # far below the error of a step
        settings.timeIntegration.newton.relativeTolerance, settings.timeIntegration.newton.absoluteTolerance = 1e-10, 1e-12
        if count > 20:
            settings.linearSolverType = exudyn.LinearSolverType.EigenSparse
        seconds = own.solved(settings, exudyn.DynamicSolverType.TrapezoidalIndex2)
        found = {}
        for name, (owner, what, of) in shown.items():
            if what == "angle":
                turned = system.GetNodeOutput(nodes[owner], exudyn.OutputVariableType.Coordinates)[2]
                found[name] = turned + q[3 * mechanism.bodies.index(owner) + 2]
            else:
                found[name] = system.GetMarkerOutput(of, exudyn.OutputVariableType.Position)[("x", "y").index(what)]
        return found, seconds

    return simulate


def exudyn_tree(count):
    """A function of step and stop that simulates a chain in relative angles."""

    def simulate(step, stop):
        from exudyn import itemInterface as items

        own = Exudyn()
        exudyn, system = own.exudyn, own.system
        angles = np.diff([0.0, *(angle for _, _, angle in link_places(count))])
        node = system.AddNode(
            items.NodeGenericODE2(
                referenceCoordinates=[0.0] * count, initialCoordinates=list(angles), initialCoordinates_t=[0.0] * count, numberOfODE2Coordinates=count
            )
        )
        inertia = MASS * LINK**2 / 12
        inertias, rotations = exudyn.Matrix3DList(), exudyn.Matrix3DList()
        offsets, centres = exudyn.Vector3DList(), exudyn.Vector3DList()
        for k in range(count):
            # about the centre
            inertias.Append(np.diag([1e-9, inertia, inertia]))
            offsets.Append([LINK if k else 0.0, 0, 0])
            rotations.Append(np.eye(3))
            centres.Append([LINK / 2, 0, 0])
        tree = system.AddObject(
            items.ObjectKinematicTree(
                nodeNumber=node,
                jointTypes=[exudyn.JointType.RevoluteZ] * count,
                linkParents=[k - 1 for k in range(count)],
                jointTransformations=rotations,
                jointOffsets=offsets,
                linkInertiasCOM=inertias,
                linkCOMs=centres,
                linkMasses=[MASS] * count,
                baseOffset=[0.0, 0.0, 0.0],
                gravity=[0.0, -GRAVITY, 0.0],
                jointDControlVector=[DAMPING] * count,
                jointPControlVector=[0.0] * count,
                jointPositionOffsetVector=[0.0] * count,
                jointVelocityOffsetVector=[0.0] * count,
            )
        )
        tip = system.AddMarker(items.MarkerKinematicTreeRigid(objectNumber=tree, linkNumber=count - 1, localPosition=[LINK, 0, 0]))
        seconds = own.solved(own.settings(step, stop), exudyn.DynamicSolverType.RK67)
        place = system.GetMarkerOutput(tip, exudyn.OutputVariableType.Position)
        return {"x": place[0], "y": place[1]}, seconds

    return simulate


def mujoco_chain(count, is_pendulum=False):
    """A function of step and stop that simulates a chain, or A01."""
    angles = [math.pi] if is_pendulum else [angle for _, _, angle in link_places(count)]
    length, mass = (1.0, 1.0) if is_pendulum else (LINK, MASS)
    inertia, damping = (0.0, 0.0) if is_pendulum else (MASS * LINK**2 / 12, DAMPING)
    bodies = ""
    for k in range(count):
        # a body needs some inertia: this much is below rounding
        turns = f'{1e-9} {max(inertia, 1e-14)} {max(inertia, 1e-14)}' if inertia else "1e-14 1e-14 1e-14"
        centre = length if is_pendulum else length / 2
        bodies += f"""<body pos="{length if k else 0} 0 0"><joint type="hinge" axis="0 -1 0" damping="{damping}"/>
            <inertial pos="{centre} 0 0" mass="{mass}" diaginertia="{turns}"/>"""
    bodies += f'<site name="tip" pos="{length} 0 0"/>' + "</body>" * count

    def simulate(step, stop):
        import mujoco

        options = f'<option integrator="RK4" timestep="{step!r}" gravity="0 0 {-GRAVITY}"><flag contact="disable" constraint="disable" eulerdamp="disable"/></option>'
        compiler = '<compiler boundinertia="0" boundmass="0" balanceinertia="true"/>'
        model = mujoco.MjModel.from_xml_string(f"<mujoco>{compiler}{options}<worldbody>{bodies}</worldbody></mujoco>")
        data = mujoco.MjData(model)
        data.qpos[:] = np.diff([0.0, *angles])
        begin = time.perf_counter()
        mujoco.mj_step(model, data, round(stop / step))
        seconds = time.perf_counter() - begin
        mujoco.mj_kinematics(model, data)
        place = data.site("tip").xpos
        return {"x": place[0], "y": place[2]}, seconds

    return simulate


def cases():
    """Mechanism file, end of the run in s, reference or None if a run at 1e-13 is it, and ways of the others, by name."""
    found = {
        "A01": (pendulum(), 10.0, dict(zip("xy", A01[10])), {"Exudyn": exudyn_bodies(pendulum()), "MuJoCo": mujoco_chain(1, True)}),
        # until just before its singular position
        "A02, N = 2": (four_bars(2), 0.5, None, {"Exudyn": exudyn_bodies(four_bars(2))}),
        "A03": (andrews(), 0.03, ANDREWS, {"Exudyn": exudyn_bodies(andrews())}),
        "car axis": (car_axis(), 3.0, {name: value for name, value in CAR_AXIS.items() if name[0] != "v"}, {}),
    }
    for count in (10, 20):
        others = {"Exudyn": exudyn_bodies(chain(count)), "Exudyn, tree": exudyn_tree(count), "MuJoCo": mujoco_chain(count)}
        found[f"chain of {count}"] = (chain(count), 1.0, None, others)
    return found


def error(found, reference):
    return max(abs(found[name] - value) for name, value in reference.items())


def own_ways(text, stop, reference, bound):
    """A function that times a run for each formulation, with the loosest tolerance within the bound."""
    ways = {}
    for formulation in ("augmented", "embedding"):
        for tolerance in (10.0**-power for power in range(2, 14)):
            values, _ = simulate(text, stop, stop / 2, tolerance, formulation)
            reached = error({name: of[-1] for name, of in values.items()}, reference)
            if reached <= bound:
                break
        else:
            raise SystemExit(f"error: {formulation}: {reached:.1e} at 1e-13, expected at most {bound:.0e}")
        way = lambda formulation=formulation, tolerance=tolerance: simulate(text, stop, stop / 2, tolerance, formulation)[1]
        ways[formulation] = (way, reached, f"{tolerance:.0e}")
    return ways


def other_way(simulate, stop, reference, bound):
    """A function that times a run, with the longest step within the bound."""
    steps = 64
    while (reached := error(found := simulate(stop / steps, stop)[0], reference)) > bound or not all(map(math.isfinite, found.values())):
        steps *= 2
        if steps > 2**20:
            return None, reached, f"{stop / steps:.0e} s"
    return (lambda: simulate(stop / steps, stop)[1]), reached, f"{stop / steps:.1e} s"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", metavar="CASE", help="all of them unless given")
    parser.add_argument("--error", type=float, default=1e-6, help="largest error at the end of the run, in m or rad")
    parser.add_argument("--repetitions", type=int, default=3)
    options = parser.parse_args()
    known = cases()
    if unknown := [name for name in options.cases if name not in known]:
        raise SystemExit(f"error: no case `{unknown[0]}`, expected one of {', '.join(known)}")
    print("| case | program | tolerance or step | error | median, ms | minimum, ms |\n|---|---|---|---|---|---|", flush=True)
    for name in options.cases or known:
        text, stop, reference, others = known[name]
        if reference is None:
            values, _ = simulate(text, stop, stop / 2)
            reference = {of: value[-1] for of, value in values.items()}
        ways = own_ways(text, stop, reference, options.error)
        ways |= {other: other_way(simulate, stop, reference, options.error) for other, simulate in others.items()}
        times = {way: [] for way in ways}
        for _ in range(options.repetitions):
            for way, (run, _, _) in ways.items():
                if run is not None:
                    times[way].append(1e3 * run())
        for way, (run, reached, setting) in ways.items():
            of = times[way]
            shown = f"{statistics.median(of):.3g} | {min(of):.3g}" if run else "- | -"
            print(f"| {name} | {way} | {setting} | {reached:.1e} | {shown} |", flush=True)


if __name__ == "__main__":
    main()
