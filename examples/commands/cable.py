"""A clamped cable with a mass at its end, released from the horizontal, simulated by Exudyn."""

import exudyn
import exudyn.itemInterface as items
import numpy as np
from exudyn.beams import GenerateStraightLineANCFCable2D

import metafmu

# errors of 2e-4 of the range, against 32 elements and forty steps a row
ELEMENTS = 12
STEPS_PER_ROW = 2


@metafmu.source(
    parameters={
        "length": {"min": 0.8, "max": 1.2, "unit": "m"},
        "stiffness": {"min": 0.3, "max": 1.0, "unit": "N.m2", "description": "bending stiffness"},
        "tip.mass": {"min": 0.02, "max": 0.1, "unit": "kg"},
    },
    outputs={"tip.x": "m", "tip.y": "m"},
    stop=1.0,
    step=0.01,
)
def cable(times, parameters):
    """Clamped flexible cable with a mass at its end, simulated by Exudyn"""
    container = exudyn.SystemContainer()
    system = container.AddSystem()
    gravity = [0, -9.81, 0]
    element = items.ObjectANCFCable2D(
        physicsMassPerLength=0.1,
        physicsBendingStiffness=parameters["stiffness"],
        physicsAxialStiffness=5e3,
        physicsBendingDamping=0.01,
    )
    nodes = GenerateStraightLineANCFCable2D(
        mbs=system,
        positionOfNode0=[0, 0, 0],
        positionOfNode1=[parameters["length"], 0, 0],
        numberOfElements=ELEMENTS,
        cableTemplate=element,
        massProportionalLoad=gravity,
        fixedConstraintsNode0=[1, 1, 1, 1],
    )[0]
    tip = nodes[-1]
    mass = parameters["tip.mass"]
    # mass as a diagonal on the two translations of the last node
    system.AddObject(items.ObjectGenericODE2(nodeNumbers=[tip], massMatrix=np.diag([mass, mass, 0, 0])))
    marker = system.AddMarker(items.MarkerNodePosition(nodeNumber=tip))
    system.AddLoad(items.LoadForceVector(markerNumber=marker, loadVector=[g * mass for g in gravity]))
    sensor = system.AddSensor(
        items.SensorNode(nodeNumber=tip, outputVariableType=exudyn.OutputVariableType.Position, storeInternal=True)
    )
    system.Assemble()
    settings = exudyn.SimulationSettings()
    settings.timeIntegration.numberOfSteps = STEPS_PER_ROW * (len(times) - 1)
    settings.timeIntegration.endTime = times[-1]
    settings.timeIntegration.generalizedAlpha.spectralRadius = 0.8
    settings.solutionSettings.sensorsWritePeriod = times[1]
    settings.solutionSettings.writeSolutionToFile = False
    settings.timeIntegration.verboseMode = 0
    system.SolveDynamic(settings)
    rows = system.GetSensorStoredData(sensor)
    return {"tip.x": rows[:, 1], "tip.y": rows[:, 2]}


if __name__ == "__main__":
    cable.serve()
