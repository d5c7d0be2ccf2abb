#!/usr/bin/env bash
# Installs zsh and fish, in which the tests try the completion of commands; does nothing if they are there.
set -euo pipefail

if command -v zsh >/dev/null && command -v fish >/dev/null; then exit 0; fi
if [ "$(id -u)" != 0 ] || ! command -v apt-get >/dev/null; then
  echo "scripts/shells.sh: a shell is missing: install zsh and fish" >&2
  exit 1
fi
apt-get update -qq && apt-get install -y -qq zsh fish
