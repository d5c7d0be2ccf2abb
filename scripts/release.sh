#!/usr/bin/env bash
# Makes what is given away, into dist/, and tries it: archives of the command, wheels, crates, a bill of materials, checksums.
# Usage: scripts/release.sh [--allow-dirty] [--only TUPLE]... [PART]...
#   libraries   the FMU's library for each platform, by scripts/build-runtimes.sh
#   archives    the command with licenses, completions and man pages, for each platform
#   wheels      the Python package, for each platform
#   crates      the Rust packages; that of the libraries holds them for each platform
#   sbom        the bill of materials
#   checksums   SHA-256 of all of them
#   try         installs and runs them: here, 64-bit ARM in QEMU, Windows in Wine
# Without PART all of them, in this order; with --only, archives and wheels for some platforms. docs/release.md says what it needs and what comes after.
set -euo pipefail
cd "$(dirname "$0")/.."

name=release
. scripts/cross.sh
# releases have the same bytes wherever they are made
std=source

MATURIN=maturin==1.16.0
TUPLES=(x86_64-linux aarch64-linux x86_64-windows)
declare -A TARGETS=([x86_64-linux]=x86_64-unknown-linux-gnu [aarch64-linux]=aarch64-unknown-linux-gnu [x86_64-windows]=x86_64-pc-windows-gnu)
PARTS=(libraries archives wheels crates sbom checksums try)
number=$(sed -n '/^\[workspace.package\]/,/^$/s/^version = "\(.*\)"/\1/p' Cargo.toml)
dist=$root/dist

clean=yes parts=() only=()
while [ $# -gt 0 ]; do
  case $1 in
    --allow-dirty) clean=no ;;
    --only) only+=("${2:?--only wants a TUPLE}"); shift ;;
    -h | --help) sed -n '2,11s/^# //p' "$0"; exit ;;
    *) [[ " ${PARTS[*]} " = *" $1 "* ]] || fail "unknown part $1, expected one of ${PARTS[*]}"; parts+=("$1") ;;
  esac
  shift
done
[ ${#parts[@]} != 0 ] || parts=("${PARTS[@]}")
[ ${#only[@]} != 0 ] || only=("${TUPLES[@]}")
for tuple in "${only[@]}"; do [ -n "${TARGETS[$tuple]:-}" ] || fail "unknown platform $tuple, expected one of ${TUPLES[*]}"; done

need git "the version that is released is a commit"
need python3 "zig and maturin come as Python packages"
need sha256sum "install coreutils"
# what takes minutes does not end with a word about what is missing
if [[ " ${parts[*]} ${only[*]} " =~ " "(libraries|try|x86_64-windows)" " ]]; then
  . scripts/emulators.sh
  install_emulators
fi
[ $clean = no ] || [ -z "$(git status --porcelain --untracked-files=no)" ] || fail "there are changes that are not committed (--allow-dirty)"
SOURCE_DATE_EPOCH=$(git log -1 --format=%ct)
export SOURCE_DATE_EPOCH
# what was built for all platforms goes into every program
export METAFMU_RUNTIMES=$root/target/runtimes
mkdir -p "$dist"

libraries() {
  local tuple options=()
  for tuple in "${TUPLES[@]}"; do options+=(--only "$tuple"); done
  scripts/build-runtimes.sh "${options[@]}" --std source
}

have_libraries() {
  local tuple
  for tuple in "${TUPLES[@]}"; do [ -d "target/runtimes/$tuple" ] || fail "no FMU library for $tuple: scripts/release.sh libraries"; done
  # others may lie there, too
  for tuple in target/runtimes/*; do
    [[ " ${TUPLES[*]} " = *" ${tuple##*/} "* ]] || fail "$tuple is no platform of releases: remove it"
  done
}

# compile TUPLE COMMAND...: runs a command of cargo or maturin that builds for a platform. All share a folder of intermediate files, and
# the settings that it depends on.
compile() {
  local tuple=$1 link=() std_arguments from
  shift
  if [ "$tuple" = x86_64-windows ]; then mingw; link=(-Wl,--no-insert-timestamp); fi
  (
    cross "${TARGETS[$tuple]}" "${link[@]}"
    export CARGO_PROFILE_RELEASE_STRIP=symbols
    say "$tuple: $1 with Rust $release and $from"
    "$@" "${std_arguments[@]}" >&2
  )
}

program() { # TUPLE
  case $1 in
    *-windows) echo "$work/cargo/${TARGETS[$1]}/release/metafmu.exe" ;;
    *) echo "$work/cargo/${TARGETS[$1]}/release/metafmu" ;;
  esac
}

# ---- Making ---------------------------------------------------------------------------------------------------------

archives() {
  local tuple target stage own
  have_libraries
  for tuple in "${only[@]}"; do
    target=${TARGETS[$tuple]}
    case $tuple in
      *-linux) compile "$tuple" zigbuild --release --locked --package metafmu --target-dir "$work/cargo" --target "$target.$GLIBC" ;;
      *) compile "$tuple" cargo build --release --locked --package metafmu --target-dir "$work/cargo" --target "$target" ;;
    esac
  done
  own=$(program x86_64-linux)
  [ -e "$own" ] || fail "completions and man pages come from the command for x86_64-linux: scripts/release.sh --only x86_64-linux archives"
  for tuple in "${only[@]}"; do
    stage=$work/stage/metafmu-$number-$tuple
    rm -rf "$stage"
    mkdir -p "$stage/completions"
    cp "$(program "$tuple")" README.md CHANGELOG.md LICENSE-APACHE LICENSE-MIT python/licenses/THIRD-PARTY.txt "$stage"
    "$own" completions bash >"$stage/completions/metafmu.bash"
    "$own" completions zsh >"$stage/completions/_metafmu"
    "$own" completions fish >"$stage/completions/metafmu.fish"
    "$own" completions powershell >"$stage/completions/metafmu.ps1"
    "$own" man "$stage/man/man1"
    pack "$stage"
  done
}

