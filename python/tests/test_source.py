"""Functions as sources, as the package offers them."""

import json
import subprocess
import sys

import metafmu
import numpy as np

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
