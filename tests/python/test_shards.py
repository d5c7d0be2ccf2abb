"""Samplings spread over machines: shards, their merge, and the campaigns in examples/campaign."""

import csv
import json
import os
import platform
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from conftest import ANY, METAFMU, ROOT, SMALL, metafmu
from dask.distributed import Client, LocalCluster

CAMPAIGN = ROOT / "examples" / "campaign"
sys.path.insert(0, str(CAMPAIGN))
import tasks

SHARDS = 4
TABLES = ["train.csv", "test.csv", "calibration.csv"]
STUDY = """name = "s"
[source]
system = "single-pendulum"
[time]
stop = 1
step = 0.05
[parameters]
L = { min = 0.1, max = 0.2 }
c = { min = 0.0, max = 0.15 }
[outputs]
theta = {}
thetad = {}
[bounds]
runs = 19
[sampling]
method = "latin-hypercube"
runs = 31
test_runs = 5
"""


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    path = tmp_path_factory.mktemp("shards") / "study.toml"
    path.write_text(STUDY)
    metafmu("sample", path, "--out", path.parent / "whole")
    return path


def tables(folder):
    return {name: (folder / name).read_bytes() for name in TABLES}


def sample_shards(study, folder, numbers=range(1, SHARDS + 1)):
    for number in numbers:
        metafmu("sample", study, "--out", folder, "--shard", f"{number}/{SHARDS}")


def refusal(*arguments):
    result = metafmu(*arguments, check=False)
    assert (result.returncode, result.stdout) == (2, ""), result
    return result.stderr


def test_shards_that_are_merged_are_the_sampling_byte_for_byte(study, tmp_path):
    sample_shards(study, tmp_path, [3, 1, 4, 2])
    assert not any((tmp_path / name).exists() for name in TABLES)
    metafmu("sample", study, "--out", tmp_path, "--merge")
    assert tables(tmp_path) == tables(study.parent / "whole")
    record, whole = (json.loads((folder / "samples.json").read_text()) for folder in (tmp_path, study.parent / "whole"))
    assert {**record, "sample_seconds": 0} == {**whole, "sample_seconds": 0}
    # what a shard would simulate can be seen before
    plans = [metafmu("sample", study, "--dry-run", "--shard", f"{i}/{SHARDS}").stdout.splitlines() for i in range(1, SHARDS + 1)]
    whole = metafmu("sample", study, "--dry-run").stdout.splitlines()
    assert sorted(line for plan in plans for line in plan[1:]) == sorted(whole[1:])
    assert max(map(len, plans)) - min(map(len, plans)) <= 1


def test_files_from_several_folders_are_merged_where_they_are_named(study, tmp_path):
    for number in range(1, SHARDS + 1):
        sample_shards(study, tmp_path / f"machine-{number}", [number])
    files = list(tmp_path.glob("machine-*/shard-*.bin"))
    metafmu("sample", study, "--out", tmp_path / "merged", "--merge", *files)
    assert tables(tmp_path / "merged") == tables(study.parent / "whole")


def test_what_does_not_belong_together_is_refused(study, tmp_path):
    assert "no shards: run `metafmu sample STUDY --shard I/N` first" in refusal("sample", study, "--out", tmp_path, "--merge")
    sample_shards(study, tmp_path, [2])
    assert "shards 1, 3, 4 of 4 are missing" in refusal("sample", study, "--out", tmp_path, "--merge")
    sample_shards(study, tmp_path, [1, 3])
    assert "shard 4 of 4 is missing" in refusal("sample", study, "--out", tmp_path, "--merge")
    sample_shards(study, tmp_path, [4])
    other = tmp_path / "other.toml"
    other.write_text(STUDY.replace("max = 0.2", "max = 0.3"))
    message = refusal("sample", other, "--out", tmp_path, "--merge")
    assert "shard-1-of-4.bin: was sampled from another study" in message
    metafmu("sample", study, "--out", tmp_path, "--shard", "1/3")
    assert "is shard 1/4, but" in (message := refusal("sample", study, "--out", tmp_path, "--merge")) and "is 1/3" in message
    (tmp_path / "shard-1-of-3.bin").unlink()
    first = tmp_path / "shard-1-of-4.bin"
    copy = tmp_path / "copy.bin"
    copy.write_bytes(first.read_bytes())
    files = [*sorted(tmp_path.glob("shard-*")), copy]
    assert "copy.bin: is shard 1/4, and so is" in refusal("sample", study, "--out", tmp_path, "--merge", *files)
    good = first.read_bytes()
    for bad in (b"", b"hello\n", good[:-1], good[:100] + b"x" + good[101:], good + b"x"):
        first.write_bytes(bad)
        assert "shard-1-of-4.bin: is damaged" in refusal("sample", study, "--out", tmp_path, "--merge")
    assert not (tmp_path / "train.csv").exists()
    first.write_bytes(good)
    metafmu("sample", study, "--out", tmp_path, "--merge")
    assert tables(tmp_path) == tables(study.parent / "whole")
    for shard in ("0/4", "5/4", "1", "a/b"):
        assert "expected I/N" in refusal("sample", study, "--shard", shard)


