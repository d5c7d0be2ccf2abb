"""FMUs as sources: campaigns over one that crashes, hangs and fails, and surrogates of the FMUs in examples/fmu-source."""

import csv
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
from conftest import METAFMU, OTHER_THREADS, ROOT, SMALL, metafmu
from fmpy import read_model_description, simulate_fmu
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp
from scipy.linalg import expm

sys.path.insert(0, str(ROOT / "examples" / "fmu-source"))
import make_fmus

# where faulty.c goes wrong: range of k[1], and how
FAULTS = [
    (0.1, 0.15, "signal: 11 (SIGSEGV)"),
    (0.3, 0.35, "signal: 6 (SIGABRT)"),
    (0.5, 0.55, "took longer than 1s"),
    (0.7, 0.75, "fmi2DoStep returned error: no solution for 0.5"),
    (0.8, 0.85, "output `tip.y[1,2]` is NaN at 0.5 s"),
    (0.95, 0.97, "the FMU ended the simulation at 0.45 s"),
]
STUDY = """name = "campaign"
[source]
fmu = "faulty.fmu"
time_limit = 1
max_failed = 0.5
[time]
stop = 1
step = 0.05
[parameters]
"rod.k[1]" = { min = 0, max = 1, unit = "N/m" }
"rod.k[2,1]" = { min = 0, max = 2 }
[outputs]
"tip.y[1,2]" = { unit = "m" }
"der(z)" = {}
""" + SMALL


def fault(k1):
    return next((reason for low, high, reason in FAULTS if low <= k1 < high), None)


@pytest.fixture()
def folder(tmp_path):
    make_fmus.build_c(ROOT / "tests" / "data" / "faulty" / "faulty.c", tmp_path / "faulty.fmu")
    (tmp_path / "campaign.toml").write_text(STUDY)
    # campaigns unpack FMUs here, where the tests check for remains
    (tmp_path / "temporary").mkdir()
    return tmp_path


def environment(folder, **variables):
    return {**os.environ, "TMPDIR": str(folder / "temporary"), **variables}


def sample(folder, *arguments, out="out", **variables):
    command = [METAFMU, "sample", "campaign.toml", "--out", out, *arguments]
    return subprocess.run(command, cwd=folder, env=environment(folder, **variables), capture_output=True, text=True)


def rows(path):
    with open(path) as file:
        return list(csv.DictReader(file))


def children(process):
    """Process ids of the workers."""
    tasks = Path(f"/proc/{process.pid}/task").iterdir()
    return [int(child) for task in tasks for child in (task / "children").read_text().split()]


def is_alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def wait_for(condition, seconds=20):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_a_campaign_over_a_crashing_and_hanging_fmu_completes_and_reports(folder):
    marks = folder / "marks"
    marks.mkdir()
    result = sample(folder, FAULTY_MARKS=str(marks))
    assert result.returncode == 0, result.stderr
    plan = list(csv.DictReader(sample(folder, "--dry-run").stdout.splitlines()))
    bad = [run for run in plan if fault(float(run["rod.k[1]"]))]
    assert {fault(float(run["rod.k[1]"])) for run in bad} == {reason for _, _, reason in FAULTS}

    record = json.loads((folder / "out" / "samples.json").read_text())
    assert record["failed_runs"] == len(record["failed"]) == len(bad)
    assert f"warning: {len(bad)} of 70 runs failed and are left out" in result.stderr
    for run, failed in zip(bad, record["failed"], strict=True):
        assert (failed["set"], str(failed["run"])) == (run["set"], run["run"])
        assert failed["parameters"] == {name: float(run[name]) for name in ("rod.k[1]", "rod.k[2,1]")}
        assert fault(float(run["rod.k[1]"])) in failed["reason"]
    assert any("faulty: assertion failed" in failed["reason"] for failed in record["failed"])
    # an abort that happens once is made good by the second try
    assert list(marks.iterdir())

    for part in ("train", "test"):
        good = [run for run in plan if run["set"] == part and not fault(float(run["rod.k[1]"]))]
        table = rows(folder / "out" / f"{part}.csv")
        assert len(table) == 21 * len(good)
        for row in table:
            k1, k2, t = (float(row[name]) for name in ("rod.k[1]", "rod.k[2,1]", "time"))
            assert abs(float(row["tip.y[1,2]"]) - (k1 * np.cos(2 * t) + k2)) < 1e-12
            assert abs(float(row["der(z)"]) - k1 * t) < 1e-12
        assert {row["rod.k[1]"] for row in table} == {run["rod.k[1]"] for run in good}

    # one worker or two: the same
    assert sample(folder, out="alone", FAULTY_MARKS=str(marks), **OTHER_THREADS).returncode == 0
    for name in ("train.csv", "test.csv"):
        assert (folder / "alone" / name).read_bytes() == (folder / "out" / name).read_bytes()
    assert not list((folder / "temporary").iterdir())


