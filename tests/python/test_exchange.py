"""Model exchange: FMUs with continuous states and events, integrated by metafmu, against exact solutions and FMPy."""

import csv
import re
import shutil
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
    # the implicit method, which the stiff ones need, uses the whole tolerance
    assert ours < (1e-8 if name in ("relay", "gate") else 1e-10) and theirs < 1e-4, (ours, theirs)


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("name", exchange.MODELS)
def test_a_run_in_one_stretch_is_as_exact_as_its_tolerance(name, version, fmus):
    folder = fmus[name, version].parent
    for tolerance in (None, 1e-5, 1e-12):
        error = exchange.single(METAFMU, name, version, folder, tolerance)
        assert error < 100 * (tolerance or 1e-8), tolerance


@pytest.fixture(scope="module")
def relaxation():
    """Van der Pol's oscillator with mu = 1000 by scipy: rows of x0 and x1, which jump every 807 s."""
    times, mu = np.arange(0, 3001, 100.0), 1000
    rates = lambda _, x: [x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]]
    jacobian = lambda _, x: [[0, 1], [-2 * mu * x[0] * x[1] - 1, mu * (1 - x[0] ** 2)]]
    return solve_ivp(rates, (0, 3000), [2, 0], "Radau", times, rtol=1e-9, atol=1e-11, jac=jacobian).y


@pytest.mark.parametrize("version", [2, 3])
def test_a_stiff_oscillator_is_that_of_scipy(version, fmus, relaxation, tmp_path, monkeypatch):
    monkeypatch.setenv("EXCHANGE_COUNTS", str(tmp_path / "counts"))
    for rows, step in [(1, 100), (10, 10), (100, 1)]:
        arguments = ["--start", "mu=1000", "--stop-time", "3000", "--step-size", step, "--tolerance", "1e-9"]
        found = simulated(fmus["van_der_pol", version], *arguments)
        for name, expected in zip(("x0", "x1"), relaxation, strict=True):
            assert np.abs(found[name][::rows] - expected).max() < 1e-7, (name, step)
    single = ["--start", "mu=1000", "--stop-time", "3000", "--step-size", "3000", "--tolerance", "1e-9"]
    found = simulated(fmus["van_der_pol", version], *single)
    assert abs(found["x0"][-1] - relaxation[0, -1]) < 1e-7
    counts = np.loadtxt(tmp_path / "counts")
    # the explicit method would need at least a step for each 6 / 3000 s, and twelve evaluations for each of them
    assert counts.shape == (4, 2) and counts[:, 0].max() < 0.1 * 12 * 3000 * 3000 / 6
    assert counts[:, 1].min() > 0


@pytest.mark.parametrize("version", [2, 3])
def test_the_jacobian_is_that_of_the_fmu_or_of_differences(version, tmp_path, monkeypatch):
    monkeypatch.setenv("EXCHANGE_COUNTS", str(tmp_path / "counts"))
    directional = []
    for provided, defines in [(True, []), (True, ["-DWRONG"]), (False, [])]:
        monkeypatch.setattr(exchange, "DIRECTIONAL", ("relay",) if provided else ())
        exchange.build("relay", version, tmp_path, *defines)
        assert exchange.single(METAFMU, "relay", version, tmp_path) < 1e-6
        directional.append(np.loadtxt(tmp_path / "counts", ndmin=2)[-1, 1])
    right, wrong, none = directional
    # two states: four numbers each time
    assert right > 0 and right % 4 == 0 and wrong > 0 and none == 0


def test_time_events_may_be_many(fmus):
    found = simulated(fmus["stair", 3], "--start", "period=5e-5", "--start", "limit=1e6", "--stop-time", "2", "--step-size", "2")
    assert found["counter"][-1] in (39999, 40000)


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


def test_inputs_are_held_beyond_their_table_with_a_word(fmus, tmp_path):
    inputs = tmp_path / "u.csv"
    says = lambda text, *options: (
        inputs.write_text(text),
        metafmu("simulate", fmus["dahlquist", 2], "--input", inputs, "--step-size", "0.5", "--output", tmp_path / "out.csv", *options, check=False),
    )[1].stderr
    late = says("time,u\n0.5,1\n1.5,3\n", "--stop-time", "2")
    assert "the run is from 0 to 2 s, and the table of inputs from 0.5 to 1.5 s: beyond its ends inputs keep the values" in late
    assert says("time,u\n0,1\n2,3\n", "--stop-time", "2") == "", "the table covers the run"
    assert says("time,u\n0,1\n", "--stop-time", "2") == "", "a single row: constant inputs"
    assert "variable `u`: has two start values" in says("time,u\n0,1\n", "--start", "u=1", "--start", "u=2")


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
    for name, arguments, fails_at in [
        # infinitely many bounces before 2.56 s
        ("ball", ["--stop-time", "5", "--step-size", "0.1"], 2.5584),
        # u changes its sign wherever x leaves a band that is as narrow as rounding
        ("relay", ["--start", "band=1e-14", "--stop-time", "5", "--step-size", "5"], 0.0),
    ]:
        result = metafmu("simulate", fmus[name, version], *arguments, check=False)
        found = re.search(r"error: model exchange failed at (\S+) s: no end of events: 10000 since \S+ s", result.stderr)
        assert result.returncode == 2 and abs(float(found[1]) - fails_at) < 1e-3, result.stderr
        assert "Zeno" in result.stderr and "hysteresis" in result.stderr, result.stderr
    assert "no problems found" in metafmu("validate", fmus["ball", version]).stdout


HELD = """name = "held"
structure = "discrete"
[source]
fmu = "dahlquist.fmu"
step = STEP
[time]
stop = 2
step = 0.1
[inputs]
u = { min = -1, max = 1 }
[parameters]
k = { min = 0.5, max = 2 }
[outputs]
x = {}
[sampling]
runs = 20
test_runs = 5
"""


# communication steps as long as samples, and three for each sample
@pytest.mark.parametrize("step", [0.1, 0.1 / 3])
@pytest.mark.parametrize("version", [2, 3])
def test_samples_with_held_inputs_are_the_exact_solution(version, step, fmus, tmp_path):
    """x' = -k x + u with u held over each sample: x[n + 1] = u / k + (x[n] - u / k) exp(-k h)."""
    shutil.copy(fmus["dahlquist", version], tmp_path / "dahlquist.fmu")
    (tmp_path / "held.toml").write_text(HELD.replace("STEP", str(step)))
    metafmu("sample", tmp_path / "held.toml", "--out", tmp_path / "out")
    with open(tmp_path / "out" / "train.csv") as file:
        table = list(csv.DictReader(file))
    by_run = {}
    for row in table:
        by_run.setdefault(row["run"], []).append(row)
    assert len(by_run) == 20
    for rows in by_run.values():
        t, k, u, x = (np.array([float(row[name]) for row in rows]) for name in ("time", "k", "u", "x"))
        decay = np.exp(-k[:-1] * np.diff(t))
        assert np.ptp(u) > 0.1 and np.abs(x[1:] - (u / k)[:-1] - (x[:-1] - (u / k)[:-1]) * decay).max() < 1e-9
