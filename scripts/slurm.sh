#!/usr/bin/env bash
# Runs the campaigns of examples/campaign on a SLURM cluster of one node, and compares their results with those of one machine.
# Usage: scripts/slurm.sh      after `cargo build --release`, or with the path of the command in METAFMU
# Needs root, without systemd: munged, slurmctld and slurmd are started here, on the loopback device, and ended with this script. What is
# missing is installed by apt. Not part of scripts/test.sh: the daemons need a machine of their own, and a job takes seconds to be scheduled.
set -euo pipefail
cd "$(dirname "$0")/.."
metafmu=$(realpath "${METAFMU:-target/release/metafmu}")
unset METAFMU
[ -x "$metafmu" ] || { echo "scripts/slurm.sh: $metafmu is missing: cargo build --release" >&2; exit 1; }
command -v slurmctld slurmd sbatch munged >/dev/null || { apt-get update -qq; apt-get install -y -qq --no-install-recommends slurm-wlm munge >&2; }

work=$(mktemp -d)
pids=()
finish() { for pid in "${pids[@]}"; do kill "$pid" 2>/dev/null || true; done; wait; rm -rf "$work"; }
trap finish EXIT
mkdir "$work"/{state,spool,munge,bin,study}
chmod 755 "$work"
ln -s "$metafmu" "$work/bin/metafmu"

head -c 128 /dev/urandom >"$work/munge/munge.key"
chmod 700 "$work/munge"
chmod 600 "$work/munge/munge.key"
socket=$work/munge.socket
munged --foreground --force --socket="$socket" --key-file="$work/munge/munge.key" --log-file="$work/munge/log" \
  --pid-file="$work/munge/pid" --seed-file="$work/munge/seed" >/dev/null 2>&1 & pids+=($!)
node=$(hostname -s) cpus=$(nproc)
cat >"$work/slurm.conf" <<END
ClusterName=test
SlurmctldHost=$node(127.0.0.1)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket=$socket
CryptoType=crypto/munge
SlurmctldPort=16817
SlurmdPort=16818
StateSaveLocation=$work/state
SlurmdSpoolDir=$work/spool
SlurmctldPidFile=$work/slurmctld.pid
SlurmdPidFile=$work/slurmd.pid
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SchedulerParameters=sched_interval=1,bf_interval=1
ReturnToService=2
NodeName=$node NodeAddr=127.0.0.1 CPUs=$cpus State=UNKNOWN
PartitionName=main Nodes=$node Default=YES State=UP
END
export SLURM_CONF=$work/slurm.conf PATH=$work/bin:$PATH
slurmctld -D >"$work/slurmctld.log" 2>&1 & pids+=($!)
slurmd -D -N "$node" >"$work/slurmd.log" 2>&1 & pids+=($!)
for _ in $(seq 100); do
  sinfo -h -o %t 2>/dev/null | grep -q idle && break
  sleep 0.2
done
sinfo -h -o %t | grep -q idle || { tail -n 20 "$work"/slurm*.log >&2; exit 1; }

# the documented commands, from the root of a checkout, with as many processors a task as the node has
campaign() {
  local verb=$1 tasks=$2 number
  number=$(sbatch --parsable --cpus-per-task=1 --output="$work/job-%A-%a.log" --array="1-$tasks" examples/campaign/slurm.sh "$verb" "$work/study/study.toml" "$work/out")
  sbatch --parsable --wait --cpus-per-task=1 --output="$work/merge-%A.log" --dependency="afterok:$number" examples/campaign/slurm.sh "$verb" "$work/study/study.toml" "$work/out" >/dev/null ||
    { cat "$work"/job-* "$work"/merge-* >&2; exit 1; }
}
cat >"$work/study/study.toml" <<'END'
name = "grid"
[source]
system = "single-pendulum"
[time]
stop = 1
step = 0.05
[parameters]
L = { min = 0.1, max = 0.2 }
[outputs]
theta = {}
[baselines]
models = ["linear", "knn"]
[sampling]
method = "sobol"
runs = 16
test_runs = 4
[network]
hidden = [8]
[training]
epochs = 2
[search]
method = "grid"
[search.space]
"training.learning_rate" = [0.001, 0.01]
END
mkdir "$work/one"
one() { metafmu "$1" "$work/study/study.toml" --out "$work/one" >"$work/one.log" 2>&1 || [ $? = 1 ] || { cat "$work/one.log" >&2; exit 1; }; }
# files of both folders, without times
same() {
  python3 - "$work/one/$1" "$work/out/$1" <<'END'
import re, sys
one, out = (re.sub(r'"\w*seconds\w*": [^,\n]*', "", open(path).read()) for path in sys.argv[1:])
assert one == out, (one, out)
END
  echo "$1: as on one machine"
}

one sample
campaign sample 4
same train.csv
same test.csv
one search
campaign search 2
same grid-best.toml
one train
find "$work/one" -maxdepth 1 -type f -exec cp -t "$work/out" {} +
one compare
campaign compare 2
same comparison.json

# a node without the command
rm "$work/bin/metafmu"
if PATH=${PATH#*:} sbatch --wait --cpus-per-task=1 --output="$work/none.log" --array=1-1 examples/campaign/slurm.sh sample "$work/study/study.toml" "$work/out" >/dev/null; then
  echo "scripts/slurm.sh: a node without metafmu succeeded" >&2
  exit 1
fi
grep "found no command" "$work/none.log"
