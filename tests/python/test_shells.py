"""The FMU's library and its C sources answer every call alike."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
import shells
from conftest import ROOT, metafmu

# of fmu-template/runtime/examples/model_file.rs: two of each clock
MODELS = ["covered", "encoded", "crane", "oscillator", "supported", "cell"]
CASES = [
    (model, version, interface)
    for model in MODELS
    for version in (2, 3)
    for interface in ("CoSimulation", "ModelExchange")
    # models of samples are for co-simulation only
    if interface == "CoSimulation" or model not in ("supported", "cell")
]


@pytest.fixture(scope="module")
def libraries(tmp_path_factory):
    """Unpacked FMU, library and compiled sources of each model and version, made on demand."""
    made = {}

    def make(model, version):
        if (model, version) not in made:
            made[model, version] = build(tmp_path_factory.mktemp(model), model, version)
        return made[model, version]

    return make


def build(folder, model, version):
    subprocess.run([ROOT / "target/release/examples/model_file", folder / f"{model}.safetensors", model], check=True, capture_output=True)
    metafmu("export", folder / f"{model}.safetensors", "--out", folder, "--fmi", version, "--sources")
    unpacked, compiled = folder / "fmu", folder / "sources.so"
    (packed,) = folder.glob("*.fmu")
    with zipfile.ZipFile(packed) as archive:
        archive.extractall(unpacked)
    (library,) = unpacked.glob("binaries/*linux*/*.so")
    flags = ["-std=c99", "-O1", "-DMETAFMU_PLAIN", "-fPIC", "-shared", "-Wl,--no-undefined", "-o", compiled]
    subprocess.run(["cc", *flags, *unpacked.glob("sources/*.c"), "-lm"], check=True)
    return unpacked, library, compiled


@pytest.mark.parametrize("model, version, interface", CASES)
def test_library_and_sources_answer_alike(libraries, model, version, interface):
    command = [sys.executable, Path(shells.__file__), *libraries(model, version), interface, "1,2"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert result.returncode == 0, f"ended with {result.returncode}:\n{result.stdout[-10_000:]}\n{result.stderr[-3000:]}"
