#!/usr/bin/env bash
# Builds the library that goes into every FMU for other platforms than this one, into target/runtimes/TUPLE/.
# Usage: scripts/build-runtimes.sh [--only TUPLE]... [--std auto|rustup|source]
# docs/platforms.md says what it needs, where Rust's standard library comes from, and what the results require.
set -euo pipefail
cd "$(dirname "$0")/.."

# another version of either makes other bytes
ZIG_PACKAGES=(cargo-zigbuild==0.24.0 ziglang==0.17.0)
GLIBC=2.17
# Debian suites that carry the newer releases of rust-src, the first that has this compiler's is taken
SUITES=(trixie-backports testing unstable)

say() { printf 'build-runtimes: %s\n' "$*" >&2; }
fail() { say "error: $*"; exit 1; }
need() { command -v "$1" >/dev/null || fail "$1 is missing: $2"; }

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

need cargo "install Rust"
need rustc "install Rust"
# what the caller's environment sets must not change the library
for name in RUSTFLAGS CARGO_ENCODED_RUSTFLAGS CARGO_BUILD_RUSTFLAGS CARGO_BUILD_TARGET CARGO_TARGET_DIR \
  CARGO_BUILD_TARGET_DIR CARGO_BUILD_BUILD_DIR RUSTC RUSTC_WORKSPACE_WRAPPER CARGO_BUILD_RUSTC \
  CARGO_BUILD_RUSTC_WORKSPACE_WRAPPER RUSTC_BOOTSTRAP $(compgen -e CARGO_PROFILE_ || true); do
  unset "$name"
done

root=$PWD
work=$root/target/runtimes-build
sysroot=$(rustc --print sysroot)
version=$(rustc -vV)
release=$(sed -n 's/^release: //p' <<<"$version")
commit=$(sed -n 's/^commit-hash: //p' <<<"$version")
mkdir -p "$work"

# ---- Rust's standard library --------------------------------------------------------------------------------------

# Succeeds if the toolchain has, or now gets, the compiled standard library of a target.
compiled_std() {
  local target=$1
  if [ -d "$sysroot/lib/rustlib/$target/lib" ]; then return 0; fi
  if [ "$std" = source ]; then return 1; fi
  # with this setting rustup was told to download nothing unasked
  if [ "$std" = auto ] && [ "${RUSTUP_AUTO_INSTALL:-1}" = 0 ]; then return 1; fi
  if command -v rustup >/dev/null && [ "$(rustup which rustc)" -ef "$sysroot/bin/rustc" ]; then
    say "rustup target add $target"
    if rustup target add "$target" >&2; then return 0; fi
  fi
  [ "$std" = auto ] || fail "rustup cannot add $target"
  return 1
}