def test_an_fmu_whose_instances_share_state_is_refused_or_gets_a_process_a_run(folder):
    study = folder / "campaign.toml"
    study.write_text(STUDY.replace("time_limit = 1", "time_limit = 20").replace("min = 0, max = 1", "min = 0, max = 0.09"))
    for threads in ("1", "3"):
        result = sample(folder, SHARED="1", RAYON_NUM_THREADS=threads)
        assert result.returncode == 2 and "campaign.toml:3: source.fmu: output `der(z)` is " in result.stderr, result.stderr
        assert "when that is repeated after other runs: a difference of 0.001, " in result.stderr, result.stderr
        assert not (folder / "out" / "train.csv").exists()
    # no process has so little memory
    study.write_text(study.read_text().replace("time_limit", "memory_limit = 0.1\ntime_limit"))
    result = sample(folder, SHARED="1", out="separate")
    assert result.returncode == 0, result.stderr
    assert {float(row["der(z)"]) for row in rows(folder / "separate" / "test.csv") if float(row["time"]) == 0} == {0.001}


def test_too_many_failures_end_the_campaign_and_what_was_done_counts_when_more_are_allowed(folder):
    study = folder / "campaign.toml"
    study.write_text(STUDY.replace("max_failed = 0.5", "max_failed = 0.02"))
    result = sample(folder, SLOW="300")
    assert result.returncode == 2 and ".fmu: 2 of 70 runs failed, at most 1 may (source.max_failed = 0.02)" in result.stderr
    assert "rod.k[1] = " in result.stderr and not (folder / "out" / "train.csv").exists()
    study.write_text(STUDY)
    result = sample(folder)
    assert result.returncode == 0 and "kept from a sampling that was not finished" in result.stderr


def test_a_campaign_that_is_killed_loses_no_finished_run_and_leaves_nothing_behind(folder):
    (folder / "campaign.toml").write_text(STUDY.replace("min = 0, max = 1,", "min = 0.56, max = 1,"))
    command = [METAFMU, "sample", "campaign.toml", "--out", "out"]
    log = subprocess.PIPE
    process = subprocess.Popen(command, cwd=folder, env=environment(folder, SLOW="100"), stderr=log)
    journal = folder / "out" / "unfinished-runs.bin"
    size = 8 * (2 + 2 * 21) + 8
    wait_for(lambda: journal.exists() and journal.stat().st_size > 32 + 5 * size)
    workers = children(process)
    assert workers
    process.kill()
    process.communicate()
    finished = (journal.stat().st_size - 32) // size
    wait_for(lambda: not any(map(is_alive, workers)))
    wait_for(lambda: not list((folder / "temporary").iterdir()))
    result = sample(folder)
    assert f"{finished} runs are kept from a sampling that was not finished" in result.stderr
    assert sample(folder, out="undisturbed").returncode == 0
    for name in ("train.csv", "test.csv"):
        assert (folder / "out" / name).read_bytes() == (folder / "undisturbed" / name).read_bytes()
    assert not journal.exists()


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGKILL])
def test_a_hanging_fmu_ends_with_the_program(folder, end):
    text = STUDY.replace("min = 0, max = 1,", "min = 0.5, max = 0.549,").replace("time_limit = 1", "time_limit = 600")
    (folder / "campaign.toml").write_text(text)
    command = [METAFMU, "sample", "campaign.toml", "--out", "out"]
    process = subprocess.Popen(command, cwd=folder, env=environment(folder), stderr=subprocess.PIPE)
    wait_for(lambda: children(process))
    time.sleep(0.3)
    workers = children(process)
    process.send_signal(end)
    _, message = process.communicate(timeout=10)
    if end == signal.SIGINT:
        assert (process.returncode, message) == (130, b"error: stopped\n")
    wait_for(lambda: not any(map(is_alive, workers)))
    wait_for(lambda: not list((folder / "temporary").iterdir()))


