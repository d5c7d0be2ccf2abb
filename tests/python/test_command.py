"""The command around its verbs, and the scripts beside it: errors as JSON, folders that are missing, usage."""

import json
import shutil
import subprocess
import sys

import pytest
from conftest import ROOT, metafmu


@pytest.mark.parametrize("arguments", [("build", "none.toml", "--json"), ("evaluate", "wrong.toml", "--json"), ("train", "--json")])
def test_an_error_is_json_on_stdout_too(tmp_path, arguments):
    (tmp_path / "wrong.toml").write_text("nam = 1\n[time]\nstop = -1\nstep = 1\n")
    run = metafmu(*arguments, cwd=tmp_path, check=False)
    told = json.loads(run.stdout)
    assert run.returncode == told["exit_code"] == 2
    assert told["problems"] and all(problem.removeprefix("error: ") in run.stderr for problem in told["problems"])
    assert metafmu(*arguments[:-1], cwd=tmp_path, check=False).stdout == ""


def test_export_makes_no_folder_but_the_last(pendulum, tmp_path):
    model = pendulum.folder / "single-pendulum.safetensors"
    for out, message in [("none/here", "none/here: cannot write into the folder"), ("x.fmu", "x.fmu: cannot write into the folder: expected a folder")]:
        run = metafmu("export", model, "--out", out, cwd=tmp_path, check=False)
        assert run.returncode == 2 and message in run.stderr, run.stderr
        assert not list(tmp_path.iterdir())
    metafmu("export", model, "--out", "here", cwd=tmp_path)
    assert [path.name for path in (tmp_path / "here").iterdir()] == ["single-pendulum.fmu"]


def test_the_test_script_prints_its_usage():
    run = subprocess.run([ROOT / "scripts" / "test.sh", "--help"], capture_output=True, text=True, timeout=10, check=True, cwd="/")
    assert "Usage: scripts/test.sh [--quick | --ci | --all]" in run.stdout and "set -" not in run.stdout
    assert run.stderr == ""


def test_bounds_are_checked_of_a_study_whose_name_is_not_that_of_its_file(pendulum, tmp_path):
    study = tmp_path / "other.toml"
    study.write_text((ROOT / "examples" / "single-pendulum.toml").read_text())
    (tmp_path / "out").mkdir()
    shutil.copytree(pendulum.folder, tmp_path / "out" / "single-pendulum")
    command = [sys.executable, ROOT / "scripts" / "measure", "bounds", study, "--out", tmp_path / "out", "--runs", "40", "--seeds", "7"]
    lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    assert [line.split()[:2] for line in lines[1:]] == [["single-pendulum", name] for name in ("theta", "thetad", "thetadd")]
    assert all(75.0 < float(line.split()[-1]) <= 100.0 for line in lines[1:])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other.toml", "out"]


def test_the_fmus_of_c_are_made_without_mujoco(tmp_path):
    script = ROOT / "examples" / "fmu-source" / "make_fmus.py"
    code = f"import sys, runpy; sys.modules['mujoco'] = None; sys.argv = ['make_fmus.py', {str(tmp_path)!r}]; runpy.run_path({str(script)!r}, run_name='__main__')"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["chain.fmu", "van_der_pol.fmu"]
    assert "no Pendulum.fmu, which needs mujoco" in run.stderr
