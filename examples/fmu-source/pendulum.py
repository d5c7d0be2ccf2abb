"""A double pendulum with friction, simulated by MuJoCo, as PythonFMU makes an FMU of it: `pythonfmu build -f pendulum.py`."""

import mujoco
from pythonfmu import DefaultExperiment, Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

MODEL = """
<mujoco>
  <option timestep="0.001" integrator="RK4"/>
  <default><joint type="hinge" axis="0 -1 0" damping="{damping}"/><geom type="capsule" size="0.02" mass="0.5" contype="0"/></default>
  <worldbody>
    <body>
      <joint name="upper"/>
      <geom fromto="0 0 0 0 0 -{upper}"/>
      <body pos="0 0 -{upper}">
        <joint name="lower"/>
        <geom fromto="0 0 0 0 0 -{lower}"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""

# name, start value, description
PARAMETERS = [
    ("upper.length", 0.5, "length of the upper rod in m"),
    ("lower.length", 0.4, "length of the lower rod in m"),
    ("damping", 0.05, "friction of both joints in N.m.s/rad"),
    ("upper.angle0", 1.2, "initial angle of the upper rod from the vertical in rad"),
]
OUTPUTS = ["upper.angle", "lower.angle", "upper.velocity", "lower.velocity"]


class Pendulum(Fmi2Slave):
    description = "Double pendulum with friction, simulated by MuJoCo"
    default_experiment = DefaultExperiment(start_time=0, stop_time=2, step_size=0.01)

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.values = {name: start for name, start, _ in PARAMETERS}
        self.data = None
        for name, _, description in PARAMETERS:
            self.register_variable(
                Real(
                    name,
                    causality=Fmi2Causality.parameter,
                    variability=Fmi2Variability.fixed,
                    description=description,
                    getter=lambda name=name: self.values[name],
                    setter=lambda value, name=name: self.values.update({name: value}),
                )
            )
        for index, name in enumerate(OUTPUTS):
            getter = lambda index=index: self.output(index)
            self.register_variable(Real(name, causality=Fmi2Causality.output, getter=getter))

    def output(self, index):
        """The lower angle is relative to the upper rod."""
        return float([*self.data.qpos, *self.data.qvel][index])

    def enter_initialization_mode(self):
        values = self.values
        text = MODEL.format(upper=values["upper.length"], lower=values["lower.length"], damping=values["damping"])
        self.model = mujoco.MjModel.from_xml_string(text)
        self.data = mujoco.MjData(self.model)
        self.data.qpos[0] = values["upper.angle0"]
        mujoco.mj_forward(self.model, self.data)

    def do_step(self, current_time, step_size):
        while self.data.time < current_time + step_size - 0.5 * self.model.opt.timestep:
            mujoco.mj_step(self.model, self.data)
        return True
