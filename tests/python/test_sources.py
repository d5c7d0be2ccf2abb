"""The FMU compiled from its own C sources gives the results of the library inside."""

import os
import shutil
import sys
from pathlib import Path

import fmpy
import numpy as np
import pytest
from conftest import fmu_of, metafmu
from fmpy.build import build_platform_binary
from fmpy.validation import validate_fmu


@pytest.mark.parametrize("version", ["2", "3"])
def test_fmpy_compiles_the_sources(pendulum, tmp_path, monkeypatch, version):
    # fmpy calls the cmake that was installed beside it
    monkeypatch.setenv("PATH", os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
    folder = shutil.copytree(pendulum.folder, tmp_path / "out")
    metafmu("export", "examples/single-pendulum.toml", "--out", folder, "--sources", "--fmi", version)
    packed = str(fmu_of(folder, "single-pendulum", version))
    assert validate_fmu(packed) == []
    unpacked = Path(fmpy.extract(packed))
    # the weights are compiled in: neither library nor model file is needed
    shutil.rmtree(unpacked / "binaries")
    shutil.rmtree(unpacked / "resources")
    build_platform_binary(unpacked, all_warnings=True)
    for interface in ["CoSimulation", "ModelExchange"]:
        found, expected = (
            fmpy.simulate_fmu(fmu, fmi_type=interface, stop_time=1, step_size=0.01, output_interval=0.01)
            for fmu in (str(unpacked), packed)
        )
        for name in expected.dtype.names:
            np.testing.assert_allclose(found[name].astype(float), expected[name].astype(float), rtol=1e-12, atol=1e-12)
