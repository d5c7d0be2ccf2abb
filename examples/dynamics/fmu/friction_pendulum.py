"""A pendulum with a motor and dry friction, for model exchange: `pythonfmu3 build -f friction_pendulum.py`."""

from math import cos, sin, tanh

from pythonfmu3 import Fmi3Causality, Fmi3Initial, Fmi3SlaveBase, Fmi3Variability, Float64, ModelExchange

GRAVITY = 9.81


class FrictionPendulum(Fmi3SlaveBase, ModelExchange):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.description = "Pendulum of 1 kg with a motor and dry friction"
        self.time = 0.0
        self.length, self.torque = 1.0, 0.0
        self.angle, self.speed, self.rate, self.acceleration = 0.3, 0.0, 0.0, 0.0
        exact, calculated = {"initial": Fmi3Initial.exact}, {"initial": Fmi3Initial.calculated}
        continuous = {"variability": Fmi3Variability.continuous}
        variables = [
            Float64("time", causality=Fmi3Causality.independent, **continuous),
            Float64("angle", causality=Fmi3Causality.output, start=0.3, **continuous, **exact),
            Float64("speed", causality=Fmi3Causality.output, start=0.0, **continuous, **exact),
            Float64("rate", causality=Fmi3Causality.local, derivative=1, **continuous),
            Float64("acceleration", causality=Fmi3Causality.local, derivative=2, **continuous),
            Float64("torque", causality=Fmi3Causality.input, start=0.0, **continuous),
            Float64("length", causality=Fmi3Causality.parameter, variability=Fmi3Variability.fixed, start=1.0),
            Float64("height", causality=Fmi3Causality.output, getter=lambda: -self.length * cos(self.angle), **continuous),
        ]
        for variable in variables:
            self.register_variable(variable)

    def get_continuous_state_derivatives(self):
        inertia = self.length**2
        friction = 0.5 * tanh(4.0 * self.speed)
        self.rate = self.speed
        self.acceleration = (self.torque - friction) / inertia - GRAVITY / self.length * sin(self.angle)
        return [self.rate, self.acceleration]
