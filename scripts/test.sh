#!/usr/bin/env bash
# Runs the tests: format, imports, words, lints, documentation, Rust tests, then the FMU in other people's tools.
# Usage: scripts/test.sh [--quick | --ci | --all] [OPTION OF PYTEST]...
#   --quick   format, imports, words, lints, Rust unit tests, and one small build whose FMU is checked by fmpy
#   --ci      also the Python package, the FMU's library with debug assertions, builds that are killed at random moments, the host fmi-sim,
#             which takes a minute to compile, hosts of the package registry, and other platforms
#   --all     also fuzzing, for which everything is compiled once more
# Needs cargo with rustfmt and clippy, a C compiler (cargo links with it), python3, Chromium, zsh, fish, and with --ci and --all libclang,
# Wine, QEMU and compilers for other platforms: as root what is missing is installed by apt. A missing tool is an error.
set -euo pipefail
cd "$(dirname "$0")/.."
root=$PWD

extent=default
case ${1:-} in
  -h | --help) sed -n '2,/^set /{/^#/s/^# \{0,1\}//p}' scripts/test.sh; exit ;;
  --quick | --ci | --all) extent=${1#--}; shift ;;
esac
for tool in cargo cc python3; do
  command -v "$tool" >/dev/null || { echo "scripts/test.sh: $tool is missing" >&2; exit 1; }
done
step() { printf '\n== %s, after %d s\n' "$*" $SECONDS >&2; }
# a test that hangs fails after minutes, and says where it was; after a crash nothing is waited for
pytest() { "$root/.venv/bin/python" -m pytest -p no:cacheprovider --timeout 900 --max-worker-restart 0 --durations 12 "$@"; }
# one worker more than CI has cores, as some tests wait, and each file's tests in one worker, because they share what the first of them builds
tests() { pytest -n 3 --dist loadfile --no-loadscope-reorder "$@" tests/python; }

if [ $extent = quick ]; then
  step "Python packages";   scripts/venv.sh
else
  # what is downloaded and installed, while the compiler is at work
  mkdir -p target
  # in a process group of its own, which ends with this script
  set -m
  (scripts/venv.sh && scripts/chromium.sh && scripts/shells.sh && { [ $extent = default ] || { scripts/venv.sh --hosts && scripts/fmi-sim.sh; }; }) >target/set-up.log 2>&1 &
  set_up=$!
  set +m
  trap 'kill -- -$set_up 2>/dev/null || true' EXIT
fi

# the unit tests of the core, and of the crates of the tool, are optimized less, to compile sooner; what they link below, and what all other
# tests run, is as released: no crate that is tested in the first line depends on the core
unit_tests() {
  local quick=profile.release.package
  local tool=(metafmu metafmu-source metafmu-surrogate metafmu-report metafmu-export) above_core=(metafmu-baselines)
  cargo test --workspace $(printf -- '--exclude %s ' "${tool[@]}" "${above_core[@]}" metafmu-python metafmu-testing) --lib --release --locked \
    --config $quick.metafmu-core.opt-level=1 --config $quick.metafmu-core.codegen-units=16
  cargo test $(printf -- '--package %s ' "${tool[@]}" "${above_core[@]}") --lib --release --locked \
    $(printf -- "--config $quick.%s.opt-level=0 " "${tool[@]}")
}
# with the interpreter of the tests; models of PyTorch are left out, which is gigabytes
python_package() {
  rm -rf target/wheels
  scripts/wheel.sh --quiet
  .venv/bin/python -m pip install --quiet --disable-pip-version-check --force-reinstall --no-deps target/wheels/*.whl
  (cd python/tests && pytest -n 2 --dist load --no-skips --ignore test_torch.py -k "not torch")
}
lints() { step "lints"; cargo clippy --workspace --all-targets --release --locked -- -D warnings; }

# everything is compiled as the wheel is, and so once
if [ $extent = ci ] || [ $extent = all ]; then
  . scripts/remap.sh
  export_remapped
fi
step "format";              cargo fmt --all --check
step "imports";             python3 scripts/check-imports.py
step "words";               python3 scripts/check-words.py
if [ $extent = quick ]; then
  step "Rust unit tests";   unit_tests
  step "command";           cargo build --release --locked
  lints
  step "one build in fmpy"; tests -m quick -n 0 "$@"
  exit
fi
# with the examples, which the Python tests run; before the lints, as the FMU's library, which a build script compiles on one core, then
# is built beside the dependencies
step "command";             cargo build --release --locked --package metafmu --package metafmu-runtime --bins --examples
step "Rust unit tests";     unit_tests
step "other Rust tests";    cargo test --package metafmu --bins --test '*' --release --locked
step "examples in docs";    cargo test --workspace --doc --release --locked
lints
step "documentation";       RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --release --locked --quiet
step "set-up";              wait $set_up || { cat target/set-up.log >&2; exit 1; }
trap - EXIT
step "Python tests";        tests -m "not thorough" "$@"
if [ $extent = ci ] || [ $extent = all ]; then
  step "Python package";    python_package
  step "debug assertions";  cargo test --package metafmu-runtime --package fmu-template --locked
  step "kills, more hosts"; tests -m thorough "$@"
  step "other platforms";   scripts/test-platforms.sh
fi
if [ $extent = all ]; then
  step "fuzzing";           scripts/fuzz.sh
fi
