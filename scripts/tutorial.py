#!/usr/bin/env python3
"""Runs the blocks of a tutorial in their order, as a reader would paste them, and keeps its pictures.

A block ```toml title="NAME" or ```xml title="NAME" becomes the file NAME, ```python title="NAME" too; ```sh runs in bash with `metafmu` on the path.
Pictures that the page shows and the blocks write are copied beside the page. Needs target/release/metafmu and the packages of the tests.

Usage: .venv/bin/python scripts/tutorial.py docs/tutorial/PAGE.md [--folder FOLDER]
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BLOCK = re.compile(r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```$', re.S | re.M)


def blocks(page):
    """Language, file name or None, and text of each block."""
    return [(match[1], match[2], match[3]) for match in BLOCK.finditer(page.read_text(encoding="utf-8"))]


def pictures(page):
    return re.findall(r"!\[[^\]]*\]\(([^)]+)\)", page.read_text(encoding="utf-8"))


def run(page, folder):
    """Runs a page in a folder. A block that fails ends it, as does a warning of `metafmu`."""
    programs = [ROOT / "target" / "release", Path(sys.executable).parent]
    environment = {**os.environ, "PATH": os.pathsep.join([*map(str, programs), os.environ["PATH"]]), "MPLBACKEND": "agg"}
    for language, name, text in blocks(page):
        if name:
            (folder / name).write_text(text, encoding="utf-8")
        elif language == "sh":
            finished = subprocess.run(["bash", "-euo", "pipefail", "-c", text], cwd=folder, env=environment, capture_output=True, text=True)
            if finished.returncode != 0:
                raise RuntimeError(f"{page.name}: exit code {finished.returncode} of\n{text}\n{finished.stdout}\n{finished.stderr}")
            if "warning: " in finished.stderr:
                raise RuntimeError(f"{page.name}: a warning of\n{text}\n{finished.stderr}")
            print(finished.stdout, end="")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("page", type=Path)
    parser.add_argument("--folder", type=Path, help="a folder that stays, instead of a temporary one")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        run(options.page, folder)
        for picture in pictures(options.page):
            shutil.copy(folder / picture, options.page.parent / picture)


if __name__ == "__main__":
    main()
