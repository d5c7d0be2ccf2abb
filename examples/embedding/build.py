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


def build_ssp(structure, ssp, fmus):
    """A system of FMUs, by their names in it."""
    with zipfile.ZipFile(ssp, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(structure, "SystemStructure.ssd")
        for name, fmu in fmus.items():
            archive.write(fmu, f"resources/{name}")


if __name__ == "__main__":
    slider_crank, folder = map(Path, sys.argv[1:])
    folder.mkdir(parents=True, exist_ok=True)
    build_load(folder / "load.fmu")
    fmus = {"slider-crank.fmu": slider_crank, "load.fmu": folder / "load.fmu"}
    build_ssp(HERE / "SystemStructure.ssd", folder / "system.ssp", fmus)
