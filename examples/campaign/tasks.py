"""Divides `metafmu sample`, `search` and `compare` into tasks for any scheduler, and merges their results.

Usage: tasks.py VERB STUDY OUT I/N        runs task I of N
       tasks.py VERB STUDY OUT merge      merges the results of all tasks

A task runs units of work: a shard of a sampling, a part of a grid, a model of a comparison. All tasks share the study, its files and OUT under
the same paths. `metafmu` is on their PATH, or the variable METAFMU names it. `slurm.sh` and `dask_campaign.py` call this file.
"""

import csv
import hashlib
import itertools
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import time
import tomllib
from pathlib import Path

try:
    import fcntl
except ImportError:
    # on Windows
    fcntl = None

VERBS = ("sample", "search", "compare")
# how the command says that another one samples into the same file
BUSY = "another metafmu is at work in this folder"
# Runs a command, and ends it as soon as standard input is closed: by the end of the worker, however it ends.
GUARD = """
import os, subprocess, sys, threading
child = subprocess.Popen(sys.argv[1:], stdin=subprocess.DEVNULL)
def watch():
    os.read(0, 1)
    child.kill()
threading.Thread(target=watch, daemon=True).start()
code = child.wait()
os._exit(code if code >= 0 else 128 - code)
"""


def program():
    """Path of the command on this machine."""
    name = os.environ.get("METAFMU", "metafmu")
    if path := shutil.which(name):
        return path
    raise RuntimeError(f"{platform.node()}: found no command `{name}`, expected `metafmu` on the PATH, or its path in the variable METAFMU")


class Busy(RuntimeError):
    """Another command samples the same runs."""


def metafmu(*arguments, accept=(0,)):
    """Runs the command, which does not outlive this process; returns its last message."""
    closed_at_the_end, kept = os.pipe()
    try:
        command = [sys.executable, "-c", GUARD, program(), *map(str, arguments)]
        result = subprocess.run(command, stdin=closed_at_the_end, capture_output=True, text=True)
    finally:
        os.close(closed_at_the_end)
        os.close(kept)
    messages = result.stderr.strip() or f"exit code {result.returncode}"
    if BUSY in messages:
        raise Busy(messages)
    if result.returncode not in accept:
        raise RuntimeError(f"metafmu {' '.join(map(str, arguments))}: {messages}")
    return messages.splitlines()[-1]


def units(verb, study, tasks):
    """Names of the units of work; only a sampling has as many of them as tasks."""
    if verb == "sample":
        return [f"{number}/{tasks}" for number in range(1, tasks + 1)]
    if verb == "search":
        return [str(number) for number in range(len(parts(study)))]
    return models(study)


def shard_version(out, unit):
    """Differs before and after a shard's file is replaced; none without a file."""
    number, of = unit.split("/")
    path = Path(out) / f"shard-{number}-of-{of}.bin"
    return (path.stat().st_ino, path.stat().st_mtime_ns) if path.exists() else None


def run(verb, study, out, unit, old_shard=None):
    """Runs a unit, unless it is finished; returns a message. A shard is finished if its version is not that of an old one.

    A command that is at work on the same runs, perhaps of a worker that the scheduler has lost, is waited for.
    """
    study, out = Path(study), Path(out)
    do = {"sample": sample_shard, "search": search_part, "compare": compare_model}[verb]
    while True:
        if verb == "sample":
            is_finished = shard_version(out, unit) not in (None, old_shard)
        else:
            is_finished = (results(verb, study, out) / unit).exists()
        if is_finished:
            return f"{verb} {unit}: finished already"
        try:
            return do(study, out, unit)
        except Busy:
            time.sleep(0.5)
            if verb == "sample" and fcntl:
                # else a shard that is finished just before the next attempt would be sampled again
                wait_for_lock(out, unit)


def wait_for_lock(out, unit):
    """Returns when no command holds the lock of a shard's runs, which it holds until the shard is written."""
    number, of = unit.split("/")
    try:
        with open(out / f"unfinished-runs-{number}-of-{of}.bin", "r+b") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
    except FileNotFoundError:
        pass


