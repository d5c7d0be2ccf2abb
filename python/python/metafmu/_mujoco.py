"""A model of MuJoCo as a source: joints are states, actuators inputs, sensors outputs."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np

from ._needed import needed
from ._source import Source, _quantities, _refuse_all

# units of the sensors whose values have one; of a joint it depends on the type
UNITS = {
    "ACCELEROMETER": "m/s2",
    "VELOCIMETER": "m/s",
    "GYRO": "rad/s",
    "FORCE": "N",
    "TORQUE": "N.m",
    "RANGEFINDER": "m",
    "TENDONPOS": "m",
    "TENDONVEL": "m/s",
    "FRAMEPOS": "m",
    "FRAMELINVEL": "m/s",
    "FRAMEANGVEL": "rad/s",
    "FRAMELINACC": "m/s2",
    "FRAMEANGACC": "rad/s2",
    "SUBTREECOM": "m",
    "SUBTREELINVEL": "m/s",
    "CLOCK": "s",
}
AXES = {1: [""], 3: [".x", ".y", ".z"], 4: [".w", ".x", ".y", ".z"]}


def mujoco(
    path: str | os.PathLike[str], *, ranges=None, parameters=None, contacts: bool = False, stop: float = 2.0, step: float = 0.01
) -> Source:
    """Makes an MJCF file the source of a study with `structure = "dynamics"`.

    >>> arm = metafmu.mujoco("arm.xml", ranges={"elbow.rate": (-3, 3)}, parameters={"geom.payload.mass": {"min": 0.2, "max": 1, "unit": "kg"}})
    >>> metafmu.Study(arm, structure="dynamics").build()

    States are the position `JOINT` and the velocity `JOINT.rate` of each hinge and slide, and `ACTUATOR.activation`. Inputs are the controls
    `ACTUATOR.control`. Outputs are the sensors, `SENSOR` or `SENSOR.x`. ``ranges``: pairs, in which the equations are learned. Joints have those of
    the file, controls and activations, too; velocities have none there. ``parameters``: attributes of elements, as `geom.NAME.mass`,
    `joint.NAME.damping[0]` or `body.NAME.pos[2]`.

    If all sensors show the configuration or velocities of joints, there is no friction, contact or activation, and the source gives its mass
    matrix: equations of motion are learned.

    Runs are integrated by the Runge-Kutta method with the step of the file. ``contacts``: `True` keeps contacts and limits of joints, which make
    equations steep. Refused are ball joints and free joints, which need quaternions, and equality constraints: states are sampled
    independently and would violate them.
    """
    path = os.path.abspath(path)
    model = Mechanism(path, list(parameters or {}), contacts)
    return model.source(dict(ranges or {}), parameters, stop, step)


class Mechanism:
    """Equations and runs of a model. Each process compiles it when it is first evaluated."""

    def __init__(self, path, attributes, contacts):
        self.path, self.attributes, self.contacts = path, attributes, contacts
        self.__name__ = Path(path).stem
        self._key = self._model = self._data = self._timestep = self._structure = None

    def __getstate__(self):
        return self.__dict__ | dict.fromkeys(("_key", "_model", "_data", "_timestep", "_structure"))

    def source(self, ranges, parameters, stop, step):
        mujoco = needed("mujoco", "a model of MuJoCo")
        spec, model = self._compiled({})
        self._refuse(spec, model)
        start = mujoco.MjData(model)
        mujoco.mj_resetData(model, start)
        states, inputs, missing = {}, {}, []

        def quantity(name, limits, unit, value):
            low, high = ranges.pop(name, limits or (None, None))
            if low is None:
                missing.append(name)
            return {"min": low, "max": high, "start": float(value), "unit": unit}

        joints, structure = self._joints(model), self._has_structure(model)
        for number, name in enumerate(joints):
            unit = _unit(model, number)
            limits = tuple(map(float, model.jnt_range[number])) if model.jnt_limited[number] else None
            states[name] = quantity(name, limits, unit, start.qpos[number])
            states[f"{name}.rate"] = quantity(f"{name}.rate", None, f"{unit}/s", 0.0) | ({"rate_of": name} if structure else {})
        for number, name in enumerate(self._actuators(model)):
            limits = tuple(map(float, model.actuator_ctrlrange[number])) if model.actuator_ctrllimited[number] else None
            inputs[f"{name}.control"] = quantity(f"{name}.control", limits, "", 0.0)
            if model.actuator_actnum[number]:
                limits = tuple(map(float, model.actuator_actrange[number])) if model.actuator_actlimited[number] else None
                states[f"{name}.activation"] = quantity(f"{name}.activation", limits, "", 0.0)
        if missing:
            raise ValueError(f"{self.path}: no range of {', '.join(missing)}: expected them in `ranges`, for instance ranges={{{missing[0]!r}: (-1.0, 1.0)}}")
        if ranges:
            raise ValueError(f"{self.path}: ranges of {', '.join(ranges)}: unknown, expected some of {', '.join([*states, *inputs])}")
        problems = []
        known = _quantities("parameters", parameters, problems)
        _refuse_all(problems)
        for name, options in known.items():
            options.setdefault("start", float(_read(self._element(spec, name), name)))
        about = {
            "description": f"MuJoCo model {spec.modelname}",
            "stop": stop,
            "step": step,
            "parameters": known,
            "inputs": inputs,
            "states": states,
            "outputs": {name: {"unit": unit} for name, unit in self._sensors(model)},
        }
        found = Source(self, about)
        found.files = [self.path]
        return found

    def _refuse(self, spec, model):
        import mujoco

        for number, kind in enumerate(map(mujoco.mjtJoint, model.jnt_type)):
            if kind not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
                name, kind = model.joint(number).name, kind.name.removeprefix("mjJNT_").lower()
                raise ValueError(f"{self.path}: joint `{name}` is of the type {kind}, expected hinge or slide")
        if model.neq:
            raise ValueError(f"{self.path}: {model.neq} equality constraints, expected none: sampled states would violate them")
        for kind, count in (("actuator", model.nu), ("sensor", model.nsensor), ("joint", model.njnt)):
            if count == 0 and kind != "actuator":
                raise ValueError(f"{self.path}: has no {kind}, expected at least one")
            for number in range(count):
                if not getattr(model, kind)(number).name:
                    raise ValueError(f"{self.path}: {kind} {number} has no name, expected one")

    def _joints(self, model):
        return [model.joint(number).name for number in range(model.njnt)]

    def _actuators(self, model):
        return [model.actuator(number).name for number in range(model.nu)]

    def _has_structure(self, model):
        """True if forces are linear in velocities and controls as far as the file says, and sensors show the configuration or velocities of joints."""
        import mujoco

        shown = [
            model.sensor_needstage[number] == mujoco.mjtStage.mjSTAGE_POS or model.sensor_type[number] == mujoco.mjtSensor.mjSENS_JOINTVEL
            for number in range(model.nsensor)
        ]
        resists = model.opt.density or model.opt.viscosity
        return all(shown) and not (self.contacts or resists or model.na or model.dof_frictionloss.any() or model.tendon_frictionloss.any() or model.nplugin)

    def _sensors(self, model):
        """Name and unit of each value of the sensors."""
        import mujoco

        for number in range(model.nsensor):
            name, width = model.sensor(number).name, int(model.sensor_dim[number])
            kind = mujoco.mjtSensor(model.sensor_type[number]).name.removeprefix("mjSENS_")
            unit = UNITS.get(kind, "")
            if kind in ("JOINTPOS", "JOINTVEL"):
                unit = _unit(model, model.sensor_objid[number]) + ("/s" if kind == "JOINTVEL" else "")
            for axis in AXES.get(width, [f".{place}" for place in range(width)]):
                yield name + axis, unit

    def _element(self, spec, name):
        """The element of `geom.NAME.mass`; names may have points."""
        kind, _, rest = name.partition(".")
        element = getattr(spec, kind, None)
        element = element(rest.rpartition(".")[0]) if callable(element) else None
        if element is None or not hasattr(element, _attribute(name)[0]):
            raise ValueError(f"{self.path}: no attribute `{name}`, expected for instance `geom.NAME.mass`")
        return element

    def _compiled(self, parameters):
        import mujoco

        spec = mujoco.MjSpec.from_file(self.path)
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
        flags = mujoco.mjtDisableBit
        # the solver of the last step would decide the digits of the next one
        spec.option.disableflags |= flags.mjDSBL_WARMSTART
        if not self.contacts:
            spec.option.disableflags |= flags.mjDSBL_CONTACT | flags.mjDSBL_LIMIT
        for name in self.attributes:
            if name in parameters:
                _write(self._element(spec, name), name, parameters[name])
        return spec, spec.compile()

    def _load(self, parameters):
        import mujoco

        if self._key != parameters:
            self._key, self._model = dict(parameters), self._compiled(parameters)[1]
            self._data, self._timestep = mujoco.MjData(self._model), float(self._model.opt.timestep)
            self._structure = self._has_structure(self._model)
        mujoco.mj_resetData(self._model, self._data)
        return self._model, self._data

    def _set(self, model, data, states):
        joints = self._joints(model)
        data.qpos[:] = [states[name] for name in joints]
        data.qvel[:] = [states[f"{name}.rate"] for name in joints]
        for number, name in enumerate(self._actuators(model)):
            if model.actuator_actnum[number]:
                data.act[model.actuator_actadr[number]] = states[f"{name}.activation"]

    def run(self, times, parameters, inputs, states=None):
        import mujoco

        if states is None:
            # a model without actuators has no inputs, which are left out then
            inputs, states = {}, inputs
        model, data = self._load(parameters)
        self._set(model, data, states)
        signals = [inputs[f"{name}.control"] for name in self._actuators(model)]
        at = lambda time: [np.interp(time, times, signal) for signal in signals]
        rows = []
        for row, time in enumerate(times):
            # equal steps that end at the row; controls of the middle of a step are of second order
            count = max(1, round((time - data.time) / self._timestep)) if row else 0
            model.opt.timestep = (time - data.time) / count if count else model.opt.timestep
            for _ in range(count):
                data.ctrl[:] = at(data.time + model.opt.timestep / 2)
                mujoco.mj_step(model, data)
            data.time = time
            data.ctrl[:] = at(time)
            mujoco.mj_forward(model, data)
            rows.append(data.sensordata.copy())
        return dict(zip([name for name, _ in self._sensors(model)], np.array(rows).T))

    def equations(self, parameters, inputs, states):
        import mujoco

        model, data = self._load(parameters)
        self._set(model, data, states)
        data.ctrl[:] = [inputs[f"{name}.control"] for name in self._actuators(model)]
        mujoco.mj_forward(model, data)
        rates = {}
        for number, name in enumerate(self._joints(model)):
            rates |= {name: float(data.qvel[number]), f"{name}.rate": float(data.qacc[number])}
        for number, name in enumerate(self._actuators(model)):
            if model.actuator_actnum[number]:
                rates[f"{name}.activation"] = float(data.act_dot[model.actuator_actadr[number]])
        outputs = dict(zip([name for name, _ in self._sensors(model)], data.sensordata.tolist()))
        if not self._structure:
            return rates, outputs
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        return rates, outputs, mass


def _unit(model, joint):
    import mujoco

    return "rad" if mujoco.mjtJoint(model.jnt_type[joint]) == mujoco.mjtJoint.mjJNT_HINGE else "m"


def _attribute(name):
    """Attribute and place of `body.NAME.pos[2]`."""
    attribute, place = re.fullmatch(r"(\w+)(?:\[(\d+)\])?", name.rpartition(".")[2]).groups()
    return attribute, None if place is None else int(place)


def _read(element, name):
    attribute, place = _attribute(name)
    value = np.asarray(getattr(element, attribute), float)
    if place is None and value.ndim and value.size > 1:
        raise ValueError(f"`{name}` has {value.size} values, expected one of them, as in `{name}[0]`")
    return value.reshape(-1)[place or 0]


def _write(element, name, number):
    attribute, place = _attribute(name)
    value = getattr(element, attribute)
    if np.ndim(value):
        value[place or 0] = number
    else:
        setattr(element, attribute, number)
