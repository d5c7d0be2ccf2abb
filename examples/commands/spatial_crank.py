"""A spatial slider-crank: a crank, a rod between two spherical joints, and a slider on a tilted guide, simulated by Exudyn."""

import exudyn
import exudyn.itemInterface as items
import exudyn.utilities as tools
import numpy as np

import metafmu

GRAVITY = [0, 0, -9.81]
# the crank turns about x; the guide has an angle of 30 degrees with its plane
GUIDE = np.array([np.sin(np.pi / 6), np.cos(np.pi / 6), 0.0])
OFFSET = np.array([0.05, 0.0, 0.0])
ROTOR_INERTIA, ROD_MASS, SLIDER_MASS = 0.02, 0.4, 0.6
STEPS_PER_ROW = 10


@metafmu.source(
    parameters={
        "crank": {"min": 0.08, "max": 0.12, "unit": "m", "description": "length of the crank"},
        "rod": {"min": 0.3, "max": 0.4, "unit": "m", "description": "length of the rod"},
        "speed": {"min": 6.0, "max": 12.0, "unit": "rad/s", "description": "speed of the crank at the start"},
    },
    outputs={"slider": "m", "slider.speed": "m/s", "crank.speed": "rad/s", "pin.force": "N"},
    stop=1.0,
    step=0.01,
)
def spatial_crank(times, parameters):
    """Spatial slider-crank with two spherical joints, simulated by Exudyn"""
    crank, rod, speed = (parameters[name] for name in ("crank", "rod", "speed"))
    # the crank begins along y; positions and velocities of pin and slider fit the length of the rod
    pin, pin_velocity = np.array([0, crank, 0]), np.array([0, 0, crank * speed])
    toward = OFFSET - pin
    along = -GUIDE @ toward + np.sqrt((GUIDE @ toward) ** 2 - toward @ toward + rod**2)
    slider = OFFSET + along * GUIDE
    direction = (slider - pin) / rod
    slider_velocity = (direction @ pin_velocity) / (direction @ GUIDE) * GUIDE
    # the rod has no spin about its axis
    rod_velocity = np.cross(direction, slider_velocity - pin_velocity) / rod

    container = exudyn.SystemContainer()
    system = container.AddSystem()
    ground = system.CreateGround()
    # its center of mass is on its axis
    rotor = tools.RigidBodyInertia(mass=1, inertiaTensor=ROTOR_INERTIA * np.eye(3))
    across = ROD_MASS * rod**2 / 12
    slender = tools.RigidBodyInertia(mass=ROD_MASS, inertiaTensor=np.diag([1e-3 * across, across, across]))
    block = tools.RigidBodyInertia(mass=SLIDER_MASS, inertiaTensor=1e-3 * np.eye(3))
    middle, velocity = (pin + slider) / 2, (pin_velocity + slider_velocity) / 2
    frame = np.column_stack([direction, *np.linalg.svd(direction[None])[2][1:]])
    frame[:, 2] = np.cross(frame[:, 0], frame[:, 1])
    bodies = [
        system.CreateRigidBody(inertia=rotor, initialAngularVelocity=[speed, 0, 0], gravity=GRAVITY),
        system.CreateRigidBody(
            inertia=slender, referencePosition=middle, referenceRotationMatrix=frame, initialVelocity=velocity, initialAngularVelocity=rod_velocity, gravity=GRAVITY
        ),
        system.CreateRigidBody(inertia=block, referencePosition=slider, initialVelocity=slider_velocity, gravity=GRAVITY),
    ]
    system.CreateRevoluteJoint(bodyNumbers=[ground, bodies[0]], position=[0, 0, 0], axis=[1, 0, 0])
    joint = system.CreateSphericalJoint(bodyNumbers=[bodies[0], bodies[1]], position=pin)
    system.CreateSphericalJoint(bodyNumbers=[bodies[1], bodies[2]], position=slider)
    system.CreatePrismaticJoint(bodyNumbers=[ground, bodies[2]], position=slider, axis=GUIDE)

    kinds = exudyn.OutputVariableType
    of_body = lambda body, kind: system.AddSensor(items.SensorBody(bodyNumber=body, outputVariableType=kind, storeInternal=True))
    sensors = [of_body(bodies[2], kinds.Position), of_body(bodies[2], kinds.Velocity), of_body(bodies[0], kinds.AngularVelocity)]
    sensors.append(system.AddSensor(items.SensorObject(objectNumber=joint, outputVariableType=kinds.Force, storeInternal=True)))
    system.Assemble()
    settings = exudyn.SimulationSettings()
    settings.timeIntegration.numberOfSteps = STEPS_PER_ROW * (len(times) - 1)
    settings.timeIntegration.endTime = times[-1]
    settings.timeIntegration.generalizedAlpha.spectralRadius = 0.8
    settings.timeIntegration.generalizedAlpha.computeInitialAccelerations = True
    settings.solutionSettings.sensorsWritePeriod = times[1]
    settings.solutionSettings.writeSolutionToFile = False
    settings.timeIntegration.verboseMode = 0
    system.SolveDynamic(settings)
    position, velocity, turning, force = (system.GetSensorStoredData(sensor)[:, 1:] for sensor in sensors)
    return {
        "slider": (position - OFFSET) @ GUIDE,
        "slider.speed": velocity @ GUIDE,
        "crank.speed": turning[:, 0],
        "pin.force": np.linalg.norm(force, axis=1),
    }


if __name__ == "__main__":
    spatial_crank.serve()
