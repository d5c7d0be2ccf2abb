"""The command around its verbs, and the scripts beside it: errors as JSON, folders that are missing, usage."""

import json
import re
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
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]
    assert [row[:2] for row in rows] == [["single-pendulum", name] for name in ("theta", "thetad", "thetadd")]
    assert all(75.0 < float(row[-1]) <= 100.0 for row in rows)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other.toml", "out"]


def test_the_fmus_of_c_are_made_without_mujoco(tmp_path):
    script = ROOT / "examples" / "fmu-source" / "make_fmus.py"
    code = f"import sys, runpy; sys.modules['mujoco'] = None; sys.argv = ['make_fmus.py', {str(tmp_path)!r}]; runpy.run_path({str(script)!r}, run_name='__main__')"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["chain.fmu", "van_der_pol.fmu"]
    assert "no Pendulum.fmu, which needs mujoco" in run.stderr


def test_quiet_leaves_warnings_and_errors(tmp_path):
    (tmp_path / "points.csv").write_text("x,y\n" + "".join(f"{i},{i * i}\n" for i in range(30)))
    said = metafmu("new", "loud", "--table", "points.csv", cwd=tmp_path).stderr
    assert said
    assert metafmu("new", "still", "--table", "points.csv", "--quiet", cwd=tmp_path).stderr == ""
    assert metafmu("build", "none.toml", "-q", cwd=tmp_path, check=False).stderr.startswith("error: none.toml")
    assert "cannot be used with" in metafmu("build", "none.toml", "-q", "-v", check=False).stderr


def test_color_is_where_it_is_asked_for(tmp_path):
    plain = metafmu("build", "none.toml", cwd=tmp_path, check=False).stderr
    assert metafmu("build", "none.toml", "--color", "never", cwd=tmp_path, check=False).stderr == plain
    colored = metafmu("build", "none.toml", "--color", "always", cwd=tmp_path, check=False).stderr
    assert colored.startswith("\x1b[") and re.sub(r"\x1b\[[0-9;]*m", "", colored) == plain
    # usage errors, which clap writes
    assert metafmu("bild", "--color", "always", check=False).stderr.startswith("\x1b[")
    assert "\x1b" not in metafmu("bild", check=False).stderr
    assert "invalid value 'blue'" in metafmu("build", "x.toml", "--color", "blue", check=False).stderr


def test_the_number_of_threads_changes_no_byte(tmp_path):
    (tmp_path / "points.csv").write_text("x,z,y\n" + "".join(f"{i % 7},{i},{(i % 7) * i / 50}\n" for i in range(60)))
    metafmu("new", "map", "--table", "points.csv", cwd=tmp_path)
    for threads in ("1", "3"):
        metafmu("build", "map.toml", "--out", threads, "--threads", threads, cwd=tmp_path, check=False)
    one, three = ((tmp_path / threads / "map.safetensors").read_bytes() for threads in ("1", "3"))
    assert one == three
    assert "0 is not in 1..=1024" in metafmu("build", "map.toml", "--threads", "0", cwd=tmp_path, check=False).stderr


def test_version_answers_what_a_report_of_a_problem_needs():
    assert re.fullmatch(r"metafmu \d+\.\d+\.\d+\n", metafmu("--version").stdout)
    told = metafmu("--version", "--verbose").stdout
    assert "FMUs for: " in told and "x86_64-linux" in told and "threads" in told
