"""Habits of hosts: each gives what a host that follows the standard gets, of every kind of surrogate, with the library and with the C sources."""

import subprocess
import sys

import numpy as np
import pytest
from conftest import ROOT
from fmpy import extract, read_model_description
from fmpy.fmi3 import FMU3Model, FMU3Slave

sys.path.insert(0, str(ROOT / "tests" / "hosts"))
import habits

KINDS = (
    "response", "response-of-time-points", "response-with-input", "response-with-bounds", "equations", "equations-with-actuator",
    "network-of-rates", "discrete", "recurrent",
)  # fmt: skip
# a further habit, which no FMU allows
SET_AN_OUTPUT = """
import sys
import habits

@habits.habit("none", version=2, interface="cs")
def set_an_output(host):
    \"\"\"an output is set\"\"\"
    host.initialize()
    host.set({host.named("output")[0].name: 1.0})
    return host.finish()

habits.main()
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("kinds")
    subprocess.run([ROOT / "target" / "release" / "examples" / "kinds", folder], check=True)
    assert {path.stem for path in folder.iterdir()} == {f"{kind}{ending}" for kind in KINDS for ending in ("", "-fmi3")}
    return folder


def run(fmu, *program):
    """The table of an FMU, in a separate process: FMPy keeps the last logger in a process, and a crash ends it."""
    command = [sys.executable, *(program or [habits.__file__]), fmu]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=ROOT / "tests" / "hosts")


@pytest.mark.parametrize("ending", ["", "-fmi3"], ids=["2", "3"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_habit_gets_what_it_means(kind, ending, folder):
    result = run(folder / f"{kind}{ending}.fmu")
    rows = [line.strip("| ").split(" | ") for line in result.stdout.splitlines()[2:]]
    assert result.returncode == 0 and len(rows) == len(habits.HABITS), result.stdout + result.stderr
    outcomes = [row[-1] for row in rows]
    assert set(outcomes) <= {"✓", "-"} and outcomes.count("✓") >= 10, result.stdout


def running(fmu, description):
    """An instance of an FMU of FMI 3.0 in Continuous-Time Mode, or after a step where there is no model exchange."""
    interface, offer = (FMU3Model, description.modelExchange) if description.modelExchange else (FMU3Slave, description.coSimulation)
    instance = interface(guid=description.guid, unzipDirectory=extract(str(fmu)), modelIdentifier=offer.modelIdentifier, instanceName="listed")
    instance.instantiate()
    instance.enterInitializationMode()
    instance.exitInitializationMode()
    if description.modelExchange:
        instance.updateDiscreteStates()
        instance.enterContinuousTimeMode()
    else:
        instance.doStep(0.0, 0.02)
    return instance


@pytest.mark.parametrize("kind", KINDS)
def test_what_no_dependency_lists_has_a_derivative_of_zero(kind, folder):
    fmu = folder / f"{kind}-fmi3.fmu"
    description = read_model_description(str(fmu))
    instance, pairs = running(fmu, description), 0
    states = [unknown.variable.derivative for unknown in description.derivatives or []]
    reals = [variable for variable in description.modelVariables if variable.type == "Float64"]
    knowns = [variable for variable in reals if variable.causality in ("parameter", "input", "independent") or variable in states]
    for unknown in [*description.outputs, *(description.derivatives or [])]:
        size = int(np.prod([int(dimension.start) for dimension in unknown.variable.dimensions]))
        for known in knowns:
            slopes = instance.getDirectionalDerivative([unknown.variable.valueReference], [known.valueReference], [1.0], size)
            assert known in unknown.dependencies or not np.any(slopes), (unknown.variable.name, known.name, slopes)
            pairs += bool(np.any(slopes))
    # inputs of these act from the next sample on
    assert (pairs > 0) == (kind not in ("discrete", "recurrent"))
    instance.freeInstance()


def test_what_is_refused_is_in_the_table_with_the_fmus_sentence(folder):
    result = run(folder / "equations.fmu", "-c", SET_AN_OUTPUT)
    # by the library and by the C sources
    assert result.returncode == 1 and result.stdout.count("is an output and cannot be set") == 2, result.stdout + result.stderr
    assert len(result.stdout.splitlines()) == 2 + len(habits.HABITS) + 1


def test_the_page_has_every_habit():
    rows = [line.split(" | ") for line in (ROOT / "docs" / "calls.md").read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    listed = {row[0].removeprefix("| ") for row in rows if len(row) == 3} - {"call"}
    assert listed == {of.run.__doc__ for of in habits.HABITS.values()}