def test_shards_with_failed_runs_are_merged_as_if_they_were_one_sampling(folder):
    # nothing hangs there
    study = folder / "campaign.toml"
    study.write_text(STUDY.replace("min = 0, max = 1,", "min = 0.56, max = 1,"))
    assert sample(folder).returncode == 0
    for number in (1, 2, 3):
        assert sample(folder, "--shard", f"{number}/3", out="shards").returncode == 0
    result = sample(folder, "--merge", out="shards")
    assert result.returncode == 0 and "runs failed and are left out" in result.stderr
    for name in ("train.csv", "test.csv"):
        assert (folder / "shards" / name).read_bytes() == (folder / "out" / name).read_bytes()
    failed = [json.loads((folder / out / "samples.json").read_text())["failed"] for out in ("out", "shards")]
    assert failed[0] and failed[0] == failed[1]
    # the share that may fail is one of all shards together
    study.write_text(study.read_text().replace("max_failed = 0.5", "max_failed = 0.1"))
    result = sample(folder, "--merge", out="shards")
    assert result.returncode == 2 and "of 70 runs failed, at most 7 may" in result.stderr


def test_a_search_leaves_failed_runs_out(folder):
    # nothing hangs there
    text = STUDY.replace("min = 0, max = 1,", "min = 0.6, max = 1,")
    text += "[search]\nmethod = 'grid'\n[search.space]\n'network.hidden' = [[4], [5]]\n'sampling.runs' = [60, 40]\n"
    (folder / "campaign.toml").write_text(text)
    command = [METAFMU, "search", "campaign.toml", "--out", "out"]
    result = subprocess.run(command, cwd=folder, env=environment(folder), capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert [row["status"] for row in rows(folder / "out" / "search.csv")] == ["finished"] * 4
    # the best study lies elsewhere and finds the FMU
    assert subprocess.run([METAFMU, "sample", "out/campaign-best.toml"], cwd=folder, env=environment(folder)).returncode == 0


def test_runs_that_fail_do_not_keep_a_target_from_being_pursued(folder):
    # nothing hangs there
    text = STUDY.replace("min = 0, max = 1,", "min = 0.56, max = 1,").replace("test_runs = 10", "test_runs = 20")
    text = text.replace("epochs = 2", "epochs = 2\nvalidation = 0.25")
    study = folder / "campaign.toml"
    study.write_text(text + "[target]\nr2 = 0.9999999\nruns = 20\nmax_runs = 85\n")
    build = lambda: subprocess.run([METAFMU, "build", study], cwd=folder, env=environment(folder), capture_output=True, text=True)
    result = build()
    assert result.returncode == 1 and "no more runs allowed" in result.stderr, result.stderr
    rounds = rows(folder / "out" / "campaign" / "rounds.csv")
    failed = 60 - int(rounds[0]["runs"])
    assert failed > 0 and int(rounds[-1]["runs"]) == 85
    # some of those added failed, too
    assert any(20 > int(after["runs"]) - int(before["runs"]) > 0 for before, after in zip(rounds, rounds[1:-1])), rounds
    added = rows(folder / "out" / "campaign" / "added.csv")
    assert len({row["run"] for row in added}) == 85 - 60 + failed
    assert not any(fault(float(row["rod.k[1]"])) for row in added)
    # more than may
    study.write_text(study.read_text().replace("max_failed = 0.5", "max_failed = 0.02"))
    result = build()
    assert result.returncode == 2 and "runs failed, at most 1 may (source.max_failed = 0.02)" in result.stderr, result.stderr


# ---- Other verbs that run an FMU -------------------------------------------------------------------------------------


def run(folder, *arguments, **variables):
    command = [METAFMU, *arguments]
    return subprocess.run(command, cwd=folder, env=environment(folder, **variables), capture_output=True, text=True, timeout=60)


ENDS = {
    "exit": "the FMU ended its process with exit code 0",
    "crash": "its process ended with signal: 11 (SIGSEGV)",
    "hang": "took longer than 1 s (--time-limit)",
    "orphan": "the FMU ended its process with exit code 3",
}


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize(
    ("function", "check"),
    [
        ("fmi2Instantiate", "an instance with a wrong token"),
        ("fmi2DoStep", "the default experiment"),
        ("fmi2Reset", "a run after a reset"),
    ],
)
def test_an_fmu_that_ends_its_process_does_not_pass_the_validation(folder, function, check, end):
    result = run(folder, "validate", "faulty.fmu", "--json", "--time-limit", "1", FAULTY=f"{function}:{end}")
    assert result.returncode == 1, result.stderr
    # what it prints is elsewhere, and does nothing to a terminal
    report = json.loads(result.stdout)
    assert [problem["message"] for problem in report["problems"]][-1].startswith(f"co-simulation, {check}: {ENDS[end]}")
    assert f"co-simulation after {check}: the process had ended" in report["not_checked"]
    if function != "fmi2Instantiate":
        assert '{"Done": 3}\n\\u001b[31mhello from the FMU\n' in result.stderr
    assert not list((folder / "temporary").iterdir())


@pytest.mark.parametrize("end", ENDS)
def test_an_fmu_that_ends_its_process_ends_a_simulation_with_an_error(folder, end):
    arguments = ["simulate", "faulty.fmu", "--time-limit", "1"]
    for output in ([], ["--output", "table.csv"]):
        result = run(folder, *arguments, *output, FAULTY=f"fmi2DoStep:{end}")
        assert (result.returncode, result.stdout) == (2, "")
        assert f"error: faulty.fmu: in the simulation, at 0 s or later, " in result.stderr and ENDS[end] in result.stderr
        assert not (folder / "table.csv").exists() and not list((folder / "temporary").iterdir())
    result = run(folder, *arguments, FAULTY=f"fmi2Instantiate:{end}")
    assert result.returncode == 2 and f"when it was loaded or instantiated, " in result.stderr and ENDS[end] in result.stderr


def test_what_an_fmu_prints_is_no_result(folder):
    result = run(folder, "simulate", "faulty.fmu")
    assert result.returncode == 0 and "hello from the FMU" in result.stderr and "\033" not in result.stderr
    table = list(csv.DictReader(result.stdout.splitlines()))
    assert len(table) == 21 and set(table[0]) == {"time", "tip.y[1,2]"}
    for row in table:
        assert abs(float(row["tip.y[1,2]"]) - (0.6 * np.cos(2 * float(row["time"])) + 0.5)) < 1e-12


def test_a_failure_late_in_a_long_simulation_prints_what_came_before(folder):
    # of less than a megabyte nothing is printed; of more, what was there
    for step, printed in (("0.05", False), ("0.000005", True)):
        result = run(folder, "simulate", "faulty.fmu", "--start", "rod.k[1]=0.72", "--step-size", step)
        assert result.returncode == 2 and bool(result.stdout) == printed
        assert "error: fmi2DoStep returned error: no solution for 0.5" in result.stderr


def test_the_rows_of_a_long_simulation_are_not_kept(folder):
    code = "import resource, subprocess, sys; subprocess.run(sys.argv[1:], check=True); print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    size = lambda step: int(
        run_python(folder, code, METAFMU, "simulate", "faulty.fmu", "--step-size", step, "--output", "table.csv")
    )
    short, long = size("0.05"), size("0.0000005")
    with open(folder / "table.csv") as file:
        assert sum(1 for _ in file) == 2_000_002
    # two million rows of two numbers alone are 31 MiB
    assert long < short + 10_000, (short, long)


