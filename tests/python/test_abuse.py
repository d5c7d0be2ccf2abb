"""What broken hosts do to the FMU's library: it neither crashes nor leaks, and answers as the standard says."""

import subprocess
import sys
import zipfile
from pathlib import Path

import abuse
import pytest


@pytest.fixture(scope="module")
def unpacked(pendulum, tmp_path_factory):
    folders = {}
    for version, fmu in pendulum.fmus.items():
        # a space and a sign that a URI escapes
        folders[version] = tmp_path_factory.mktemp("fmu") / f"FMI {version} #1"
        with zipfile.ZipFile(fmu) as archive:
            archive.extractall(folders[version])
    return folders


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("scenario", [scenario.__name__ for scenario in abuse.SCENARIOS])
def test_the_library_bears(unpacked, scenario, version):
    command = [sys.executable, Path(abuse.__file__), unpacked[version], scenario]
    result = subprocess.run(command, capture_output=True, text=True, timeout=300)
    print(result.stdout)
    assert result.returncode == 0, f"ended with {result.returncode}:\n{result.stdout}\n{result.stderr}"
