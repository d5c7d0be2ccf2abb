"""Mechanisms against an independent code: scipy on equations derived by hand, beside tables and FMUs of the command."""

import json
import re

import numpy as np
import pandas as pd
import pytest
from conftest import ROOT, metafmu
from fmpy import simulate_fmu
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp
from scipy.linalg import expm

MECHANISMS = ROOT / "examples" / "mechanisms"


def sample(name, formulation, tmp_path, runs=8):
    """Samples a few runs of an example's study in one formulation and returns its table."""
    mechanism = (MECHANISMS / f"{name}.toml").read_text()
    lines = [line for line in mechanism.splitlines() if not line.startswith("formulation")]
    (tmp_path / f"{name}.toml").write_text("\n".join([f'formulation = "{formulation}"', *lines]))
    study = (MECHANISMS / f"{name}-study.toml").read_text().splitlines()
    study = [f"runs = {runs}" if line.startswith("runs = ") else line for line in study]
    (tmp_path / "study.toml").write_text("\n".join(study))
    metafmu("sample", tmp_path / "study.toml", "--out", tmp_path / "out")
    table = pd.read_csv(tmp_path / "out" / "train.csv")
    assert table["run"].nunique() == runs
    return table


def four_bar(crank, theta0, damping, times):
    """theta, psi, psid, x, y of examples/mechanisms/four-bar.toml.

    One degree of freedom, the crank angle: coupler and rocker angles from the loop closure
    `crank e^(i theta) + coupler e^(i phi) = base + rocker e^(i psi)`, the equation of motion from Lagrange's equation
    with the velocity coefficients phi' = dphi/dtheta, psi' = dpsi/dtheta and their derivatives.
    """
    coupler, rocker, base, density, gravity, stiffness, rest = 0.5, 0.4, 0.45, 2.0, 9.81, 2.0, 1.5

    def angles(theta):
        tip = crank * np.exp(1j * theta)
        diagonal = base - tip
        length = abs(diagonal)
        # the triangle of coupler, rocker and diagonal, coupler above it
        at_tip = np.arccos((coupler**2 + length**2 - rocker**2) / (2 * coupler * length))
        phi = np.angle(diagonal) + at_tip
        psi = np.angle(tip + coupler * np.exp(1j * phi) - base)
        return phi, psi

    def coefficients(theta, phi, psi):
        # i crank e^(i theta) + i coupler e^(i phi) phi' = i rocker e^(i psi) psi', and once more
        matrix = np.array(
            [[-coupler * np.sin(phi), rocker * np.sin(psi)], [coupler * np.cos(phi), -rocker * np.cos(psi)]]
        )
        first = np.linalg.solve(matrix, [crank * np.sin(theta), -crank * np.cos(theta)])
        phi1, psi1 = first
        # derivative of both sides with the coefficients held
        right = np.array(
            [
                crank * np.cos(theta) + coupler * np.cos(phi) * phi1**2 - rocker * np.cos(psi) * psi1**2,
                crank * np.sin(theta) + coupler * np.sin(phi) * phi1**2 - rocker * np.sin(psi) * psi1**2,
            ]
        )
        return first, np.linalg.solve(matrix, right)

    def derivative(_, state):
        theta, thetad = state
        phi, psi = angles(theta)
        (phi1, psi1), (phi2, psi2) = coefficients(theta, phi, psi)
        masses = density * np.array([crank, coupler, rocker])
        inertias = masses * np.array([crank, coupler, rocker]) ** 2 / 12
        # centre of the coupler: crank e^(i theta) + coupler/2 e^(i phi)
        e, f = np.exp(1j * theta), np.exp(1j * phi)
        c1 = 1j * crank * e + 1j * coupler / 2 * f * phi1
        c2 = -crank * e - coupler / 2 * f * phi1**2 + 1j * coupler / 2 * f * phi2
        mass = (
            inertias[0] + masses[0] * crank**2 / 4
            + inertias[1] * phi1**2 + masses[1] * abs(c1) ** 2
            + (inertias[2] + masses[2] * rocker**2 / 4) * psi1**2
        )
        half_slope = (
            inertias[1] * phi1 * phi2
            + masses[1] * (c1 * np.conj(c2)).real
            + (inertias[2] + masses[2] * rocker**2 / 4) * psi1 * psi2
        )
        weight = -gravity * (
            masses[0] * crank / 2 * np.cos(theta) + masses[1] * c1.imag + masses[2] * rocker / 2 * np.cos(psi) * psi1
        )
        spring = -(stiffness * (psi - rest) + damping * psi1 * thetad) * psi1
        return [thetad, (weight + spring - half_slope * thetad**2) / mass]

    solution = solve_ivp(derivative, (0, times[-1]), [theta0, 0.0], "DOP853", times, rtol=1e-12, atol=1e-12)
    theta, thetad = solution.y
    rows = []
    for angle, rate in zip(theta, thetad):
        phi, psi = angles(angle)
        (_, psi1), _ = coefficients(angle, phi, psi)
        centre = crank * np.exp(1j * angle) + coupler / 2 * np.exp(1j * phi)
        rows.append([angle, psi, psi1 * rate, centre.real, centre.imag])
    return np.array(rows)


@pytest.mark.parametrize("formulation", ["augmented", "embedding"])
def test_the_four_bar_linkage_is_the_loop_closure_with_lagranges_equation(formulation, tmp_path):
    for _, run in sample("four-bar", formulation, tmp_path).groupby("run"):
        parameters = run[["crank_length", "theta0", "damping"]].iloc[0]
        exact = four_bar(*parameters, run["time"].to_numpy())
        np.testing.assert_allclose(run[["theta", "psi", "psid", "x", "y"]], exact, rtol=0, atol=1e-8)


