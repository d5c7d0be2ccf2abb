"""Runs of mechanisms that cannot be simulated: left out and listed, in whatever way the runs are sampled."""

import json
import os
import pty
import re
import signal
import subprocess
import time

from conftest import METAFMU, ROOT, changed, metafmu

# below 1 the rod is shorter than the crank
RATIO = "L_over_r = { min = 0.85, max = 4.0 }"
STUDY = """name = "cranks"
[source]
mechanism = "slider-crank.toml"
{options}
[time]
stop = 5
step = 0.05
[parameters]
{ratio}
[outputs]
xB = {{}}
[sampling]
method = "sobol"
runs = 60
test_runs = 20
[network]
hidden = [4]
[training]
epochs = 2
validation = 0.25
"""


def write_study(folder, options="", ratio=RATIO, more=""):
    (folder / "slider-crank.toml").write_text((ROOT / "examples" / "mechanisms" / "slider-crank.toml").read_text())
    study = folder / "cranks.toml"
    study.write_text(STUDY.format(options=options, ratio=ratio) + more)
    return study


def samples(folder):
    return json.loads((folder / "samples.json").read_text())


def test_failed_runs_are_left_out_counted_and_listed_also_of_shards(tmp_path):
    study = write_study(tmp_path)
    result = metafmu("sample", study, "--out", tmp_path / "out")
    record = samples(tmp_path / "out")
    assert 1 <= record["failed_runs"] == len(record["failed"]) <= 8
    assert record["train_runs"] + record["test_runs"] == 80 - record["failed_runs"]
    assert f"warning: {record['failed_runs']} of 80 runs failed and are left out" in result.stderr
    for run in record["failed"]:
        assert run["parameters"]["L_over_r"] < 1 and re.search(r"`joints\.C` at t = [0-9.]+ s", run["reason"])
    for number in (1, 2, 3):
        metafmu("sample", study, "--out", tmp_path / "shards", "--shard", f"{number}/3")
    metafmu("sample", study, "--out", tmp_path / "shards", "--merge")
    for name in ("train.csv", "test.csv"):
        assert (tmp_path / "shards" / name).read_bytes() == (tmp_path / "out" / name).read_bytes()
    assert samples(tmp_path / "shards")["failed"] == record["failed"]
    # fewer may fail
    write_study(tmp_path, "max_failed = 0.0")
    for more in ([], ["--merge"]):
        result = metafmu("sample", study, "--out", tmp_path / "shards", *more, check=False)
        assert result.returncode == 2 and "at most 0 may (source.max_failed = 0)" in result.stderr, result.stderr


def test_rounds_of_a_target_leave_failed_runs_out(tmp_path):
    target = "[target]\nr2 = 0.9999999\nruns = 20\nmax_runs = 100\nadaptive = false\n"
    study = write_study(tmp_path, "max_failed = 0.3", RATIO.replace("4.0", "1.5"), target)
    result = metafmu("build", study, "--out", tmp_path / "out", check=False)
    assert result.returncode == 1 and "further runs failed and are left out, the first: " in result.stderr, result.stderr
    assert (tmp_path / "out" / "added.csv").exists()
    failed = samples(tmp_path / "out")
    assert metafmu("build", study, "--out", tmp_path / "out", "--resume", check=False).returncode == 1
    assert samples(tmp_path / "out") == failed


def stiff_study(folder):
    """Runs that take long: the pendulum on a spring of 3e4 rad/s. The first three have none and are done at once."""
    mechanism = changed(
        "mechanisms/single-pendulum.toml",
        ('coordinate = "pivot.angle"\n', 'coordinate = "pivot.angle"\nstiffness = "k"\n'),
        ("[parameters]\n", '[parameters]\nk = { default = 0, min = 0, max = 6e6, unit = "N.m/rad" }\n'),
    )
    (folder / "m.toml").write_text(mechanism)
    stiff = "".join(f"{500 + run}e4\n" for run in range(19))
    (folder / "points.csv").write_text(f"k\n0\n1\n2\n{stiff}")
    study = folder / "stiff.toml"
    study.write_text(
        'name = "stiff"\n[source]\nmechanism = "m.toml"\nmax_failed = 0.9\n[time]\nstop = 2\nstep = 0.01\n'
        '[parameters]\nk = { min = 0, max = 6e6, unit = "N.m/rad" }\n[outputs]\ntheta = {}\n'
        '[sampling]\nmethod = "list"\nfile = "points.csv"\ntest_runs = 2\n'
    )
    return study


def test_the_first_interrupt_ends_a_run_that_takes_long(tmp_path):
    command = [METAFMU, "sample", stiff_study(tmp_path), "--out", tmp_path / "out"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE)
    time.sleep(2)
    begin = time.monotonic()
    process.send_signal(signal.SIGINT)
    _, message = process.communicate(timeout=30)
    assert process.returncode == 130 and message.endswith(b"error: stopped\n"), message
    assert time.monotonic() - begin < 5


def test_the_progress_bar_says_that_nothing_moves(tmp_path):
    leader, follower = pty.openpty()
    command = [METAFMU, "sample", stiff_study(tmp_path), "--out", tmp_path / "out"]
    one_thread = {**os.environ, "RAYON_NUM_THREADS": "1"}
    process = subprocess.Popen(command, stderr=follower, stdout=subprocess.DEVNULL, env=one_thread)
    time.sleep(6)
    process.send_signal(signal.SIGINT)
    process.wait(30)
    os.close(follower)
    text = b""
    try:
        while chunk := os.read(leader, 65536):
            text += chunk
    except OSError:
        pass
    shown = re.findall(r"(\d+)/24 runs, ([0-9.]+)/s, ([^ ]+) left", text.decode())
    assert len(shown) > 5, text
    done, speed, left = shown[-1]
    assert int(done) < 24 and float(speed) < 1 and left != "0s", shown
