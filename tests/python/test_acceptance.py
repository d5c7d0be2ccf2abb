"""Reasons of verdicts: constant outputs, stopped trainings, useless surrogates."""

import json
import signal
import subprocess
import zipfile

import fmpy
import numpy as np
import pandas as pd
import pytest
from conftest import METAFMU, ROOT, changed

CART = """
gravity = [0, -9.81]
[parameters]
m = { default = 1.0, min = 0.5, max = 2.0, unit = "kg" }
[bodies.cart]
mass = "m"
inertia = 0.1
[joints]
rail = { type = "prismatic", axis = [1, 0], between = ["ground", "cart"] }
[outputs]
x = { measure = "rail.position" }
v = { measure = "rail.velocity" }
"""
STUDY = """
name = "cart"
[source]
mechanism = "cart.toml"
[time]
stop = 1
step = 0.1
[parameters]
m = { min = 0.5, max = 2.0, unit = "kg" }
[outputs]
x = { unit = "m" }
v = { unit = "m/s" }
[sampling]
method = "sobol"
runs = 20
test_runs = 3
[network]
hidden = [8]
[training]
epochs = 5
"""


def build(folder, study, *options):
    command = [METAFMU, "build", study, "--out", "out", *options]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True)


def test_a_cart_at_rest_is_exported_as_the_constant_that_it_is(tmp_path):
    # what the solver's constraints leave of gravity along the rail moves the cart by 1e-30 m
    (tmp_path / "cart.toml").write_text(CART)
    (tmp_path / "study.toml").write_text(STUDY)
    done = build(tmp_path, "study.toml")
    assert done.returncode == 0, done.stderr
    assert "output x does not vary: it is exported as the constant 0 m" in done.stderr
    assert "\ngood: " in done.stdout
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["constants"] == {"x": 0.0, "v": 0.0}
    assert metrics["verdict"]["grade"] == "good"
    assert metrics["outputs"]["x"]["r2"] is None and metrics["outputs"]["x"]["max_abs_error"] == 0
    table = pd.read_csv(tmp_path / "out" / "train.csv")
    assert (table[["x", "v"]] == 0).all().all()
    result = fmpy.simulate_fmu(str(tmp_path / "out" / "cart.fmu"), start_values={"m": 1.7}, output=["x", "v"], stop_time=1.0)
    assert np.all(result["x"] == 0) and np.all(result["v"] == 0)
    with zipfile.ZipFile(tmp_path / "out" / "cart.fmu") as fmu:
        card = fmu.read("documentation/index.html").decode()
    assert "constant, 0" in card
    assert "output, constant" in (tmp_path / "out" / "report.html").read_text()


def test_a_constant_output_of_a_component_with_states_rejects_nothing(tmp_path):
    text = (ROOT / "examples" / "dynamics" / "crane.toml").read_text()
    (tmp_path / "crane.toml").write_text(text.replace("[outputs]", '[outputs]\ny = { measure = "trolley.y" }\nvy = { measure = "trolley.vy" }'))
    command = [METAFMU, "new", "study", "--mechanism", "crane.toml", "--structure", "dynamics"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    done = build(tmp_path, "study.toml", "--json")
    assert done.returncode == 0, done.stderr
    metrics = json.loads(done.stdout)
    assert metrics["constants"] == {"y": 0.0, "vy": 0.0} and metrics["verdict"]["grade"] == "good"
    assert metrics["roll_outs"]["horizons"][0]["median"] < 1e-6
    result = fmpy.simulate_fmu(str(tmp_path / "out" / "study.fmu"), output=["y", "vy", "x"], stop_time=2.0)
    assert np.all(result["y"] == 0) and np.all(result["vy"] == 0) and np.ptp(result["x"]) > 0.01


@pytest.mark.parametrize("verb", ["train", "build"])
def test_a_training_that_is_stopped_in_its_first_epoch_writes_nothing(tmp_path, verb):
    slow = ("hidden = [64, 64, 64, 64, 64, 64]", "hidden = [1024, 1024, 1024, 1024]")
    (tmp_path / "study.toml").write_text(changed("single-pendulum.toml", slow))
    command = lambda verb: [METAFMU, verb, "study.toml", "--out", "out"]
    if verb == "train":
        subprocess.run(command("sample"), cwd=tmp_path, check=True, capture_output=True)
    process = subprocess.Popen(command(verb), cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    if verb == "build":
        assert any("sampled" in line for line in process.stderr)
    else:
        # the tables are read before the training begins
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(3)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    assert "the first epoch is not complete: there is no network to keep" in err
    left = {path.name for path in (tmp_path / "out").iterdir()}
    assert not {name for name in left if name.endswith((".fmu", ".safetensors"))} and "metrics.json" not in left
    assert "rejected" not in out and "good" not in out


def test_a_surrogate_that_is_usable_only_says_what_may_help(tmp_path):
    table = pd.DataFrame({"run": np.repeat(np.arange(40), 21), "time": np.tile(np.linspace(0, 2, 21), 40)})
    table["a"] = np.repeat(np.random.default_rng(1).uniform(0, 1, 40), 21)
    noise = np.random.default_rng(2).normal(0, 0.16, len(table))
    table["y"] = np.sin(3 * table.time + table.a) + noise
    table.to_csv(tmp_path / "runs.csv", index=False)
    study = STUDY.split("[source]")[0] + (
        '[source]\ntable = "runs.csv"\n[time]\nstop = 2\nstep = 0.1\n[parameters]\na = { min = 0, max = 1 }\n[outputs]\ny = {}\n'
        "[sampling]\ntest_runs = 10\n[network]\nhidden = [16]\n[training]\nschedule = \"cosine\"\nbatch = 128\nepochs = 300\n[baselines]\nbuild = []\n"
    )
    (tmp_path / "study.toml").write_text(study)
    done = build(tmp_path, "study.toml", "--json")
    verdict = json.loads(done.stdout)["verdict"]
    assert (done.returncode, verdict["grade"], verdict["accepted"]) == (0, "usable", True), verdict
    limit = verdict["limits"][0]
    assert (limit["check"], limit["place"], limit["cause"][:6]) == ("accuracy", "y", "R² 0.9") and "record more runs" in " ".join(verdict["advice"])
    assert "usable, not good" in done.stderr and "  try: record more runs" in done.stderr
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.split("</h1>")[1].lstrip().startswith('<div class="verdict usable"><p><strong>Usable</strong>')
    # what is usable by default is not by other limits
    with open(tmp_path / "study.toml", "a") as file:
        file.write("[accept]\nr2 = 0.995\n")
    done = subprocess.run([METAFMU, "evaluate", "study.toml", "--out", "out"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 1 and "expected at least 0.995 (accept.r2)" in done.stdout
