#!/usr/bin/env bash
# Tries what scripts/release.sh made in dist/: installs and runs it where there is neither cargo nor a C compiler, 64-bit ARM in QEMU,
# Windows in Wine, and builds the crates outside the repository. Prints sizes and times.
# Usage: scripts/try-release.sh [--only TUPLE]... [archives | wheels | crates]...
# docs/release.md says what is tried and what is not. Needs an x86_64 Linux with Debian's packages.
set -euo pipefail
cd "$(dirname "$0")/.."

name=try-release
. scripts/cross.sh
. scripts/emulators.sh
number=$(sed -n '/^\[workspace.package\]/,/^$/s/^version = "\(.*\)"/\1/p' Cargo.toml)
dist=$root/dist
TUPLES=(x86_64-linux aarch64-linux x86_64-windows)
# Debian's Python for 64-bit ARM: the suite, its version, and the packages with what it needs
SUITE=bookworm
PYTHON=3.11
ARM_PACKAGES=(python3.11-minimal libpython3.11-minimal libpython3.11-stdlib libc6 zlib1g libexpat1 libstdc++6 libgcc-s1 libffi8
  libbz2-1.0 liblzma5 libssl3 libuuid1)

parts=() only=()
while [ $# -gt 0 ]; do
  case $1 in
    --only) only+=("${2:?--only wants a TUPLE}"); shift ;;
    *) parts+=("$1") ;;
  esac
  shift
