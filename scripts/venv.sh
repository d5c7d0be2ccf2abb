#!/usr/bin/env bash
# Makes .venv with the pinned Python packages of the tests; does nothing if it is up to date.
# With --peers: .peers, with the programs that some figures of scripts/figures.toml compare with (7 GB).
# With --hosts: .hosts, with the hosts of tests/hosts/installed.py.
set -euo pipefail
cd "$(dirname "$0")/.."

folder=.venv requirements=tests/python/requirements.txt options=()
if [ "${1:-}" = --peers ]; then
  folder=.peers requirements=scripts/measure/requirements.txt options=(--no-deps)
elif [ "${1:-}" = --hosts ]; then
  folder=.hosts requirements=tests/hosts/requirements.txt options=(--no-deps)
elif [ $# != 0 ]; then
  echo "usage: scripts/venv.sh [--peers | --hosts]" >&2
  exit 1
fi
# the target of a link belongs to another checkout, and would be emptied
if [ -L $folder ]; then
  echo "scripts/venv.sh: $folder is a symbolic link: remove it, then run this script again" >&2
  exit 1
fi
stamp=$folder/requirements.txt
if cmp -s "$requirements" "$stamp"; then exit 0; fi

command -v python3 >/dev/null || { echo "scripts/venv.sh: python3 is missing: install Python 3.11 or newer" >&2; exit 1; }
if ! python3 -m venv --clear $folder; then
  # Debian keeps the venv module in a package of its own
  if [ "$(id -u)" != 0 ] || ! command -v apt-get >/dev/null; then
    echo "scripts/venv.sh: python3 -m venv failed: install python3-venv" >&2
    exit 1
  fi
  apt-get update -qq && apt-get install -y -qq python3-venv
  python3 -m venv --clear $folder
fi
# what is never imported need not be compiled
$folder/bin/python -m pip install --no-compile --quiet --disable-pip-version-check ${options[@]+"${options[@]}"} --requirement "$requirements"
cp "$requirements" "$stamp"
