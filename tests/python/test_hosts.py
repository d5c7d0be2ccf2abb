"""The single pendulum's FMU in other tools than fmpy: fmpy's numbers, as close to the solution as metrics.json says."""

import csv
import json
import re
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
from conftest import CASES, OUTPUTS, PARAMETERS, ROOT, reference, simulate_with_fmpy

# host, the FMI version it gets, and the interface
RUNS = [
    ("libcosimpy", 2, "co-simulation"),
    ("ecospy", 2, "co-simulation"),
    ("ecospy", 3, "co-simulation"),
    # it takes a minute and a half to compile
    *(
        pytest.param("fmi-sim", version, interface, marks=pytest.mark.thorough)
        for version in (2, 3)
        for interface in ("co-simulation", "model-exchange")
    ),
]
FMI_SIM = ROOT / "target" / "tools" / "bin" / "fmi-sim"


def run_in_host(host, interface, fmu, case, step=0.01, steps=200):
    """A table of time and outputs."""
    start_values = dict(zip(PARAMETERS, case))
    if host == "fmi-sim":
        return run_fmi_sim(interface, fmu, start_values, OUTPUTS, step, steps)
    request = {"fmu": str(fmu), "start_values": start_values, "outputs": OUTPUTS, "step": step, "steps": steps}
    return run_python_host(host, request)


def run_python_host(host, request):
    command = [sys.executable, Path(__file__).with_name("run_host.py"), host, json.dumps(request)]
    return np.array(json.loads(run(command).stdout.splitlines()[-1]))


def run_fmi_sim(interface, fmu, start_values, outputs, step, steps, inputs=None):
    """A table of time and outputs; `inputs` is a CSV file."""
    assert FMI_SIM.exists(), "run scripts/fmi-sim.sh first"
    options = [option for name, value in start_values.items() for option in ("--init-values", f"{name}={value!r}")]
    times = ["--output-interval", repr(step), "-f", repr(step * steps)]
    given = ["-i", inputs] if inputs else []
    with tempfile.TemporaryDirectory() as folder:
        copy, result = Path(folder) / "copy.fmu", Path(folder) / "result.csv"
        rewrite_description(fmu, copy, as_fmi_sim_reads_it)
        run([FMI_SIM, "--model", copy, *given, "-o", result, interface, *options, *times])
        with result.open(newline="") as file:
            return np.array([[float(row[name]) for name in ["time", *outputs]] for row in csv.DictReader(file)])


def as_fmi_sim_reads_it(description):
    """Its reader of FMI 3.0 refuses the units and nominal values that the standard allows at variables."""
    head, variables = description.split("<ModelVariables>")
    if 'fmiVersion="3.0"' in head:
        variables = re.sub(' (unit|nominal)="[^"]*"', "", variables)
    return f"{head}<ModelVariables>{variables}"


def rewrite_description(fmu, copy, change):
    with zipfile.ZipFile(fmu) as source, zipfile.ZipFile(copy, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            target.writestr(name, change(content.decode()) if name == "modelDescription.xml" else content)


def run(command, **options):
    result = subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=60, **options)
    assert result.returncode == 0, f"{command} ended with {result.returncode}:\n{result.stdout}\n{result.stderr}"
    return result


def assert_is_the_run(build, version, case, table):
    """That a host's table of time and outputs is fmpy's, and as close to scipy's as metrics.json promises.

    It is the same binary, but a host that adds up its time steps is off by 200 roundings: 1e-12 of each output's
    largest value.
    """
    expected = simulate_with_fmpy(build, *case, version=version)
    assert table.shape == (201, 1 + len(OUTPUTS))
    np.testing.assert_allclose(table[:, 0], expected["time"], rtol=0, atol=1e-12)
    exact = reference(*case, expected["time"])
    for output, values, solution in zip(OUTPUTS, table.T[1:], exact):
        np.testing.assert_allclose(values, expected[output], rtol=0, atol=1e-12 * np.max(np.abs(expected[output])))
        assert np.max(np.abs(values - solution)) <= build.metrics["outputs"][output]["max_abs_error"]


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize(("host", "version", "interface"), RUNS)
def test_the_host_computes_what_fmpy_does(pendulum, host, version, interface, case):
    assert_is_the_run(pendulum, version, case, run_in_host(host, interface, pendulum.fmus[version], case))


@pytest.mark.parametrize(("host", "version", "interface"), RUNS)
def test_the_host_may_take_longer_steps(pendulum, host, version, interface):
    """Rows at the same times are the same whatever the step: the surrogate has no history."""
    fmu = pendulum.fmus[version]
    fine = run_in_host(host, interface, fmu, CASES[0])
    coarse = run_in_host(host, interface, fmu, CASES[0], step=0.25, steps=8)
    largest = np.max(np.abs(fine), axis=0)
    np.testing.assert_allclose(coarse / largest, fine[::25] / largest, rtol=0, atol=1e-12)


def run_fmutool(fmu):
    command = [Path(sys.executable).with_name("fmutool"), "-input", fmu, "-check"]
    return subprocess.run(command, capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize("version", [2, 3])
def test_fmutool_finds_no_problem(pendulum, version):
    result = run_fmutool(pendulum.fmus[version])
    report = result.stdout + result.stderr
    assert result.returncode == 0 and "ERROR" not in report and "WARNING" not in report, report
    assert f"compliant with FMI-{version}.0" in report, report
    assert f"No semantic error against the FMI-{version} standard" in report, report


def test_fmutool_reports_a_problem_that_was_put_in(pendulum, tmp_path):
    """Guards the test above against a tool that finds nothing in any FMU."""
    broken = tmp_path / "broken.fmu"
    rewrite_description(pendulum.fmus[2], broken, lambda text: text.replace('causality="output"', 'causality="local"', 1))
    result = run_fmutool(broken)
    assert result.returncode != 0 and "is not an output" in result.stdout + result.stderr