def sample_shard(study, out, unit):
    return metafmu("sample", study, "--out", out, "--shard", unit)


def unfinished_folder(verb, study, out, unit):
    folder = results(verb, study, out) / f"unfinished-{unit}"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def finish(unfinished):
    """Gives the folder of a unit its name: its files are complete."""
    folder = unfinished.with_name(unfinished.name.removeprefix("unfinished-"))
    try:
        unfinished.rename(folder)
    except OSError:
        # another worker was faster
        if not folder.exists():
            raise


def merge(verb, study, out):
    """Merges the units' results into the files that one machine would write."""
    study, out = Path(study), Path(out)
    if verb == "sample":
        # the command has printed the reason of a failure
        if code := subprocess.run([program(), "sample", study, "--out", out, "--merge"]).returncode:
            sys.exit(code)
        return
    folder = results(verb, study, out)
    names = units(verb, study, None)
    missing = [name for name in names if not (folder / name).exists()]
    if missing:
        sys.exit(f"{verb}: {len(missing)} of {len(names)} are missing: {', '.join(missing)}")
    {"search": merge_search, "compare": merge_comparison}[verb](study, out, folder)
    shutil.rmtree(folder)


def results(verb, study, out):
    """Folder of the units' results. Its name depends on the study and the files that it names: after a change all units run again."""
    digest = hashlib.sha256(study.read_bytes())
    if verb == "compare":
        files = sorted(path for path in out.iterdir() if path.name in ("samples.json", "training.json"))
    else:
        strings = re.findall(r'"([^"]*)"', json.dumps(tomllib.loads(study.read_text())))
        files = sorted({path for text in strings if text and (path := study.parent / text).is_file()})
    for path in files:
        digest.update(path.read_bytes())
    return out / f"{verb}-{digest.hexdigest()[:16]}"


# ---- a grid ------------------------------------------------------------------------------------------------------


def parts(study):
    """Parts of a grid: one for each combination of listed values, as pairs of the part's space and the numbers of its trials.

    A range stays whole, so that its levels are computed in one place.
    """
    options = tomllib.loads(Path(study).read_text()).get("search", {})
    if options.get("method") != "grid":
        sys.exit(f'{study}: search.method: found {options.get("method")!r}, expected "grid": other trials depend on each other')
    space = options["space"]
    choices = [[[value] for value in values] if isinstance(values, list) else [values] for values in space.values()]
    lengths = [len(values) if isinstance(values, list) else values["levels"] for values in space.values()]
    found = []
    for chosen in itertools.product(*map(enumerate, choices)):
        levels = [[place] if isinstance(values, list) else range(length) for (place, values), length in zip(chosen, lengths)]
        numbers = []
        for place in itertools.product(*levels):
            number = 0
            for level, length in zip(place, lengths):
                number = number * length + level
            numbers.append(number)
        found.append((dict(zip(space, (values for _, values in chosen))), numbers))
    return found


def part_text(text, space):
    """A study with a smaller space."""
    is_search, kept = False, []
    for line in text.splitlines():
        if re.match(r"\s*\[[^\]\[]+\]\s*(#.*)?$", line):
            is_search = re.match(r"\s*\[\s*search\s*[.\]]", line) is not None
        if not is_search:
            kept.append(line)
    options = {key: value for key, value in tomllib.loads(text)["search"].items() if key != "space"}
    kept += ["[search]", *(f"{key} = {toml(value)}" for key, value in options.items())]
    kept += ["[search.space]", *(f"{json.dumps(key)} = {toml(value)}" for key, value in space.items())]
    found = "\n".join(kept) + "\n"
    if tomllib.loads(found) != {**tomllib.loads(text), "search": {**options, "space": space}}:
        sys.exit('the study cannot be divided: write its search as the tables "[search]" and "[search.space]"')
    return found


