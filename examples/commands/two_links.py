"""A robot of two links in a vertical plane: its equations in numpy, with the mass matrix.

metafmu new robot --structure dynamics --command python two_links.py
"""

import numpy as np

import metafmu

LENGTH, MASS, INERTIA, GRAVITY = 0.5, 1.2, 0.03, 9.81


def joint(low, high):
    return {"min": low, "max": high, "start": 0.5 * (low + high), "unit": "rad"}


def rate(of, largest):
    return {"min": -largest, "max": largest, "start": 0.0, "unit": "rad/s", "rate_of": of}


@metafmu.source(
    parameters={"load": {"min": 0.0, "max": 2.0, "start": 1.0, "unit": "kg"}},
    inputs={name: {"min": -5.0, "max": 5.0, "start": 0.0, "unit": "N.m"} for name in ("shoulder.torque", "elbow.torque")},
    states={"shoulder": joint(-2.2, -0.9), "elbow": joint(-1.0, 1.0), "shoulder.rate": rate("shoulder", 6.0), "elbow.rate": rate("elbow", 9.0)},
    outputs={"tip.x": "m", "tip.y": "m", "elbow": "rad", "elbow.rate": "rad/s"},
    stop=2.0,
    step=0.01,
)
class TwoLinks:
    """Robot with two links and a load"""

    def equations(self, parameters, inputs, states):
        load = parameters["load"]
        q1, q2 = states["shoulder"], states["shoulder"] + states["elbow"]
        v1, v2 = states["shoulder.rate"], states["shoulder.rate"] + states["elbow.rate"]
        # of the angles to the ground: uniform links with the load at the tip
        coupling = LENGTH**2 * (MASS / 2 + load)
        first = INERTIA + LENGTH**2 * (MASS / 4 + MASS + load)
        second = INERTIA + LENGTH**2 * (MASS / 4 + load)
        mass = np.array([[first, coupling * np.cos(q1 - q2)], [coupling * np.cos(q1 - q2), second]])
        centrifugal = coupling * np.sin(q1 - q2) * np.array([v2**2, -(v1**2)])
        weight = GRAVITY * LENGTH * np.array([(1.5 * MASS + load) * np.cos(q1), (0.5 * MASS + load) * np.cos(q2)])
        # of the angles of the joints
        joints = np.array([[1.0, 0.0], [1.0, 1.0]])
        torques = np.array([inputs["shoulder.torque"], inputs["elbow.torque"]])
        damping = 0.4 * np.array([v1, states["elbow.rate"]])
        mass = joints.T @ mass @ joints
        accelerations = np.linalg.solve(mass, torques - damping - joints.T @ (centrifugal + weight))
        derivatives = {"shoulder": v1, "elbow": states["elbow.rate"], "shoulder.rate": accelerations[0], "elbow.rate": accelerations[1]}
        tip = LENGTH * np.array([np.cos(q1) + np.cos(q2), np.sin(q1) + np.sin(q2)])
        outputs = {"tip.x": tip[0], "tip.y": tip[1], "elbow": states["elbow"], "elbow.rate": states["elbow.rate"]}
        return derivatives, outputs, mass


if __name__ == "__main__":
    TwoLinks.serve()
