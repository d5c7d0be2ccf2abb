"""Studies of functions and classes that are defined in this process: the processes that sample them have copies."""

import json
import os
import subprocess
import sys
import threading
import types

import numpy as np
import pytest

import metafmu

pytest.importorskip("cloudpickle")
tomllib = pytest.importorskip("tomllib")

QUICK = {"sampling": {"runs": 60, "test_runs": 20}, "network": {"hidden": [16, 16]}, "training": {"epochs": 300, "batch": 128}}
RATE = 1.5
TIMES = [0.0, 0.5, 1.0]
# a cell, whose file differs from session to session
CELL = """
import math
import metafmu

SHIFT = 0.25

def helper(k, t):
    return SHIFT + math.exp(-k * t)

@metafmu.source(parameters={"k": {"min": 0.5, "max": 2.0}}, outputs={"x": "m"}, stop=1.0, step=0.1)
def cell(times, parameters):
    return {"x": [helper(parameters["k"], t) for t in times]}
"""


def decorated(function, **more):
    return metafmu.source(parameters={"k": {"min": 0.5, "max": 2.0, "unit": "1/s"}}, outputs={"x": "m"}, stop=2.0, step=0.02, **more)(function)


def asked(folder, name, outputs=("x",)):
    """Outputs at TIMES with k = 1.2, of the process that samples a study; it starts in the folder of the study."""
    command = tomllib.loads((folder / f"{name}.toml").read_text())["source"]["command"]
    request = {"id": 1, "request": "run", "parameters": {"k": 1.2}, "times": TIMES, "outputs": list(outputs)}
    result = subprocess.run(command, input=json.dumps(request) + "\n", cwd=folder, capture_output=True, text=True)
    return json.loads(result.stdout)


def defined_in_a_cell(file, text=CELL):
    module = types.ModuleType("__main__")
    exec(compile(text, file, "exec"), module.__dict__)
    return module.cell


