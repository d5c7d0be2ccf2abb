"""Discrete-time surrogates whose outputs follow inputs at the same instant, against the closed form, in fmpy, C and the command."""

import csv

import numpy as np
import pytest
from conftest import change, compiled_from_sources, fmu_of, metafmu
from fmpy import read_model_description
from scipy.signal import cont2discrete
from test_discrete import Running

MASS, DAMPING, STIFFNESS, STEP = 2.0, 1.5, 80.0, 0.02
RUNS, ROWS, HELD = 10, 160, 5
GIVEN = 10
OUTPUTS = ["position", "acceleration"]


def plant(force):
    """Position and acceleration at each row of a mass on a spring, whose force is held from row to row; exact."""
    a, b = np.array([[0, 1], [-STIFFNESS / MASS, -DAMPING / MASS]]), np.array([[0], [1 / MASS]])
    a, b, *_ = cont2discrete((a, b, np.eye(2), np.zeros((2, 1))), STEP)
    state, rows = np.zeros(2), []
    for value in force:
        rows.append((state[0], (value - DAMPING * state[1] - STIFFNESS * state[0]) / MASS))
        state = a @ state + b[:, 0] * value
    return np.array(rows)


def forces(seed, rows=ROWS):
    return np.repeat(np.random.default_rng(seed).uniform(-20, 20, rows // HELD), HELD)


def write(path, header, *columns):
    np.savetxt(path, np.column_stack(columns), fmt="%.17g", delimiter=",", header=header, comments="")


def table(path, noise=0.0):
    random = np.random.default_rng(1)
    rows = []
    for run in range(RUNS):
        outputs = plant(forces(run))
        outputs += noise * outputs.std(axis=0) * random.standard_normal(outputs.shape)
        rows.append(np.column_stack([np.full(ROWS, run), np.round(STEP * np.arange(ROWS), 6), forces(run), outputs]))
    write(path, "run,time,force,position,acceleration", np.concatenate(rows))


def new(folder, noise=0.0):
    """The study that the command proposes for the table."""
    table(folder / "runs.csv", noise)
    metafmu("new", folder / "mass", "--table", folder / "runs.csv", "--structure", "discrete", "--inputs", "force")
    return folder / "mass.toml"


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    folder = tmp_path_factory.mktemp("direct")
    result = metafmu("build", new(folder), "--out", folder / "out", "--fmi", "both", "--ports", "measured")
    assert "direct effects: acceleration of force" in result.stdout + result.stderr
    return folder / "out"


@pytest.fixture(params=[(2, "library"), (3, "library"), (2, "sources"), (3, "sources")], ids=lambda of: f"FMI {of[0]}, {of[1]}")
def fmu(request, built, tmp_path, monkeypatch):
    version, kind = request.param
    if kind == "library":
        return fmu_of(built, "mass", version)
    out = tmp_path / "sources"
    metafmu("export", built / "mass.safetensors", "--out", out, "--sources", "--fmi", version, "--ports", "measured")
    return compiled_from_sources(fmu_of(out, "mass", version), monkeypatch)


def error(found, expected):
    return np.abs(found - expected).max(axis=0) / np.ptp(expected, axis=0)


def test_an_output_changes_when_its_input_is_set(fmu, tmp_path):
    force = forces(99)
    truth = plant(force)
    running = Running(str(fmu), tmp_path / "unpacked", force=force[0], acceleration_start=truth[0, 1])
    found, before = [], []
    for value in force:
        before.append(running.get(*OUTPUTS))
        running.set("force", value)
        found.append(running.get(*OUTPUTS))
        running.step(STEP)
    assert (error(np.array(found), truth) < 1e-7).all()
    # up to then it follows from the force before
    expected = truth[1:, 1] - np.diff(force) / MASS
    assert np.abs(np.array(before)[1:, 1] - expected).max() < 1e-6


class Clamping(Running):
    """An FMU that clamps its inputs from the start."""

    def set(self, name, value):
        if name == "force" and not hasattr(self, "clamps"):
            self.clamps = True
            setter = self.fmu.setInt32 if self.is_fmi3 else self.fmu.setInteger
            setter([self.references["domain_policy"]], [1])
        super().set(name, value)


def test_a_clamped_input_acts_as_clamped(fmu, tmp_path):
    running = Clamping(str(fmu), tmp_path / "unpacked", force=1e3, acceleration_start=3.0)
    assert abs(running.get("acceleration")[0] - 3.0) < 1e-12
    force = next(variable for variable in running.description.modelVariables if variable.name == "force")
    for value in [float(force.max), float(force.max) + 5]:
        running.set("force", value)
        assert abs(running.get("acceleration")[0] - 3.0) < 1e-12
    running.set("force", float(force.max) - 1)
    assert abs(running.get("acceleration")[0] - (3.0 - 1 / MASS)) < 1e-7


@pytest.mark.parametrize("version", [2, 3])
def test_the_description_says_which_outputs_follow_an_input(built, version):
    description = read_model_description(str(fmu_of(built, "mass", version)))
    following = {unknown.variable.name: [of.name for of in unknown.dependencies] for unknown in description.outputs}
    assert (following["position"], following["acceleration"]) == ([], ["force"])


def read(path):
    with open(path, newline="") as file:
        return np.array([[float(row[name]) for name in OUTPUTS] for row in csv.DictReader(file)])


def test_it_starts_from_measured_samples(fmu, built, tmp_path):
    start = 40
    force, truth = forces(77)[start:], plant(forces(77))[start:]
    times = STEP * (np.arange(ROWS - start) - GIVEN)
    write(tmp_path / "rows.csv", "time,force,position,acceleration", times, force, truth)
    metafmu("predict", built / "mass.safetensors", tmp_path / "rows.csv", "--out", tmp_path / "predicted.csv")
    predicted = read(tmp_path / "predicted.csv")
    assert (error(predicted[GIVEN:], truth[GIVEN:]) < 1e-6).all()
    running = Running(str(fmu), tmp_path / "unpacked", start=times[0])
    found = []
    for row in range(len(times)):
        running.set("force", force[row])
        is_measured = row < GIVEN
        running.fmu.setBoolean([running.references["use_measured"]], [is_measured])
        for name, value in zip(OUTPUTS, truth[row]):
            running.set(f"{name}_measured", value)
        found.append(running.get(*OUTPUTS))
        running.step(STEP)
    assert (error(np.array(found)[GIVEN:], predicted[GIVEN:]) < 1e-9).all()


def linear(study):
    """A study that learns linear equations only: direct effects are found before."""
    return change(study, (r"\[discrete\]", '[discrete]\nmodel = "linear"'))


def test_noise_and_inputs_that_act_later_are_no_direct_effects(tmp_path):
    result = metafmu("build", linear(new(tmp_path, noise=0.02)), "--out", tmp_path / "out")
    assert "direct effects: acceleration of force" in result.stdout + result.stderr
    rows = np.genfromtxt(tmp_path / "runs.csv", delimiter=",", skip_header=1)
    # without the acceleration nothing follows at once
    write(tmp_path / "runs.csv", "run,time,force,position", rows[:, :4])
    metafmu("new", tmp_path / "other", "--table", tmp_path / "runs.csv", "--structure", "discrete", "--inputs", "force")
    result = metafmu("build", linear(tmp_path / "other.toml"), "--out", tmp_path / "other")
    assert "direct" not in result.stdout + result.stderr
