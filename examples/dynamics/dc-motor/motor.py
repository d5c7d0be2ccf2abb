"""A DC motor as an FMU for co-simulation, whose inertia is a parameter: the current and the friction are not shown.

    L i' = u - R i - k w,    T = k I tanh(i / I),    J w' = T - T_L - d w - c tanh(w / w_c)

with voltage u, current i, its saturation I, speed w, torque T and load T_L, by Euler steps of 0.2 ms.

    pythonfmu build -f motor.py        # Motor.fmu
"""

import math

from pythonfmu import DefaultExperiment, Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

RESISTANCE, INDUCTANCE, CONSTANT, SATURATION = 1.2, 0.01, 0.08, 20.0
DAMPING, FRICTION, STICTION_SPEED = 2e-4, 0.02, 0.1
LONGEST_STEP = 2e-4


class Motor(Fmi2Slave):
    description = "A DC motor with friction and a current that saturates"
    default_experiment = DefaultExperiment(start_time=0, stop_time=3, step_size=0.01)

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.inertia, self.voltage, self.load = 0.01, 0.0, 0.0
        self.current, self.speed, self.torque = 0.0, 0.0, 0.0
        fixed = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.fixed}
        self.register_variable(Real("inertia", description="in kg.m2", **fixed))
        self.register_variable(Real("voltage", causality=Fmi2Causality.input, description="in V, held over a step"))
        self.register_variable(Real("load", causality=Fmi2Causality.input, description="in N.m, held over a step"))
        self.register_variable(Real("speed", causality=Fmi2Causality.output, description="in rad/s"))
        self.register_variable(Real("torque", causality=Fmi2Causality.output, description="in N.m"))

    def do_step(self, current_time, step_size):
        steps = max(1, round(step_size / LONGEST_STEP))
        h = step_size / steps
        for _ in range(steps):
            self.current += h * (self.voltage - RESISTANCE * self.current - CONSTANT * self.speed) / INDUCTANCE
            self.torque = CONSTANT * SATURATION * math.tanh(self.current / SATURATION)
            friction = DAMPING * self.speed + FRICTION * math.tanh(self.speed / STICTION_SPEED)
            self.speed += h * (self.torque - self.load - friction) / self.inertia
        return True
