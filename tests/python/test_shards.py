"""Samplings spread over machines: shards, their merge, and the campaigns in examples/campaign."""

import json
import os
import subprocess
import sys

import pytest
from conftest import METAFMU, ROOT, metafmu

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


def environment(**variables):
    return {**os.environ, "PATH": f"{METAFMU.parent}:{os.environ['PATH']}", **variables}


def test_the_array_job_for_slurm(study, tmp_path):
    script = ROOT / "examples" / "campaign" / "slurm.sh"
    for number in range(1, SHARDS + 1):
        task = {"SLURM_ARRAY_TASK_ID": str(number), "SLURM_ARRAY_TASK_COUNT": str(SHARDS), "SLURM_CPUS_PER_TASK": "1"}
        subprocess.run([script, study, tmp_path], check=True, env=environment(**task))
    subprocess.run([script, study, tmp_path], check=True, env=environment())
    assert tables(tmp_path) == tables(study.parent / "whole")


def test_the_campaign_on_a_dask_cluster(study, tmp_path):
    script = ROOT / "examples" / "campaign" / "dask_campaign.py"
    command = [sys.executable, script, study, tmp_path, str(SHARDS)]
    result = subprocess.run(command, env=environment(), capture_output=True, text=True, timeout=120)
    assert result.returncode == 0, result.stderr
    assert result.stdout.count("sampled shard") == SHARDS
    assert tables(tmp_path) == tables(study.parent / "whole")
