"""Builds the FMUs of this folder for 64-bit Linux: two of C with the compiler `cc`, one of PythonFMU around MuJoCo.

Usage: make_fmus.py FOLDER

Without the packages pythonfmu and mujoco, the last one is left out.
"""

import importlib.util
import os
import subprocess
import sys
import sysconfig
import tempfile
import zipfile
from pathlib import Path

HERE = Path(__file__).resolve().parent


def build_c(source, fmu):
    """An FMU of a C file and the modelDescription.xml beside it."""
    options = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "-fvisibility=hidden"]
    description = source.with_name("modelDescription.xml")
    tuple_of = {"2.0": "linux64", "3.0": "x86_64-linux"}
    platform = next(name for version, name in tuple_of.items() if f'fmiVersion="{version}"' in description.read_text())
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / f"{source.stem}.so"
        subprocess.run(["cc", *options, "-o", library, source, "-lm"], check=True)
        with zipfile.ZipFile(fmu, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.write(description, "modelDescription.xml")
            archive.write(library, f"binaries/{platform}/{library.name}")
    return fmu


def build_python(source, folder):
    """An FMU of a PythonFMU script; PythonFMU names it after the class."""
    command = [sys.executable, "-m", "pythonfmu", "build", "-f", source, "-d", folder]
    subprocess.run(command, check=True, capture_output=True)
    return folder / f"{source.stem.capitalize()}.fmu"


def activated():
    """The environment with this Python first on the PATH, which is what metafmu needs to run an FMU of PythonFMU."""
    return {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}


def python_environment():
    """Environment in which a host that is not Python can run an FMU of PythonFMU: this interpreter's library and its packages."""
    library = Path(sysconfig.get_config_var("LIBDIR")) / (sysconfig.get_config_var("INSTSONAME") or "")
    if not library.is_file():
        sys.exit(f"PythonFMU needs the shared library of {sys.base_prefix}: install libpython3-dev, or another Python")
    packages = sysconfig.get_path("purelib")
    return {**os.environ, "LD_PRELOAD": str(library), "PYTHONHOME": sys.base_prefix, "PYTHONPATH": packages}


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    print(build_c(HERE / "van-der-pol" / "van_der_pol.c", folder / "van_der_pol.fmu"))
    print(build_c(HERE / "chain" / "chain.c", folder / "chain.fmu"))
    missing = [package for package in ("pythonfmu", "mujoco") if importlib.util.find_spec(package) is None]
    if missing:
        print(f"no Pendulum.fmu, which needs {' and '.join(missing)}: {sys.executable} -m pip install {' '.join(missing)}", file=sys.stderr)
    else:
        print(build_python(HERE / "pendulum.py", folder))