done
[ ${#only[@]} != 0 ] || only=("${TUPLES[@]}")
# x86_64-linux is what the others are compared with
[[ " ${only[*]} " = *" x86_64-linux "* ]] || only=(x86_64-linux "${only[@]}")
has() { [[ " ${only[*]} " = *" $1 "* ]]; }
[ ${#parts[@]} != 0 ] || parts=(archives wheels crates)
for part in "${parts[@]}"; do [[ $part =~ ^(archives|wheels|crates)$ ]] || fail "unknown part $part, expected archives, wheels or crates"; done
install_emulators

scratch=$(mktemp -d)
clean_up() {
  stop_wine
  rm -rf "$scratch" 2>/dev/null || true
}
trap clean_up EXIT

passed=0 failed=0
# check WHAT FINDING: passes if there is nothing to complain about
check() {
  if [ -z "$2" ]; then passed=$((passed + 1)); say "ok: $1"; else failed=$((failed + 1)); say "FAILED: $1: $2"; fi
}
# attempt WHAT COMMAND...: passes if the command succeeds
attempt() {
  local what=$1
  shift
  if "$@" >"$scratch/output" 2>&1; then check "$what" ''; else check "$what" "$(tail -n 20 "$scratch/output")"; return 1; fi
}
# alone PATH COMMAND...: runs a command that finds only programs in PATH, and no setting of ours
alone() { env -i "PATH=$1" "HOME=$scratch" LANG=C.UTF-8 "${@:2}"; }
seconds() { awk -v from="$1" -v to="$EPOCHREALTIME" 'BEGIN { printf "%.1f", to - from }'; }

cat >"$scratch/study.toml" <<'E2'
name = "pendulum"
source = { system = "single-pendulum", constants = { m = 0.3, g = 9.81, theta0 = 1.5, c = 0.1, thetad0 = 0.0 } }
time = { stop = 0.5, step = 0.05 }
parameters.L = { min = 0.1, max = 0.2, unit = "m" }
outputs.theta = { unit = "rad" }
sampling = { method = "mesh", levels = 9, test_runs = 4 }
network = { hidden = [16, 16] }
training = { epochs = 200, batch = 16, learning_rate = 0.01 }
E2
printf 'L,time\n0.12,0.1\n0.15,0.2\n0.19,0.45\n' >"$scratch/designs.csv"

# Complains of an FMU that has not a library for each platform.
platforms() { # FMU
  python3 - "$1" <<'E2'
import sys, zipfile
names = zipfile.ZipFile(sys.argv[1]).namelist()
for folder in ["linux64/", "win64/", "aarch64-linux/"]:
    if not any(name.startswith("binaries/" + folder) for name in names):
        print(f"no binaries/{folder}")
E2
}

# Complains of a library of Linux that asks for more than manylinux2014 has, or of Windows for more than Windows has.
requirements() { # TUPLE FILE
  local tool=objdump system
  case $1 in
    *-windows)
      system='advapi32|api-ms-win-core-synch-l1-2-0|bcrypt|bcryptprimitives|kernel32|msvcrt|ntdll|ole32|oleaut32|psapi|python3|shell32|user32|userenv|ws2_32'
      x86_64-w64-mingw32-objdump -p "$2" | sed -n 's/^\tDLL Name: //p' | grep -Eivx "($system)\.dll" || true
      ;;
    *)
      system='ld-linux-x86-64\.so\.2|ld-linux-aarch64\.so\.1|lib(c|m)\.so\.6|lib(pthread\.so\.0|dl\.so\.2|rt\.so\.1|gcc_s\.so\.1|util\.so\.1)'
      "$tool" -p "$2" | awk '$1 == "NEEDED" { print $2 }' | grep -Evx "$system" || true
      "$tool" -T "$2" | grep -oE 'GLIBC_[0-9.]+' | sed 's/GLIBC_//' | sort -uV | tail -n 1 |
        awk -v limit="$GLIBC" '{ split($1, a, "."); split(limit, b, "."); if (a[1] > b[1] || a[1] == b[1] && a[2] + 0 > b[2] + 0) print "glibc " $1 }'
      ;;
  esac
}

# ---- The archives ---------------------------------------------------------------------------------------------------

# Greatest difference of the numbers in two tables.
difference() {
  paste -d, "$1" "$2" | tr -d '\r' | awk -F, '
    NR > 1 { for (i = 1; i <= NF / 2; i++) if ($i ~ /^[-0-9.e]+$/) { d = $i - $(i + NF / 2); if (d < 0) d = -d; if (d > worst) worst = d; n++ } }
    END { if (n < 6) print "not comparable"; else printf "%g\n", worst }'
}
agree() { # WHAT FILE
  local worst
  worst=$(difference "$scratch/predictions.csv" "$2")
  check "$1 predicts what x86_64-linux does (greatest difference $worst)" \
    "$(awk -v worst="$worst" 'BEGIN { if (!(worst + 0 <= 1e-6) || worst !~ /^[0-9]/) print worst }')"
}

archives() {
  local tuple folder program
  attempt "checksums" env -C "$dist" sha256sum --check --quiet SHA256SUMS || true
  for tuple in "${only[@]}"; do
    folder=$scratch/metafmu-$number-$tuple
    case $tuple in
      *-windows) python3 -m zipfile -e "$dist/metafmu-$number-$tuple.zip" "$scratch"; program=$folder/metafmu.exe ;;
      *) tar -xzf "$dist/metafmu-$number-$tuple.tar.gz" -C "$scratch"; program=$folder/metafmu ;;
    esac
    check "$tuple needs nothing but the system" "$(requirements "$tuple" "$program")"
    check "$tuple names no folder of the builder" "$(grep -aoFm 3 -e "$PWD" -e "${CARGO_HOME:-$HOME/.cargo}/" "$program" || true)"
  done
  cd "$scratch"
  folder=$scratch/metafmu-$number
  attempt "x86_64-linux builds" alone /nonexistent "$folder-x86_64-linux/metafmu" build study.toml || return 0
  check "x86_64-linux exports for every platform" "$(platforms out/pendulum/pendulum.fmu)"
  alone /nonexistent "$folder-x86_64-linux/metafmu" predict out/pendulum/pendulum.fmu designs.csv >predictions.csv
  if has aarch64-linux; then archive_of_arm "$folder-aarch64-linux"; fi
  if has x86_64-windows; then archive_of_windows "$folder-x86_64-windows"; fi
  cd "$root"
}

archive_of_arm() { # FOLDER
  # worker processes, which run FMUs, would need QEMU in the kernel: what is tried needs none
  local arm=(qemu-aarch64 -L /usr/aarch64-linux-gnu "$1/metafmu")
  attempt "aarch64-linux samples" "${arm[@]}" sample study.toml --out arm || true
  attempt "aarch64-linux trains" "${arm[@]}" train study.toml --out arm || true
  attempt "aarch64-linux exports" "${arm[@]}" export study.toml --out arm || return 0
  check "aarch64-linux exports for every platform" "$(platforms arm/pendulum.fmu)"
  "${arm[@]}" predict out/pendulum/pendulum.fmu designs.csv >arm.csv || true
  agree aarch64-linux arm.csv
}

