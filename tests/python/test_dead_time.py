"""Components whose outputs follow an input late: the FMU in fmpy, at once and from measured samples, against the component."""

import numpy as np
import pytest
from conftest import compiled_from_sources, fmu_of, metafmu
from fmpy import simulate_fmu

STEP, ROWS, LATE, GIVEN = 0.1, 800, 20, 50


def inputs(seed):
    return np.repeat(np.random.default_rng(seed).uniform(-1, 1, (ROWS // 10, 2)), 10, axis=0)


def component(u):
    """An oscillator with a stiffening spring; the first input is late, the second is not."""
    position, speed, rows = 0.0, 0.0, []
    for k in range(ROWS):
        rows.append(position)
        force = (u[k - LATE, 0] if k >= LATE else 0.0) + 0.5 * u[k, 1]
        speed += STEP * (force - position - 0.3 * position**3 - 0.5 * speed)
        position += STEP * speed
    return np.array(rows)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dead-time")
    rows = [["run", "time", "u", "v", "y"]]
    for run in range(4):
        u = inputs(run)
        u[0] = 0.0
        table = np.column_stack([STEP * np.arange(ROWS), u, component(u)])
        rows += [[f"r{run}", *map(repr, map(float, row))] for row in table]
    (folder / "runs.csv").write_text("\n".join(map(",".join, rows)) + "\n")
    metafmu("new", "study", "--table", "runs.csv", "--structure", "discrete", "--inputs", "u,v", cwd=folder)
    study = (folder / "study.toml").read_text().replace("[discrete]\n", '[discrete]\nmodel = "polynomial"\n')
    (folder / "study.toml").write_text(study)
    return folder, metafmu("build", "study.toml", "--ports", "measured", cwd=folder).stderr


def simulated(fmu, u, y=None):
    signals = np.zeros(ROWS, [("time", float), ("u", float), ("v", float), ("y_measured", float), ("use_measured", bool)])
    signals["time"], signals["u"], signals["v"] = STEP * np.arange(ROWS), *u.T
    if y is not None:
        signals["y_measured"], signals["use_measured"] = y, np.arange(ROWS) < GIVEN
    options = {"stop_time": STEP * (ROWS - 1), "output_interval": STEP, "fmi_type": "CoSimulation"}
    return simulate_fmu(str(fmu), input=signals, output=["y"], **options)["y"][:ROWS]


def test_an_input_that_is_late_is_simulated_exactly(built, monkeypatch):
    folder, printed = built
    assert "dead time: u " in printed and "v " not in printed.split("dead time: ")[1].splitlines()[0]
    u = inputs(9)
    u[0] = 0.0
    truth = component(u)
    found = simulated(folder / "out/study/study.fmu", u)
    # a third of it would be wrong without
    assert np.abs(found - truth).max() < 1e-3 * np.ptp(truth)
    # from the middle of a motion
    whole = inputs(10)
    motion = component(whole)
    shifted = np.roll(whole, -100, axis=0), np.roll(motion, -100)
    assert np.abs(simulated(folder / "out/study/study.fmu", *shifted) - shifted[1])[GIVEN:-100].max() < 1e-3 * np.ptp(truth)
    metafmu("export", "out/study/study.safetensors", "--out", "sources", "--sources", "--ports", "measured", cwd=folder)
    compiled = compiled_from_sources(fmu_of(folder / "sources", "study", 2), monkeypatch)
    assert np.abs(simulated(compiled, u) - found).max() < 1e-12
