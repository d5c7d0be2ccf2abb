"""The network as PythonFMU packages it: a class whose step is a few lines of numpy."""

from pathlib import Path

import numpy as np
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class Network(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        arrays = np.load(Path(self.resources) / "network.npz")
        self.layers = [(arrays[f"weight{i}"], arrays[f"bias{i}"]) for i in range(len(arrays.files) // 2)]
        self.L, self.c, self.thetad0 = 0.15, 0.075, 2.5
        self.theta = self.thetad = self.thetadd = 0.0
        for name in ("L", "c", "thetad0"):
            self.register_variable(Real(name, causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable))
        for name in ("theta", "thetad", "thetadd"):
            self.register_variable(Real(name, causality=Fmi2Causality.output))

    def do_step(self, current_time, step_size):
        x = np.array([self.L, self.c, self.thetad0, current_time + step_size], np.float32)
        for weight, bias in self.layers[:-1]:
            x = np.tanh(x @ weight + bias)
        weight, bias = self.layers[-1]
        self.theta, self.thetad, self.thetadd = (float(y) for y in x @ weight + bias)
        return True
