"""An arm in three dimensions, simulated by MuJoCo: attributes of arm.xml are parameters, joints are states, motors are inputs.

    python arm.py            # without the floor: has equations
    python arm.py contact    # falls or is driven onto the floor: has runs only
"""

import sys
from pathlib import Path

import mujoco
import numpy as np

import metafmu

FILE = Path(__file__).with_name("arm.xml")
CONTACT = "contact" in sys.argv[1:]
JOINTS = {"turn": (-0.5, 0.5), "shoulder": (-0.4, 0.4), "elbow": (0.3, 1.3)}
START = {"turn": 0.0, "shoulder": 0.0, "elbow": 0.8}
RATES = {"turn": 1.2, "shoulder": 1.5, "elbow": 2.5}

states = {name: {"min": low, "max": high, "start": START[name], "unit": "rad"} for name, (low, high) in JOINTS.items()}
rates = {f"{name}.rate": {"min": -rate, "max": rate, "start": 0.0, "unit": "rad/s", "rate_of": name} for name, rate in RATES.items()}
parameters = {"payload.mass": {"min": 0.2, "max": 1.0, "start": 0.5, "unit": "kg"}}
if CONTACT:
    parameters |= {"shoulder.start": {"min": -0.6, "max": 0.4, "start": 0.0, "unit": "rad", "description": "initial angle"}}


@metafmu.source(
    parameters=parameters,
    inputs={name: {"min": -1.0, "max": 1.0, "start": 0.0, "description": "share of the torque of the motor"} for name in map("{}.motor".format, JOINTS)},
    states=None if CONTACT else states | rates,
    outputs={"tip.x": "m", "tip.y": "m", "tip.z": "m"},
    stop=2.0,
    step=0.01,
)
class Arm:
    """Arm with a payload and a cable, simulated by MuJoCo"""

    def __init__(self):
        self.key, self.model, self.data = None, None, None

    def load(self, parameters):
        """The model whose attributes have these values."""
        if self.key != parameters:
            spec = mujoco.MjSpec.from_file(str(FILE))
            spec.geom("payload").mass = parameters["payload.mass"]
            if CONTACT:
                for name in ("base", "upper", "lower"):
                    spec.body(name).gravcomp = 0.0
            else:
                spec.geom("floor").contype = spec.geom("floor").conaffinity = 0
                spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
            self.key, self.model = dict(parameters), spec.compile()
            self.data = mujoco.MjData(self.model)
        mujoco.mj_resetData(self.model, self.data)
        return self.model, self.data

    def run(self, times, parameters, inputs, states=None):
        model, data = self.load(parameters)
        begin = START | {"shoulder": parameters.get("shoulder.start", 0.0)} if CONTACT else states
        data.qpos[:] = [begin[name] for name in JOINTS]
        data.qvel[:] = [0.0 if CONTACT else begin[f"{name}.rate"] for name in JOINTS]
        signals = np.array([inputs.get(f"{name}.motor", np.zeros(len(times))) for name in JOINTS])
        rows = []
        for row, time in enumerate(times):
            while data.time < time - 1e-9:
                # with contact the structure is "discrete": inputs hold from row to row; else they are linear
                held = signals[:, row - 1]
                # in the middle of the step
                share = (data.time + 0.5 * model.opt.timestep - times[row - 1]) / (time - times[row - 1])
                data.ctrl[:] = held if CONTACT else held + share * (signals[:, row] - held)
                mujoco.mj_step(model, data)
            data.ctrl[:] = signals[:, row]
            mujoco.mj_forward(model, data)
            rows.append(data.site("tip").xpos.copy())
        return dict(zip(("tip.x", "tip.y", "tip.z"), np.array(rows).T))

    def equations(self, parameters, inputs, states):
        model, data = self.load(parameters)
        data.qpos[:] = [states[name] for name in JOINTS]
        data.qvel[:] = [states[f"{name}.rate"] for name in JOINTS]
        data.ctrl[:] = [inputs[f"{name}.motor"] for name in JOINTS]
        mujoco.mj_forward(model, data)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        derivatives = dict(zip(JOINTS, data.qvel.tolist())) | dict(zip(rates, data.qacc.tolist()))
        return derivatives, dict(zip(("tip.x", "tip.y", "tip.z"), data.site("tip").xpos.tolist())), mass


if __name__ == "__main__":
    Arm.serve()
