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
    assert run == {"id": 2, "outputs": {"x": [0.0, 1.0]}} and failed == {"id": 3, "error": "KeyError: 'y'"}
    assert result.stderr.count("printed") == 2 and np.isclose(described["stop"], 1.0)
