"""A pendulum on a spring, solved by scipy: a response to its parameters."""

import numpy as np
from scipy.integrate import solve_ivp

import metafmu

GRAVITY = 9.81


@metafmu.source(
    parameters={
        "length": {"min": 0.4, "max": 0.6, "unit": "m", "description": "rest length of the spring"},
        "frequency": {"min": 2.0, "max": 3.0, "unit": "Hz", "description": "frequency of the spring with the mass on it"},
        "angle0": {"min": 0.2, "max": 1.0, "unit": "rad", "description": "initial angle from the vertical"},
    },
    outputs={"angle": "rad", "extension": "m"},
    stop=2.0,
    step=0.02,
)
def spring_pendulum(times, parameters):
    """Pendulum on a spring"""
    length, stiffness = parameters["length"], (2 * np.pi * parameters["frequency"]) ** 2

    def rates(_, state):
        r, angle, v, omega = state
        return [
            v,
            omega,
            r * omega**2 + GRAVITY * np.cos(angle) - stiffness * (r - length),
            (-GRAVITY * np.sin(angle) - 2 * v * omega) / r,
        ]

    start = [length, parameters["angle0"], 0.0, 0.0]
    solution = solve_ivp(rates, (times[0], times[-1]), start, "DOP853", times, rtol=1e-9, atol=1e-9)
    return {"angle": solution.y[1], "extension": solution.y[0] - length}


if __name__ == "__main__":
    spring_pendulum.serve()
