"""Optimal control with CasADi: the force that brings the load of a crane from one place to rest at another, with the least effort.

CasADi takes the equations and their derivatives from the FMU of a surrogate. A replay in FMPy shows that the force does what was planned.

Usage: casadi_crane.py CRANE.fmu FOLDER, after `metafmu build examples/dynamics/crane-study.toml`; needs `pip install casadi`

Writes force.csv, a table for `metafmu simulate --input`, and crane.svg into the folder.
"""

import sys
from pathlib import Path

import casadi
import matplotlib
import numpy as np
from fmpy import extract, simulate_fmu

matplotlib.use("svg")
import matplotlib.pyplot as plt

# of the motion, in s; the force is constant in each interval
STOP, INTERVALS, STAGES = 6.0, 60, 4
STATES = ["rail.position", "rope.angle", "rail.velocity", "rope.angular_velocity"]
START, TARGET, LIMIT = [-1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], 5.0


def equations(fmu):
    """Rates of the states as a function of states, force and tunable parameters, and the parameters' values."""
    model = casadi.DaeBuilder("crane", str(extract(str(fmu))))
    assert model.x() == STATES and model.u() == ["force"], (model.x(), model.u())
    parameters = np.ravel([model.start(name) for name in model.p()])
    return model.create("rates", ["x", "u", "p"], ["ode"]), parameters


def step_of(rates):
    """Runge-Kutta's classical method over an interval."""
    x, u, p = casadi.MX.sym("x", len(STATES)), casadi.MX.sym("u"), casadi.MX.sym("p", rates.size1_in("p"))
    size, state = STOP / INTERVALS / STAGES, x
    for _ in range(STAGES):
        first = rates(state, u, p)
        second = rates(state + size / 2 * first, u, p)
        third = rates(state + size / 2 * second, u, p)
        state = state + size / 6 * (first + 2 * second + 2 * third + rates(state + size * third, u, p))
    return casadi.Function("step", [x, u, p], [state])


def plan(fmu):
    """States at the ends of the intervals, and the force in each: multiple shooting, solved by IPOPT with exact first derivatives."""
    rates, parameters = equations(fmu)
    step, problem = step_of(rates), casadi.Opti()
    states, force = problem.variable(len(STATES), INTERVALS + 1), problem.variable(1, INTERVALS)
    for index in range(INTERVALS):
        problem.subject_to(states[:, index + 1] == step(states[:, index], force[index], parameters))
    problem.subject_to(states[:, 0] == START)
    problem.subject_to(states[:, -1] == TARGET)
    problem.subject_to(problem.bounded(-LIMIT, force, LIMIT))
    problem.minimize(casadi.sumsqr(force))
    problem.set_initial(states, np.linspace(START, TARGET, INTERVALS + 1).T)
    problem.solver("ipopt", {"print_time": False}, {"print_level": 0, "hessian_approximation": "limited-memory", "tol": 1e-9})
    solution = problem.solve()
    return np.array(solution.value(states)).T, np.atleast_1d(solution.value(force))


def replay(fmu, force):
    """States at the ends of the intervals when FMPy steps the FMU with this force."""
    times = np.linspace(0.0, STOP, INTERVALS + 1)
    signal = np.array(list(zip(times[:-1], force)), dtype=[("time", float), ("force", float)])
    starts = {f"{name}_start": value for name, value in zip(STATES, START)}
    result = simulate_fmu(str(fmu), start_values=starts, input=signal, output=STATES, stop_time=STOP, output_interval=STOP / INTERVALS)
    return np.stack([result[name] for name in STATES], axis=1)


def draw(states, replayed, force, file):
    times = np.linspace(0.0, STOP, INTERVALS + 1)
    figure, (top, bottom) = plt.subplots(2, sharex=True, figsize=(7, 5), layout="constrained")
    for column, label in ((0, "position, m"), (1, "angle, rad")):
        [line] = top.plot(times, states[:, column], label=label)
        top.plot(times, replayed[:, column], "o", markersize=3, markevery=5, color=line.get_color(), label=f"{label}, in FMPy")
    top.legend()
    bottom.step(times, [*force, force[-1]], where="post")
    bottom.set_xlabel("time, s")
    bottom.set_ylabel("force, N")
    figure.savefig(file)


def main():
    fmu, folder = map(Path, sys.argv[1:])
    folder.mkdir(parents=True, exist_ok=True)
    states, force = plan(fmu)
    replayed = replay(fmu, force)
    table = np.column_stack([np.linspace(0.0, STOP, INTERVALS + 1), [*force, force[-1]]])
    np.savetxt(folder / "force.csv", table, "%.17g", ",", header="time,force", comments="")
    draw(states, replayed, force, folder / "crane.svg")
    for name, planned, found in zip(STATES, states[-1], replayed[-1]):
        print(f"{name} at the end: planned {planned:.6f}, in FMPy {found:.6f}")
    print(f"largest difference of a state: {np.abs(states - replayed).max():.1e}; largest force: {np.abs(force).max():.2f} N")


if __name__ == "__main__":
    main()
