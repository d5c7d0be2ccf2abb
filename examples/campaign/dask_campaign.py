"""Samples a study on a Dask cluster: one task for each shard, then the merge.

Usage: dask_campaign.py STUDY OUT SHARDS [SCHEDULER]

Without the address of a scheduler, on a cluster of processes of this machine. The workers of another cluster share the study,
its files and OUT under the same paths, and have `metafmu` on their PATH (or the variable METAFMU names it).
"""

import os
import subprocess
import sys

from dask.distributed import Client, LocalCluster, as_completed


def sample(study, out, shard, shards):
    """One shard; returns what the command says about it."""
    command = [os.environ.get("METAFMU", "metafmu"), "sample", study, "--out", out, "--shard", f"{shard}/{shards}"]
    result = subprocess.run(command, capture_output=True, text=True)
    if result.returncode != 0:
        raise RuntimeError(f"shard {shard}/{shards}: {result.stderr.strip()}")
    return result.stderr.strip().splitlines()[-1]


def campaign(client, study, out, shards):
    """All shards, in any order; a task whose worker is lost is run again and goes on from the runs that are finished."""
    numbers = range(1, shards + 1)
    # each task uses all processors of its worker
    tasks = [client.submit(sample, study, out, number, shards, pure=False, retries=2) for number in numbers]
    for task in as_completed(tasks):
        print(task.result(), flush=True)
    subprocess.run([os.environ.get("METAFMU", "metafmu"), "sample", study, "--out", out, "--merge"], check=True)


def main():
    study, out, shards, *scheduler = sys.argv[1:]
    if scheduler:
        with Client(scheduler[0]) as client:
            campaign(client, study, out, int(shards))
    else:
        with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
            campaign(client, study, out, int(shards))


if __name__ == "__main__":
    main()
