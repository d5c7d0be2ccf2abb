"""The FMU compiled from its own C sources gives the results of the library inside."""

import shutil

import fmpy
import numpy as np
import pytest
from conftest import compiled_from_sources, fmu_of, metafmu
from fmpy.validation import validate_fmu


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


@pytest.mark.parametrize("model", ["polynomial", "decision-tree", "svr"])
def test_simpler_models_are_compiled_too(pendulum, tmp_path, monkeypatch, model):
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
        np.testing.assert_allclose(found[name].astype(float), expected[name].astype(float), rtol=1e-12, atol=1e-12)


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
                fmu, fmi_type=interface, stop_time=2, step_size=0.01, output_interval=0.01, input=force, start_values={"l": 1.3}
            )
            for fmu in (str(unpacked), packed)
        )
        assert np.ptp(expected["theta"]) > 0.1
        for name in expected.dtype.names:
            np.testing.assert_allclose(found[name].astype(float), expected[name].astype(float), rtol=1e-12, atol=1e-12)