# pack FOLDER: the same files give the same bytes.
pack() {
  local folder=${1##*/} file
  find "$1" -exec touch --no-dereference --date "@$SOURCE_DATE_EPOCH" {} +
  case $folder in
    *-windows)
      file=$dist/$folder.zip
      rm -f "$file"
      (cd "$1/.." && TZ=UTC python3 - "$file" "$folder" <<'EOF'
import sys, zipfile
from pathlib import Path

with zipfile.ZipFile(sys.argv[1], "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
    for path in sorted(Path(sys.argv[2]).rglob("*")):
        if path.is_file():
            archive.write(path)
EOF
      ) ;;
    *)
      file=$dist/$folder.tar.gz
      tar -C "$1/.." --sort=name --owner=0 --group=0 --numeric-owner -c "$folder" | gzip -9n >"$file"
      ;;
  esac
  say "$file, $(wc -c <"$file") bytes"
}

maturin() {
  local venv=$work/maturin
  if [ "$(cat "$venv/packages" 2>/dev/null)" != "$MATURIN" ]; then
    say "Python package $MATURIN"
    python3 -m venv --clear "$venv" >&2 || fail "python3 -m venv failed: install python3-venv"
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check "$MATURIN" >&2
    echo "$MATURIN" >"$venv/packages"
  fi
  (zig && exec "$venv/bin/maturin" "$@")
}

wheels() {
  local tuple options
  have_libraries
  for tuple in "${only[@]}"; do
    mkdir -p "$work/sbom"
    python3 scripts/sbom.py --target "${TARGETS[$tuple]}" >"$work/sbom/metafmu.cdx.json"
    options=(build --release --locked --manifest-path python/Cargo.toml --target-dir "$work/cargo" --out "$dist" --target "${TARGETS[$tuple]}")
    options+=(--sbom-include "$work/sbom/metafmu.cdx.json")
    # 2014 is that of glibc 2.17
    if [[ $tuple = *-linux ]]; then options+=(--zig --compatibility manylinux2014); fi
    compile "$tuple" maturin "${options[@]}"
  done
}

crates() {
  local tuple prebuilt=fmu-template/embedded/prebuilt
  have_libraries
  rm -rf "$prebuilt" "$work/package"
  mkdir "$prebuilt"
  for tuple in "${TUPLES[@]}"; do cp -R "target/runtimes/$tuple" "$prebuilt/"; done
  # cargo takes the libraries, which are not in the repository, for changes; what packages hold is tried below
  cargo package --workspace --exclude metafmu-python --exclude metafmu-benches --exclude metafmu-example --exclude metafmu-testing --no-verify --locked --allow-dirty --target-dir "$work/package"
  rm -f "$dist"/*.crate
  cp "$work"/package/package/*.crate "$dist/"
}

sbom() {
  python3 scripts/sbom.py >"$dist/metafmu-$number.cdx.json"
}

checksums() {
  (cd "$dist" && rm -f SHA256SUMS && sha256sum -- * >"$work/SHA256SUMS" && mv "$work/SHA256SUMS" .)
  cat "$dist/SHA256SUMS"
}

# ---- Trying ---------------------------------------------------------------------------------------------------------

try() {
  local tuple options=()
  for tuple in "${only[@]}"; do options+=(--only "$tuple"); done
  scripts/try-release.sh "${options[@]}"
}

for part in "${parts[@]}"; do "$part"; done
