#!/usr/bin/env bash
# Prints nanoseconds per step of the pendulum's FMU beside onnxruntime, PythonFMU and bare C: the same network, one run.
# Usage: scripts/step-latency/run.sh [--rounds N]
# Needs cargo, a C compiler and python3; everything it makes is in target/step-latency/.
set -euo pipefail
cd "$(dirname "$0")/../.."

work=target/step-latency
requirements=scripts/step-latency/requirements.txt
if ! cmp -s "$requirements" "$work/venv/requirements.txt"; then
  python3 -m venv --clear "$work/venv"
  "$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check --requirement "$requirements"
  cp "$requirements" "$work/venv/requirements.txt"
fi
cargo build --release --locked --quiet
exec "$work/venv/bin/python" scripts/step-latency/compare.py "$@"
