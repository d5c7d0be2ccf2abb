#!/usr/bin/env bash
# Installs fmi-sim, a host of FMUs from crates.io that the Python tests run, into target/tools; does nothing if it is there.
# Needs libclang, of Debian's libclang-dev.
set -euo pipefail
cd "$(dirname "$0")/.."

version=0.7.0
if grep -qs "^\"fmi-sim $version " target/tools/.crates.toml; then exit 0; fi

if [ -z "${LIBCLANG_PATH:-}" ] && ! ldconfig -p | grep -q 'libclang[-.0-9]*\.so'; then
  if [ "$(id -u)" != 0 ] || ! command -v apt-get >/dev/null; then
    echo "scripts/fmi-sim.sh: libclang is missing: install libclang-dev" >&2
    exit 1
  fi
  apt-get update -qq && apt-get install -y -qq libclang-dev
fi
# it only runs small FMUs: without optimization it builds in a third of the time
CARGO_PROFILE_DEV_DEBUG=0 cargo install fmi-sim --version "$version" --locked --debug --root target/tools --quiet
