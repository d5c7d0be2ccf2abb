"""Compares chains in MuJoCo with the FMU of examples/dynamics/parts/chain.toml, and with our simulation of 5 to 40 links.

Chains are pushed by 1 N and released from bent positions. MuJoCo's step is shortened until its largest error is at most that of the other side.
Times are those of the whole motion for a simulated second, median and minimum of alternating repetitions.

FMU: MuJoCo with steps of 20 µs is the reference, and its step is halved from 4 ms. Both are driven from Python in steps of 10 ms, and the
FMU's outputs are read after each.
Usage: .venv/bin/python scripts/measure parts chain --out FOLDER; .venv/bin/python scripts/measure mujoco-chain --out FOLDER

Simulation: `run_mechanism` times itself, without assembly; our simulation with a tolerance of 1e-13 is the reference. Errors are those of all joint angles, in rad.
MuJoCo's step is divided by the root of 2 from 10 ms.
Usage: cargo build --release -p metafmu-multibody --example run_mechanism; .venv/bin/python scripts/measure mujoco-chain --simulation

It needs `pip install mujoco`.
"""

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

LENGTH, STOP, STEP = 0.2, 5.0, 0.01
MASSES = [0.4, 0.4, 0.4, 0.4, 0.5]
STIFFNESS, DAMPING, PUSH = 2.0, 0.05, 1.0
ANGLES = [0.6, -0.4, 0.5, 0.3, -0.7]
REFERENCE = 2e-5
REPETITIONS = 7
COUNTS = [5, 10, 20, 40]
TOLERANCES = [1e-4, 1e-6, 1e-8]
PROGRAM = Path("target/release/examples/run_mechanism")


def bent(count):
    """Joint angles at the start: the pattern of five, again and again."""
    return np.resize(ANGLES, count)


def mjcf(step, masses):
    bodies = ""
    for number, mass in enumerate(masses):
        moment = mass * LENGTH**2 / 12
        place = -LENGTH if number else 0.0
        bodies += f"""<body pos="0 0 {place}"><joint type="hinge" axis="0 -1 0" stiffness="{STIFFNESS}" damping="{DAMPING}"/>
            <inertial pos="0 0 {-LENGTH / 2}" mass="{mass}" diaginertia="1e-9 {moment} {moment}"/>"""
    bodies += f'<site name="tip" pos="0 0 {-LENGTH}"/>' + "</body>" * len(masses)
    options = f'<option integrator="RK4" timestep="{step}" gravity="0 0 -9.81"><flag contact="disable" eulerdamp="disable"/></option>'
    actuator = '<actuator><motor site="tip" refsite="world" gear="1 0 0 0 0 0"/></actuator>'
    return f'<mujoco>{options}<worldbody><site name="world"/>{bodies}</worldbody>{actuator}</mujoco>'


def in_mujoco(step, masses=MASSES):
    """Tip positions and joint angles at multiples of STEP, and a function that simulates the motion."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(mjcf(step, masses))
    data = mujoco.MjData(model)
    count = round(STEP / step)

    def begin():
        mujoco.mj_resetData(model, data)
        data.qpos[:] = bent(len(masses))
        data.ctrl[:] = PUSH
        mujoco.mj_forward(model, data)

    def simulate():
        begin()
        for _ in range(round(STOP / STEP)):
            mujoco.mj_step(model, data, count)

    begin()
    tips, angles = [], []
    for _ in range(round(STOP / STEP)):
        mujoco.mj_step(model, data, count)
        angles.append(data.qpos.copy())
        # positions of sites belong to the step before
        mujoco.mj_kinematics(model, data)
        tips.append([data.site("tip").xpos[0], data.site("tip").xpos[2]])
    return np.array(tips), np.array(angles), simulate


class Slave:
    """The FMU, driven step by step."""

    def __init__(self, path, starts):
        from fmpy import extract, read_model_description
        from fmpy.fmi2 import FMU2Slave

        description = read_model_description(path)
        reference = {variable.name: variable.valueReference for variable in description.modelVariables}
        self.starts = [reference[name] for name in starts], list(starts.values())
        self.outputs = [reference[name] for name in ("x", "y", "first", "last")]
        identifier = description.coSimulation.modelIdentifier
        self.slave = FMU2Slave(guid=description.guid, unzipDirectory=extract(path), modelIdentifier=identifier)
        self.slave.instantiate()

    def simulate(self):
        self.slave.reset()
        self.slave.setupExperiment()
        self.slave.setReal(*self.starts)
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()
        for row in range(round(STOP / STEP)):
            self.slave.doStep(row * STEP, STEP)
            self.slave.getReal(self.outputs)


def mechanism(count):
    """Mechanism file of a chain."""
    text = f"gravity = [0, -9.81]\ninputs.push = {{ min = -2, max = 2, start = {PUSH} }}\n"
    angles, tip = np.cumsum(bent(count)), np.zeros(2)
    for link, angle in enumerate(angles.tolist(), 1):
        along = LENGTH * np.array([np.sin(angle), -np.cos(angle)])
        centre, tip = tip + along / 2, tip + along
        text += f"""
            bodies.link{link} = {{ mass = {MASSES[0]}, inertia = {MASSES[0] * LENGTH**2 / 12}, position = {centre.tolist()}, angle = {angle},
                points = {{ top = [0, {LENGTH / 2}], tip = [0, {-LENGTH / 2}] }} }}
            joints.j{link} = {{ type = "revolute", between = ["{f"link{link - 1}.tip" if link > 1 else "ground"}", "link{link}.top"] }}
            springs.s{link} = {{ coordinate = "j{link}.angle", stiffness = {STIFFNESS}, damping = {DAMPING} }}
            initial.link{link} = {{ angle = {angle}, angular_velocity = 0 }}
            outputs.angle{link} = {{ measure = "j{link}.angle" }}"""
    return text + f"""\n forces.push = {{ point = "link{count}.tip", force = ["push", 0] }}\n"""


def simulated(program, file, tolerance, repetitions=1):
    """Joint angles at multiples of STEP, and seconds of each run."""
    arguments = [program, file, str(tolerance), str(STOP), str(round(STOP / STEP)), str(repetitions)]
    lines = subprocess.run(arguments, check=True, capture_output=True, text=True).stdout.splitlines()
    seconds, *rows = [[float(number) for number in line.split()] for line in lines[1:]]
    return np.array(rows[1:]), seconds


def alternating(ways):
    """Seconds for a simulated second of functions that return seconds."""
    times = {name: [] for name in ways}
    for _ in range(REPETITIONS):
        for name, way in ways.items():
            times[name].append(way() / STOP)
    return times


def timed(simulate):
    begin = time.perf_counter()
    simulate()
    return time.perf_counter() - begin


def at_error(error, largest, masses, step, factor):
    """MuJoCo's step, divided by a factor until its largest error is below another one."""
    while largest(in_mujoco(STEP / np.ceil(STEP / step), masses)) > error and step > 2 * REFERENCE:
        step /= factor
    return STEP / np.ceil(STEP / step)


