"""Broken hosts: the FMU's library neither crashes nor leaks, and responds as the standard requires."""

import subprocess
import sys
import zipfile
from pathlib import Path

import abuse
import pytest
from conftest import fmu_of, metafmu

SCENARIOS = [scenario.__name__ for scenario in abuse.SCENARIOS if scenario is not abuse.cycles]

# a cycle of an FMU with few weights takes a tenth of the time, and a hundred thousand are needed to see a leak of a few bytes
SMALL = """
name = "small"
source = { system = "single-pendulum" }
time = { stop = 2, step = 0.1 }
parameters = { L = { min = 0.1, max = 0.2, unit = "m" } }
outputs = { theta = {} }
sampling = { method = "sobol", runs = 30, test_runs = 5 }
network = { hidden = [8] }
training = { schedule = "cosine", epochs = 400 }
# how it answers counts, not how good it is
accept = { r2 = -1000 }
export = { fmi = "both" }
"""


def unpack(fmu, version, tmp_path_factory):
    # a space and a sign that a URI escapes
    folder = tmp_path_factory.mktemp("fmu") / f"FMI {version} #1"
    with zipfile.ZipFile(fmu) as archive:
        archive.extractall(folder)
    return folder


@pytest.fixture(scope="module")
def unpacked(pendulum, tmp_path_factory):
    return {version: unpack(fmu, version, tmp_path_factory) for version, fmu in pendulum.fmus.items()}


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    study = tmp_path_factory.mktemp("small") / "small.toml"
    study.write_text(SMALL)
    metafmu("sample", study, "--out", study.parent)
    metafmu("train", study, "--out", study.parent)
    metafmu("export", study, "--out", study.parent)
    return {version: unpack(fmu_of(study.parent, "small", version), version, tmp_path_factory) for version in (2, 3)}


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_the_library_bears(unpacked, scenario, version):
    bears(unpacked[version], scenario)


@pytest.mark.parametrize("version", [2, 3])
def test_the_library_bears_cycles(small, version):
    bears(small[version], abuse.cycles.__name__)


def bears(folder, scenario):
    command = [sys.executable, Path(abuse.__file__), folder, scenario]
    result = subprocess.run(command, capture_output=True, text=True, timeout=300)
    print(result.stdout)
    assert result.returncode == 0, f"ended with {result.returncode}:\n{result.stdout}\n{result.stderr}"
