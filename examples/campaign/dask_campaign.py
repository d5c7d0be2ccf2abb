"""Samples a study on a Dask cluster: one task for each shard, then the merge.

Usage: dask_campaign.py STUDY OUT SHARDS [SCHEDULER]

Without the address of a scheduler, it starts a cluster of processes on this machine. The workers of any other cluster must share the study,
its files and OUT under the same paths. They must have `metafmu` on their PATH, or the variable METAFMU must name it.
"""

import os
import subprocess
import sys

from dask.distributed import Client, LocalCluster, as_completed


def sample(study, out, shard, shards):
    """Samples one shard; returns the last message of the command."""
    command = [os.environ.get("METAFMU", "metafmu"), "sample", study, "--out", out, "--shard", f"{shard}/{shards}"]
    result = subprocess.run(command, capture_output=True, text=True)
    if result.returncode != 0:
        raise RuntimeError(f"shard {shard}/{shards}: {result.stderr.strip()}")
    return result.stderr.strip().splitlines()[-1]


def campaign(client, study, out, shards):
    """Samples all shards, in any order. A task whose worker is lost runs again and continues after the finished runs."""
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
