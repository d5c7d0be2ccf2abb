#!/usr/bin/env bash
# Prints nanoseconds per step of the pendulum's FMU beside onnxruntime, PythonFMU and bare C: the same network, one run.
# Usage: scripts/step-latency/run.sh [--rounds N]
# Needs cargo, a C compiler and .peers (scripts/venv.sh --peers); everything it makes is in target/step-latency/.
set -euo pipefail
cd "$(dirname "$0")/../.."

mkdir -p target/step-latency
cargo build --release --locked --quiet
exec .peers/bin/python scripts/step-latency/compare.py "$@"
