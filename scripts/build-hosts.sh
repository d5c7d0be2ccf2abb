#!/usr/bin/env bash
# Builds three hosts of FMUs that no package registry has: PyFMI, OMSimulator and fmusim. Not for CI: call it by hand, then run FMUs in them.
#
#     scripts/build-hosts.sh [FOLDER [pyfmi] [omsimulator] [fmusim]]
#     cargo run --release --example kinds -- FMUS
#     HOSTS_FOLDER=FOLDER FOLDER/pyfmi/bin/python tests/hosts/built.py FMUS
#
# FOLDER is target/hosts by default; without names it builds all three. A host that was built from the same commits is left alone. JOBS compilers run
# at a time, 2 by default.
#
# Sources are cloned at the commits below. To take them from a folder instead, for example without a network, set one of
#     PYFMI_SOURCE ASSIMULO_SOURCE FMI_LIBRARY_SOURCE
#     OMSIMULATOR_SOURCE OMSIMULATOR_3RDPARTY_SOURCE
#     FMUSIM_SOURCE FMI_RS_SOURCE SUNDIALS_SOURCE LIBXML2_SOURCE
# to a checkout; it is copied, not changed. Python packages come from PyPI, crates from crates.io, and the SUNDIALS of Assimulo from SUNDIALS_HOME,
# which is /usr by default (Debian's libsundials-dev). Tried with Python 3.11 and Debian 12; it takes 2 GB.
set -euo pipefail

folder=${1:-$(dirname "$0")/../target/hosts}
shift || true
hosts=("$@")
if [ $# = 0 ]; then hosts=(pyfmi omsimulator fmusim); fi
for host in "${hosts[@]}"; do
  case $host in
    pyfmi | omsimulator | fmusim) ;;
    *) echo "usage: scripts/build-hosts.sh [FOLDER [pyfmi] [omsimulator] [fmusim]]" >&2 && exit 1 ;;
  esac
done
jobs=${JOBS:-2}
sundials_home=${SUNDIALS_HOME:-/usr}

# by the name of the variable with the folder, without _SOURCE
declare -A repository=(
  [PYFMI]=modelon-community/PyFMI
  [ASSIMULO]=modelon-community/Assimulo
  [FMI_LIBRARY]=modelon-community/fmi-library
  [OMSIMULATOR]=OpenModelica/OMSimulator
  [OMSIMULATOR_3RDPARTY]=OpenModelica/OMSimulator-3rdParty
  [FMUSIM]=modelica/fmusim
  [FMI_RS]=CATIA-Systems/fmi-rs
  [SUNDIALS]=LLNL/sundials
  [LIBXML2]=GNOME/libxml2
)
declare -A commit=(
  [PYFMI]=b704ebd099f4cd988fd2c6845808528498f2de1d # April 2026, 3.0-dev
  [ASSIMULO]=a08af61a91db0086bf086103600338b8cd00591e # 3.8.0
  [FMI_LIBRARY]=1599ab1e61eeb224db307a0d8893ee284168beff # July 2026
  # the last one whose submodule is the commit below
  [OMSIMULATOR]=acb56d9d9c8ecbe4408fcee0f2a548daf3d7573b # November 2025, 3.0.0 and 114 commits
  [OMSIMULATOR_3RDPARTY]=1168b8e255c1d57563a5f90ae31df2ba62f3c676
  # the last ones that run model exchange of FMI 3.0: in 0.8.0 fmi-rs takes each instance for NULL, as it checks a field before it sets it
  [FMUSIM]=1a16f9838b873e486dac1a1fc76e9c88ddfdfd60 # August 2026, after 0.7.0
  [FMI_RS]=6a831ad2a4b106acf60a845733c6d39b4b6c344b # fmusim's submodule
  [SUNDIALS]=c8dabcea90ca8bf195474da120e4f3dd39aa711f # 7.5.0
  [LIBXML2]=c94eb0210183b9d7cb43f8e7fddc6be55843ef49 # 2.15.3
)

builds() { [[ " ${hosts[*]} " == *" $1 "* ]]; }

# Reports all that is missing at once.
missing=() packages=()
lacks() {
  missing+=("$1")
  packages+=(${2:+"$2"})
}
command -v git >/dev/null || lacks git git
command -v cmake >/dev/null || lacks cmake cmake
command -v make >/dev/null || lacks make make
command -v c++ >/dev/null || lacks "a C++ compiler" g++
if builds pyfmi; then
  command -v gfortran >/dev/null || lacks gfortran gfortran
  [ -e "$sundials_home/include/cvodes/cvodes.h" ] || lacks "SUNDIALS in $sundials_home" libsundials-dev
  python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || lacks "Python 3.11 or newer" python3
  python3 -c 'import ensurepip' 2>/dev/null || lacks "Python's venv" python3-venv
  header='import os, sys, sysconfig; sys.exit(not os.path.exists(sysconfig.get_path("include") + "/Python.h"))'
  python3 -c "$header" 2>/dev/null || lacks "Python's headers" python3-dev
