#!/usr/bin/env python3
"""Makes a picture of a report's first screen, as a desktop shows it: docs/report.png.

    metafmu build examples/commands/cable.toml
    .venv/bin/python scripts/report_picture.py out/cable/report.html docs/report.png

Needs Chromium (scripts/chromium.sh).
"""

import argparse
import subprocess
import tempfile
from pathlib import Path

from PIL import Image

WIDTH, HEIGHT = 1200, 486
# enough for text and curves, in a quarter of the bytes
COLORS = 96


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("report", type=Path, help="report.html of a build")
    parser.add_argument("picture", type=Path, help="PNG file to write")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        screen = Path(folder, "screen.png")
        command = ["chromium", "--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--force-prefers-reduced-motion", f"--user-data-dir={folder}/profile"]
        command += [f"--window-size={WIDTH},{HEIGHT}", f"--screenshot={screen}", options.report.resolve().as_uri()]
        subprocess.run(command, check=True, capture_output=True, timeout=60)
        Image.open(screen).convert("RGB").quantize(COLORS, dither=Image.Dither.NONE).save(options.picture, optimize=True)


if __name__ == "__main__":
    main()
