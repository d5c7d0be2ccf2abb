#!/usr/bin/env bash
# Samples a study as an array job of SLURM, and puts the shards together when all of them are done:
#
#     sbatch --array=1-8 examples/campaign/slurm.sh study.toml OUT                                  # prints the job's number
#     sbatch --dependency=afterok:NUMBER examples/campaign/slurm.sh study.toml OUT
#
# OUT is a folder that all nodes share. A shard that is killed, because its time is up for instance, loses no finished run:
# submit the array again. The second job says which shards are missing, and leaves train.csv and test.csv for `metafmu train`.
#SBATCH --job-name=metafmu
#SBATCH --cpus-per-task=4
#SBATCH --time=01:00:00
set -euo pipefail
study=$1 out=$2

# as many workers as the job has processors, not as many as the node has
export RAYON_NUM_THREADS=${SLURM_CPUS_PER_TASK:-1}
if [ -n "${SLURM_ARRAY_TASK_ID:-}" ]; then
  exec metafmu sample "$study" --out "$out" --shard "$SLURM_ARRAY_TASK_ID/$SLURM_ARRAY_TASK_COUNT"
else
  exec metafmu sample "$study" --out "$out" --merge
fi
