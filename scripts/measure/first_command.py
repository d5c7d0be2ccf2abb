"""Times both ways of README to a first FMU, in parts, from nothing: the wheel by pip, and a fresh clone by cargo.

Each way has an empty folder, without what earlier ones downloaded. `download` is pip's installation, or the clone and `cargo fetch`. `compile`
includes the FMU's library, which a build script compiles beside other crates; its own time is a separate column. The seconds of the first FMU
are `sample` and `learn`, and the rest of `metafmu build`. The cargo way takes about ten minutes. Needs git, cargo and a C compiler.

Usage: .venv/bin/python scripts/measure first-command --wheel FILE.whl [--out FOLDER]
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

from common import ROOT

STUDY = "examples/dynamics/crane-study.toml"


def seconds(folder, *command, **environment):
    """Wall time of a command."""
    begin = time.monotonic()
    subprocess.run(list(map(str, command)), cwd=folder, check=True, stdout=subprocess.DEVNULL, env={**os.environ, **environment})
    return time.monotonic() - begin


def parts_of_build(out, total):
    """Seconds of sampling, of learning and of the rest, from `metrics.json`."""
    metrics = json.loads((out / "metrics.json").read_text(encoding="utf-8"))
    sample, learn = metrics["sample_seconds"], metrics["train_seconds"]
    return [sample, learn, total - sample - learn]


def by_wheel(folder, wheel):
    programs = folder / "venv" / "bin"
    subprocess.run([sys.executable, "-m", "venv", folder / "venv"], check=True)
    install = seconds(folder, programs / "python", "-m", "pip", "install", "--quiet", "--no-cache-dir", "--disable-pip-version-check", wheel)
    propose = seconds(folder, programs / "metafmu", "new", "my-crane", "--template", "crane")
    build = seconds(folder, programs / "metafmu", "build", "my-crane.toml")
    return [install, None, None, *parts_of_build(folder / "out" / "my-crane", propose + build)]


def library_seconds(timings):
    """Time of the build script that compiles the FMU's library, from cargo's page of timings."""
    units = json.loads(re.search(r"^const UNIT_DATA = (\[.*?^\]);", timings.read_text(encoding="utf-8"), re.M | re.S)[1])
    return sum(unit["duration"] for unit in units if unit["name"] == "metafmu-libraries" and unit["mode"] == "run-custom-build")


def by_cargo(folder):
    clone, home = folder / "clone", folder / "cargo"
    home.mkdir()
    # where this machine finds crates
    settings = Path(os.environ.get("CARGO_HOME", Path.home() / ".cargo"), "config.toml")
    if settings.exists():
        shutil.copy(settings, home)
    cargo = {"CARGO_HOME": str(home), "CARGO_TARGET_DIR": str(clone / "target")}
    download = seconds(folder, "git", "clone", "--quiet", "--no-hardlinks", ROOT, clone) + seconds(clone, "cargo", "fetch", "--locked", **cargo)
    compile = seconds(clone, "cargo", "build", "--release", "--locked", "--timings", **cargo)
    library = library_seconds(clone / "target" / "cargo-timings" / "cargo-timing.html")
    build = seconds(clone, "cargo", "run", "--quiet", "--release", "--locked", "--", "build", STUDY, **cargo)
    return [download, compile, library, *parts_of_build(clone / "out" / "crane", build)]


def row(way, parts):
    download, compile, library, *build = parts
    whole = sum(part for part in (download, compile, *build) if part is not None)
    shown = ["" if part is None else f"{part:.1f}" if part < 10 else f"{part:.0f}" for part in (*parts, whole)]
    return f"| {way} | {' | '.join(shown)} |"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--wheel", type=Path, required=True, help="metafmu's wheel for this platform")
    parser.add_argument("--out", type=Path, default=Path("out/first-command"), help="folder that is emptied first [default: out/first-command]")
    options = parser.parse_args()
    folder, wheel = options.out.resolve(), options.wheel.resolve()
    shutil.rmtree(folder, ignore_errors=True)
    for way in ("wheel", "cargo"):
        (folder / way).mkdir(parents=True)
    print("| seconds | download | compile | of which the FMU's library | sample | learn | rest of the build | all |\n|---|---|---|---|---|---|---|---|")
    print(row("the wheel", by_wheel(folder / "wheel", wheel)), flush=True)
    print(row("a checkout", by_cargo(folder / "cargo")), flush=True)


if __name__ == "__main__":
    main()
