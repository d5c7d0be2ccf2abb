#!/usr/bin/env bash
# Makes .venv with the pinned Python packages of the tests; does nothing if it is up to date.
set -euo pipefail
cd "$(dirname "$0")/.."

requirements=tests/python/requirements.txt
stamp=.venv/requirements.txt
if cmp -s "$requirements" "$stamp"; then exit 0; fi

command -v python3 >/dev/null || { echo "scripts/venv.sh: python3 is missing: install Python 3.11 or newer" >&2; exit 1; }
if ! python3 -m venv --clear .venv; then
  # Debian keeps the venv module in a package of its own
  if [ "$(id -u)" != 0 ] || ! command -v apt-get >/dev/null; then
    echo "scripts/venv.sh: python3 -m venv failed: install python3-venv" >&2
    exit 1
  fi
  apt-get update -qq && apt-get install -y -qq python3-venv
  python3 -m venv --clear .venv
fi
# what is never imported need not be compiled
.venv/bin/python -m pip install --no-compile --quiet --disable-pip-version-check --requirement "$requirements"
cp "$requirements" "$stamp"