def run_python(folder, code, *arguments):
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, cwd=folder, env=environment(folder), capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
@pytest.mark.parametrize("verb", ["validate", "simulate", "sample"])
def test_nothing_is_left_behind_whatever_ends_the_program(folder, verb, end):
    (folder / "campaign.toml").write_text(STUDY.replace("time_limit = 1", "time_limit = 600"))
    arguments = {"validate": ["faulty.fmu"], "simulate": ["faulty.fmu"], "sample": ["campaign.toml"]}[verb]
    env = environment(folder, FAULTY="fmi2DoStep:hang")
    process = subprocess.Popen([METAFMU, verb, *arguments], cwd=folder, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    wait_for(lambda: children(process))
    time.sleep(0.3)
    workers = children(process)
    process.send_signal(end)
    output, message = process.communicate(timeout=10)
    assert output == b"" and process.returncode == (130 if end == signal.SIGINT else -end)
    assert end != signal.SIGINT or message.endswith(b"error: stopped\n")
    wait_for(lambda: not any(map(is_alive, workers)))
    wait_for(lambda: not list((folder / "temporary").iterdir()))


def test_what_a_killed_process_and_its_workers_left_is_removed_by_the_next_one(folder):
    env = environment(folder, FAULTY="fmi2DoStep:hang")
    process = subprocess.Popen([METAFMU, "simulate", "faulty.fmu"], cwd=folder, env=env, stderr=subprocess.DEVNULL)
    wait_for(lambda: children(process))
    time.sleep(0.3)
    workers = children(process)
    for pid in (*workers, process.pid):
        os.kill(pid, signal.SIGSTOP)
    # in use: it is left alone
    assert run(folder, "simulate", "faulty.fmu").returncode == 0
    left = list((folder / "temporary").iterdir())
    assert len(left) == 1
    for pid in (*workers, process.pid):
        os.kill(pid, signal.SIGKILL)
    process.wait()
    wait_for(lambda: not any(map(is_alive, workers)))
    assert list((folder / "temporary").iterdir()) == left
    assert run(folder, "simulate", "faulty.fmu").returncode == 0
    assert not list((folder / "temporary").iterdir())


def test_a_temporary_folder_that_cannot_be_used_is_no_problem_of_the_fmu(folder):
    for verb in ("validate", "simulate"):
        result = run(folder, verb, "faulty.fmu", TMPDIR=str(folder / "nowhere"))
        assert (result.returncode, result.stdout) == (2, "")
        assert f"error: {folder / 'nowhere'}: cannot create a folder in: No such file or directory" in result.stderr


def test_a_temporary_folder_that_is_full_is_no_problem_of_the_fmu(folder):
    def no_room():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))

    command = [METAFMU, "validate", "faulty.fmu"]
    options = {"preexec_fn": no_room, "restore_signals": False}
    result = subprocess.run(command, cwd=folder, env=environment(folder), capture_output=True, text=True, **options)
    assert (result.returncode, result.stdout) == (2, "") and "cannot write: File too large" in result.stderr, result.stderr
    assert not list((folder / "temporary").iterdir())


