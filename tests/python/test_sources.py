"""The FMU compiled from its own C sources gives the results of the library inside."""

import re
import shutil
from zipfile import ZipFile

import fmpy
import numpy as np
import pytest
from conftest import compiled_from_sources, fmu_of, metafmu
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu


# what the compiler says of single precision is an error
SINGLE = "-DMETAFMU_SINGLE -std=c99 -Wall -Wextra -pedantic -Wconversion -Wdouble-promotion -Werror"
# and what it changes, of an output's range
SINGLE_ERROR = 1e-5


@pytest.mark.parametrize("version", ["2", "3"])
def test_fmpy_compiles_the_sources(pendulum, tmp_path, monkeypatch, version):
    folder = shutil.copytree(pendulum.folder, tmp_path / "out")
    metafmu("export", "examples/single-pendulum.toml", "--out", folder, "--sources", "--fmi", version)
    packed = str(fmu_of(folder, "single-pendulum", version))
    assert validate_fmu(packed) == []
    unpacked = compiled_from_sources(packed, monkeypatch)
    for interface in ["CoSimulation", "ModelExchange"]:
        found, expected = (
            fmpy.simulate_fmu(fmu, fmi_type=interface, stop_time=1, step_size=0.01, output_interval=0.01)
            for fmu in (str(unpacked), packed)
        )
        for name in expected.dtype.names:
            np.testing.assert_allclose(found[name].astype(float), expected[name].astype(float), rtol=1e-12, atol=1e-12)


# thousands of kernels cancel in part, and C adds them in another order than the library: what rounding is of the range
@pytest.mark.parametrize("model, rounding", [("polynomial", 0.0), ("decision-tree", 0.0), ("svr", 1e-13)])
def test_simpler_models_are_compiled_too(pendulum, tmp_path, monkeypatch, model, rounding):
    folder = shutil.copytree(pendulum.folder, tmp_path / "out")
    metafmu("export", "examples/single-pendulum.toml", "--out", folder, "--sources", "--fmi", 2, "--model", model)
    packed = str(folder / f"single-pendulum-{model}.fmu")
    assert validate_fmu(packed) == []
    unpacked = compiled_from_sources(packed, monkeypatch)
    found, expected = (
        fmpy.simulate_fmu(fmu, start_values={"L": 0.13}, stop_time=1, output_interval=0.01) for fmu in (str(unpacked), packed)
    )
    assert np.ptp(expected["theta"]) > 0.1
    for name in expected.dtype.names:
        limit = 1e-12 + rounding * np.ptp(expected[name].astype(float))
        np.testing.assert_allclose(found[name].astype(float), expected[name].astype(float), rtol=1e-12, atol=limit)


# thousands of kernels cancel in part
@pytest.mark.parametrize("model, limit", [(None, SINGLE_ERROR), ("polynomial", SINGLE_ERROR), ("svr", 30 * SINGLE_ERROR)])
def test_maps_in_single_precision(pendulum, tmp_path, monkeypatch, model, limit):
    """The network and formulas; where a tree's columns are split, rounding may decide."""
    folder = shutil.copytree(pendulum.folder, tmp_path / "out")
    metafmu("export", "examples/single-pendulum.toml", "--out", folder, "--sources", "--fmi", 2, *(["--model", model] if model else []))
    packed = str(folder / (f"single-pendulum-{model}.fmu" if model else "single-pendulum.fmu"))
    unpacked = compiled_from_sources(packed, monkeypatch, SINGLE)
    assert validate_fmu(str(unpacked)) == []
    found, expected = (fmpy.simulate_fmu(fmu, stop_time=2, step_size=0.01, output_interval=0.01) for fmu in (str(unpacked), packed))
    assert_single(found, expected, ["theta", "thetad", "thetadd"], limit)


def assert_single(found, expected, names, limit=SINGLE_ERROR):
    """Close, but not the very same: it was computed in single precision."""
    for name in names:
        difference = np.abs(found[name] - expected[name]).max() / np.ptp(expected[name])
        assert 1e-10 < difference < limit, (name, difference)


@pytest.fixture(scope="module")
def crane(tmp_path_factory):
    folder = tmp_path_factory.mktemp("crane")
    metafmu("build", "examples/dynamics/crane-study.toml", "--out", folder)
    return folder


