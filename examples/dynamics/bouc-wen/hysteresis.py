"""The oscillator with hysteresis of make_table.py as an FMU for co-simulation, with its damping as a parameter.

    pythonfmu build -f hysteresis.py        # Hysteresis.fmu
"""

from pythonfmu import DefaultExperiment, Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

M, K, A, B, G, D = 2.0, 5e4, 5e4, 1e3, 0.8, -1.1
LONGEST_STEP = 2.5e-4


class Hysteresis(Fmi2Slave):
    description = "A mass on a spring with hysteresis"
    default_experiment = DefaultExperiment(start_time=0, stop_time=2, step_size=0.00125)

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.damping, self.force, self.position = 10.0, 0.0, 0.0
        self.state = [0.0, 0.0, 0.0]
        fixed = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.fixed}
        self.register_variable(Real("damping", description="in N.s/m", **fixed))
        self.register_variable(Real("force", causality=Fmi2Causality.input, description="in N, held over a step"))
        self.register_variable(Real("position", causality=Fmi2Causality.output, description="in m"))

    def rates(self, y, v, z):
        hysteresis = A * v - B * (G * abs(v) * z + D * v * abs(z))
        return v, (self.force - self.damping * v - K * y - z) / M, hysteresis

    def do_step(self, current_time, step_size):
        steps = max(1, round(step_size / LONGEST_STEP))
        h = step_size / steps
        for _ in range(steps):
            state = self.state
            k1 = self.rates(*state)
            k2 = self.rates(*(x + h / 2 * k for x, k in zip(state, k1)))
            k3 = self.rates(*(x + h / 2 * k for x, k in zip(state, k2)))
            k4 = self.rates(*(x + h * k for x, k in zip(state, k3)))
            self.state = [x + h / 6 * (a + 2 * b + 2 * c + d) for x, a, b, c, d in zip(state, k1, k2, k3, k4)]
        self.position = self.state[0]
        return True
