"""Compares the FMU of the chain in examples/dynamics/parts with MuJoCo: results, and time at the same error.

Both are pushed by 1 N and released from bent positions. MuJoCo with steps of 20 µs is the reference. Its step is then halved from 4 ms until its
largest error is that of the FMU. Times are those of the whole motion for a simulated second, the median and the minimum of alternating repetitions, both driven
from Python in steps of 10 ms; the FMU's outputs are read after each.

Usage: .venv/bin/python scripts/measure parts chain --out FOLDER; .venv/bin/python scripts/measure mujoco-chain --out FOLDER
It needs `pip install mujoco`.
"""

import argparse
import statistics
import time
from pathlib import Path

import numpy as np
from fmpy import extract, read_model_description, simulate_fmu
from fmpy.fmi2 import FMU2Slave

LINKS, LENGTH, STOP, STEP = 5, 0.2, 5.0, 0.01
MASSES = [0.4, 0.4, 0.4, 0.4, 0.5]
STIFFNESS, DAMPING, PUSH = 2.0, 0.05, 1.0
ANGLES = [0.6, -0.4, 0.5, 0.3, -0.7]
REFERENCE = 2e-5
REPETITIONS = 7


def mjcf(step):
    bodies = ""
    for number, mass in enumerate(MASSES):
        moment = mass * LENGTH**2 / 12
        place = -LENGTH if number else 0.0
        bodies += f"""<body pos="0 0 {place}"><joint type="hinge" axis="0 -1 0" stiffness="{STIFFNESS}" damping="{DAMPING}"/>
            <inertial pos="0 0 {-LENGTH / 2}" mass="{mass}" diaginertia="1e-9 {moment} {moment}"/>"""
    bodies += f'<site name="tip" pos="0 0 {-LENGTH}"/>' + "</body>" * LINKS
    options = f'<option integrator="RK4" timestep="{step}" gravity="0 0 -9.81"><flag contact="disable" eulerdamp="disable"/></option>'
    actuator = '<actuator><motor site="tip" refsite="world" gear="1 0 0 0 0 0"/></actuator>'
    return f'<mujoco>{options}<worldbody><site name="world"/>{bodies}</worldbody>{actuator}</mujoco>'


def in_mujoco(step):
    """Tip positions at multiples of STEP, and a function that simulates the motion."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(mjcf(step))
    data = mujoco.MjData(model)
    count = round(STEP / step)

    def begin():
        mujoco.mj_resetData(model, data)
        data.qpos[:] = ANGLES
        data.ctrl[:] = PUSH
        mujoco.mj_forward(model, data)

    def simulate():
        begin()
        for _ in range(round(STOP / STEP)):
            mujoco.mj_step(model, data, count)

    begin()
    rows = []
    for _ in range(round(STOP / STEP)):
        mujoco.mj_step(model, data, count)
        # positions of sites belong to the step before
        mujoco.mj_kinematics(model, data)
        rows.append([data.site("tip").xpos[0], data.site("tip").xpos[2]])
    return np.array(rows), simulate


class Slave:
    """The FMU, driven step by step."""

    def __init__(self, path, starts):
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


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/parts"), help="folder of the builds")
    fmu = parser.parse_args().out / "out" / "chain" / "chain.fmu"
    names = ["j1.angle", *(f"link{number}.angle" for number in range(2, LINKS + 1))]
    starts = {f"{name}_start": value for name, value in zip(names, np.cumsum(ANGLES))} | {"m": MASSES[-1], "push": PUSH}
    found = simulate_fmu(fmu, fmi_type="CoSimulation", stop_time=STOP, output_interval=STEP, start_values=starts, output=["x", "y"])
    found = np.array([found["x"], found["y"]]).T[1:]
    reference, _ = in_mujoco(REFERENCE)
    largest = lambda rows: np.abs(rows - reference).max() / np.ptp(reference, axis=0).min()
    own = largest(found)
    step = 4e-3
    while largest(in_mujoco(STEP / np.ceil(STEP / step))[0]) > own and step > 2 * REFERENCE:
        step /= 2
    step = STEP / np.ceil(STEP / step)
    rows, simulate = in_mujoco(step)
    print(f"largest error, of the range: FMU {own:.1e}; MuJoCo with steps of {step * 1e3:.3g} ms {largest(rows):.1e}")
    ways = {"FMU": Slave(fmu, starts).simulate, "MuJoCo": simulate}
    times = {name: [] for name in ways}
    for _ in range(REPETITIONS):
        for name, way in ways.items():
            begin = time.perf_counter()
            way()
            times[name].append((time.perf_counter() - begin) / STOP)
    for name, seconds in times.items():
        print(f"{name}: {statistics.median(seconds) * 1e3:.3g} ms, minimum {min(seconds) * 1e3:.3g} ms")
    print(f"ratio of medians: {statistics.median(times['MuJoCo']) / statistics.median(times['FMU']):.1f}")


if __name__ == "__main__":
    main()
