"""State spaces of records whose outputs saturate, of the sensor or at a stop, in fmpy from measured samples, in C and by the library."""

import re

import numpy as np
import pytest
from conftest import compiled_from_sources, fmu_of, metafmu
from fmpy import simulate_fmu

STEP, ROWS, GIVEN = 0.1, 900, 50
LIMIT = 0.8


def inputs(seed):
    return np.repeat(np.random.default_rng(seed).uniform(-1, 1, ROWS // 10), 10)


def sensor(force):
    """A damped oscillator with a cubic spring, of whose position nothing beyond the limit is measured."""
    position, speed, rows = 0.0, 0.0, []
    for value in force:
        rows.append(min(position, LIMIT))
        rate = -position - 0.2 * position**3 - 0.4 * speed + 1.5 * value
        position, speed = position + STEP * speed, speed + STEP * rate
    return np.array(rows)


def stop(force):
    """The level of a tank behind another one; it overflows at the limit."""
    first, level, rows = 0.2, 0.2, []
    for value in force:
        rows.append(level)
        first, level = first + STEP * (0.6 + 0.6 * value - first), min(level + STEP * (first - 0.8 * level), LIMIT)
    return np.array(rows)


SYSTEMS = {"saturated sensor": sensor, "output stopped at its limit": stop}


@pytest.fixture(scope="module", params=SYSTEMS)
def built(request, tmp_path_factory):
    """The kind of saturation, the folder, and what the build printed."""
    folder = tmp_path_factory.mktemp("saturation")
    for name, seed in (("record", 1), ("test", 2)):
        force = inputs(seed)
        table = np.column_stack([STEP * np.arange(ROWS), force, SYSTEMS[request.param](force)])
        np.savetxt(folder / f"{name}.csv", table, fmt="%.17g", delimiter=",", header="time,force,y", comments="")
    metafmu("new", "study", "--table", "record.csv", "--structure", "discrete", "--inputs", "force", cwd=folder)
    study = (folder / "study.toml").read_text()
    study = re.sub(r"(?m)^test_runs = .*$", 'test = "test.csv"', study)
    study = study.replace("[discrete]\n", '[discrete]\nmodel = "state-space"\nbudget = 20\n')
    (folder / "study.toml").write_text(study)
    printed = metafmu("build", "study.toml", "--ports", "measured", cwd=folder).stderr
    return request.param, folder, printed


def simulated(fmu, rows):
    signals = np.zeros(ROWS, [("time", float), ("force", float), ("y_measured", float), ("use_measured", bool)])
    signals["time"], signals["force"], signals["y_measured"] = STEP * np.arange(ROWS), *rows.T
    signals["use_measured"] = np.arange(ROWS) < GIVEN
    options = {"stop_time": STEP * (ROWS - 1), "output_interval": STEP, "fmi_type": "CoSimulation"}
    return simulate_fmu(str(fmu), input=signals, output=["y"], **options)["y"][:ROWS]


def test_the_kind_of_saturation_is_found_and_simulated(built, monkeypatch):
    kind, folder, printed = built
    assert f", {kind}, penalty" in printed
    force = inputs(3)
    rows = np.column_stack([force, SYSTEMS[kind](force)])
    assert (rows[GIVEN:, 1] == LIMIT).sum() > 20
    found = simulated(folder / "out/study/study.fmu", rows)
    assert found.max() <= LIMIT
    # a hundred times smaller than without
    assert np.sqrt(np.mean((found - rows[:, 1])[GIVEN:] ** 2)) < 1e-3
    metafmu("export", "out/study/study.safetensors", "--out", "sources", "--sources", "--ports", "measured", cwd=folder)
    compiled = compiled_from_sources(fmu_of(folder / "sources", "study", 2), monkeypatch)
    assert np.abs(simulated(compiled, rows) - found).max() < 1e-12
