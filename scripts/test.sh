#!/usr/bin/env bash
# Runs every test: format, lints, documentation, Rust tests, then the FMU in other people's tools.
# Needs cargo with rustfmt and clippy, a C compiler (cargo links with it), libclang, python3, Chromium, and for the other
# platforms Wine, QEMU and compilers; as root what is missing is installed by apt. A missing tool is an error.
set -euo pipefail
cd "$(dirname "$0")/.."

for tool in cargo cc python3; do
  command -v "$tool" >/dev/null || { echo "scripts/test.sh: $tool is missing" >&2; exit 1; }
done
step() { printf '\n== %s\n' "$*" >&2; }

step "Python packages";     scripts/venv.sh
step "fmi-sim";             scripts/fmi-sim.sh
step "Chromium";            scripts/chromium.sh
step "format";              cargo fmt --all --check
step "imports";             python3 scripts/check-imports.py
step "lints";               cargo clippy --workspace --all-targets --locked -- -D warnings
step "documentation";       RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --locked --quiet
step "Rust tests";          cargo test --workspace --locked
step "release build";       cargo build --release --locked
step "Python tests";        .venv/bin/python -m pytest -p no:cacheprovider tests/python "$@"
step "other platforms";     scripts/test-platforms.sh
