# Sourced by the scripts that run programs for other platforms: Windows in Wine, 64-bit ARM in QEMU. The caller has `say`, `fail` and
# `scratch`, a folder that is removed in the end.

# Prints the path of Wine for 64-bit programs.
wine() {
  local program
  for program in wine64 /usr/lib/wine/wine64 wine; do
    # only `wine` itself would find this function
    if program=$(type -P "$program"); then echo "$program"; return; fi
  done
  return 1
}

# Installs what is missing with apt as root, else says what to install.
install_emulators() {
  local missing=()
  type -P x86_64-w64-mingw32-gcc >/dev/null || missing+=(gcc-mingw-w64-x86-64-win32)
  wine >/dev/null || missing+=(wine64)
  type -P qemu-aarch64 >/dev/null || missing+=(qemu-user)
  [ -e /usr/aarch64-linux-gnu/lib/ld-linux-aarch64.so.1 ] || missing+=(libc6-arm64-cross)
  type -P objdump >/dev/null || missing+=(binutils)
  python3 -c 'import ensurepip, venv' 2>/dev/null || missing+=(python3-venv)
  [ ${#missing[@]} != 0 ] || return 0
  if [ "$(id -u)" != 0 ] || ! type -P apt-get >/dev/null; then fail "install ${missing[*]}"; fi
  say "installing ${missing[*]}"
  # others may be installing as well
  apt-get -qq -o DPkg::Lock::Timeout=300 update
  DEBIAN_FRONTEND=noninteractive apt-get -qq -o DPkg::Lock::Timeout=300 install -y --no-install-recommends "${missing[@]}" >/dev/null
}

# start_wine FOLDER: makes a Wine of its own, and what programs in FOLDER lack in old ones.
start_wine() {
  export WINEPREFIX=$scratch/wine WINEDEBUG=-all WINEDLLOVERRIDES='mscoree,mshtml='
  "$(wine)" wineboot --init >/dev/null 2>&1 || true
  if [ ! -e "$WINEPREFIX/drive_c/windows/system32/bcryptprimitives.dll" ]; then
    say "this Wine has no bcryptprimitives.dll, which every Windows since 10 has: using a stand-in"
    x86_64-w64-mingw32-gcc -shared -O1 -Wall tests/platforms/bcryptprimitives.c -ladvapi32 -o "$1/bcryptprimitives.dll"
  fi
}

# Ends what runs in the Wine of start_wine, and only that.
stop_wine() {
  local server
  [ -n "${WINEPREFIX:-}" ] || return 0
  for server in wineserver /usr/lib/wine/wineserver64; do
    if server=$(type -P "$server"); then "$server" -k 2>/dev/null || true; return 0; fi
  done
}
