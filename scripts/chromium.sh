#!/usr/bin/env bash
# Installs Chromium and its driver, in which the tests look at reports; does nothing if they are there.
set -euo pipefail

if command -v chromium >/dev/null && command -v chromedriver >/dev/null; then exit 0; fi
if [ "$(id -u)" != 0 ] || ! command -v apt-get >/dev/null; then
  echo "scripts/chromium.sh: Chromium is missing: install chromium and chromium-driver" >&2
  exit 1
fi
apt-get update -qq && apt-get install -y -qq chromium chromium-driver
