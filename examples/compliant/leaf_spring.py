"""A leaf spring between a frame and an axle, simulated by Exudyn while the axle moves on a given path.

The front eye is hinged to the frame, the rear eye slides and is held by a shackle. The axle is clamped to the middle of the leaf: it moves by
`y` and turns by `angle`. Its x is free. `force` and `moment` are what the axle applies to the leaf: their power goes into the spring.
"""

import exudyn
import exudyn.itemInterface as items
import numpy as np
from exudyn.beams import GenerateStraightLineANCFCable2D
from scipy.interpolate import CubicSpline

import metafmu

LENGTH, WIDTH, MODULUS = 1.2, 0.06, 210e9
DENSITY = 780.0  # a tenth of steel's: a force without states has no inertia, so the mass belongs to frame and axle
SHACKLE = 2e5  # N/m
RETARDATION = 0.005  # s: stress grows by this time times the strain rate
ELEMENTS = 4  # of each half
STEPS_PER_ROW = 4
LEAD = 0.5  # s, in which the axle begins to move before the first row


class Path:
    """Motion of a coordinate, `middle + amplitude sin(2 pi frequency t + phase)`, from rest."""

    def __init__(self, parameters, name):
        self.middle, self.amplitude, self.frequency, self.phase = (
            parameters[f"{name}.{key}"] for key in ("middle", "amplitude", "frequency", "phase")
        )

    def full(self, t):
        return self.middle + self.amplitude * np.sin(2 * np.pi * self.frequency * t + self.phase)

    def rate(self, t):
        omega = 2 * np.pi * self.frequency
        return self.amplitude * omega * np.cos(omega * t + self.phase)

    def at(self, t):
        """The motion, where `t` is 0 at the first row."""
        share = min(max(1 + t / LEAD, 0), 1)
        return self.full(t) * share**3 * (10 - 15 * share + 6 * share**2)


def excitation(middle, amplitude, unit):
    """Parameters of a path."""
    return {
        "middle": {"min": -middle, "max": middle, "unit": unit},
        "amplitude": {"min": 0.1 * amplitude, "max": amplitude, "unit": unit},
        "frequency": {"min": 0.2, "max": 1.5, "unit": "Hz"},
        "phase": {"min": -np.pi, "max": np.pi, "unit": "rad"},
    }


@metafmu.source(
    parameters={
        "thickness": {"min": 0.007, "max": 0.009, "unit": "m"},
        **{f"y.{key}": of for key, of in excitation(0.04, 0.06, "m").items()},
        **{f"angle.{key}": of for key, of in excitation(0.04, 0.06, "rad").items()},
    },
    outputs={"y": "m", "angle": "rad", "vy": "m/s", "rate": "rad/s", "force": "N", "moment": "N.m"},
    stop=1.0,
    step=0.02,
)
def leaf_spring(times, parameters):
    """Leaf spring whose middle moves on a given path, simulated by Exudyn"""
    thickness, y, angle = parameters["thickness"], Path(parameters, "y"), Path(parameters, "angle")
    bending, axial = MODULUS * WIDTH * thickness**3 / 12, MODULUS * WIDTH * thickness
    container = exudyn.SystemContainer()
    system = container.AddSystem()
    element = items.ObjectANCFCable2D(
        physicsMassPerLength=DENSITY * WIDTH * thickness,
        physicsBendingStiffness=bending,
        physicsAxialStiffness=axial,
        physicsBendingDamping=RETARDATION * bending,
        physicsAxialDamping=RETARDATION * axial,
    )
    nodes = GenerateStraightLineANCFCable2D(
        mbs=system,
        positionOfNode0=[0, 0, 0],
        positionOfNode1=[LENGTH, 0, 0],
        numberOfElements=2 * ELEMENTS,
        cableTemplate=element,
        massProportionalLoad=[0, 0, 0],
        fixedConstraintsNode0=[1, 1, 0, 0],
        fixedConstraintsNode1=[0, 1, 0, 0],
    )[0]
    ground = system.AddMarker(
        items.MarkerNodeCoordinate(nodeNumber=system.AddNode(items.NodePointGround()), coordinate=0)
    )
    coordinate = lambda node, index: system.AddMarker(items.MarkerNodeCoordinate(nodeNumber=node, coordinate=index))
    system.AddObject(
        items.ObjectConnectorCoordinateSpringDamper(markerNumbers=[ground, coordinate(nodes[-1], 0)], stiffness=SHACKLE)
    )

    def prescribe(index, value):
        """Gives a coordinate of the middle node a value over time, and returns the sensor of the force that this takes."""
        constraint = system.AddObject(
            items.ObjectConnectorCoordinate(
                markerNumbers=[ground, coordinate(nodes[ELEMENTS], index)],
                offsetUserFunction=lambda system, t, item, offset: value(t - LEAD),
            )
        )
        kind = exudyn.OutputVariableType.Force
        return system.AddSensor(items.SensorObject(objectNumber=constraint, outputVariableType=kind, storeInternal=True))

    # slopes of the middle node are those of the axle, which is rigid
    sensors = [
        prescribe(1, y.at),
        prescribe(2, lambda t: np.cos(angle.at(t)) - 1),
        prescribe(3, lambda t: np.sin(angle.at(t))),
    ]
    system.Assemble()
    settings = exudyn.SimulationSettings()
    step = times[1] - times[0]
    settings.timeIntegration.endTime = LEAD + times[-1]
    settings.timeIntegration.numberOfSteps = round(settings.timeIntegration.endTime / step * STEPS_PER_ROW)
    settings.timeIntegration.generalizedAlpha.spectralRadius = 0.6
    settings.timeIntegration.verboseMode = 0
    settings.solutionSettings.sensorsWritePeriod = step / STEPS_PER_ROW
    settings.solutionSettings.writeSolutionToFile = False
    system.SolveDynamic(settings)
    # the solver shortens steps where it must, so they do not end at the rows
    stored = [system.GetSensorStoredData(sensor) for sensor in sensors]
    force, along, across = (CubicSpline(of[:, 0], of[:, 1])(LEAD + times) for of in stored)
    turn = angle.full(times)
    return {
        "y": y.full(times),
        "angle": turn,
        "vy": y.rate(times),
        "rate": angle.rate(times),
        # the constraint's force on the ground is the one that moves the leaf, with the opposite sign
        "force": -force,
        "moment": along * np.sin(turn) - across * np.cos(turn),
    }


if __name__ == "__main__":
    leaf_spring.serve()
