"""Samples, searches or compares on a Dask cluster: one task for each unit of work, then the merge.

Usage: dask_campaign.py VERB STUDY OUT [--shards 8] [--scheduler ADDRESS | --workers 2]

The verb is `sample`, with a task for each shard; `search` of a grid, with one for each combination of listed values; or `compare`, with one
for each model, after `metafmu build` or `sample` into OUT.

Without the address of a scheduler, it starts a cluster of processes on this machine. The workers of any other cluster must share the study,
its files and OUT under the same absolute paths. They must have `metafmu` on their PATH, or the variable METAFMU must name it. They need no
copy of this folder.
"""

import argparse
import os
import sys
from pathlib import Path

import tasks
from dask.distributed import Client, KilledWorker, LocalCluster, as_completed


def run(source, *arguments):
    """Calls `run` of tasks.py, given its text: neither the scheduler nor a worker has the file.

    distributed copies functions of this script, but refers to functions of all other modules by name.
    """
    module = {"__name__": "tasks"}
    exec(compile(source, "tasks.py", "exec"), module)
    return module["run"](*arguments)


def campaign(client, verb, study, out, shards):
    """Runs all units, in any order, and merges them.

    A command ends with its worker. Its task runs again on another worker, and continues after the runs that were finished.
    """
    names = tasks.units(verb, study, shards)
    # a finished shard whose worker is lost before it has answered is not sampled again
    old = [tasks.shard_version(out, name) if verb == "sample" else None for name in names]
    # workers have other working directories
    source, paths = Path(tasks.__file__).read_text(encoding="utf-8"), (os.path.abspath(study), os.path.abspath(out))
    # each task uses all processors of its worker
    work = [client.submit(run, source, verb, *paths, *unit, pure=False, retries=2) for unit in zip(names, old)]
    for task in as_completed(work):
        print(task.result(), flush=True)
    tasks.merge(verb, study, out)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("verb", choices=tasks.VERBS)
    parser.add_argument("study")
    parser.add_argument("out")
    parser.add_argument("--shards", type=int, default=8, help="number of shards of a sampling")
    parser.add_argument("--scheduler", help="address of the scheduler of a cluster")
    parser.add_argument("--workers", type=int, default=2, help="processes on this machine, without a scheduler")
    options = parser.parse_args()
    arguments = options.verb, options.study, options.out, options.shards
    try:
        # for the merge, which must not fail after hours
        tasks.program()
        if options.scheduler:
            with Client(options.scheduler) as client:
                campaign(client, *arguments)
        else:
            threads = {"n_workers": options.workers, "threads_per_worker": 1, "dashboard_address": None}
            with LocalCluster(**threads) as cluster, Client(cluster) as client:
                campaign(client, *arguments)
    except (RuntimeError, KilledWorker, OSError) as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
