#!/usr/bin/env bash
# Builds the FMU library for Linux and Windows, checks what each file asks of its system, and steps each of them: Windows
# under Wine, 64-bit ARM under QEMU. All outputs must be those of x86_64-linux to 1e-13.
# Installs what is missing with apt as root, else says what to install. Needs an x86_64 Linux.
set -euo pipefail
cd "$(dirname "$0")/.."

TUPLES=(x86_64-linux x86_64-windows aarch64-linux)
GLIBC=2.17
LINUX_LIBRARIES='ld-linux-x86-64\.so\.2|ld-linux-aarch64\.so\.1|lib(c|m|dl)\.so\.6|lib(pthread\.so\.0|dl\.so\.2|rt\.so\.1)'
WINDOWS_LIBRARIES='api-ms-win-core-synch-l1-2-0|bcryptprimitives|kernel32|msvcrt|ntdll'
# as the example writes it
TOKEN='{00000000-0000-0000-0000-000000000000}'

passed=0 failed=0
say() { printf 'test-platforms: %s\n' "$*" >&2; }
fail() { say "error: $*"; exit 1; }
# check WHAT FINDING: passes if there is nothing to complain about
check() {
  if [ -z "$2" ]; then passed=$((passed + 1)); say "ok: $1"; else failed=$((failed + 1)); say "FAILED: $1: $2"; fi
}

. scripts/emulators.sh
install_emulators

# --std source: the same bytes whatever the toolchain has, and nothing but packages is downloaded
for tuple in "${TUPLES[@]}"; do only+=(--only "$tuple"); done
scripts/build-runtimes.sh "${only[@]}" --std source

scratch=$(mktemp -d)
clean_up() {
  stop_wine
  rm -rf "$scratch" 2>/dev/null || true
}
trap clean_up EXIT

library() { # TUPLE
  case $1 in
    *-windows) echo "$PWD/target/runtimes/$1/fmu_template.dll" ;;
    *) echo "$PWD/target/runtimes/$1/libfmu_template.so" ;;
  esac
}

# ---- What the files ask for and offer -----------------------------------------------------------------------------

exports() { # TUPLE
  case $1 in
    *-windows) x86_64-w64-mingw32-objdump -p "$(library "$1")" | sed -n 's/^\t\[ *[0-9]*\] \(.*[^ ]\) *$/\1/p' | awk '!/^[+]base/ { print $NF }' ;;
    *) nm -D --defined-only "$(library "$1")" | awk '{ print $NF }' ;;
  esac | sort
}

for tuple in "${TUPLES[@]}"; do
  file=$(library "$tuple")
  exports "$tuple" >"$scratch/$tuple.exports"
  check "$tuple exports nothing but FMI functions" "$(grep -Ev '^fmi[23][A-Z][A-Za-z0-9]*$' "$scratch/$tuple.exports" || true)"
  [ "$tuple" = "${TUPLES[0]}" ] || check "$tuple exports what ${TUPLES[0]} does" "$(diff "$scratch/${TUPLES[0]}.exports" "$scratch/$tuple.exports")"
  check "$tuple exports FMI 2.0" "$(grep -qx fmi2DoStep "$scratch/$tuple.exports" || echo 'no fmi2DoStep')"
  case $tuple in
    *-windows)
      imports=$(x86_64-w64-mingw32-objdump -p "$file" | sed -n 's/^\tDLL Name: //p')
      check "$tuple imports only DLLs of Windows" "$(grep -Eivx "($WINDOWS_LIBRARIES)\.dll" <<<"$imports" || true)"
      ;;
    *)
      needed=$(objdump -p "$file" | awk '$1 == "NEEDED" { print $2 }')
      check "$tuple needs only libraries of glibc" "$(grep -Evx "$LINUX_LIBRARIES" <<<"$needed" || true)"
      newest=$(objdump -T "$file" | grep -oE 'GLIBC_[0-9.]+' | sed 's/GLIBC_//' | sort -uV | tail -n 1)
      check "$tuple runs from glibc $GLIBC on" "$(printf '%s\n' "$newest" "$GLIBC" | sort -CV || echo "glibc $newest")"
      ;;
  esac
  check "$tuple names no folder of the builder" "$(grep -aoFm 3 -e "$PWD" -e "${CARGO_HOME:-$HOME/.cargo}/" "$file" || true)"
done

# ---- What they compute --------------------------------------------------------------------------------------------

# a space and a sign that a URI escapes
model="$scratch/model #1"
mkdir "$model"
cargo run --quiet --release --locked --package metafmu-runtime --example model_file -- "$model/model.safetensors" 128 128 >/dev/null

zig=target/runtimes-build/zig/bin/python
options=(-std=c99 -O1 -Wall -Wextra -Werror -pedantic tests/platforms/step.c)
cc "${options[@]}" -ldl -o "$scratch/step-x86_64-linux"
x86_64-w64-mingw32-gcc "${options[@]}" -o "$scratch/step.exe"
ZIG_GLOBAL_CACHE_DIR=$PWD/target/runtimes-build/zig-cache \
  "$zig" -m ziglang cc -target "aarch64-linux-gnu.$GLIBC" "${options[@]}" -ldl -o "$scratch/step-aarch64-linux"
start_wine "$scratch"

step() { # TUPLE TOKEN
  local windows
  case $1 in
    x86_64-linux) "$scratch/step-$1" "$(library "$1")" "$model" "$2" ;;
    aarch64-linux) qemu-aarch64 -L /usr/aarch64-linux-gnu "$scratch/step-$1" "$(library "$1")" "$model" "$2" ;;
    x86_64-windows)
      windows="Z:$(library "$1")"
      "$(wine)" "$scratch/step.exe" "${windows//\//\\}" "Z:$model" "$2" | tr -d '\r'
      ;;
  esac
}

for tuple in "${TUPLES[@]}"; do
  out=$scratch/$tuple.txt
  if ! step "$tuple" "$TOKEN" >"$out" 2>"$scratch/errors"; then
    check "$tuple steps" "$(cat "$scratch/errors")."
    continue
  fi
  check "$tuple steps" "$([ "$(wc -l <"$out")" = 11 ] || echo "$(wc -l <"$out") lines")"
  if [ "$tuple" != "${TUPLES[0]}" ]; then
    worst=$(paste "$scratch/${TUPLES[0]}.txt" "$out" | awk '
      NF != 6 { bad = 1 }
      { for (i = 1; i <= 3; i++) { d = $i - $(i + 3); if (d < 0) d = -d; if (!(d <= worst)) worst = d } }
      END { if (bad || NR != 11) print "not comparable"; else printf "%g\n", worst }')
    check "$tuple computes what ${TUPLES[0]} does (greatest difference $worst)" \
      "$(awk -v worst="$worst" 'BEGIN { if (!(worst + 0 <= 1e-13) || worst !~ /^[0-9]/) print worst }')"
  fi
  # the logger is variadic: a calling convention of its own on some platforms
  if step "$tuple" '{wrong}' >/dev/null 2>"$scratch/errors"; then refused='not refused'; else refused=''; fi
  # shellcheck disable=SC2016 # the quotes are the message's
  grep -q 'status 3, logStatusError: .*`{wrong}`' "$scratch/errors" || refused=$(cat "$scratch/errors")
  check "$tuple refuses a wrong token through the logger" "$refused"
done

for tuple in "${TUPLES[@]}"; do say "$tuple: $(wc -c <"$(library "$tuple")") bytes, SHA-256 $(sha256sum <"$(library "$tuple")" | cut -c 1-16)"; done
echo "$passed passed, $failed failed"
[ "$failed" = 0 ]
