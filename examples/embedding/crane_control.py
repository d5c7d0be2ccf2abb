"""A third-party controller moves the surrogate of a crane to its target and damps the sway: in fmpy, and as SSP.

Both FMUs step over the same interval with the values of its beginning (Jacobi): the controller samples, and its force acts
one step later.

Usage: crane_control.py CRANE.fmu FOLDER > RESULT.csv, after `metafmu build examples/dynamics/crane-study.toml`

Writes controller.fmu, crane.ssp and mechanism.ssp, with the mechanism instead of the surrogate, into the folder. On stderr it prints the
difference between the result and scipy's solution of the crane's equations under the same controller.
"""

import contextlib
import subprocess
import sys
from pathlib import Path

import numpy as np
from build import build_ssp
from crane.controller import Controller
from fmpy import read_model_description
from master import Component
from scipy.integrate import solve_ivp

HERE = Path(__file__).resolve().parent
STOP, STEP = 10.0, 0.02
COLUMNS = ["time", "x", "theta", "force"]
TROLLEY, GRAVITY = 2.0, 9.81


def build_controller(folder):
    """Builds crane/controller.py as an FMU; PythonFMU names it after the class."""
    script = HERE / "crane" / "controller.py"
    command = [sys.executable, "-m", "pythonfmu", "build", "-f", script, "-d", folder]
    subprocess.run(command, check=True, capture_output=True)
    return (folder / "Controller.fmu").rename(folder / "controller.fmu")


def simulate(crane, controller, stop=STOP, step=STEP):
    """A table with a row for each communication point: time, position, angle, and the force from then on."""
    with contextlib.ExitStack() as stack:
        crane, controller = Component(crane, "crane"), Component(controller, "controller")
        for component in (crane, controller):
            stack.callback(component.close)
            component.initialize()
        rows = [[0.0, *crane.get("x", "theta"), *controller.get("force")]]
        for index in range(round(stop / step)):
            _, x, theta, force = rows[-1]
            crane.set("force", force)
            controller.set("x", x)
            controller.set("theta", theta)
            for component in (crane, controller):
                component.slave.doStep(index * step, step)
            rows.append([(index + 1) * step, *crane.get("x", "theta"), *controller.get("force")])
    return np.array(rows)


def rates(state, force, parameters):
    """Time derivatives of the crane's states, by its equations of motion: position, angle and their velocities; l, m and b."""
    (_, theta, v, omega), (l, m, b) = state, parameters
    masses = [[TROLLEY + m, m * l * np.cos(theta)], [np.cos(theta), l]]
    forces = [force - b * v + m * l * omega**2 * np.sin(theta), -GRAVITY * np.sin(theta)]
    return np.array([v, omega, *np.linalg.solve(masses, forces)])


def solve(parameters, start, measure=lambda index, x, theta: (x, theta), stop=STOP, step=STEP):
    """The table of `simulate`, computed from the equations of motion; `measure` maps the positions of a step to the inputs of the
    controller."""
    controller, state, rows = Controller(instance_name="controller"), start, [[0.0, *start[:2], 0.0]]
    for index in range(round(stop / step)):
        derivative = lambda _, state: rates(state, controller.force, parameters)
        run = solve_ivp(derivative, (0, step), state, "DOP853", rtol=1e-12, atol=1e-12)
        controller.x, controller.theta = measure(index, *state[:2])
        controller.do_step(index * step, step)
        state = run.y[:, -1]
        rows.append([(index + 1) * step, *state[:2], controller.force])
    return np.array(rows)


def start_values(fmu):
    """Parameters and start of a crane's FMU, as `solve` needs them."""
    starts = {variable.name: variable.start for variable in read_model_description(fmu).modelVariables}
    states = ["rail.position", "rope.angle", "rail.velocity", "rope.angular_velocity"]
    return [float(starts[name]) for name in "lmb"], [float(starts[f"{state}_start"]) for state in states]


if __name__ == "__main__":
    crane, folder = map(Path, sys.argv[1:])
    folder.mkdir(parents=True, exist_ok=True)
    controller = build_controller(folder)
    structure = HERE / "crane" / "SystemStructure.ssd"
    build_ssp(structure, folder / "crane.ssp", {"crane.fmu": crane, "controller.fmu": controller})
    mechanism = {"crane.toml": HERE.parent / "dynamics" / "crane.toml", "controller.fmu": controller}
    build_ssp(HERE / "crane" / "mechanism.ssd", folder / "mechanism.ssp", mechanism)
    table = simulate(crane, controller)
    errors = np.max(np.abs(table - solve(*start_values(crane))), axis=0)[1:]
    for column, error, values in zip(COLUMNS[1:], errors, table.T[1:]):
        print(f"{column}: off by at most {error:.1e}, of {np.max(np.abs(values)):.3g}", file=sys.stderr)
    np.savetxt(sys.stdout, table, "%.17g", ",", header=",".join(COLUMNS), comments="")
