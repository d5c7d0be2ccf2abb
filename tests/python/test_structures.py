"""A network for each instant: `network.structure = "fixed"`."""

import json
import os
import subprocess
import sys
import time
from zipfile import ZipFile

import numpy as np
import pytest
from conftest import METAFMU, OTHER_THREADS, OUTPUTS, PARAMETERS, ROOT, RandomKills, abort_at, changed, fmu_of, losses, metafmu
from fmpy import simulate_fmu
from fmpy.validation import validate_fmu

sys.path.insert(0, str(ROOT / "scripts" / "measure"))
from model_file import evaluate, load

KILLS = 8
STEP = 0.05
INSTANTS = 21
# its bytes hold no wall times
RESULTS = ["study.fmu", "study-fmi3.fmu", "study.safetensors"]


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    text = changed(
        "paper/single-pendulum-fixed.toml",
        ('name = "single-pendulum-fixed"', 'name = "study"'),
        ('method = "mesh"', 'method = "sobol"'),
        ("levels = 11 ", "runs = 300 "),
        ("test_runs = 200", "test_runs = 20"),
        ("stop = 2.0", "stop = 1.0"),
        ("step = 0.01", f"step = {STEP}"),
        ("hidden = [128, 128]", "hidden = [48]"),
        ('"relu"', '"tanh"'),
        ('"adam"', '"soap"'),
        ('"constant"', '"cosine"'),
        ("learning_rate = 0.001", "learning_rate = 0.01"),
        ("epochs = 400", "epochs = 300"),
        ('fmi = "2"', 'fmi = "both"'),
    )
    path = tmp_path_factory.mktemp("structures") / "study.toml"
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def fixed(study):
    """Its folder, and how long it took; `build` ends with 0 only if validation finds no problem."""
    folder = study.parent / "fixed"
    begin = time.monotonic()
    metafmu("build", study, "--out", folder)
    return folder, time.monotonic() - begin


def results(folder):
    return {name: (folder / name).read_bytes() for name in RESULTS}


def test_it_is_accurate_on_unseen_runs_and_knows_the_initial_values(fixed):
    metrics = json.loads((fixed[0] / "metrics.json").read_text())
    assert all(metrics["outputs"][output]["r2"] > 0.999 for output in OUTPUTS), metrics["outputs"]
    _, tensors = load(fixed[0] / "study.safetensors")
    np.testing.assert_allclose(tensors["graph.0.instants"], np.linspace(0, 1, INSTANTS), rtol=1e-15)
    # theta(0) is the same in every run
    weights = tensors["graph.0.functions.3.weight"]
    assert not weights[0, 0].any() and weights[1:, 0].any(axis=1).all()
    assert tensors["graph.0.functions.4.mean"][0, 0] == pytest.approx(np.pi / 2, rel=1e-13)


@pytest.mark.parametrize("version", [2, 3])
def test_fmpy_computes_what_numpy_reads_from_the_file(fixed, version):
    fmu = fmu_of(fixed[0], "study", version)
    assert validate_fmu(str(fmu)) == []
    case = (0.1583, 0.055, 2.0)
    _, tensors = load(fixed[0] / "study.safetensors")
    start_values = dict(zip(PARAMETERS, case))
    # past the last instant its outputs are kept
    result = simulate_fmu(str(fmu), start_values=start_values, output=OUTPUTS, stop_time=1.1, output_interval=0.02)
    expected = evaluate(tensors, np.array([[*case, time] for time in result["time"]]))
    for column, output in enumerate(OUTPUTS):
        np.testing.assert_allclose(result[output], expected[:, column], rtol=1e-10, atol=1e-10)


def test_the_number_of_threads_changes_nothing(study, fixed):
    folder = study.parent / "other-threads"
    command = [METAFMU, "build", study, "--out", folder]
    subprocess.run(command, check=True, capture_output=True, env=os.environ | OTHER_THREADS)
    assert results(folder) == results(fixed[0])


def test_a_build_that_is_killed_goes_on_and_ends_in_the_same_bytes(study, fixed, tmp_path):
    """After the first network, after nearly all, and between the results and the end of the journal of networks."""
    for moment in ("appended unfinished-networks.bin", f"appended unfinished-networks.bin {INSTANTS - 3}", "replaced training.json"):
        abort_at(moment, "build", study, "--out", tmp_path, "--resume")
        assert (tmp_path / "unfinished-networks.bin").exists()
    metafmu("build", study, "--out", tmp_path, "--resume")
    assert results(tmp_path) == results(fixed[0])
    assert losses(tmp_path) == losses(fixed[0])
    assert not (tmp_path / "unfinished-networks.bin").exists()


@pytest.mark.thorough
def test_a_build_that_is_killed_at_random_goes_on_and_ends_in_the_same_bytes(study, fixed):
    kill = RandomKills(fixed[1])
    went_on = 0
    for number in range(KILLS):
        folder = study.parent / f"killed-{number}"
        unfinished = folder / "unfinished-networks.bin"
        if number % 2:
            kill("build", study, "--out", folder)
        else:
            # during the training, the first third of what comes after this file
            kill("build", study, "--out", folder, latest=0.3, after=unfinished)
        went_on += unfinished.exists()
        metafmu("build", study, "--out", folder, "--resume")
        assert results(folder) == results(fixed[0]), number
        assert losses(folder) == losses(fixed[0]), number
        assert not unfinished.exists()
    assert went_on >= KILLS / 4, went_on


def test_the_model_card_says_what_it_is(fixed):
    with ZipFile(fixed[0] / "study.fmu") as archive:
        card = archive.read("documentation/index.html").decode()
    assert f"48 tanh nodes in each of {INSTANTS} networks" in card


def test_recorded_runs_with_other_times_are_refused(tmp_path):
    (tmp_path / "runs.csv").write_text(
        "run,time,L,theta\na,0,0.1,1\na,0.5,0.1,2\na,1,0.1,3\nb,0,0.2,4\nb,1,0.2,5\n"
        "c,0,0.15,6\nc,0.5,0.15,6\nc,1,0.15,7\nd,0,0.16,6\nd,1,0.16,7\n"
    )
    study = tmp_path / "study.toml"
    study.write_text(
        'name = "s"\n[source]\ntable = "runs.csv"\n[time]\nstop = 1\nstep = 0.5\n'
        "[parameters]\nL = { min = 0.1, max = 0.2 }\n[outputs]\ntheta = {}\n[sampling]\ntest_runs = 1\n"
        '[network]\nstructure = "fixed"\n'
    )
    refused = metafmu("build", study, "--out", tmp_path / "out", check=False)
    assert refused.returncode == 2
    assert 'study.toml:14: network.structure: "fixed" needs the same times in every run' in refused.stderr


def test_a_search_compares_the_structures(study):
    text = study.read_text().replace("runs = 300 ", "runs = 60 ").replace("epochs = 300", "epochs = 20")
    search = '\n[search]\nmethod = "grid"\n[search.space]\n"network.structure" = ["full", "fixed"]\n'
    both = study.with_stem("both")
    both.write_text(text.replace('structure = "fixed"', 'structure = "full"') + search)
    metafmu("search", both, "--out", study.parent / "search")
    rows = (study.parent / "search" / "search.csv").read_text().splitlines()
    assert [row.split(",")[1:3] for row in rows[1:]] == [["full", "finished"], ["fixed", "finished"]]