@pytest.mark.parametrize("size", ['<Dimension start="9000000000000000000"/>', '<Dimension valueReference="99"/>'])
def test_arrays_of_an_unreasonable_size_are_refused_by_every_verb(tmp_path, size):
    source = ROOT / "examples" / "fmu-source" / "chain"
    shutil.copytree(source, tmp_path / "chain")
    description = (source / "modelDescription.xml").read_text()
    fixed = '<Dimension start="3"/>'
    assert fixed in description
    parameter = '<UInt64 name="count" valueReference="99" causality="structuralParameter" variability="fixed" start="9000000000000000000"/>'
    changed = description.replace(fixed, size).replace("<ModelVariables>", "<ModelVariables>\n" + parameter, 1)
    (tmp_path / "chain" / "modelDescription.xml").write_text(changed)
    make_fmus.build_c(tmp_path / "chain" / "chain.c", tmp_path / "chain.fmu")
    (tmp_path / "temporary").mkdir()
    (tmp_path / "chain.toml").write_text(
        STUDY.replace("faulty", "chain").replace("rod.k[1]", "mass").replace('"rod.k[2,1]"', "force").replace("tip.y[1,2]", "position[1]")
    )
    says = 'variable "position" has 9000000000000000000 elements, expected at most 16777216 of all variables'
    for arguments in (["new", "y", "--fmu", "chain.fmu"], ["sample", "chain.toml"], ["simulate", "chain.fmu"]):
        result = run(tmp_path, *arguments)
        assert (result.returncode, result.stdout) == (2, "") and says in result.stderr, result.stderr
    result = run(tmp_path, "validate", "chain.fmu")
    assert result.returncode == 1 and says in result.stdout, result.stdout