# each run leaves a byte in the file `calls`
SLOW_PROGRAM = """
import json, os, sys, time
for line in sys.stdin:
    request = json.loads(line)
    if request["request"] == "describe":
        reply = {"protocol": 1, "parameters": {"k": {}}, "outputs": {"x": {}}}
    else:
        time.sleep(float(os.environ.get("RUN_SECONDS", 0)))
        with open("calls", "a") as file:
            file.write(".")
        reply = {"outputs": {"x": [request["parameters"]["k"] * t for t in request["times"]]}}
    print(json.dumps({"id": request["id"], **reply}), flush=True)
"""
SLOW_STUDY = f"""name = "s"
[source]
command = ["{sys.executable}", "program.py"]
repeats = 0
[time]
stop = 1
step = 0.1
[parameters]
k = {{ min = 0, max = 1 }}
[outputs]
x = {{}}
[bounds]
runs = 19
{SMALL}"""
SLOW_RUNS = 89
# the journal begins with 32 bytes; a record has 1 + 11 numbers and a checksum of 8 bytes
JOURNAL_BYTES, RECORD_BYTES = 32, 104


def environment(**variables):
    return {**os.environ, "PATH": f"{METAFMU.parent}:{os.environ['PATH']}", "METAFMU": str(METAFMU), **variables}


def dask_campaign(*arguments, **variables):
    command = [sys.executable, CAMPAIGN / "dask_campaign.py", *map(str, arguments)]
    result = subprocess.run(command, env=environment(**variables), capture_output=True, text=True, timeout=240)
    assert result.returncode == 0, result.stderr
    return result


def slurm(*arguments):
    """The array job, then the job that depends on it."""
    for number in range(1, SHARDS + 1):
        task = {"SLURM_ARRAY_TASK_ID": str(number), "SLURM_ARRAY_TASK_COUNT": str(SHARDS), "SLURM_CPUS_PER_TASK": "1"}
        subprocess.run([CAMPAIGN / "slurm.sh", *arguments], check=True, env=environment(**task), cwd=ROOT)
    subprocess.run([CAMPAIGN / "slurm.sh", *arguments], check=True, env=environment(), cwd=ROOT)


def test_the_array_job_for_slurm(study, tmp_path):
    slurm("sample", study, tmp_path)
    assert tables(tmp_path) == tables(study.parent / "whole")
    # one of the four again
    (tmp_path / "shard-3-of-4.bin").unlink()
    task = {"SLURM_ARRAY_TASK_ID": "3", "SLURM_ARRAY_TASK_COUNT": "1", "TASKS": str(SHARDS)}
    subprocess.run([CAMPAIGN / "slurm.sh", "sample", study, tmp_path], check=True, env=environment(**task), cwd=ROOT)
    assert (tmp_path / "shard-3-of-4.bin").exists()


def test_the_campaign_on_a_dask_cluster(study, tmp_path):
    result = dask_campaign("sample", study, tmp_path, "--shards", SHARDS)
    assert result.stdout.count("sampled shard") == SHARDS
    assert tables(tmp_path) == tables(study.parent / "whole")


