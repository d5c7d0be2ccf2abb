"""Model exchange: FMUs with continuous states and events, integrated by metafmu, against exact solutions and FMPy."""

import csv
import subprocess
import sys

import numpy as np
import pytest
from conftest import METAFMU, ROOT, metafmu
from scipy.integrate import solve_ivp

sys.path.insert(0, str(ROOT / "examples" / "fmu-source"))
import exchange


def simulated(fmu, *arguments):
    """Columns of `metafmu simulate`."""
    table = list(csv.DictReader(metafmu("simulate", fmu, *arguments).stdout.splitlines()))
    return {name: np.array([float(row[name]) for row in table]) for name in table[0]}


@pytest.fixture(scope="module")
def fmus(tmp_path_factory):
    folder = tmp_path_factory.mktemp("exchange")
    return {(name, version): exchange.build(name, version, folder) for name in exchange.MODELS for version in (2, 3)}


# runs of `metafmu new` and `metafmu sample` with rows every 0.02 s; FMPy's CVode at a tolerance of 1e-8 has larger errors
@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("name", exchange.MODELS)
def test_samplings_are_exact_solutions(name, version, tmp_path):
    ours, theirs = exchange.errors(METAFMU, name, version, tmp_path)
    assert ours < 1e-10 and theirs < 1e-4, (ours, theirs)


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("name", exchange.MODELS)
def test_a_run_in_one_stretch_is_as_exact_as_its_tolerance(name, version, fmus):
    folder = fmus[name, version].parent
    for tolerance in (None, 1e-5, 1e-12):
        error = exchange.single(METAFMU, name, version, folder, tolerance)
        assert error < 100 * (tolerance or 1e-8), tolerance


@pytest.mark.parametrize("version", [2, 3])
def test_inputs_that_vary_and_jump_are_followed(version, fmus, tmp_path):
    """x' = -x + u with a ramp up to 1 s, then a jump; within one row, and in rows that do not meet the jump."""
    inputs = tmp_path / "u.csv"
    inputs.write_text("time,u\n0,0\n1,1\n1,3\n1.5,3\n")
    solve = lambda u, span, x: solve_ivp(lambda t, x: u(t) - x, span, [x], "DOP853", rtol=1e-13, atol=1e-13).y[0, -1]
    at_jump = solve(lambda t: t, (0, 1), 1.0)
    expected = solve(lambda t: 3.0, (1, 2), at_jump)
    for step in ("2", "0.3", "0.01"):
        found = simulated(fmus["dahlquist", version], "--input", inputs, "--step-size", step)
        assert abs(found["x"][-1] - expected) < 1e-8, step
    # the row of a jump is what is there after it
    found = simulated(fmus["dahlquist", version], "--input", inputs, "--stop-time", "1", "--step-size", "1")
    assert abs(found["x"][-1] - at_jump) < 1e-8


@pytest.mark.parametrize("version", [2, 3])
def test_an_fmu_ends_its_simulation_at_an_event(version, fmus):
    # h = 1e-4, where h' = -0.01, at 2 (1 - 0.01) s; behind it a state is found impossible and discarded
    tank = simulated(fmus["tank", version], "--stop-time", "5", "--step-size", "5")
    assert tank["time"].size == 2 and abs(tank["time"][-1] - 1.98) < 1e-6 and abs(tank["h"][-1] - 1e-4) < 1e-12
    stair = simulated(fmus["stair", version], "--start", "limit=3")
    assert (stair["time"][-1], stair["counter"][-1]) == (0.75, 3)


def test_a_sampling_leaves_runs_out_that_the_fmu_ended(fmus):
    fmu = fmus["tank", 2]
    run = lambda *arguments: subprocess.run([METAFMU, *arguments], cwd=fmu.parent, capture_output=True, text=True)
    assert run("new", "tank", "--fmu", fmu.name).returncode == 0
    study = fmu.parent / "tank.toml"
    text = study.read_text().replace("stop = 1.3", "stop = 1.5").replace("runs = 1000", "runs = 30")
    study.write_text(text.replace("# max_failed = 0.1", "max_failed = 0.5"))
    result = run("sample", "tank.toml")
    assert result.returncode == 0 and "the FMU ended the simulation at 1.4" in result.stderr, result.stderr


@pytest.mark.parametrize("version", [2, 3])
def test_what_cannot_be_integrated_is_an_error_that_says_why(version, fmus):
    for name, arguments, says in [
        # infinitely many bounces before 2.56 s
        ("ball", ["--stop-time", "5", "--step-size", "0.1"], "s: no end of events: 10000 since 2.5 s"),
        ("van_der_pol", ["--start", "mu=1000", "--stop-time", "3000", "--step-size", "100"], "the equations are stiff"),
    ]:
        result = metafmu("simulate", fmus[name, version], *arguments, check=False)
        assert result.returncode == 2 and "error: model exchange failed at 2." in result.stderr, result.stderr
        assert says in result.stderr, result.stderr
    assert "no problems found" in metafmu("validate", fmus["ball", version]).stdout