def test_an_array_of_very_many_elements_does_not_become_outputs(tmp_path):
    source = ROOT / "examples" / "fmu-source" / "chain"
    description = (source / "modelDescription.xml").read_text()
    with zipfile.ZipFile(tmp_path / "chain.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", description.replace('<Dimension start="3"/>', '<Dimension start="16000000"/>'))
        archive.writestr("binaries/x86_64-linux/chain.so", "")
    (tmp_path / "temporary").mkdir()
    result = run(tmp_path, "new", "x", "--fmu", "chain.fmu")
    assert result.returncode == 0, result.stderr
    study = (tmp_path / "x.toml").read_text()
    assert '\nenergy = {' in study and '\n# "position[1]" = {' in study and "\n# and 15999960 more in the FMU\n" in study
    assert len(study) < 10_000 and "[arrays]" not in study


# ---- Surrogates that take the place of their FMUs -------------------------------------------------------------------


def surrogate_of(fmu, folder, env=None, runs=120, epochs=15, **changes):
    """The two commands, with fewer runs and a smaller network than `metafmu new` proposes."""
    run = lambda *arguments: subprocess.run([METAFMU, *arguments], cwd=folder, env=env, capture_output=True, text=True)
    result = run("new", "x", "--fmu", fmu)
    assert result.returncode == 0, result.stderr
    text = (folder / "x.toml").read_text()
    smaller = {
        "runs = 1000": f"runs = {runs}",
        "test_runs = 200": "test_runs = 10",
        "hidden = [64, 64, 64, 64, 64, 64]": "hidden = [48, 48]",
        "batch = 1024": "batch = 256",
    }
    for old, new in {**smaller, **changes}.items():
        assert old in text, old
        text = text.replace(old, new)
    text = re.sub(r"(?m)^epochs = \d+", f"epochs = {epochs}", text)
    (folder / "x.toml").write_text(text)
    result = run("build", "x.toml", "--out", "out")
    assert result.returncode == 0, result.stderr
    # of the version that its source has
    (surrogate,) = (folder / "out").glob("*.fmu")
    assert validate_fmu(surrogate) == []
    return surrogate, json.loads((folder / "out" / "metrics.json").read_text())


def variables(fmu):
    return {variable.name: variable for variable in read_model_description(fmu).modelVariables}


def expect_same(found, expected, names):
    """Names, units and what they are to a host. What was constant in each run is a fixed parameter, also an input."""
    for name in names:
        new, old = found[name], expected[name]
        for attribute in ("unit", "type", *([] if old.dimensions else ["description"])):
            assert getattr(new, attribute) == getattr(old, attribute), (name, attribute)
        was_set = old.causality in ("parameter", "input")
        kind = ("parameter", "fixed") if was_set else (old.causality, old.variability)
        assert (new.causality, new.variability) == kind, name


def test_an_oscillator_of_c_becomes_a_surrogate_that_takes_its_place(tmp_path):
    fmu = make_fmus.build_c(ROOT / "examples" / "fmu-source" / "van-der-pol" / "van_der_pol.c", tmp_path / "van_der_pol.fmu")
    surrogate, metrics = surrogate_of(fmu, tmp_path)
    assert all(output["r2"] > 0.99 for output in metrics["outputs"].values()), metrics
    found = variables(surrogate)
    expect_same(found, variables(fmu), ["mu", "x0_start", "x0", "x1"])
    assert float(found["x0_start"].start) == 2.0 and float(found["mu"].start) == 1.0
    # the table is the oscillator's: scipy solves its equation
    table = rows(tmp_path / "out" / "test.csv")
    run = [row for row in table if row["run"] == "3"]
    mu, start = (float(run[0][name]) for name in ("mu", "x0_start"))
    times = [float(row["time"]) for row in run]
    rates = lambda _, x: [x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]]
    expected = solve_ivp(rates, (0, 5), [start, 0.0], "DOP853", times, rtol=1e-10, atol=1e-10).y
    assert np.allclose([[float(row["x0"]), float(row["x1"])] for row in run], expected.T, atol=1e-7)
    # and so is the surrogate
    start_values = {"mu": mu, "x0_start": start}
    options = {"start_values": start_values, "output": ["x0", "x1"], "stop_time": 5.0, "output_interval": 0.02}
    ours, theirs = (simulate_fmu(file, **options) for file in (surrogate, fmu))
    for name in ("x0", "x1"):
        assert np.sqrt(np.mean((ours[name] - theirs[name]) ** 2)) < 0.15 * np.std(theirs[name])