def test_a_four_bar_linkage_becomes_a_validated_fmu_with_one_command(tmp_path):
    metafmu("build", MECHANISMS / "four-bar-study.toml", "--out", tmp_path)
    outputs = json.loads((tmp_path / "metrics.json").read_text())["outputs"]
    assert min(output["r2"] for output in outputs.values()) >= 0.9999
    fmu = tmp_path / "four-bar.fmu"
    assert validate_fmu(fmu) == []
    metafmu("validate", fmu)
    # points that neither training nor metafmu's own test runs have seen, on equations that are not metafmu's
    random, times = np.random.default_rng(5), np.linspace(0, 1, 101)
    low, high = np.array([0.15, 0.5, 0.02]), np.array([0.25, 1.1, 0.1])
    exact, found = [], []
    for _ in range(20):
        point = random.uniform(low, high)
        exact.append(four_bar(*point, times))
        start_values = dict(zip(["crank_length", "theta0", "damping"], point))
        run = simulate_fmu(fmu, start_values=start_values, output=list(outputs), stop_time=1, output_interval=0.01)
        found.append(np.column_stack([run[name] for name in outputs]))
    exact, found = np.concatenate(exact), np.concatenate(found)
    r2 = 1 - ((found - exact) ** 2).sum(0) / ((exact - exact.mean(0)) ** 2).sum(0)
    assert r2.min() >= 0.9999, dict(zip(outputs, r2))


def quarter_car(stiffness, damping, times):
    """y, ay, yw of examples/mechanisms/quarter-car.toml by the matrix exponential; the road's sine is two more states."""
    tyre, mass, wheel, height, omega = 160000.0, 250.0, 40.0, 0.02, 6.283185307179586
    # y - 1, yw - 0.4, their rates, road, road's rate
    matrix = np.zeros((6, 6))
    matrix[0, 2] = matrix[1, 3] = matrix[4, 5] = 1
    matrix[2, :4] = np.array([-stiffness, stiffness, -damping, damping]) / mass
    matrix[3, :5] = np.array([stiffness, -stiffness - tyre, damping, -damping, tyre]) / wheel
    matrix[5, 4] = -(omega**2)
    states = np.array([expm(matrix * t) @ [0, 0, 0, 0, 0, height * omega] for t in times])
    return np.column_stack([1 + states[:, 0], states @ matrix[2], 0.4 + states[:, 1]])


STIFF_TYRE = """
formulation = "FORMULATION"
parameters.c = { default = 1e7, min = 1e5, max = 1e7, unit = "N.s/m" }
bodies.body = { mass = 250, inertia = 1 }
bodies.wheel = { mass = 40, inertia = 1 }
joints.b = { type = "prismatic", between = ["ground", "body"], axis = [0, 1] }
joints.w = { type = "prismatic", between = ["ground", "wheel"], axis = [0, 1] }
springs.tyre = { coordinate = "w.position", stiffness = 160000, damping = "c" }
bushings.suspension = { between = ["wheel", "body"], stiffness = [0, 16000, 0], damping = [0, 1000, 0] }
initial = { b = { position = 0.1, velocity = 0.3 }, w = { position = 0.01, velocity = -0.5 } }
outputs = { y = { measure = "body.y" }, w = { measure = "wheel.y" }, v = { measure = "body.vy" } }
"""


@pytest.mark.parametrize("formulation", ["augmented", "embedding"])
def test_a_tyre_with_a_stiff_damper_is_its_matrix_exponential(formulation, tmp_path):
    """Up to 250000 / s in a run of 5 s, in which the explicit method takes millions of evaluations."""
    (tmp_path / "tyre.toml").write_text(STIFF_TYRE.replace("FORMULATION", formulation))
    metafmu("new", tmp_path / "study", "--mechanism", tmp_path / "tyre.toml")
    study = (tmp_path / "study.toml").read_text()
    study = re.sub(r"(?m)^runs = .*", "runs = 6", re.sub(r"(?m)^stop = .*", "stop = 5.0", re.sub(r"(?m)^step = .*", "step = 0.05", study)))
    (tmp_path / "study.toml").write_text(re.sub(r"(?m)^test_runs = .*", "test_runs = 2", study))
    metafmu("sample", tmp_path / "study.toml", "--out", tmp_path / "out")
    table = pd.read_csv(tmp_path / "out" / "train.csv")
    assert table["c"].max() > 5e6
    for _, run in table.groupby("run"):
        c = run["c"].iloc[0]
        matrix = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-64, 64, -4, 4], [400, -4400, 25, -25 - c / 40]])
        times = run["time"].to_numpy()
        states, transition = [np.array([0.1, 0.01, 0.3, -0.5])], expm(matrix * times[1])
        for _ in times[1:]:
            states.append(transition @ states[-1])
        np.testing.assert_allclose(run[["y", "w", "v"]], np.array(states)[:, :3], rtol=0, atol=1e-10)


@pytest.mark.parametrize("formulation", ["augmented", "embedding"])
def test_the_quarter_car_is_its_matrix_exponential(formulation, tmp_path):
    for _, run in sample("quarter-car", formulation, tmp_path).groupby("run"):
        exact = quarter_car(*run[["k", "c"]].iloc[0], run["time"].to_numpy())
        np.testing.assert_allclose(run[["y", "ay", "yw"]], exact, rtol=0, atol=1e-8)
