"""A mass on a stiffening spring with a force on it, by its equations: states and inputs."""

import metafmu


@metafmu.source(
    parameters={"damping": {"min": 0.1, "max": 0.5, "unit": "N.s/m"}},
    inputs={"force": {"min": -2.0, "max": 2.0, "start": 0.0, "unit": "N"}},
    states={
        "x": {"min": -1.5, "max": 1.5, "start": 0.0, "unit": "m"},
        "v": {"min": -3.0, "max": 3.0, "start": 0.0, "unit": "m/s"},
    },
    outputs={"spring": {"unit": "N", "description": "force of the spring"}},
    stop=10.0,
    step=0.05,
)
class Oscillator:
    """Mass on a stiffening spring"""

    def equations(self, parameters, inputs, states):
        x, v = states["x"], states["v"]
        spring = -x - 2 * x**3
        return {"x": v, "v": spring - parameters["damping"] * v + inputs["force"]}, {"spring": spring}


if __name__ == "__main__":
    Oscillator.serve()