def test_an_input_of_an_fmu_stays_an_input_if_the_study_says_so(tmp_path):
    fmu = make_fmus.build_c(ROOT / "examples" / "fmu-source" / "chain" / "chain.c", tmp_path / "chain.fmu")
    surrogate, _ = surrogate_of(fmu, tmp_path, **{'unit = "N" }': 'unit = "N", variability = "continuous" }'})
    force = variables(surrogate)["force"]
    assert (force.causality, force.variability) == ("input", "continuous")
    assert "after a change outputs are as if it had been so from the start" in force.description
    signal = np.array([(0.0, 5.0), (1.0, 5.0), (1.0, 10.0), (2.0, 10.0)], dtype=[("time", float), ("force", float)])
    result = simulate_fmu(surrogate, input=signal, output=["in_domain"], stop_time=2.0, output_interval=0.1)
    assert result["in_domain"][result["time"] < 0.95].all() and not result["in_domain"][result["time"] > 1.15].any()


def test_an_fmi_3_fmu_with_an_array_keeps_it_and_its_input_becomes_a_parameter(tmp_path):
    fmu = make_fmus.build_c(ROOT / "examples" / "fmu-source" / "chain" / "chain.c", tmp_path / "chain.fmu")
    surrogate, metrics = surrogate_of(fmu, tmp_path, **{"# constants = { NAME = VALUE }": "constants = { mass = 2 }"})
    assert read_model_description(surrogate).fmiVersion == "3.0"
    assert all(output["r2"] > 0.99 for output in metrics["outputs"].values()), metrics
    found, expected = variables(surrogate), variables(fmu)
    expect_same(found, expected, ["spring.stiffness", "spring.damping", "force", "position", "energy"])
    assert found["position"].dimensions[0].start == 3 and "position[2]" in found
    # the table is that of the linear system: the matrix exponential solves it
    run = [row for row in rows(tmp_path / "out" / "test.csv") if row["run"] == "1"]
    k, d, force = (float(run[0][name]) for name in ("spring.stiffness", "spring.damping", "force"))
    coupling = np.array([[-2.0, 1, 0], [1, -2, 1], [0, 1, -1]]) / 2.0
    system = np.zeros((7, 7))
    system[:3, 3:6], system[3:6, :3], system[3:6, 3:6] = np.eye(3), k * coupling, d * coupling
    system[5, 6] = force / 2.0
    for row in run:
        state = expm(system * float(row["time"])) @ [0, 0, 0, 0, 0, 0, 1]
        assert np.allclose([float(row[f"position[{i}]"]) for i in (1, 2, 3)], state[:3], atol=1e-9)


def test_a_pendulum_of_mujoco_becomes_a_surrogate(tmp_path):
    """PythonFMU around MuJoCo: nobody here wrote the simulator, nor what makes an FMU of it."""
    fmu = make_fmus.build_python(ROOT / "examples" / "fmu-source" / "pendulum.py", tmp_path)
    surrogate, metrics = surrogate_of(fmu, tmp_path, make_fmus.activated(), runs=60, epochs=60)
    assert all(output["r2"] > 0.99 for output in metrics["outputs"].values()), metrics
    expect_same(variables(surrogate), variables(fmu), ["upper.length", "damping"])
    assert float(variables(surrogate)["upper.angle0"].start) == 1.2
    # MuJoCo itself, without any FMU
    from pendulum import OUTPUTS, Pendulum

    run = [row for row in rows(tmp_path / "out" / "test.csv") if row["run"] == "2"]
    pendulum = Pendulum(instance_name="x")
    pendulum.values = {name: float(run[0][name]) for name in pendulum.values}
    pendulum.enter_initialization_mode()
    for index, row in enumerate(run):
        found = [float(row[name]) for name in OUTPUTS]
        assert np.allclose(found, [pendulum.output(i) for i in range(4)], rtol=0, atol=1e-12), index
        pendulum.do_step(0.01 * index, 0.01)


