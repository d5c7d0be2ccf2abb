"""Samples, searches or compares on a Dask cluster: one task for each unit of work, then the merge.

Usage: dask_campaign.py VERB STUDY OUT [--shards 8] [--scheduler ADDRESS | --workers 2]

The verb is `sample`, with a task for each shard; `search` of a grid, with one for each combination of listed values; or `compare`, with one
for each model, after `metafmu build` or `sample` into OUT.

Without the address of a scheduler, it starts a cluster of processes on this machine. The workers of any other cluster must share the study,
its files and OUT under the same absolute paths. They must have `metafmu` on their PATH, or the variable METAFMU must name it: a worker without
it is named in a warning and gets no tasks. They need no copy of this folder.
"""

import argparse
import os
import sys
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path

import tasks
from dask.distributed import Client, Future, KilledWorker, LocalCluster, wait

# between two checks for workers that came or left
SECONDS_BETWEEN_CHECKS = 1.0


def run(source, *arguments):
    """Calls `run` of tasks.py, given its text: neither the scheduler nor a worker has the file.

    distributed copies functions of this script, but refers to functions of all other modules by name.
    """
    return module_of(source)["run"](*arguments)


def missing_program(source):
    """Returns the sentence about a worker without `metafmu`, None for a worker that has it."""
    try:
        module_of(source)["program"]()
    except RuntimeError as error:
        return str(error)
    return None


def module_of(source):
    module = {"__name__": "tasks"}
    exec(compile(source, "tasks.py", "exec"), module)
    return module


class Workers:
    """Returns the workers of a cluster that have `metafmu`. Each worker is queried once."""

    def __init__(self, client, source):
        self.client, self.source = client, source
        self.has_program, self.some_had_program = {}, False

    def threads(self):
        """Threads of each worker that has `metafmu`, by its address.

        Prints a warning about each worker that lacks it. Raises RuntimeError if no worker has it, and none had it before.
        """
        threads = self.client.nthreads()
        sentences = {}
        if unknown := [address for address in threads if address not in self.has_program]:
            sentences = self.client.run(missing_program, self.source, workers=unknown, on_error="return")
        # a worker that has left has no answer
        sentences = {address: sentence for address, sentence in sentences.items() if not isinstance(sentence, BaseException)}
        self.has_program |= {address: sentence is None for address, sentence in sentences.items()}
        found = {address: count for address, count in threads.items() if self.has_program.get(address)}
        self.some_had_program |= bool(found)
        lacking = {address: sentence for address, sentence in sentences.items() if sentence is not None}
        if lacking and not self.some_had_program:
            raise RuntimeError("; ".join(dict.fromkeys(lacking.values())))
        for address, sentence in lacking.items():
            print(f"warning: {sentence}; the worker {address} gets no tasks", file=sys.stderr, flush=True)
        return found


@dataclass
class Task:
    """A unit of work at a cluster, and the workers that may run it."""

    future: Future
    unit: tuple
    workers: set


def campaign(client, verb, study, out, shards):
    """Runs all units, in any order, on the workers that have `metafmu`, and merges them.

    A command ends with its worker. Its task runs again on another worker, and continues after the runs that were finished.
    """
    names = tasks.units(verb, study, shards)
    # a finished shard whose worker is lost before it has answered is not sampled again
    old = [tasks.shard_version(out, name) if verb == "sample" else None for name in names]
    # workers have other working directories
    source, paths = Path(tasks.__file__).read_text(encoding="utf-8"), (os.path.abspath(study), os.path.abspath(out))
    waiting, submitted, workers = deque(zip(names, old)), [], Workers(client, source)
    while waiting or submitted:
        threads = workers.threads()
        for task in [task for task in submitted if task.workers.isdisjoint(threads) and not task.future.done()]:
            # a worker that is started again has another address
            task.future.cancel()
            submitted.remove(task)
            waiting.appendleft(task.unit)
        while waiting and len(submitted) < sum(threads.values()):
            unit = waiting.popleft()
            # each task uses all processors of its worker
            future = client.submit(run, source, verb, *paths, *unit, pure=False, retries=2, workers=list(threads))
            submitted.append(Task(future, unit, set(threads)))
        wait_for_one(submitted)
        for task in [task for task in submitted if task.future.done()]:
            print(task.future.result(), flush=True)
            submitted.remove(task)
    tasks.merge(verb, study, out)


def wait_for_one(submitted):
    """Returns when a task has ended, or after a while."""
    if not submitted:
        time.sleep(SECONDS_BETWEEN_CHECKS)
        return
    try:
        wait([task.future for task in submitted], timeout=SECONDS_BETWEEN_CHECKS, return_when="FIRST_COMPLETED")
    except TimeoutError:
        pass


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
