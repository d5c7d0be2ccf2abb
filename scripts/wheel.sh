#!/usr/bin/env bash
# Builds the Python package for this platform: a wheel in target/wheels/, without the builder's folders in it.
# Usage: scripts/wheel.sh [OPTION OF MATURIN]...
# Needs Python 3.11 and maturin, on the PATH or in .venv. Wheels of releases are made by scripts/release.sh.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/remap.sh
export_remapped
PATH=$PATH:$PWD/.venv/bin
command -v maturin >/dev/null || { echo "scripts/wheel.sh: maturin is missing: pip install maturin" >&2; exit 1; }
bill=$PWD/target/metafmu.cdx.json
mkdir -p target
python3 scripts/sbom.py --target "$(rustc -vV | sed -n 's/^host: //p')" >"$bill"
exec maturin build --release --locked --manifest-path python/Cargo.toml --sbom-include "$bill" "$@"
