#!/usr/bin/env bash
# Samples, searches or compares as an array job of SLURM, and merges the results when all tasks are done:
#
#     sbatch --array=1-8 examples/campaign/slurm.sh sample study.toml OUT                           # prints the job's number
#     sbatch --dependency=afterok:NUMBER examples/campaign/slurm.sh sample study.toml OUT
#
# `search` needs a grid. `compare` needs what `metafmu build` or `sample` wrote into OUT. OUT is a folder that all nodes share. Both verbs run
# `tasks.py` beside this script with the first python3 on the PATH, 3.11 or newer; CAMPAIGN names its folder, by default examples/campaign.
#
# A task that is killed, because its time is up for instance, loses no finished run. The merge says what is missing. To run only tasks
# 3 and 5 of 8 again: sbatch --array=3,5 --export=ALL,TASKS=8 examples/campaign/slurm.sh sample study.toml OUT
#SBATCH --job-name=metafmu
#SBATCH --cpus-per-task=4
#SBATCH --time=01:00:00
set -euo pipefail
verb=$1 study=$2 out=$3

# as many workers as the job has processors, not as many as the node has
export RAYON_NUM_THREADS=${SLURM_CPUS_PER_TASK:-1}
task=${SLURM_ARRAY_TASK_ID:+$SLURM_ARRAY_TASK_ID/${TASKS:-$SLURM_ARRAY_TASK_COUNT}}
if [ "$verb" != sample ]; then
  # SLURM runs a copy of this script: its own folder is another one
  exec python3 "${CAMPAIGN:-examples/campaign}/tasks.py" "$verb" "$study" "$out" "${task:-merge}"
elif ! command -v "${METAFMU:-metafmu}" >/dev/null; then
  echo "error: $(hostname): found no command \`${METAFMU:-metafmu}\`, expected \`metafmu\` on the PATH, or its path in the variable METAFMU" >&2
  exit 1
elif [ -n "$task" ]; then
  exec "${METAFMU:-metafmu}" sample "$study" --out "$out" --shard "$task"
else
  exec "${METAFMU:-metafmu}" sample "$study" --out "$out" --merge
fi
