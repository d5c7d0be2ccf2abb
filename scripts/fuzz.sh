#!/usr/bin/env bash
# Fuzzes what reads files of others: the model file, modelDescription.xml and ONNX files, each for SECONDS (60 if not given).
# Usage: scripts/fuzz.sh [SECONDS [TARGET...]]
# Installs cargo-fuzz into target/tools. What it finds stands in fuzz/artifacts/.
set -euo pipefail
cd "$(dirname "$0")/.."

seconds=${1:-60}
targets=("${@:2}")
[ ${#targets[@]} -gt 0 ] || targets=(model_file model_description onnx)
version=0.13.2
command -v c++ >/dev/null || { echo "scripts/fuzz.sh: libFuzzer needs a C++ compiler: install g++" >&2; exit 1; }
if ! grep -qs "^\"cargo-fuzz $version " target/tools/.crates.toml; then
  CARGO_PROFILE_DEV_DEBUG=0 cargo install cargo-fuzz --version "$version" --locked --debug --root target/tools --quiet
fi

mkdir -p fuzz/corpus/model_file fuzz/corpus/model_description fuzz/corpus/onnx
model_file() { cargo run --quiet --release --locked --package metafmu-runtime --example model_file -- "fuzz/corpus/model_file/$1.safetensors" "${@:2}" >/dev/null; }
model_file seed 3 2
model_file per-instant per-instant 3
for name in covered encoded crane motor splines reactions networks oscillator supported cell; do model_file "$name" "$name"; done
cp tests/data/modelDescription-fmi*.xml examples/embedding/load/modelDescription.xml fuzz/corpus/model_description/
scripts/venv.sh
PYTHONPATH=tests/python .venv/bin/python -c 'import pathlib, graphs; [pathlib.Path(f"fuzz/corpus/onnx/{name}.onnx").write_bytes(m.SerializeToString()) for name, m in graphs.fitting()]'

for target in "${targets[@]}"; do
  # without sanitizers, which only a nightly compiler has: what is fuzzed is safe Rust, and a panic is a finding
  PATH="$PWD/target/tools/bin:$PATH" cargo fuzz run --sanitizer none "$target" -- \
    -max_total_time="$seconds" -max_len=65536 -timeout=10 -rss_limit_mb=2048 -print_final_stats=1
done