@pytest.fixture
def dask_worker(tmp_path):
    """Starts workers as Dask's guide does, in other folders and with no variable of this process, and returns the scheduler's address."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    dask, processes = Path(sys.executable).with_name("dask"), []

    def start(name, *arguments, path="/usr/bin:/bin"):
        folder = tmp_path / "cluster" / name
        folder.mkdir(parents=True)
        clean = {"PATH": path, "HOME": str(folder)}
        with open(folder / "log", "w") as log:
            command = [dask, *arguments, "--host", "127.0.0.1", "--no-dashboard"]
            processes.append(subprocess.Popen(list(map(str, command)), cwd=folder, env=clean, stdout=log, stderr=log, start_new_session=True))
        return folder / "log"

    def start_worker(path):
        number = len(processes)
        log = start(f"worker-{number}", "worker", address, "--nthreads", 1, path=f"{path}:/usr/bin:/bin")
        wait_until(lambda: "Registered to:" in log.read_text())
        return address

    try:
        start("scheduler", "scheduler", "--port", address.rpartition(":")[2])
        yield start_worker
    finally:
        for process in processes:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def test_the_campaign_on_a_cluster_that_was_started_by_hand(study, dask_worker, tmp_path):
    for _ in range(2):
        address = dask_worker(METAFMU.parent)
    # as documented: paths are relative to the user's folder
    command = [sys.executable, CAMPAIGN / "dask_campaign.py", "sample", "study.toml", tmp_path.name, "--shards", str(SHARDS), "--scheduler", address]
    (study.parent / tmp_path.name).symlink_to(tmp_path)
    result = subprocess.run(command, env=environment(), cwd=study.parent, capture_output=True, text=True, timeout=60)
    assert result.returncode == 0, result.stderr
    assert result.stdout.count("sampled shard") == SHARDS
    assert tables(tmp_path) == tables(study.parent / "whole")


def test_a_dask_worker_without_metafmu_is_reported_in_a_sentence(study, dask_worker, tmp_path):
    command = [sys.executable, CAMPAIGN / "dask_campaign.py", "sample", study, tmp_path, "--shards", "1", "--scheduler", dask_worker(tmp_path)]
    result = subprocess.run(command, env=environment(), capture_output=True, text=True, timeout=60)
    says = "found no command `metafmu`, expected `metafmu` on the PATH, or its path in the variable METAFMU"
    assert (result.returncode, result.stderr) == (1, f"error: {platform.node()}: {says}\n")
    # and the user's machine, before anything runs
    result = subprocess.run(command, env=environment(METAFMU="none"), capture_output=True, text=True, timeout=60)
    assert (result.returncode, result.stderr.replace("`none`", "`metafmu`")) == (1, f"error: {platform.node()}: {says}\n")


def test_dask_workers_with_metafmu_do_the_tasks_of_one_without_it(study, dask_worker, tmp_path):
    dask_worker(tmp_path)
    address = dask_worker(METAFMU.parent)
    result = dask_campaign("sample", study, tmp_path, "--shards", SHARDS, "--scheduler", address)
    assert tables(tmp_path) == tables(study.parent / "whole")
    warnings = [line for line in result.stderr.splitlines() if line.startswith("warning: ")]
    begin = f"warning: {platform.node()}: found no command `metafmu`, expected `metafmu` on the PATH, or its path in the variable METAFMU; the worker tcp://"
    assert len(warnings) == 1 and warnings[0].startswith(begin) and warnings[0].endswith(" gets no tasks"), result.stderr


def test_a_node_of_slurm_without_metafmu_is_reported_in_a_sentence(study, tmp_path):
    task = {"SLURM_ARRAY_TASK_ID": "1", "SLURM_ARRAY_TASK_COUNT": "1", "METAFMU": "none"}
    for command in [["slurm.sh", "sample"], ["slurm.sh", "compare"]]:
        result = subprocess.run([CAMPAIGN / command[0], command[1], study, tmp_path], env=environment(**task), cwd=ROOT, capture_output=True, text=True)
        assert result.returncode == 1 and result.stderr.endswith("its path in the variable METAFMU\n"), result.stderr
        assert result.stderr.count("\n") == 1 and "found no command `none`" in result.stderr, result.stderr


@pytest.fixture
def slow_study(tmp_path):
    (tmp_path / "program.py").write_text(SLOW_PROGRAM)
    path = tmp_path / "study.toml"
    path.write_text(SLOW_STUDY)
    metafmu("sample", path, "--out", tmp_path / "whole")
    assert (tmp_path / "calls").stat().st_size == SLOW_RUNS
    (tmp_path / "calls").unlink()
    return path


def shards_below(worker):
    """The shards that a process samples, and the processes of metafmu that do."""
    found = {}
    for process in psutil.Process(worker).children(recursive=True):
        try:
            command = process.cmdline()
        except psutil.Error:
            continue
        if command and command[0] == str(METAFMU) and "--shard" in command:
            found[command[command.index("--shard") + 1]] = process
    return found


def wait_until(condition, seconds=60):
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end, "waited too long"
        time.sleep(0.02)
    return found


def test_two_of_four_workers_that_are_killed_lose_nothing(slow_study, tmp_path, monkeypatch):
    for name, value in environment(RUN_SECONDS="0.4", RAYON_NUM_THREADS="1").items():
        monkeypatch.setenv(name, value)
    out, shards = tmp_path / "out", 8
    unfinished = lambda shard: out / f"unfinished-runs-{shard.replace('/', '-of-')}.bin"
    finished = lambda shard: out / f"shard-{shard.replace('/', '-of-')}.bin"
    runs = lambda shard: (unfinished(shard).stat().st_size - JOURNAL_BYTES) // RECORD_BYTES if unfinished(shard).exists() else 0
    with LocalCluster(n_workers=4, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        workers = list(client.run(os.getpid).values())
        command = [CAMPAIGN / "dask_campaign.py", "sample", slow_study, out, "--shards", shards, "--scheduler", cluster.scheduler_address]
        campaign = subprocess.Popen([sys.executable, *map(str, command)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        try:
            killed = {}
            for worker in workers[:2]:
                # two runs of eleven or twelve are finished
                begun = wait_until(lambda: {shard: process for shard, process in shards_below(worker).items() if runs(shard) >= 2})
                os.kill(worker, signal.SIGKILL)
                assert all(2 <= runs(shard) < SLOW_RUNS // shards and not finished(shard).exists() for shard in begun)
                # its command ends with it, and holds no lock
                wait_until(lambda: not any(map(is_alive, begun.values())), 10)
                assert not any(finished(shard).exists() for shard in begun)
                killed |= begun
            assert len(killed) == 2
            output, messages = campaign.communicate(timeout=120)
        finally:
            campaign.kill()
        assert campaign.returncode == 0, messages
        assert not set(client.run(os.getpid).values()) & set(workers[:2]), "the cluster replaced both"
    assert tables(out) == tables(tmp_path / "whole")
    assert output.count("sampled shard") == shards
    # only the run that a killed command was at is simulated again
    again = (tmp_path / "calls").stat().st_size - SLOW_RUNS
    assert again <= len(killed), again


def is_alive(process):
    return process.is_running() and process.status() != psutil.STATUS_ZOMBIE


def test_a_unit_waits_for_the_command_that_holds_its_lock(slow_study, tmp_path, monkeypatch):
    """A scheduler may lose a worker that is still at work."""
    monkeypatch.setenv("METAFMU", str(METAFMU))
    out = tmp_path / "out"
    command = [METAFMU, "sample", slow_study, "--out", out, "--shard", "1/4"]
    slow = environment(RUN_SECONDS="0.2", RAYON_NUM_THREADS="1")
    other = subprocess.Popen(command, env=slow, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wait_until((out / "unfinished-runs-1-of-4.bin").exists)
    with pytest.raises(tasks.Busy):
        tasks.sample_shard(slow_study, out, "1/4")
    assert tasks.run("sample", slow_study, out, "1/4") == "sample 1/4: finished already"
    assert other.wait(10) == 0 and (tmp_path / "calls").stat().st_size == 23
    # from here on the shard is an old one
    old = tasks.shard_version(out, "1/4")
    assert "sampled shard 1/4: 23 runs" in tasks.run("sample", slow_study, out, "1/4", old)


GRID_STUDY = f"""name = "grid"
[source]
system = "single-pendulum"
[time]
stop = 1
step = 0.05
[parameters]
L = {{ min = 0.1, max = 0.2 }}
c = {{ min = 0.0, max = 0.15 }}
[outputs]
theta = {{}}
[search] # trials that fail among them
method = "grid"
[search.space]
"training.optimizer" = ["adam", "adamw"]
"training.learning_rate" = {{ min = 1e-3, max = 1e-2, scale = "log", levels = 3 }}
"training.weight_decay" = [0.0, 0.01]
"network.hidden" = [
  [8],
  [6, 6],
]
{SMALL}"""


@pytest.fixture(scope="module")
def grid(tmp_path_factory):
    path = tmp_path_factory.mktemp("grid") / "study.toml"
    path.write_text(GRID_STUDY)
    assert metafmu("search", path, "--out", path.parent / "whole", check=False).returncode == 1
    return path


def searched(folder):
    with open(folder / "search.csv", newline="") as file:
        rows = [{**row, "seconds": None} for row in csv.DictReader(file)]
    return rows, (folder / "grid-best.toml").read_bytes()


def test_a_grid_that_is_divided_is_the_search(grid, tmp_path):
    expected = searched(grid.parent / "whole")
    assert len(expected[0]) == 24 and sum(row["status"] == "failed" for row in expected[0]) == 6
    slurm("search", grid, tmp_path / "slurm")
    assert searched(tmp_path / "slurm") == expected
    result = dask_campaign("search", grid, tmp_path / "dask")
    assert result.stdout.count("on held-out runs") == 6
    assert searched(tmp_path / "dask") == expected
    # nothing else is left
    assert sorted(path.name for path in [*(tmp_path / "dask").iterdir(), *grid.parent.iterdir()]) == ["grid-best.toml", "search.csv", "study.toml", "whole"]


def test_a_search_continues_where_tasks_are_missing_and_is_new_after_a_change(grid, tmp_path):
    study = tmp_path / "study.toml"
    study.write_bytes(grid.read_bytes())
    run = lambda *arguments: subprocess.run(
        [sys.executable, CAMPAIGN / "tasks.py", "search", study, tmp_path / "out", *arguments], capture_output=True, text=True, env=environment()
    )
    run("2/2")
    assert "search: 4 of 8 are missing: 0, 2, 4, 6" in run("merge").stderr
    assert run("2/2").stdout.splitlines() == [f"search {part}: finished already" for part in (1, 3, 5, 7)]
    run("1/2")
    study.write_text(study.read_text().replace("epochs = 2", "epochs = 3"))
    assert "search: 8 of 8 are missing" in run("merge").stderr
    study.write_bytes(grid.read_bytes())
    assert "is the best" in run("merge").stdout
    assert searched(tmp_path / "out")[0][9] == searched(grid.parent / "whole")[0][9]
    study.write_text(study.read_text().replace('method = "grid"', 'method = "halving"'))
    assert "search.method: found 'halving', expected \"grid\"" in run("1/2").stderr


def compared(folder):
    """The comparison but for times."""
    found = json.loads((folder / "comparison.json").read_text())
    for row in found["models"]:
        del row["predict_seconds_per_point"], row["fit_seconds"]
    with open(folder / "comparison.csv", newline="") as file:
        rows = [{**row, "fit_seconds": None, "predict_seconds_per_point": None} for row in csv.DictReader(file)]
    return found, rows


def test_a_comparison_that_is_divided_is_the_comparison(study, tmp_path, monkeypatch):
    monkeypatch.setenv("METAFMU", str(METAFMU))
    models = ["linear", "knn", "polynomial", "decision-tree"]
    path = tmp_path / "study.toml"
    path.write_text(STUDY + f"[network]\nhidden = [8]\n[training]\nepochs = 2\n[baselines]\nmodels = {models}\n{ANY}")
    out = tmp_path / "out"
    metafmu("sample", path, "--out", out)
    metafmu("train", path, "--out", out)
    metafmu("compare", path, "--out", out)
    expected = compared(out)
    assert [row["model"] for row in expected[0]["models"]] == ["network", *models]
    before = sorted(out.iterdir())
    for spread in (lambda: slurm("compare", path, out), lambda: dask_campaign("compare", path, out)):
        (out / "comparison.json").unlink()
        (out / "comparison.csv").unlink()
        spread()
        assert compared(out) == expected
        assert sorted(out.iterdir()) == before
    assert len(tasks.models(study)) == 12