fi
if builds fmusim; then command -v cargo >/dev/null || lacks "cargo 1.88 or newer, of rustup.rs"; fi
if [ ${#missing[@]} != 0 ]; then
  printf 'scripts/build-hosts.sh: missing: %s\n' "${missing[@]}" >&2
  if [ ${#packages[@]} != 0 ]; then echo "on Debian: apt-get install ${packages[*]}" >&2; fi
  exit 1
fi

mkdir -p "$folder/log" "$folder/src" "$folder/stamps"
folder=$(cd "$folder" && pwd)

# Prints the commit of a source, or the path of a folder that is no checkout.
version_of() {
  local variable=$1_SOURCE
  local given=${!variable:-}
  if [ -z "$given" ]; then
    echo "$1 ${commit[$1]}"
  elif [ ! -d "$given" ]; then
    echo "scripts/build-hosts.sh: $variable: $given is not a folder" >&2
    return 1
  else
    echo "$1 $(git -C "$given" rev-parse HEAD 2>/dev/null || echo "$given")"
  fi
}

# Puts a source into the folder of the build: source_of NAME PATH.
source_of() {
  local variable=$1_SOURCE path=$folder/src/$2
  local given=${!variable:-}
  rm -rf "$path"
  mkdir -p "$path"
  if [ -n "$given" ]; then
    cp -r "$given/." "$path"
    # the builds need no history, and a worktree's would point elsewhere
    rm -rf "$path/.git"
  else
    git init --quiet "$path"
    git -C "$path" fetch --quiet --depth 1 "https://github.com/${repository[$1]}.git" "${commit[$1]}"
    git -C "$path" -c advice.detachedHead=false checkout --quiet FETCH_HEAD
  fi
}

# Runs a command with its output in a log, and shows the end of the log if it fails: logged NAME COMMAND...
logged() {
  local log=$folder/log/$1.log
  shift
  if ! "$@" >>"$log" 2>&1; then
    tail -n 30 "$log" >&2
    echo "scripts/build-hosts.sh: failed: $*" >&2
    echo "all of the output: $log" >&2
    return 1
  fi
}

# Configures and builds a CMake project: cmake_build NAME PATH TARGET OPTION...
cmake_build() {
  local name=$1 path=$folder/src/$2 target=$3
  shift 3
  logged "$name" cmake -S "$path" -B "$folder/build/$name" "$@"
  logged "$name" cmake --build "$folder/build/$name" --parallel "$jobs" --target "$target"
}

build_pyfmi() {
  source_of FMI_LIBRARY fmi-library
  source_of ASSIMULO assimulo
  source_of PYFMI pyfmi
  cmake_build fmi-library fmi-library install -DCMAKE_BUILD_TYPE=Release -DCMAKE_INSTALL_PREFIX="$folder/fmi-library" \
    -DFMILIB_INSTALL_PREFIX="$folder/fmi-library" -DFMILIB_BUILD_TESTS=OFF -DFMILIB_BUILD_STATIC_LIB=OFF -DFMILIB_GENERATE_DOXYGEN_DOC=OFF
  logged pyfmi python3 -m venv --clear "$folder/pyfmi"
  local python=$folder/pyfmi/bin/python
  # newer versions of setuptools break numpy.distutils, which Assimulo needs for its solvers in Fortran
  logged pyfmi "$python" -m pip install --quiet --disable-pip-version-check setuptools==69.1.0 wheel==0.45.1 Cython==3.1.4 \
    numpy==2.3.3 scipy==1.15.2 matplotlib==3.10.6 FMPy==0.3.32
  # with setup.cfg setuptools would look for packages that are there
  rm -f "$folder/src/assimulo/setup.cfg" "$folder/src/pyfmi/setup.cfg"
  logged pyfmi env -C "$folder/src/assimulo" NPY_NUM_BUILD_JOBS="$jobs" "$python" setup.py install --sundials-home="$sundials_home"
  logged pyfmi env -C "$folder/src/pyfmi" NPY_NUM_BUILD_JOBS="$jobs" "$python" setup.py install --fmil-home="$folder/fmi-library"
  # from elsewhere, because the sources have folders of the same names
  logged pyfmi env -C "$folder" "$python" -c 'import pyfmi, assimulo.solvers; assimulo.solvers.CVode'
}

build_omsimulator() {
  source_of OMSIMULATOR omsimulator
  source_of OMSIMULATOR_3RDPARTY omsimulator/3rdParty
  # it asks git for its version, and a single commit has no tag
  local version
  version=$(version_of OMSIMULATOR)
  version=${version#* }
  echo "v3.0.0.post-${version:0:7}" >"$folder/src/omsimulator/version.txt"
  # it only runs small FMUs: without optimization it builds faster
  cmake_build omsimulator omsimulator OMSimulator -DCMAKE_BUILD_TYPE=None -DCMAKE_INSTALL_PREFIX="$folder/omsimulator"
  mkdir -p "$folder/omsimulator"
  find "$folder/build/omsimulator" -type f -name OMSimulator -perm -u+x -exec cp {} "$folder/omsimulator/" \;
  logged omsimulator "$folder/omsimulator/OMSimulator" --version
}

# Makes a build script of fmi-rs take a library from a folder rather than download it.
point_fmi_rs() {
  local file=$folder/src/fmusim/fmi-rs/fmi-rs/build/$1.rs
  local before="let library_dir = out_dir.join(\"$2\");"
  grep -qF "$before" "$file" || { echo "scripts/build-hosts.sh: $file of another version: no line $before" >&2 && return 1; }
  sed -i "s|let library_dir = out_dir.join(\"$2\");|let library_dir = PathBuf::from(\"$folder/$2\"); let _ = out_dir;|" "$file"
}

build_fmusim() {
  source_of FMUSIM fmusim
  source_of FMI_RS fmusim/fmi-rs
  source_of LIBXML2 libxml2
  source_of SUNDIALS sundials
  cmake_build libxml2 libxml2 install -DCMAKE_BUILD_TYPE=Release -DCMAKE_INSTALL_PREFIX="$folder/libxml2" -DBUILD_SHARED_LIBS=OFF \
    -DLIBXML2_WITH_PYTHON=OFF -DLIBXML2_WITH_ZLIB=OFF -DLIBXML2_WITH_LZMA=OFF -DLIBXML2_WITH_ICONV=OFF -DLIBXML2_WITH_PROGRAMS=OFF \
    -DLIBXML2_WITH_TESTS=OFF
  # the options were renamed in a later version: SUNDIALS_ENABLE_... is for that one
  local part options=()
  for part in ARKODE CVODES IDAS KINSOL; do options+=("-DBUILD_$part=OFF" "-DSUNDIALS_ENABLE_$part=OFF"); done
  cmake_build sundials sundials install -DCMAKE_BUILD_TYPE=Release -DCMAKE_INSTALL_PREFIX="$folder/sundials" -DCMAKE_INSTALL_LIBDIR=lib \
    -DBUILD_SHARED_LIBS=OFF -DBUILD_TESTING=OFF -DEXAMPLES_ENABLE_C=OFF -DSUNDIALS_ENABLE_C_EXAMPLES=OFF "${options[@]}"
  point_fmi_rs schema libxml2
  point_fmi_rs sundials sundials
  # without optimization and debug information it builds faster
  logged fmusim env -C "$folder/src/fmusim" CARGO_PROFILE_DEV_DEBUG=0 CARGO_TARGET_DIR="$folder/build/fmusim" \
    cargo build --locked --jobs "$jobs" --package fmusim
  mkdir -p "$folder/fmusim"
  cp "$folder/build/fmusim/debug/fmusim" "$folder/fmusim/"
  logged fmusim "$folder/fmusim/fmusim" --version
}

declare -A sources=(
  [pyfmi]="PYFMI ASSIMULO FMI_LIBRARY"
  [omsimulator]="OMSIMULATOR OMSIMULATOR_3RDPARTY"
  [fmusim]="FMUSIM FMI_RS SUNDIALS LIBXML2"
)
for host in "${hosts[@]}"; do
  versions=$(for name in ${sources[$host]}; do version_of "$name" || exit 1; done)
  stamp=$folder/stamps/$host
  if [ "$versions" = "$(cat "$stamp" 2>/dev/null)" ]; then
    echo "$host is up to date"
    continue
  fi
  rm -f "$stamp"
  started=$SECONDS
  echo "building $host"
  "build_$host"
  echo "$versions" >"$stamp"
  echo "built $host in $((SECONDS - started)) s"
done
