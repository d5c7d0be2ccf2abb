"""Surrogates that are files, packaged again."""

import subprocess
from zipfile import ZipFile

import numpy as np
import pytest
from conftest import METAFMU, fmu_of, metafmu
from fmpy import read_model_description, simulate_fmu


def entry(fmu, name):
    with ZipFile(fmu) as archive:
        return archive.read(name)


@pytest.mark.parametrize("form", ["safetensors", "fmu"])
def test_a_surrogate_that_is_a_file_is_packaged_as_the_study_would(pendulum, form, tmp_path):
    source = pendulum.folder / f"{pendulum.fmu.stem}.{form}"
    written = metafmu("export", source, "--out", tmp_path, "--fmi", "both", "--sources").stdout.split()
    assert written == [str(tmp_path / f"{pendulum.fmu.stem}{suffix}.fmu") for suffix in ("", "-fmi3")]
    of_study = fmu_of(pendulum.folder, pendulum.fmu.stem, 2)
    options = {"start_values": {"L": 0.13}, "stop_time": 1.0, "output_interval": 0.05}
    expected = simulate_fmu(of_study, **options)
    for fmu in written:
        assert entry(fmu, "resources/model.safetensors") == entry(of_study, "resources/model.safetensors")
        assert entry(fmu, "sources/instance.c")
        result = simulate_fmu(fmu, **options)
        for name in ("theta", "thetad"):
            np.testing.assert_array_equal(result[name], expected[name])
    assert [read_model_description(fmu).fmiVersion for fmu in written] == ["2.0", "3.0"]
    metafmu("validate", written[1])


def test_the_working_directory_is_the_default(pendulum, tmp_path):
    source = pendulum.folder / f"{pendulum.fmu.stem}.safetensors"
    result = subprocess.run([METAFMU, "export", source], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert result.stdout == f"./{pendulum.fmu.stem}.fmu\n" and (tmp_path / f"{pendulum.fmu.stem}.fmu").exists()


def test_what_cannot_be_packaged_is_refused_and_nothing_is_written(pendulum, tmp_path):
    fmu = fmu_of(pendulum.folder, pendulum.fmu.stem, 2)
    copy = tmp_path / f"{pendulum.fmu.stem}.fmu"
    copy.write_bytes(fmu.read_bytes())
    damaged = tmp_path / "damaged.safetensors"
    damaged.write_bytes((pendulum.folder / f"{pendulum.fmu.stem}.safetensors").read_bytes()[:-5])
    for arguments, says in [
        ([copy, "--out", tmp_path], "is the surrogate itself: expected another folder, by --out"),
        ([copy, "--model", "ridge"], "model `ridge`: is fitted to the runs of a study: expected a study file"),
        ([damaged, "--out", tmp_path], "damaged.safetensors: "),
        ([tmp_path / "none.safetensors"], "none.safetensors: cannot read"),
        ([copy, "--out", tmp_path / "new", "--platform", "sparc-linux"], "platform `sparc-linux` is not known"),
    ]:
        result = metafmu("export", *arguments, check=False)
        assert result.returncode == 2 and says in result.stderr, (result.returncode, result.stderr)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["damaged.safetensors", f"{pendulum.fmu.stem}.fmu"]
    assert copy.read_bytes() == fmu.read_bytes()
