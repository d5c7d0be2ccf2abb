"""Measures metafmu: each figure of the documentation has its command here.

Usage: .venv/bin/python scripts/measure WHAT [OPTION]...    (WHAT --help: its options)
"""

import ast
import runpy
import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
SHARED = ("__main__", "common", "model_file", "onnx_layers", "paper_models", "paper_page", "paper_pictures", "peer_models", "planar", "record_peers")
FILES = {file.stem.replace("_", "-"): file for file in sorted(FOLDER.glob("*.py")) if file.stem not in SHARED}


def first_line(file):
    return ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))).splitlines()[0]


def main():
    what = sys.argv[1] if len(sys.argv) > 1 else "--help"
    if what not in FILES:
        width = max(map(len, FILES))
        listed = "\n".join(f"  {name:{width}}  {first_line(file)}" for name, file in FILES.items())
        is_asked = what in ("-h", "--help")
        text = f"{__doc__.strip()}\n\nWHAT is one of\n{listed}"
        sys.exit(print(text) if is_asked else f"error: `{what}` is not known\n\n{text}")
    # as in messages of argparse
    sys.argv = [f"scripts/measure {what}", *sys.argv[2:]]
    runpy.run_path(str(FILES[what]), run_name="__main__")


if __name__ == "__main__":
    main()
