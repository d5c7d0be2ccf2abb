"""Published benchmarks of multibody dynamics in both formulations; Andrews' squeezing mechanism is in crates/multibody/src/tests.rs."""

import sys

import numpy as np
import pytest
from conftest import ROOT
from scipy.integrate import solve_ivp

sys.path.insert(0, str(ROOT / "scripts" / "measure"))
import benchmarks

FORMULATIONS = pytest.mark.parametrize("formulation", ["augmented", "embedding"])


@FORMULATIONS
def test_the_pendulum_is_the_exact_solution(formulation):
    values, _ = benchmarks.simulate(benchmarks.pendulum(), 10.0, 1.0, formulation=formulation)
    found = np.column_stack([values["x"], values["y"]])
    for row, place in benchmarks.A01.items():
        # 1000 tolerances of the integration; the reference has 13 digits
        np.testing.assert_allclose(found[row], place, rtol=0, atol=1e-10)


@FORMULATIONS
def test_the_car_axis_is_the_reference_solution(formulation):
    values, _ = benchmarks.simulate(benchmarks.car_axis(), 3.0, 0.1, formulation=formulation)
    for name, reference in benchmarks.CAR_AXIS.items():
        # frequencies of some 60 rad/s for 3 s make 1e-12 in positions 1e-10 in rates
        assert abs(values[name][-1] - reference) < (1e-9 if name[0] == "v" else 1e-11), name


def upright(count, times):
    """x and y of the top of the first bar on the physical branch."""
    rate = benchmarks.four_bar_rate(count)
    state = solve_ivp(lambda _, s: [s[1], -rate * np.cos(s[0])], (0, times[-1]), [np.pi / 2, -1.0], "DOP853", times, rtol=1e-13, atol=1e-13).y
    return np.column_stack([np.cos(state[0]), np.sin(state[0])])


@FORMULATIONS
@pytest.mark.parametrize("count", [1, 2, 8])
def test_four_bars_fall_as_one_until_they_are_level(count, formulation):
    stop, step = 0.5, 0.1
    values, _ = benchmarks.simulate(benchmarks.four_bars(count), stop, step, formulation=formulation)
    exact = upright(count, np.arange(6) * step)
    assert exact[-1, 1] > 0.1, "they are above their bearings"
    np.testing.assert_allclose(np.column_stack([values["x"], values["y"]]), exact, rtol=0, atol=1e-10)


@FORMULATIONS
def test_four_bars_leave_the_physical_branch_nowhere_in_silence(formulation):
    """Level bars are a singular position from which other motions begin."""
    try:
        values, _ = benchmarks.simulate(benchmarks.four_bars(2), 10.0, 0.1, formulation=formulation)
    except RuntimeError as error:
        assert "singular position" in str(error) and "`joints." in str(error)
        return
    exact = upright(2, np.arange(101) * 0.1)
    np.testing.assert_allclose(np.column_stack([values["x"], values["y"]]), exact, rtol=0, atol=1e-3)


def test_the_reference_of_the_four_bars_is_the_published_one():
    found = upright(2, np.array([0.0, 1.0, 5.0, 10.0]))
    np.testing.assert_allclose(found[1:], [[-0.19502030195, -0.98079920566], [-0.81131046100, -0.58461554535], [0.32845811154, 0.94451853818]], rtol=0, atol=1e-9)
