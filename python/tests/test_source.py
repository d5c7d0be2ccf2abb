"""Functions as sources, as the package offers them."""

import json
import re
import subprocess
import sys

import metafmu
import numpy as np
import pytest

SCRIPT = """
import metafmu

@metafmu.source(parameters={"k": {"min": 1.0, "max": 2.0, "unit": "1/s"}}, outputs={"x": "m"}, stop=1.0, step=0.5)
def line(times, parameters):
    print("printed")
    return {"x": parameters["k"] * times}

if __name__ == "__main__":
    line.serve()
"""


def test_a_source_is_still_a_function_whose_parameters_have_start_values():
    @metafmu.source(parameters={"k": {"min": 1.0, "max": 2.0}, "c": {"start": 3.0}}, outputs={"x": "m"})
    def line(times, parameters):
        return {"x": parameters["c"] + parameters["k"] * times}

    assert line([0.0, 2.0], {"k": 2.0})["x"].tolist() == [3.0, 7.0]
    assert line([2.0], {})["x"].tolist() == [6.0]


def test_names_that_a_source_does_not_have_are_refused_with_the_closest():
    @metafmu.source(parameters={"L": {"start": 1.0}, "gain": {"start": 3.0}}, inputs={"force": "N"}, outputs={"x": "m"})
    def line(times, parameters, inputs):
        return {"x": parameters["L"] * inputs["force"] + parameters["gain"]}

    times = [0.0, 1.0]
    assert line(times, {"L": 2.0}, {"force": [1.0, 2.0]})["x"].tolist() == [5.0, 7.0]
    message = "parameters: no parameters `l`, `Gain`, expected them among L, gain; did you mean `L` for `l`, `gain` for `Gain`?"
    with pytest.raises(metafmu.Error, match=re.escape(message)):
        line(times, {"l": 2.0, "Gain": 1.0}, {"force": times})
    with pytest.raises(metafmu.Error, match="inputs: no input `Force`, expected it among force; did you mean `force`?"):
        line(times, {}, {"Force": times})
    with pytest.raises(metafmu.Error, match="inputs: no input `force`, expected it among none"):
        line(times, {})


def test_a_decorator_without_arguments_says_which_it_needs():
    with pytest.raises(TypeError, match=re.escape('@metafmu.source has no arguments for `decay`, expected for instance @metafmu.source(outputs={"x": "m"}')):

        @metafmu.source
        def decay(times, parameters):
            return {"x": np.exp(-times)}

    with pytest.raises(TypeError, match="has no outputs, expected a dict of names to units"):
        metafmu.source(stop=1.0)


def run(times, parameters):
    return {"x": parameters["k"] * times}


class OfEquations:
    def equations(self, parameters, inputs, states):
        return {"x": 1.0}, {"y": 2.0}


class OfPath:
    def __init__(self, path):
        self.path = path

    def run(self, times):
        return {"x": times}


def test_names_and_ranges_suffice_for_quantities():
    line = metafmu.source(parameters={"k": (0, 1)}, outputs=["x"])(run)
    assert line([0.0, 2.0], {})["x"].tolist() == [0.0, 1.0]
    of_states = metafmu.source(states=["x"], inputs={"u": (-1, 1)}, outputs="y")(OfEquations)
    assert of_states.equations({}, {"u": 0.0}, {"x": 0.0}) == ({"x": 1.0}, {"y": 2.0})


WRONG_SOURCES = {
    "swapped ranges": (
        {"parameters": {"k": (1, 0), "j": {"min": 2, "max": 2}}},
        run,
        ["parameters.k: found min 1 and max 0, expected min < max", "parameters.j: found min 2 and max 2, expected min < max"],
    ),
    "texts": (
        {"parameters": {"k": ("0", 1)}, "stop": "1"},
        run,
        ["parameters.k.min: found '0', expected a finite number", "stop: found '1', expected a finite number"],
    ),
    "a start outside": ({"parameters": {"k": {"min": 0, "max": 1, "start": 2}}}, run, ["parameters.k.start: found 2, expected a number from min 0 to max 1"]),
    "an unknown key": (
        {"parameters": {"k": {"minimum": 0}}},
        run,
        ["parameters.k: no key `minimum`, expected it among unit, min, max, start, description; did you mean `min`?"],
    ),
    "a number": (
        {"parameters": {"k": 3}},
        run,
        ["parameters.k: found 3, expected a unit, a range (min, max) or a dict with unit, min, max, start, description"],
    ),
    "a set": ({"outputs": {"x"}}, run, ["outputs: found {'x'}, expected a list of names, or a dict of names to units or dicts"]),
    "a name twice": ({"outputs": ["x", "x"]}, run, ["outputs: found `x` twice, expected each name once"]),
    "a range of an output": ({"outputs": {"x": (0, 1)}}, run, ["outputs.x: found (0, 1), expected a unit or a dict with unit, min, max, start, description"]),
    "times": ({"stop": 1, "step": 2}, run, ["step: found 2, expected at most the 1 of stop"]),
    "no time": ({"stop": -1}, run, ["stop: found -1, expected a number of seconds above 0"]),
    "no state": ({"states": {"v": {"rate_of": "w"}}}, OfEquations, ["states.v.rate_of: no state `w`, expected it among v"]),
    "no inputs": ({"inputs": ["u"]}, run, ["found `run(times, parameters)`, expected `run(times, parameters, inputs)`"]),
    "no function": ({}, 42, ["found 42, expected a function or class below the decorator"]),
    "a class with arguments": (
        {},
        OfPath,
        ["found `OfPath(path)`, expected `OfPath()`", "found `OfPath.run(self, times)`, expected `OfPath.run(self, times, parameters)`"],
    ),
}


