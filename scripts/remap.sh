# Sourced by the scripts that build what is given away: panic messages in programs do not have the builder's folders.
# remap ROOT SYSROOT COMMIT: sets `remapped`, options of rustc. Of the folders that fit, the last one counts.
remap() {
  remapped=("--remap-path-prefix=$1=metafmu" "--remap-path-prefix=${CARGO_HOME:-$HOME/.cargo}=cargo"
    "--remap-path-prefix=$2/lib/rustlib/src/rust=/rustc/$3")
}

# Exports them for cargo, unless flags are set already. With other flags than before, cargo compiles everything again.
export_remapped() {
  if [ -n "${CARGO_ENCODED_RUSTFLAGS:-}${RUSTFLAGS:-}" ]; then return; fi
  remap "$PWD" "$(rustc --print sysroot)" "$(rustc -vV | sed -n 's/^commit-hash: //p')"
  CARGO_ENCODED_RUSTFLAGS=$(IFS=$'\x1f'; echo "${remapped[*]}")
  export CARGO_ENCODED_RUSTFLAGS
}