def test_a_function_becomes_a_surrogate(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    decay = decorated(lambda times, parameters: {"x": np.exp(-RATE * parameters["k"] * times)})
    study = metafmu.Study(decay, name="decay", seed=3, **QUICK)
    assert (study.name, study.path.name) == ("decay", "decay.toml")
    result = study.build(verbose=False)
    assert result.accepted, result
    points = np.random.default_rng(1).uniform([0.5, 0.0], [2.0, 2.0], (100, 2))
    expected = np.exp(-RATE * points[:, 0] * points[:, 1])
    names = [item.name for item in result.surrogate.inputs]
    found = result.surrogate.predict(points[:, [["k", "time"].index(name) for name in names]])
    assert np.abs(found[:, 0] - expected).max() < 0.01
    # the same source again keeps its runs
    before = os.stat(result.folder / "train.csv").st_mtime_ns
    metafmu.Study(decay, name="decay", seed=3, **QUICK).build(resume=True, verbose=False)
    assert os.stat(result.folder / "train.csv").st_mtime_ns == before


def test_closures_methods_and_cells_are_copied_with_what_they_use(tmp_path):
    offset = np.array([0.5])

    def with_offset(times, parameters):
        return {"x": offset + RATE * parameters["k"] * times}

    class Model:
        calls = 0

        def __init__(self):
            # made anew in each process
            self.file = open(os.devnull)

        def run(self, times, parameters):
            self.calls += 1
            return {"x": self.calls * RATE * times}

    expected = {"with_offset": [0.5, 1.4, 2.3], "Model": [0.0, 0.75, 1.5], "cell": [0.25 + np.exp(-1.2 * t) for t in TIMES]}
    for source in (decorated(with_offset), decorated(Model), defined_in_a_cell("/tmp/ipykernel_1/1.py")):
        study = metafmu.Study(source, folder=tmp_path)
        np.testing.assert_allclose(asked(tmp_path, study.name)["outputs"]["x"], expected.pop(study.name), rtol=1e-15)
    assert not expected
    # values at the time of the study, not of the run
    offset[0] = 100.0
    assert asked(tmp_path, "with_offset")["outputs"]["x"][0] == 0.5


def test_a_class_with_equations_has_states(tmp_path):
    @metafmu.source(parameters={"k": {"min": 0.5, "max": 2.0}}, inputs={"u": {"min": -1, "max": 1}}, states={"x": {"min": -1, "max": 1}}, outputs={"y": ""}, stop=1, step=0.01)
    class Lag:
        def equations(self, parameters, inputs, states):
            return {"x": parameters["k"] * (inputs["u"] - states["x"])}, {"y": 2 * states["x"]}

    metafmu.Study(Lag, structure="dynamics", folder=tmp_path)
    study = tomllib.loads((tmp_path / "Lag.toml").read_text())
    assert study["structure"] == "dynamics" and list(study["states"]) == ["x"] and list(study["inputs"]) == ["u"]


def test_equal_code_has_an_equal_copy_in_another_session(tmp_path):
    copies = []
    for number, text in enumerate((CELL, "\n\n# a comment\n" + CELL, CELL.replace("0.25", "0.5"))):
        metafmu.Study(defined_in_a_cell(f"/tmp/ipykernel_{number}/{number}.py", text), folder=tmp_path)
        copies.append((tmp_path / "cell-source.pickle").read_bytes())
    assert copies[0] == copies[1] != copies[2]


def test_equal_classes_have_an_equal_copy_in_another_session(tmp_path):
    lines = ["class Base:", "    factor = 2", "class cell(Base):", "    run = lambda self, times, parameters: {'x': self.factor * times + isinstance(self, Base)}"]
    decorator = "@metafmu.source(parameters={'k': {'min': 1, 'max': 2}}, outputs={'x': 'm'}, stop=1, step=0.1)"
    script = "\n".join(["import metafmu", *lines[:2], decorator, *lines[2:], f"metafmu.Study(cell, folder={str(tmp_path)!r})"])
    copies = set()
    for _ in range(2):
        subprocess.run([sys.executable, "-c", script], check=True)
        copies.add((tmp_path / "cell-source.pickle").read_bytes())
    assert len(copies) == 1 and asked(tmp_path, "cell")["outputs"]["x"] == [1.0, 2.0, 3.0]


def test_modules_are_imported_and_their_changes_count(tmp_path, monkeypatch):
    library = tmp_path / "library"
    library.mkdir()
    (library / "deep_part.py").write_text("FACTOR = 3.0\n")
    (library / "own_part.py").write_text("import deep_part\ndef law(k, t):\n    return deep_part.FACTOR * k * t\n")
    monkeypatch.syspath_prepend(str(library))
    import own_part

    source = decorated(lambda times, parameters: {"x": own_part.law(parameters["k"], times)})
    (tmp_path / "data.csv").write_text("1\n")
    metafmu.Study(source, name="own", folder=tmp_path, source={"files": ["data.csv"], "time_limit": 7})
    found = tomllib.loads((tmp_path / "own.toml").read_text())["source"]
    assert [os.path.basename(file) for file in found["files"]] == ["deep_part.py", "own_part.py", "data.csv"] and found["time_limit"] == 7
    # in another process, which has another path
    monkeypatch.undo()
    np.testing.assert_allclose(asked(tmp_path, "own")["outputs"]["x"], [0.0, 1.8, 3.6])


def test_keys_of_the_study_are_set_added_and_left_out(tmp_path):
    metafmu.Study(
        decorated(lambda times, parameters: {"x": times}),
        name="keys",
        folder=tmp_path,
        seed=7,
        description='a "b"',
        time={"stop": 1, "margin": None},
        parameters={"k": {"min": np.float64(0.6), "max": 1.0, "unit": "1/s"}},
        sampling={"method": "random", "runs": 50, "faces": None},
        bounds={"runs": 20},
        export={"author": "A"},
    )
    study = tomllib.loads((tmp_path / "keys.toml").read_text())
    assert (study["seed"], study["description"], study["time"], study["bounds"]) == (7, 'a "b"', {"stop": 1, "step": 0.02}, {"runs": 20})
    assert study["parameters"] == {"k": {"min": 0.6, "max": 1.0, "unit": "1/s"}} and study["export"]["author"] == "A"
    assert study["sampling"] == {"method": "random", "runs": 50, "test_runs": 200}
    with pytest.raises(metafmu.Error, match=r"wrong.toml:\d+: sampling.run: unknown key `run`"):
        metafmu.Study(decorated(lambda times, parameters: {"x": times}), name="wrong", folder=tmp_path, sampling={"run": 5})


@pytest.mark.parametrize(
    "options,message",
    [
        ({"structure": "dynamic"}, "^structure: found 'dynamic', expected one of response, discrete, dynamics$"),
        ({"sampling": 200}, r"^sampling: found 200, expected a dict with keys of \[sampling\]$"),
        ({"sampling": {"runs": print}}, "^sampling.runs: found <built-in function print>, expected a number, a text, True or False, a list or a dict$"),
        ({"name": "a/b"}, "^name: found 'a/b', expected a text without folders: `folder` has the place$"),
    ],
)
def test_wrong_arguments_of_a_study_are_sentences(options, message, tmp_path):
    with pytest.raises(metafmu.Error, match=message):
        metafmu.Study(decorated(lambda times, parameters: {"x": times}), **{"name": "wrong", "folder": tmp_path, **options})


def test_what_cannot_be_sampled_elsewhere_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def plain(times, parameters):
        return {"x": times}

    with pytest.raises(TypeError, match="expected a function or class with the decorator metafmu.source$"):
        metafmu.Study(plain)
    with pytest.raises(TypeError, match="metafmu.Study.load reads a file"):
        metafmu.Study("study.toml")
    with pytest.raises(TypeError, match="no name, expected the argument `name`"):
        metafmu.Study(decorated(lambda times, parameters: {"x": times}))
    lock = threading.Lock()

    def locked(times, parameters):
        with lock:
            return {"x": times}

    with pytest.raises(TypeError, match="`locked` uses the variable `lock` of the type lock, which cannot be copied .* create it in the function"):
        metafmu.Study(decorated(locked))
    (tmp_path / "plain.toml").write_text("# by hand\n")
    with pytest.raises(FileExistsError, match="was not made by metafmu.Study, expected another `name` or `folder`"):
        metafmu.Study(decorated(plain))
    assert (tmp_path / "plain.toml").read_text() == "# by hand\n"
    with pytest.raises(metafmu.Error, match="no parameter"):
        metafmu.Study(metafmu.source(outputs={"x": "m"}, stop=1, step=0.1)(plain), name="without")
    monkeypatch.setitem(sys.modules, "cloudpickle", None)
    with pytest.raises(ImportError, match="pip install cloudpickle"):
        metafmu.Study(decorated(plain), name="other")