@pytest.mark.parametrize("about,model,problems", WRONG_SOURCES.values(), ids=WRONG_SOURCES)
def test_every_mistake_of_a_source_is_a_sentence(about, model, problems):
    with pytest.raises(metafmu.Error) as raised:
        metafmu.source(**{"outputs": {"x": "m"}, **about})(model)
    assert str(raised.value).splitlines() == [f"metafmu.source: {problem}" for problem in problems]


@pytest.mark.parametrize(
    "result,problem",
    [
        (None, "the function returned None, expected a dict with an array for each of x, y"),
        (np.zeros(2), "the function returned `ndarray` of the shape (2,), expected a dict with an array for each of x, y"),
        ({"x": [0.0, 1.0], "Y": [0.0, 1.0]}, "the function returned no output `y`, expected it among x, Y; did you mean `Y`?"),
        ({"x": [0.0, 1.0], "y": [0.0]}, "the function returned the output `y` of the shape (1,), expected (2,), a number for each time"),
        ({"x": [0.0, 1.0], "y": "up"}, "the function returned the output `y` of the type `str`, expected 2 numbers, one for each time"),
    ],
)
def test_wrong_results_of_a_source_are_named(result, problem):
    source = metafmu.source(outputs=["x", "y"])(lambda times, parameters: result)
    with pytest.raises(metafmu.Error, match=f"^metafmu.source: {re.escape(problem)}$"):
        source([0.0, 1.0], {})


def test_wrong_calls_of_a_source_are_refused():
    source = metafmu.source(parameters={"k": (0, 1)}, outputs=["x"])(run)
    for wrong, message in [
        (([0.0], [0.5]), r"parameters: found \[0.5\], expected a dict by name"),
        (("now", {}), "times: found 'now', expected an array of numbers"),
        ((1.0, {}), r"times: found the shape \(\), expected an array of numbers"),
    ]:
        with pytest.raises(metafmu.Error, match=message):
            source(*wrong)


def test_wrong_equations_of_a_source_are_named():
    class Wrong:
        def equations(self, parameters, inputs, states):
            return {"x": 1.0}

    class Incomplete:
        def equations(self, parameters, inputs, states):
            return {"x": 1.0}, {}

    options = {"states": ["x", "v"], "outputs": ["y"]}
    with pytest.raises(metafmu.Error, match="`equations` returned `dict`, expected two dicts: derivatives of the states, and outputs"):
        metafmu.source(**options)(Wrong).equations({}, {}, {"x": 0.0, "v": 0.0})
    with pytest.raises(metafmu.Error, match="`equations` returned no derivative `v`, expected it among x"):
        metafmu.source(**options)(Incomplete)([0.0, 1.0], {}, None, {"x": 0.0})


def test_a_script_answers_requests(tmp_path):
    (tmp_path / "line.py").write_text(SCRIPT)
    requests = [
        {"id": 1, "request": "describe", "protocol": 1},
        {"id": 2, "request": "run", "parameters": {"k": 2.0}, "times": [0.0, 0.5], "outputs": ["x"]},
        {"id": 3, "request": "run", "parameters": {"k": 2.0}, "times": [0.0], "outputs": ["y"]},
    ]
    lines = "".join(json.dumps(request) + "\n" for request in requests)
    result = subprocess.run([sys.executable, tmp_path / "line.py"], input=lines, capture_output=True, text=True)
    described, run, failed = map(json.loads, result.stdout.splitlines())
    assert described["protocol"] == 1 and described["outputs"] == {"x": {"unit": "m"}}
    assert run == {"id": 2, "outputs": {"x": [0.0, 1.0]}} and failed == {"id": 3, "error": "metafmu.source: the function returned no output `y`, expected it among x"}
    assert result.stderr.count("printed") == 2 and np.isclose(described["stop"], 1.0)
