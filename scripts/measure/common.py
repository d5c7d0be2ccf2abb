"""Paths of the checkout and its command, and the build of a study."""

import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
METAFMU = ROOT / "target" / "release" / "metafmu"


def run(folder, *arguments):
    """Output of a command; a rejected surrogate is measured as well."""
    done = subprocess.run([METAFMU, *map(str, arguments)], cwd=folder, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    if done.returncode and "\nrejected: " not in done.stdout:
        raise SystemExit(f"error: metafmu {' '.join(map(str, arguments))}: {done.stdout}")
    return done.stdout


def build_record(folder, table, seed, test=None):
    """Builds the study that `metafmu new` writes for a record with an input `u`, tested on a separate table if one is given. The output is
    also written to build.txt."""
    study = folder / "study.toml"
    study.unlink(missing_ok=True)
    run(folder, "new", "study", "--table", table, "--structure", "discrete", "--inputs", "u")
    text = re.sub(r"(?m)^seed = \d+", f"seed = {seed}", study.read_text())
    study.write_text(re.sub(r"(?m)^test_runs = .*$", f'test = "{test}"', text) if test else text)
    text = run(folder, "build", "study.toml", "--ports", "measured")
    (folder / "build.txt").write_text(text)
    return text