def test_an_fmu_that_needs_python_finds_it_or_says_what_to_do(tmp_path):
    """Its binary refers to symbols of Python and to no library that has them."""
    fmu = make_fmus.build_python(ROOT / "examples" / "fmu-source" / "pendulum.py", tmp_path)
    simulate = lambda env: subprocess.run([METAFMU, "simulate", fmu], cwd=tmp_path, env=env, capture_output=True, text=True)
    result = simulate(make_fmus.activated())
    assert result.returncode == 0, result.stderr
    # what worked before still does
    assert simulate(make_fmus.python_environment()).stdout == result.stdout
    # an interpreter without a shared library, none, and one that fails
    bare = tmp_path / "bare"
    bare.mkdir()
    python = bare / "python3"
    for script, says in [
        (None, "but `python3` cannot be started: No such file or directory"),
        ("echo oh dear >&2; exit 7", "but `python3` ended with exit status: 7: oh dear"),
        (
            """echo '{"program": "/my/python3", "version": "3.99", "libraries": ["/my/libpython3.99.so"], "home": "/my", "paths": []}'""",
            "but `python3`, which is /my/python3, has no shared library: install libpython3.99, or put a Python that has one first on the PATH",
        ),
    ]:
        if script:
            python.write_text(f"#!/bin/sh\n{script}\n")
            python.chmod(0o755)
        result = simulate({**os.environ, "PATH": str(bare)})
        assert result.returncode == 2 and f"undefined symbol: _Py_NoneStruct: it needs Python, {says}" in result.stderr, result.stderr


def test_variables_that_cannot_be_used_are_refused_with_the_reason(folder):
    for old, new, says in [
        ('"rod.k[1]" =', '"rod.k" =', "parameters.rod.k: the FMU has no variable to be set `rod.k`, expected one of rod.k[1], rod.k[2,1]"),
        ('"rod.k[1]" =', "count =", "parameters.count: is of type Integer: only real numbers are varied"),
        ("max = 1,", "max = 1.5,", "parameters.rod.k[1]: range from 0 to 1.5, the FMU takes 0 to 1"),
        ('unit = "N/m"', 'unit = "N/mm"', "parameters.rod.k[1].unit: `N/mm`, expected `N/m`"),
        ('"der(z)" =', '"count" =', "outputs.count: is of type Integer: only real numbers are predicted"),
        ("time_limit = 1", "time_limit = 0", "source.time_limit: 0, expected a positive number"),
        ("time_limit = 1", 'constants = { "der(z)" = 1 }', "source.constants.der(z): is calculated by the FMU"),
        ("time_limit = 1", "tolerance = 1e-6", "source.tolerance: belongs to model exchange; this FMU is for co-simulation"),
        ("time_limit = 1", "step = 0.02", "source.step: 0.02 s does not divide the time between two rows, 0.05 s"),
    ]:
        assert old in STUDY
        (folder / "campaign.toml").write_text(STUDY.replace(old, new, 1))
        result = sample(folder)
        assert result.returncode == 2 and says in result.stderr, (new, result.stderr)
    # what is found only when it is loaded
    (folder / "campaign.toml").write_text(STUDY)
    source = folder / "broken.c"
    source.write_text("extern int nowhere;\nint *fmi2GetVersion = &nowhere;\n")
    description = (ROOT / "tests" / "data" / "faulty" / "modelDescription.xml").read_text()
    (folder / "modelDescription.xml").write_text(description.replace('"faulty"', '"broken"'))
    make_fmus.build_c(source, folder / "faulty.fmu")
    result = sample(folder)
    assert result.returncode == 2 and "undefined symbol: nowhere" in result.stderr, result.stderr
