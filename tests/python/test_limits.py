"""Files without an end, and archives that hold more than they seem to: refused in seconds, with the limit, and nothing is left behind."""

import os
import resource
import subprocess
import zipfile

import numpy as np
import pytest
from conftest import ANY, METAFMU, metafmu

STUDY = """name = "s"
[source]
fmu = "pipe"
[time]
stop = 1
step = 0.5
[parameters]
L = { min = 0.1, max = 0.2 }
[outputs]
y = {}
[sampling]
runs = 8
test_runs = 1
"""
DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="m" guid="1">
  <CoSimulation modelIdentifier="m"/>
  <ModelVariables><ScalarVariable name="y" valueReference="0" causality="output"><Real/></ScalarVariable></ModelVariables>
  <ModelStructure><Outputs><Unknown index="1"/></Outputs></ModelStructure>
</fmiModelDescription>
"""
# trained in a moment
SMALL = """name = "small"
source = { system = "single-pendulum" }
time = { stop = 2, step = 0.1 }
parameters = { L = { min = 0.1, max = 0.2, unit = "m" } }
outputs = { theta = {} }
sampling = { method = "sobol", runs = 8, test_runs = 1 }
network = { hidden = [8] }
training = { epochs = 2 }
"""
PIPE = "it is not a regular file but a pipe: write its content to a file first"
# bytes of zeros that an archive of any size may not have
TOO_MANY = (64 << 20) + 1


def run(folder, *arguments, gigabytes=8):
    """Runs the command, with little memory, and a temporary folder that it has to leave empty."""
    temporary = folder / "temporary"
    temporary.mkdir(exist_ok=True)
    bytes_ = gigabytes << 30
    result = subprocess.run(
        [METAFMU, *map(str, arguments)], cwd=folder, env=os.environ | {"TMPDIR": str(temporary)}, capture_output=True, text=True, timeout=60,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (bytes_, bytes_)),
    )
    assert "panicked" not in result.stderr and not list(temporary.iterdir())
    return result


def fmu(path, entries):
    """An FMU with these entries beside a description and something at the place of its library."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", DESCRIPTION)
        archive.writestr("binaries/linux64/m.so", METAFMU.read_bytes()[:4096])
        for name, content in entries:
            archive.writestr(name, content)


@pytest.mark.parametrize(
    "arguments",
    [
        ["validate", "pipe"],
        ["simulate", "pipe"],
        ["new", "y", "--fmu", "pipe"],
        ["new", "y", "--table", "pipe"],
        ["new", "y", "--mechanism", "pipe"],
        ["sample", "s.toml"],
        ["build", "pipe"],
        ["import", "pipe", "--new", "i.toml"],
        ["import", "pipe", "--interface", "pipe"],
        ["predict", "pipe.fmu", "t.csv"],
        ["predict", "pipe.safetensors", "t.csv"],
        ["export", "pipe.safetensors"],
        ["swap", "pipe", "--component", "c", "--with", "pipe"],
        ["search", "pipe"],
    ],
    ids=" ".join,
)
def test_a_pipe_in_the_place_of_a_file_is_refused_at_once(tmp_path, arguments):
    for name in ("pipe", "pipe.fmu", "pipe.safetensors"):
        os.mkfifo(tmp_path / name)
    (tmp_path / "s.toml").write_text(STUDY)
    result = run(tmp_path, *arguments)
    assert result.returncode == 2 and f"{PIPE}\n" in result.stderr, result


def test_a_table_from_a_pipe_is_read_and_announced(tmp_path):
    (tmp_path / "small.toml").write_text(SMALL + ANY)
    for verb in ("sample", "train"):
        metafmu(verb, tmp_path / "small.toml", "--out", tmp_path)
    model, table = tmp_path / "small.safetensors", "time,L\n0.5,0.15\n"
    (tmp_path / "table.csv").write_text(table)
    expected = run(tmp_path, "predict", model, "table.csv").stdout
    result = subprocess.run([METAFMU, "predict", model, "/dev/stdin"], input=table, capture_output=True, text=True, timeout=60)
    assert result.stdout == expected and len(expected.splitlines()) == 2
    assert "/dev/stdin: reading a pipe or device up to its end\n" in result.stderr
    refused = run(tmp_path, "predict", model, "/dev/zero", gigabytes=2)
    assert refused.returncode == 2 and "/dev/zero:1: a line of more than 67108864 bytes, expected a table" in refused.stderr


def test_an_archive_beyond_the_limits_is_refused_before_it_is_unpacked(tmp_path):
    fmu(tmp_path / "many.fmu", ((f"resources/{index}", b"") for index in range(50_000)))
    fmu(tmp_path / "large.fmu", [("resources/zeros", bytes(TOO_MANY))])
    for verb, code, kind in [("validate", 1, "archive: "), ("simulate", 2, "error: ")]:
        for name, says in [("many", "has 50002 entries to unpack, expected at most 50000"), ("large", "expected at most 67108864: pack it with less")]:
            result = run(tmp_path, verb, f"{name}.fmu", gigabytes=2)
            text = result.stdout + result.stderr
            assert result.returncode == code and kind in text and says in text, result


def test_what_a_run_does_not_need_is_not_unpacked(tmp_path):
    fmu(tmp_path / "documented.fmu", [("documentation/zeros", bytes(TOO_MANY)), ("binaries/win64/zeros", bytes(TOO_MANY))])
    result = run(tmp_path, "simulate", "documented.fmu")
    # its library is none
    assert "`binaries/linux64/m.so`" in result.stderr and "unpack" not in result.stderr, result


def test_unpacking_ends_at_the_time_limit(tmp_path):
    fmu(tmp_path / "many.fmu", ((f"resources/{index % 100}/{index}", b"") for index in range(20_000)))
    result = run(tmp_path, "validate", "many.fmu", "--time-limit", "0.01")
    assert result.returncode == 1
    assert "is not unpacked: the archive took longer than 0.01 s (--time-limit)" in result.stdout, result


def test_arrays_that_are_larger_than_their_archive_allows_are_refused(tmp_path):
    np.savez_compressed(tmp_path / "zeros.npz", w=np.zeros(TOO_MANY // 8 + 1))
    assert (tmp_path / "zeros.npz").stat().st_size < 200_000
    (tmp_path / "i.toml").write_text('name = "n"\ninputs.a = {}\noutputs.y = {}\n[[layers]]\nweight = "w"\nactivation = "identity"\n')
    result = run(tmp_path, "import", "zeros.npz", "--interface", "i.toml", gigabytes=1)
    assert result.returncode == 2 and "zeros.npz: has 67109" in result.stderr and "expected at most 67108864" in result.stderr, result