archive_of_windows() { # FOLDER
  local windows
  cd "$root"
  start_wine "$1"
  cd "$scratch"
  windows=("$(wine)" "$1/metafmu.exe")
  attempt "x86_64-windows builds and validates" "${windows[@]}" build study.toml --out windows || return 0
  check "x86_64-windows exports for every platform" "$(platforms windows/pendulum.fmu)"
  "${windows[@]}" predict out/pendulum/pendulum.fmu designs.csv >windows.csv || true
  agree x86_64-windows windows.csv
}

# ---- The wheels -----------------------------------------------------------------------------------------------------

cat >"$scratch/first.py" <<'E2'
"""The first thing that one does: an FMU of a fitted model, here y = 2 a - b."""
import sys, time

import metafmu

begin = time.perf_counter()
graph = metafmu.Graph(2)
surrogate = graph.finish(graph.affine(0, [[2.0, -1.0]], [0.0]), inputs={"a": (0, 1), "b": (0, 1)}, outputs=["y"])
assert abs(surrogate.predict([[0.5, 0.25]])[0, 0] - 0.75) < 1e-12
surrogate.export(sys.argv[1], fmi="both")
print(f"{time.perf_counter() - begin:.3f} s for an FMU of each version")
E2

# Unpacks Debian's Python for 64-bit ARM. apt works on lists of its own, and nothing is installed.
arm_python() {
  local folder=$work/arm64 mirror apt options package
  if [ ! -e "$folder/complete" ]; then
    need apt-get "Python for 64-bit ARM comes as Debian packages"
    rm -rf "$folder"
    apt=$folder/apt
    mkdir -p "$apt/lists/partial" "$apt/cache/archives/partial"
    # shellcheck disable=SC2016 # apt expands these
    mirror=$(apt-get indextargets --format '$(LABEL) $(REPO_URI)' 'Created-By: Packages' | sed -n '/^Debian /{s///p;q}')
    [ -n "$mirror" ] || fail "apt has no Debian mirror, or no lists (apt-get update): cannot get Python for 64-bit ARM"
    printf 'deb [signed-by=/usr/share/keyrings/debian-archive-keyring.gpg] %s %s main\n' "$mirror" "$SUITE" >"$apt/sources.list"
    options=(-q -o "Dir::Etc::sourcelist=$apt/sources.list" -o Dir::Etc::sourceparts=- -o "Dir::State::lists=$apt/lists"
      -o Dir::State::status=/dev/null -o "Dir::Cache=$apt/cache" -o APT::Architecture=arm64 -o APT::Architectures=arm64
      -o APT::Sandbox::User= -o Dpkg::Use-Pty=0)
    (cd "$apt" && apt-get "${options[@]}" update && apt-get "${options[@]}" download "${ARM_PACKAGES[@]}") >"$folder/log" 2>&1 ||
      fail "$(tail -n 5 "$folder/log")"
    for package in "$apt"/*.deb; do dpkg-deb -x "$package" "$folder"; done
    rm -rf "$apt"
    touch "$folder/complete"
  fi
  arm=(qemu-aarch64 -L "$folder" "$folder/usr/bin/python$PYTHON")
}

# Prints the wheel of a platform.
wheel_of() { # TUPLE
  local file tag
  case $1 in
    x86_64-linux) tag="manylinux*x86_64" ;;
    aarch64-linux) tag="manylinux*aarch64" ;;
    x86_64-windows) tag=win_amd64 ;;
  esac
  # shellcheck disable=SC2086 # a pattern
  file=$(ls "$dist"/metafmu-"$number"-*$tag.whl 2>/dev/null) || fail "no wheel for $1: scripts/release.sh wheels"
  echo "$file"
}

# Complains of a wheel without our licenses or those of its packages.
lacks_licenses() { # FOLDER
  local file
  for file in python/licenses/*; do
    cmp -s "$file" "$(find "$1" -name "${file##*/}")" || echo "no ${file##*/}"
  done
}