def compare_simulation(program):
    print("| links | tolerance | error, rad | MuJoCo's step | its error | ms | MuJoCo, ms | ratio of minima |\n|---|---|---|---|---|---|---|---|")
    for count in COUNTS:
        masses = MASSES[:1] * count
        with tempfile.NamedTemporaryFile("w", suffix=".toml") as file:
            file.write(mechanism(count))
            file.flush()
            reference, _ = simulated(program, file.name, 1e-13)
            for tolerance in TOLERANCES:
                error = np.abs(simulated(program, file.name, tolerance)[0] - reference).max()
                largest = lambda found: np.abs(found[1] - reference).max()
                step = at_error(error, largest, masses, STEP, 2**0.5)
                found = in_mujoco(step, masses)
                # the first run of a process warms its caches
                ours = lambda: simulated(program, file.name, tolerance, 2)[1][1]
                times = alternating({"ours": ours, "MuJoCo": lambda: timed(found[2])})
                figures = [[1e3 * of(times[name]) for of in (min, statistics.median)] for name in ("ours", "MuJoCo")]
                ms = [f"{least:.3g}, {median:.3g}" for least, median in figures]
                columns = [count, f"{tolerance:.0e}".replace("e-0", "e-"), f"{error:.1e}", f"{step * 1e3:.3g} ms", f"{largest(found):.1e}", *ms]
                print(f"| {' | '.join(map(str, columns))} | {figures[0][0] / figures[1][0]:.2g} |", flush=True)


def compare_fmu(fmu):
    from fmpy import simulate_fmu

    names = ["j1.angle", *(f"link{number}.angle" for number in range(2, len(MASSES) + 1))]
    starts = {f"{name}_start": value for name, value in zip(names, np.cumsum(ANGLES))} | {"m": MASSES[-1], "push": PUSH}
    found = simulate_fmu(fmu, fmi_type="CoSimulation", stop_time=STOP, output_interval=STEP, start_values=starts, output=["x", "y"])
    found = np.array([found["x"], found["y"]]).T[1:]
    reference, *_ = in_mujoco(REFERENCE)
    largest = lambda found: np.abs(found[0] - reference).max() / np.ptp(reference, axis=0).min()
    own = largest([found])
    step = at_error(own, largest, MASSES, 4e-3, 2)
    rows = in_mujoco(step)
    print(f"largest error, of the range: FMU {own:.1e}; MuJoCo with steps of {step * 1e3:.3g} ms {largest(rows):.1e}")
    slave = Slave(fmu, starts)
    times = alternating({"FMU": lambda: timed(slave.simulate), "MuJoCo": lambda: timed(rows[2])})
    for name, seconds in times.items():
        print(f"{name}: {statistics.median(seconds) * 1e3:.3g} ms, minimum {min(seconds) * 1e3:.3g} ms")
    print(f"ratio of medians: {statistics.median(times['MuJoCo']) / statistics.median(times['FMU']):.1f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/parts"), help="folder of the builds")
    help = f"compare our simulation; PROGRAM is {PROGRAM} unless given"
    parser.add_argument("--simulation", type=Path, nargs="?", const=PROGRAM, metavar="PROGRAM", help=help)
    arguments = parser.parse_args()
    if arguments.simulation:
        if not arguments.simulation.exists():
            sys.exit(f"{arguments.simulation} is missing: cargo build --release -p metafmu-multibody --example run_mechanism")
        compare_simulation(arguments.simulation)
    else:
        compare_fmu(arguments.out / "out" / "chain" / "chain.fmu")


if __name__ == "__main__":
    main()