def toml(value):
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(key)} = {toml(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return repr(value).lower() if isinstance(value, (bool, float)) else json.dumps(value)


def part_path(study, unit):
    # relative paths in a study start from its folder
    return study.with_name(f"{study.stem}-part-{unit}.toml")


def search_part(study, out, unit):
    folder = unfinished_folder("search", study, out, unit)
    part = part_path(study, unit)
    part.write_text(part_text(study.read_text(), parts(study)[int(unit)][0]))
    (folder / "search.csv").unlink(missing_ok=True)
    try:
        # 1: a trial failed; 2: each of them
        message = metafmu("search", part, "--out", folder, "--resume", accept=(0, 1, 2))
    finally:
        part.unlink(missing_ok=True)
    if not (folder / "search.csv").exists():
        raise RuntimeError(f"search {unit}: {message}")
    finish(folder)
    return f"search {unit}: {message}"


def merge_search(study, out, folder):
    rows, header, owners = {}, [], {}
    for unit, (_, numbers) in enumerate(parts(study)):
        with open(folder / str(unit) / "search.csv", newline="") as file:
            header, *found = csv.reader(file)
        if len(found) != len(numbers):
            sys.exit(f"{folder / str(unit)}: {len(found)} trials, expected {len(numbers)}")
        for number, row in zip(numbers, found):
            part = part_path(study, unit)
            # tasks of Dask have absolute paths
            message = row[-1].replace(os.path.abspath(part), str(study)).replace(str(part), str(study))
            rows[number], owners[number] = [str(number), *row[1:-1], message], unit
    with open(out / "search.csv", "w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *(rows[number] for number in sorted(rows))])
    status, score = header.index("status"), header.index("one_minus_r2")
    finished = [number for number in sorted(rows) if rows[number][status] == "finished" and rows[number][score]]
    if not finished:
        sys.exit(f"{out / 'search.csv'}: no trial finished")
    best = min(finished, key=lambda number: float(rows[number][score]))
    name = f"{tomllib.loads(study.read_text())['name']}-best.toml"
    text = (folder / str(owners[best]) / name).read_text()
    comment, rest = text.split("\n", 1)
    (out / name).write_text(f"# The best of {len(rows)} trials of {study}.\n{rest}")
    print(f"trial {best} of {len(rows)} is the best: {out / name}")


# ---- a comparison ------------------------------------------------------------------------------------------------


def models(study):
    """Models of the study, else all that the command has."""
    named = tomllib.loads(Path(study).read_text()).get("baselines", {}).get("models")
    if named is not None:
        return named
    schema = json.loads(subprocess.run([program(), "schema", "study"], check=True, capture_output=True, text=True).stdout)
    return schema["properties"]["baselines"]["properties"]["models"]["default"]


def compare_model(study, out, unit):
    folder = unfinished_folder("compare", study, out, unit)
    # tables and network of OUT; each comparison writes its own files
    for path in out.iterdir():
        link = folder / path.name
        if path.is_file() and not path.name.startswith("comparison.") and not link.exists():
            link.symlink_to(os.path.abspath(path))
    message = metafmu("compare", study, "--out", folder, "--model", unit)
    finish(folder)
    return f"compare {unit}: {message}"


def merge_comparison(study, out, folder):
    whole, lines = None, []
    for model in models(study):
        found = json.loads((folder / model / "comparison.json").read_text())
        header, *rows = (folder / model / "comparison.csv").read_text().splitlines()
        is_network = lambda row: row.startswith("network,")
        if whole is None:
            whole, lines = found, [header, *filter(is_network, rows)]
        else:
            whole["models"] += found["models"][1:]
        lines += itertools.filterfalse(is_network, rows)
    (out / "comparison.json").write_text(json.dumps(whole, indent=2, ensure_ascii=False) + "\n")
    (out / "comparison.csv").write_text("\n".join(lines) + "\n")
    print(f"{len(whole['models'])} models: {out / 'comparison.json'}")


def main():
    verb, study, out, task = sys.argv[1:]
    if verb not in VERBS:
        sys.exit(f"found {verb!r}, expected one of {', '.join(VERBS)}")
    try:
        if task == "merge":
            merge(verb, study, out)
            return
        number, of = map(int, task.split("/"))
        names = units(verb, study, of)
        for name in names[number - 1 :: of]:
            old_shard = shard_version(out, name) if verb == "sample" else None
            print(run(verb, study, out, name, old_shard), flush=True)
    except (RuntimeError, OSError) as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
