"""Builds load.fmu of load/ with the C compiler `cc`, and packs it with a slider crank's FMU into system.ssp.

Usage: build.py SLIDER_CRANK.fmu FOLDER
"""

import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

HERE = Path(__file__).resolve().parent


def build_load(fmu):
    """The load as FMI 2.0 co-simulation FMU for 64-bit Linux."""
    options = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic"]
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "load.so"
        link = ["-shared", "-fPIC", "-fvisibility=hidden", "-o", library, HERE / "load" / "load.c", "-lm"]
        subprocess.run(["cc", *options, *link], check=True)
        with zipfile.ZipFile(fmu, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.write(HERE / "load" / "modelDescription.xml", "modelDescription.xml")
            archive.write(library, "binaries/linux64/load.so")


def build_ssp(slider_crank, load, ssp):
    """Both FMUs and how they are connected."""
    with zipfile.ZipFile(ssp, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(HERE / "SystemStructure.ssd", "SystemStructure.ssd")
        archive.write(slider_crank, "resources/slider-crank.fmu")
        archive.write(load, "resources/load.fmu")


if __name__ == "__main__":
    slider_crank, folder = map(Path, sys.argv[1:])
    folder.mkdir(parents=True, exist_ok=True)
    build_load(folder / "load.fmu")
    build_ssp(slider_crank, folder / "load.fmu", folder / "system.ssp")
