# Sourced by the scripts that build for other platforms than this one: where Rust's standard library for a target comes from, and what
# links. docs/platforms.md explains it. Sets `root`, `work` (a folder for everything intermediate) and `release` (of Rust).
# The caller has `name`, which begins its messages, and sets `std` to auto, rustup or source.

# another version of either makes other bytes
ZIG_PACKAGES=(cargo-zigbuild==0.24.0 ziglang==0.17.0)
GLIBC=2.17
# Debian suites that carry the newer releases of rust-src, the first that has this compiler's is taken
SUITES=(trixie-backports testing unstable)

. scripts/remap.sh
say() { printf '%s: %s\n' "$name" "$*" >&2; }
fail() { say "error: $*"; exit 1; }
need() { command -v "$1" >/dev/null || fail "$1 is missing: $2"; }

need cargo "install Rust"
need rustc "install Rust"
# what the caller's environment sets must not change the library
for variable in RUSTFLAGS CARGO_ENCODED_RUSTFLAGS CARGO_BUILD_RUSTFLAGS CARGO_BUILD_TARGET CARGO_TARGET_DIR \
  CARGO_BUILD_TARGET_DIR CARGO_BUILD_BUILD_DIR RUSTC RUSTC_WORKSPACE_WRAPPER CARGO_BUILD_RUSTC \
  CARGO_BUILD_RUSTC_WORKSPACE_WRAPPER RUSTC_BOOTSTRAP $(compgen -e CARGO_PROFILE_ || true); do
  unset "$variable"
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

# ---- What compiles and links --------------------------------------------------------------------------------------

# Installs zig, the C compiler that can link against a glibc of one's choice; it and what uses it come as Python packages.
zig() {
  local venv=$work/zig wanted="${ZIG_PACKAGES[*]}"
  if [ "$(cat "$venv/packages" 2>/dev/null)" != "$wanted" ]; then
    need python3 "zig comes as a Python package"
    say "Python packages $wanted"
    python3 -m venv --clear "$venv" >&2 || fail "python3 -m venv failed: install python3-venv"
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check "${ZIG_PACKAGES[@]}" >&2
    echo "$wanted" >"$venv/packages"
  fi
  PATH=$venv/bin:$PATH
  export CARGO_ZIGBUILD_CACHE_DIR=$work/zig-cache ZIG_GLOBAL_CACHE_DIR=$work/zig-cache
}
zigbuild() { (zig && exec cargo-zigbuild zigbuild "$@"); }


# What mingw-w64 needs.
mingw() {
  need x86_64-w64-mingw32-gcc "install mingw-w64 (Debian: gcc-mingw-w64-x86-64-win32)"
  # its dlltool splits them
  [[ $work != *[[:space:]]* ]] || fail "mingw-w64 takes no folder with a space: $work"
}

# cross TARGET [LINK ARGUMENT]...: sets `std_arguments`, options of cargo, and `from`, words for where the standard library is from, and
# exports what cargo is to see. To be called in a subshell: what one platform exports is not for the next.
cross() {
  local target=$1 overlay=$sysroot flags argument
  shift
  std_arguments=()
  if compiled_std "$target"; then
    from="the toolchain's compiled standard library"
  else
    source_std
    from="the standard library built from source"
    std_arguments=(-Z "build-std=std,panic_unwind")
    # a stable compiler builds its own standard library only so
    export RUSTC_BOOTSTRAP=1
    if [ "$overlay" != "$sysroot" ]; then export RUSTC=$overlay/rustc; fi
  fi
  remap "$root" "$overlay" "$commit"
  flags=("${remapped[@]}")
  for argument in "$@"; do flags+=("-Clink-arg=$argument"); done
  CARGO_ENCODED_RUSTFLAGS=$(IFS=$'\x1f'; echo "${flags[*]}")
  export CARGO_ENCODED_RUSTFLAGS
}
