#!/usr/bin/env bash
# Builds the library that goes into every FMU for other platforms than this one, into target/runtimes/TUPLE/.
# Usage: scripts/build-runtimes.sh [--only TUPLE]... [--std auto|rustup|source]
# docs/platforms.md says what it needs, where Rust's standard library comes from, and what the results require.
set -euo pipefail
cd "$(dirname "$0")/.."

name=build-runtimes
. scripts/cross.sh

only=() std=auto
while [ $# -gt 0 ]; do
  case $1 in
    --only) only+=("${2:?--only wants a TUPLE}"); shift 2 ;;
    --std) std=${2:?--std wants auto, rustup or source}; shift 2 ;;
    -h | --help) sed -n '2,4s/^# //p' "$0"; exit ;;
    *) fail "unknown argument $1, see --help" ;;
  esac
done
case $std in auto | rustup | source) ;; *) fail "--std is auto, rustup or source, not $std" ;; esac
if [ ${#only[@]} = 0 ]; then
  only=(x86_64-linux x86_64-windows aarch64-linux)
  # elsewhere only on request: Apple's SDK is not to be had freely
  if [ "$(uname -s)" = Darwin ]; then only+=(x86_64-darwin aarch64-darwin); fi
fi

# build TUPLE TARGET FILE COMMAND [LINK ARGUMENT]...
build() {
  local tuple=$1 target=$2 file=$3 command=$4 glibc='' from std_arguments built result
  shift 4
  cross "$target" "$@"
  if [ "$command" = zigbuild ] && [[ $target = *-linux-gnu ]]; then
    glibc=.$GLIBC
    # zig links its own static libunwind, no part of which can be replaced
    CARGO_ENCODED_RUSTFLAGS+=$'\x1f--cfg=static_unwinder'
  fi
  say "$tuple: $target$glibc with Rust $release and $from"
  $command --package fmu-template --profile fmu --locked --target-dir "$work/cargo" "${std_arguments[@]}" --target "$target$glibc" >&2
  built=$work/cargo/$target/fmu/$file
  result=target/runtimes/$tuple/$file
  mkdir -p "target/runtimes/$tuple"
  # an unchanged file keeps its time, or whoever embeds it would build again
  if ! cmp -s "$built" "$result"; then cp "$built" "$result"; fi
  say "$tuple: $result, $(wc -c <"$result" | tr -d ' ') bytes"
}

darwin() {
  # Apple's linker where there is one, else zig with the SDK that the user has
  if [ "$(uname -s)" = Darwin ]; then
    build "$1" "$2" libfmu_template.dylib "cargo build"
  else
    [ -d "${SDKROOT:-}" ] || fail "$1 needs a Mac, or SDKROOT with the folder of a macOS SDK"
    build "$1" "$2" libfmu_template.dylib zigbuild
  fi
}

# before anything is built
if [[ " ${only[*]} " = *" x86_64-windows "* ]]; then mingw; fi
for tuple in "${only[@]}"; do
  case $tuple in
    x86_64-linux) (build "$tuple" x86_64-unknown-linux-gnu libfmu_template.so zigbuild) ;;
    aarch64-linux) (build "$tuple" aarch64-unknown-linux-gnu libfmu_template.so zigbuild) ;;
    x86_64-windows) (build "$tuple" x86_64-pc-windows-gnu fmu_template.dll "cargo build" -Wl,--no-insert-timestamp) ;;
    x86_64-darwin) (darwin "$tuple" x86_64-apple-darwin) ;;
    aarch64-darwin) (darwin "$tuple" aarch64-apple-darwin) ;;
    *) fail "unknown platform $tuple: x86_64-linux, x86_64-windows, aarch64-linux, x86_64-darwin or aarch64-darwin" ;;
  esac
done
