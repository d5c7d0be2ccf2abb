#!/usr/bin/env bash
# Builds the documentation as a searchable site: target/site/docs/index.html, which works from a file too.
# A broken link is an error. Usage: scripts/site.sh
set -euo pipefail
cd "$(dirname "$0")/.."

scripts/venv.sh
.venv/bin/zensical build --strict --clean
# pages link to files of the examples beside docs/
rm -rf target/site/examples
cp -r examples target/site/examples
echo "target/site/docs/index.html"