# Sets `overlay` to a sysroot that has the standard library's source: the toolchain itself, or a folder of links beside
# the source, which leaves the toolchain as it is.
source_std() {
  local package
  if [ -f "$sysroot/lib/rustlib/src/rust/library/Cargo.lock" ]; then overlay=$sysroot; return; fi
  overlay=$work/rust-$release
  if [ -f "$overlay/complete" ]; then return; fi
  rm -rf "$overlay"
  mkdir -p "$overlay/lib/rustlib/src/rust"
  ln -s "$sysroot"/lib/rustlib/*-*-* "$overlay/lib/rustlib/"
  printf '#!/bin/sh\nexec "%s" --sysroot "%s" "$@"\n' "$sysroot/bin/rustc" "$overlay" >"$overlay/rustc"
  chmod +x "$overlay/rustc"
  if [ -f "/usr/src/rustc-$release/library/Cargo.lock" ]; then
    say "source of Rust's standard library: /usr/src/rustc-$release"
    cp -R "/usr/src/rustc-$release/library" "$overlay/lib/rustlib/src/rust/"
  else
    debian_source "$overlay"
  fi
  touch "$overlay/complete"
}

# Unpacks the library's source from the Debian package of this very release. apt works on lists of its own in a folder
# that is thrown away: neither the system's sources nor its packages change, and root is not needed.
debian_source() {
  local overlay=$1 suite mirror found='' apt=$work/apt options package
  need apt-get "the source of Rust $release is neither in the toolchain nor a Debian package here: rustup component add rust-src"
  need dpkg-deb "install dpkg"
  # shellcheck disable=SC2016 # apt expands these
  mirror=$(apt-get indextargets --format '$(LABEL) $(REPO_URI)' 'Created-By: Packages' | sed -n '/^Debian /{s///p;q}')
  [ -n "$mirror" ] || fail "apt has no Debian mirror, or no lists (apt-get update): cannot get rust-src $release"
  for suite in "${SUITES[@]}"; do
    rm -rf "$apt"
    mkdir -p "$apt/lists/partial" "$apt/cache/archives/partial"
    printf 'deb [signed-by=/usr/share/keyrings/debian-archive-keyring.gpg] %s %s main\n' "$mirror" "$suite" >"$apt/sources.list"
    options=(-q -o "Dir::Etc::sourcelist=$apt/sources.list" -o Dir::Etc::sourceparts=- -o "Dir::State::lists=$apt/lists"
      -o "Dir::Cache=$apt/cache" -o APT::Sandbox::User= -o Dpkg::Use-Pty=0)
    if ! apt-get "${options[@]}" update >"$apt/log" 2>&1; then
      say "suite $suite cannot be read: $(grep -m 1 '^[EW]:' "$apt/log" || true)"
      continue
    fi
    found=$(apt-cache "${options[@]}" madison rust-src | awk -v want="$release" '$3 ~ "^" want "[+-]" { print $3; exit }')
    if [ -n "$found" ]; then break; fi
  done
  [ -n "$found" ] || fail "no rust-src $release in Debian's ${SUITES[*]}: rustup component add rust-src, or use a Rust they have"
  say "source of Rust's standard library: Debian package rust-src $found from $suite"
  (cd "$apt" && apt-get "${options[@]}" download "rust-src=$found" >>"$apt/log" 2>&1) || fail "$(cat "$apt/log")"
  package=("$apt"/rust-src_*.deb)
  dpkg-deb --fsys-tarfile "${package[0]}" |
    tar -x -C "$overlay/lib/rustlib/src/rust" --strip-components=4 "./usr/src/rustc-$release/library"
  rm -rf "$apt"
}

# ---- Building -----------------------------------------------------------------------------------------------------

# Zig is the C compiler that can link against a glibc of one's choice; both come as Python packages.
zigbuild() {
  local venv=$work/zig wanted="${ZIG_PACKAGES[*]}"
  if [ "$(cat "$venv/packages" 2>/dev/null)" != "$wanted" ]; then
    need python3 "zig comes as a Python package"
    say "Python packages $wanted"
    python3 -m venv --clear "$venv" >&2 || fail "python3 -m venv failed: install python3-venv"
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check "${ZIG_PACKAGES[@]}" >&2
    echo "$wanted" >"$venv/packages"
  fi
  PATH=$venv/bin:$PATH CARGO_ZIGBUILD_CACHE_DIR=$work/zig-cache ZIG_GLOBAL_CACHE_DIR=$work/zig-cache \
    cargo-zigbuild zigbuild "$@"
}

# build TUPLE TARGET FILE COMMAND [LINK ARGUMENT]...
build() {
  local tuple=$1 target=$2 file=$3 command=$4 overlay=$sysroot arguments flags argument glibc='' from built result
  shift 4
  arguments=(--package fmu-template --profile fmu --locked --target-dir "$work/cargo")
  if compiled_std "$target"; then
    from="the toolchain's compiled standard library"
  else
    source_std
    from="the standard library built from source"
    arguments+=(-Z "build-std=std,panic_unwind")
    # a stable compiler builds its own standard library only so
    export RUSTC_BOOTSTRAP=1
    if [ "$overlay" != "$sysroot" ]; then export RUSTC=$overlay/rustc; fi
  fi
  # the builder's folders do not appear in panic messages; the last that fits counts
  flags=("--remap-path-prefix=$root=metafmu" "--remap-path-prefix=${CARGO_HOME:-$HOME/.cargo}=cargo"
    "--remap-path-prefix=$overlay/lib/rustlib/src/rust=/rustc/$commit")
  for argument in "$@"; do flags+=("-Clink-arg=$argument"); done
  CARGO_ENCODED_RUSTFLAGS=$(IFS=$'\x1f'; echo "${flags[*]}")
  export CARGO_ENCODED_RUSTFLAGS

  if [ "$command" = zigbuild ] && [[ $target = *-linux-gnu ]]; then glibc=.$GLIBC; fi
  say "$tuple: $target$glibc with Rust $release and $from"
  $command "${arguments[@]}" --target "$target$glibc" >&2
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

for tuple in "${only[@]}"; do
  # in a subshell: what one platform exports is not for the next
  case $tuple in
    x86_64-linux) (build "$tuple" x86_64-unknown-linux-gnu libfmu_template.so zigbuild) ;;
    aarch64-linux) (build "$tuple" aarch64-unknown-linux-gnu libfmu_template.so zigbuild) ;;
    x86_64-windows)
      need x86_64-w64-mingw32-gcc "install mingw-w64 (Debian: gcc-mingw-w64-x86-64-win32)"
      # its dlltool splits them
      [[ $work != *[[:space:]]* ]] || fail "mingw-w64 takes no folder with a space: $work"
      (build "$tuple" x86_64-pc-windows-gnu fmu_template.dll "cargo build" -Wl,--no-insert-timestamp)
      ;;
    x86_64-darwin) (darwin "$tuple" x86_64-apple-darwin) ;;
    aarch64-darwin) (darwin "$tuple" aarch64-apple-darwin) ;;
    *) fail "unknown platform $tuple: x86_64-linux, x86_64-windows, aarch64-linux, x86_64-darwin or aarch64-darwin" ;;
  esac
done