wheels() {
  local venv=$scratch/venv tuple wheel begin
  for tuple in "${only[@]}"; do
    wheel=$(wheel_of "$tuple")
    rm -rf "$scratch/wheel-files"
    python3 -m zipfile -e "$wheel" "$scratch/wheel-files"
    check "the wheel of $tuple needs nothing but the system" "$(requirements "$tuple" "$scratch"/wheel-files/metafmu/_metafmu.*)"
    check "the wheel of $tuple names no folder of the builder" \
      "$(grep -aoFm 3 -e "$PWD" -e "${CARGO_HOME:-$HOME/.cargo}/" "$scratch"/wheel-files/metafmu/_metafmu.* || true)"
    check "the wheel of $tuple has licenses" "$(lacks_licenses "$scratch"/wheel-files/metafmu-*.dist-info)"
  done

  wheel=$(wheel_of x86_64-linux)
  begin=$EPOCHREALTIME
  python3 -m venv "$venv"
  say "virtual environment after $(seconds "$begin") s"
  begin=$EPOCHREALTIME
  attempt "pip installs without cargo and C compiler" env "PATH=$venv/bin" "$venv/bin/pip" install --no-cache-dir --only-binary :all: "$wheel" || return 0
  say "installed after $(seconds "$begin") s"
  attempt "Python makes an FMU" alone "$venv/bin" "$venv/bin/python" "$scratch/first.py" "$scratch/first.fmu" || return 0
  say "first FMU after $(seconds "$begin") s; $(cat "$scratch/output")"
  check "Python exports for every platform" "$(platforms "$scratch/first.fmu")"
  attempt "its FMU is valid" alone "$venv/bin" "$venv/bin/metafmu" validate "$scratch/first.fmu" || true
  begin=$EPOCHREALTIME
  attempt "the wheel's command builds" alone "$venv/bin" "$venv/bin/metafmu" build "$scratch/study.toml" --out "$scratch/wheel" || return 0
  say "study built in $(seconds "$begin") s"
  check "the wheel's command exports for every platform" "$(platforms "$scratch/wheel/pendulum.fmu")"
  if has aarch64-linux; then wheel_of_arm; fi
}

wheel_of_arm() {
  local arm wheel packages=$scratch/arm-packages
  arm_python
  python3 -m pip download --quiet --no-deps --only-binary :all: --platform manylinux2014_aarch64 --python-version $PYTHON --dest "$packages" numpy
  for wheel in "$packages"/*.whl "$(wheel_of aarch64-linux)"; do python3 -m zipfile -e "$wheel" "$packages"; done
  attempt "aarch64-linux: Python makes an FMU" env "PYTHONPATH=$packages" "${arm[@]}" "$scratch/first.py" "$scratch/arm-first.fmu" || return 0
  check "aarch64-linux: Python exports for every platform" "$(platforms "$scratch/arm-first.fmu")"
  attempt "the FMU of aarch64-linux is valid" alone "$scratch/venv/bin" "$scratch/venv/bin/metafmu" validate "$scratch/arm-first.fmu" || true
}

# ---- The crates -----------------------------------------------------------------------------------------------------

crates() {
  local crate package patches=() folder=$scratch/crates target=${METAFMU_TRY_TARGET:-$scratch/crates-target}
  mkdir "$folder"
  for crate in "$dist"/*.crate; do
    tar -xzf "$crate" -C "$folder"
    package=$(basename "$crate" "-$number.crate")
    patches+=(--config "patch.crates-io.$package.path='$folder/$package-$number'")
  done
  # as from a registry, where each finds the others
  attempt "cargo installs the crates outside the repository" env -C "$folder" -u METAFMU_RUNTIMES \
    cargo install --path "metafmu-$number" --root "$scratch/installed" --target-dir "$target" "${patches[@]}" || return 0
  check "nothing was built by a cargo within cargo" "$([ ! -e "$target/fmu-library" ] || echo "$target/fmu-library")"
  attempt "the installed command builds" alone /nonexistent "$scratch/installed/bin/metafmu" build "$scratch/study.toml" --out "$scratch/installed/out" || true
  check "the installed command exports for every platform" "$(platforms "$scratch/installed/out/pendulum.fmu")"
}

for part in "${parts[@]}"; do "$part"; done
(cd "$dist" && wc -c -- *) | sed '$d' >&2
echo "$passed passed, $failed failed"
[ "$failed" = 0 ]