@pytest.mark.parametrize("version", [2, 3])
def test_equations_of_motion_are_integrated_by_the_sources(crane, tmp_path, monkeypatch, version):
    folder = shutil.copytree(crane, tmp_path / "out")
    metafmu("export", "examples/dynamics/crane-study.toml", "--out", folder, "--sources", "--fmi", version)
    packed = str(fmu_of(folder, "crane", version))
    assert validate_fmu(packed) == []
    unpacked = compiled_from_sources(packed, monkeypatch)
    force = np.array([(0.0, 2.0), (1.0, -3.0), (2.0, 4.0)], dtype=[("time", float), ("force", float)])
    for interface in ["CoSimulation", "ModelExchange"]:
        found, expected = (
            fmpy.simulate_fmu(
                fmu, fmi_type=interface, stop_time=2, step_size=0.01, output_interval=0.01, input=force, start_values={"l": 1.3}, relative_tolerance=1e-10
            )
            for fmu in (str(unpacked), packed)
        )
        assert np.ptp(expected["theta"]) > 0.1
        # the decisions of fmpy's solver, which is off by more than its tolerance, follow the last digits of the derivatives
        tolerance = {"CoSimulation": 1e-12, "ModelExchange": 1e-9}[interface]
        for name in expected.dtype.names:
            np.testing.assert_allclose(found[name].astype(float), expected[name].astype(float), rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("version", [2, 3])
def test_equations_of_motion_in_single_precision(crane, tmp_path, monkeypatch, version):
    """For a minute, by steps of fixed size, with a tolerance below the least one, which is 1e-6, and in model exchange."""
    folder = shutil.copytree(crane, tmp_path / "out")
    metafmu("export", "examples/dynamics/crane-study.toml", "--out", folder, "--sources", "--fmi", version)
    packed = str(fmu_of(folder, "crane", version))
    unpacked = compiled_from_sources(packed, monkeypatch, SINGLE)
    times = np.arange(0, 60.5, 0.5)
    force = np.array([(time, 5 * np.sin(0.7 * time)) for time in times], dtype=[("time", float), ("force", float)])
    options = {"stop_time": 60, "step_size": 0.05, "output_interval": 0.05, "input": force, "start_values": {"rope.angle_start": 0.4}}
    for tolerance in [None, 1e-10]:
        found, expected = (
            fmpy.simulate_fmu(fmu, fmi_type="CoSimulation", relative_tolerance=tolerance, **options) for fmu in (str(unpacked), packed)
        )
        assert np.ptp(expected["theta"]) > 0.1
        assert_single(found, expected, ["x", "theta"])
    # what fmpy's solver is off by with its tolerance is much more, and no more in single precision: from several starts, as its decisions follow
    # the last digits
    options |= {"stop_time": 20}
    single, double = np.zeros(2), np.zeros(2)
    for start in [0.2, 0.3, 0.4, 0.5]:
        options["start_values"] = {"rope.angle_start": start}
        expected = fmpy.simulate_fmu(packed, fmi_type="CoSimulation", relative_tolerance=1e-10, **options)
        for fmu, errors in [(str(unpacked), single), (packed, double)]:
            found = fmpy.simulate_fmu(fmu, fmi_type="ModelExchange", relative_tolerance=1e-6, **options)
            errors += [np.abs(found[name] - expected[name]).max() for name in ["x", "theta"]]
    assert (single < 2 * double).all(), (single, double)


def test_the_host_may_look_and_push_within_a_step(crane, tmp_path, monkeypatch):
    """By the library and by its sources alike: fmpy is called back after each step of the solver, and pushes."""
    folder = shutil.copytree(crane, tmp_path / "out")
    metafmu("export", "examples/dynamics/crane-study.toml", "--out", folder, "--sources", "--fmi", 3)
    packed = str(fmu_of(folder, "crane", 3))
    description = fmpy.read_model_description(packed)
    co_simulation = description.coSimulation
    assert co_simulation.providesIntermediateUpdate and co_simulation.canReturnEarlyAfterIntermediateUpdate
    references = {variable.name: variable.valueReference for variable in description.modelVariables}
    with ZipFile(packed) as archive:
        written = archive.read("modelDescription.xml").decode()
    marked = re.findall('name="([^"]*)"[^>]* intermediateUpdate="true"', written)
    assert {"force", "theta", "load_x"} & set(references) <= set(marked) and "l" not in marked
    runs = [pushed_within_steps(fmu, description, references) for fmu in (compiled_from_sources(packed, monkeypatch), fmpy.extract(packed))]
    (times, angles, reached), (expected_times, expected_angles, expected_reached) = runs
    assert reached == expected_reached == pytest.approx(0.3 + 0.0373)
    # several in each of the four steps
    assert len(times) > 12 and np.all(np.diff(times) > 0) and np.ptp(angles) > 0.01
    np.testing.assert_allclose(times, expected_times, rtol=1e-15)
    np.testing.assert_allclose(angles, expected_angles, rtol=1e-12, atol=1e-12)


def pushed_within_steps(unpacked, description, references):
    """Times and angles of the updates of four steps, the last of which is ended early, and where it ends."""
    fmu = FMU3Slave(
        guid=description.guid,
        unzipDirectory=str(unpacked),
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName="crane",
    )
    times, angles = [], []

    def update(environment, time, set_requested, get_allowed, finished, can_return, requested, return_time):
        assert set_requested and get_allowed and finished
        times.append(time)
        angles.append(fmu.getFloat64([references["theta"]])[0])
        fmu.setFloat64([references["force"]], [3 * np.sin(20 * time)])
        if 0.3 < time and can_return:
            requested[0], return_time[0] = True, 0.3373

    fmu.instantiate(
        earlyReturnAllowed=True,
        intermediateUpdate=update,
        requiredIntermediateVariables=[references["force"], references["theta"]],
    )
    fmu.enterInitializationMode(startTime=0)
    fmu.exitInitializationMode()
    reached = 0.0
    for _ in range(4):
        event, terminate, early, reached = fmu.doStep(reached, 0.1)
        assert early == (reached < 0.35 and reached > 0.3001)
    fmu.terminate()
    fmu.freeInstance()
    return times, angles, reached
