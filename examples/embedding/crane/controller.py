"""A controller of a crane: moves the trolley to its target and damps the sway. PythonFMU makes an FMU of it.

It samples two positions at the beginning of each step and computes their velocities from the previous sample. The force is its output at
the end of the step: it acts one step later, as that of a digital controller does.
"""

from pythonfmu import DefaultExperiment, Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Real

# name, start value, description
PARAMETERS = [
    ("target", 2.0, "where the trolley has to go, in m"),
    ("k_x", 3.5, "gain of the distance to the target, in N/m"),
    ("k_v", 4.0, "gain of the trolley's velocity, in N.s/m"),
    ("k_theta", 4.0, "gain of the rope's angle, in N/rad"),
    ("k_omega", 0.6, "gain of the rope's angular velocity, in N.s/rad"),
    ("limit", 10.0, "greatest force of the motor, in N"),
]


class Controller(Fmi2Slave):
    description = "Moves the trolley of a crane to its target and damps the sway"
    default_experiment = DefaultExperiment(start_time=0, stop_time=10, step_size=0.02)

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.x = self.theta = self.force = 0.0
        self.last = None
        for name, start, description in PARAMETERS:
            setattr(self, name, start)
            variability = Fmi2Variability.tunable
            self.register_variable(
                Real(name, causality=Fmi2Causality.parameter, variability=variability, description=description)
            )
        for name, description in [("x", "position of the trolley in m"), ("theta", "angle of the rope in rad")]:
            self.register_variable(Real(name, causality=Fmi2Causality.input, description=description))
        output = {"causality": Fmi2Causality.output, "initial": Fmi2Initial.exact}
        self.register_variable(Real("force", **output, description="force of the motor in N"))

    def do_step(self, current_time, step_size):
        x_before, theta_before = self.last or (self.x, self.theta)
        v, omega = (self.x - x_before) / step_size, (self.theta - theta_before) / step_size
        self.last = self.x, self.theta
        force = self.k_x * (self.target - self.x) - self.k_v * v + self.k_theta * self.theta + self.k_omega * omega
        self.force = max(-self.limit, min(self.limit, force))
        return True
