"""examples/embedding/design_study.py: one instance gives the results of a separate instance for each parameter set."""

import sys

import numpy as np
import pytest
from conftest import OUTPUTS, ROOT, simulate_with_fmpy

sys.path.insert(0, str(ROOT / "examples" / "embedding"))
import design_study

RUST = ROOT / "target" / "release" / "examples" / "design_study"


@pytest.fixture(scope="module")
def study(pendulum):
    study = design_study.Study(pendulum.fmu)
    yield study
    study.component.close()


@pytest.fixture(scope="module")
def points(pendulum):
    return design_study.draw(pendulum.fmu, 50)


def test_one_instance_gives_what_separate_ones_do(pendulum, study, points):
    for point in points:
        separate = simulate_with_fmpy(pendulum, *point)
        expected = np.column_stack([separate[output] for output in OUTPUTS])
        # the same binary; fmpy's own loop may compute a time with another rounding
        np.testing.assert_allclose(study.run(point), expected, rtol=1e-12, atol=1e-11)


def test_no_run_leaves_a_trace_in_the_next(study, points):
    first = [study.run(point) for point in points]
    again = [study.run(point) for point in reversed(points)]
    assert first == again[::-1]


def test_one_long_step_ends_where_many_short_ones_do(study, points):
    for point in points:
        np.testing.assert_allclose(study.end(point), study.run(point)[-1], rtol=1e-12, atol=1e-11)


def test_the_rust_program_gives_the_same(pendulum, study, points):
    assert RUST.exists(), "run `cargo build --examples` first"
    ends, times = design_study.by_rust([RUST], pendulum.fmu, points)
    np.testing.assert_allclose(ends, [study.run(point)[-1] for point in points], rtol=1e-12, atol=1e-11)
    assert times.shape == (3, design_study.BLOCKS)


def test_what_it_is_compared_with_solves_the_pendulum(pendulum, study, points):
    """The equations solved by scipy there are those the surrogate was trained on."""
    for point in points:
        solution, run = design_study.solve(point, "DOP853", 1e-12), np.array(study.run(point))
        for column, output in enumerate(["theta", "thetad"]):
            error = np.max(np.abs(solution[column] - run[:, column]))
            assert error <= 1.5 * pendulum.metrics["outputs"][output]["max_abs_error"]
