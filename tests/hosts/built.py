"""Hosts that scripts/build-hosts.sh builds from their sources run each FMU of a folder as it is: a table of host by FMU.

    scripts/build-hosts.sh
    cargo run --release --example kinds -- FOLDER
    target/hosts/pyfmi/bin/python tests/hosts/built.py FOLDER

Each host takes ten steps of 0.02 s with the start values of the FMU. A cell has the largest difference of an output from FMPy's at the end, relative
to the output's magnitude, or what the host said; see installed.py. A second table has more uses of PyFMI: values before the initialization, the
linearization, and two FMUs in a loop. The environment variable HOSTS_FOLDER has the folder of the hosts, target/hosts by default. Hosts that were not
built are skipped.
"""

import argparse
import csv
import importlib.util
import os
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path
from typing import Callable, NamedTuple

import numpy as np
from fmpy import read_model_description

from installed import HOSTS, PATIENCE, STEP, STEPS, UNABLE, Cell, cell, failure, forked, host, outputs_of, silence

FOLDER = Path(os.environ.get("HOSTS_FOLDER", Path(__file__).parents[2] / "target" / "hosts")).resolve()
END = STEPS * STEP
# the solvers of model exchange; errors of both add up in a difference
RELATIVE = ABSOLUTE = 1e-10
# finite differences have about half of the digits
OF_DERIVATIVES = 1e-5
NUMBERS = {"true": 1.0, "false": 0.0}
# by name
CHECKS = {}
# those of installed.py run with the packages of another environment
HOSTS.clear()


class Names(NamedTuple):
    """Names of real outputs and inputs of an FMU."""

    outputs: list
    inputs: list


class Check(NamedTuple):
    """A function that gets a loaded model and an FMU and returns a cell, and which models it is for."""

    run: Callable
    kind: str
    is_for: Callable


def check(kind, is_for):
    """Registers a check of FMUs that PyFMI loads by this interface."""

    def register(function):
        CHECKS[function.__name__.replace("_", " ")] = Check(function, kind, is_for)
        return function

    return register


def has_start(variable):
    return variable.causality == "parameter" and variable.start is not None and not variable.dimensions


def is_of_fmi2(description):
    return description.fmiVersion.startswith("2")


def has_fmi2_co_simulation(description):
    return is_of_fmi2(description) and description.coSimulation is not None


def has_model_exchange(description):
    return description.modelExchange is not None


def has_fmi2_states(description):
    return is_of_fmi2(description) and has_model_exchange(description) and description.numberOfContinuousStates > 0


def reals_of(description):
    """Real outputs and inputs of an FMU 2.0, the first of which can be wired."""
    reals = [variable for variable in description.modelVariables if variable.type == "Real"]
    return Names(*[[variable.name for variable in reals if variable.causality == causality] for causality in ("output", "input")])


def can_be_coupled(description):
    return has_fmi2_co_simulation(description) and all(reals_of(description)) and description.coSimulation.providesDirectionalDerivative


def run_program(outputs, result, *command):
    """Runs a host that writes a CSV file, and returns outputs of its last row by name; raises an exception with what the host said if it fails."""
    ended = subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=PATIENCE)
    said = " ".join((ended.stderr or ended.stdout).split())
    if ended.returncode != 0:
        raise RuntimeError(f"exit code {ended.returncode}: {said}")
    with open(result, newline="") as file:
        rows = list(csv.DictReader(file))
    if not rows:
        raise RuntimeError(f"result without rows: {said}")
    return {name: number(rows[-1][name]) for name in outputs if name in rows[-1]}


def number(text):
    stripped = text.strip()
    return NUMBERS[stripped] if stripped in NUMBERS else float(stripped)


def load_with_pyfmi(fmu, kind):
    from pyfmi import load_fmu

    # 4 logs warnings, 2 errors
    return load_fmu(str(fmu), kind=kind, log_level=2)


def simulate_with_pyfmi(fmu, description, kind):
    with tempfile.TemporaryDirectory() as folder:
        # PyFMI writes its log and its results into the working directory
        os.chdir(folder)
        model = load_with_pyfmi(fmu, kind)
        options = model.simulate_options()
        options["ncp"] = STEPS
        if kind == "ME":
            options["CVode_options"].update(rtol=RELATIVE, atol=ABSOLUTE)
        result = model.simulate(final_time=END, options=options)
        return {name: float(result[name][-1]) for name in outputs_of(description)}


@host("pyfmi", "co-simulation")
def pyfmi_cs(fmu, description):
    return simulate_with_pyfmi(fmu, description, "CS")


@host("pyfmi", "model exchange", versions=(2, 3))
def pyfmi_me(fmu, description):
    return simulate_with_pyfmi(fmu, description, "ME")


def simulate_with_omsimulator(fmu, description, mode):
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "result.csv"
        files = [f"--resultFile={result}", f"--tempDir={folder}"]
        numbers = [f"--stopTime={END}", f"--stepSize={STEP}", f"--tolerance={RELATIVE}", f"--intervals={STEPS}"]
        return run_program(outputs_of(description), result, FOLDER / "omsimulator" / "OMSimulator", fmu, f"--mode={mode}", *files, *numbers)


@host("omsimulator", "co-simulation", versions=(2, 3))
def omsimulator_cs(fmu, description):
    return simulate_with_omsimulator(fmu, description, "cs")


@host("omsimulator", "model exchange")
def omsimulator_me(fmu, description):
    return simulate_with_omsimulator(fmu, description, "me")


def simulate_with_fmusim(fmu, description, interface):
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "result.csv"
        numbers = ["--stop-time", END, "--output-interval", STEP, "--tolerance", RELATIVE]
        command = [FOLDER / "fmusim" / "fmusim", "simulate", fmu, "--interface-type", interface, "--output-file", result]
        return run_program(outputs_of(description), result, *command, *numbers)


@host("fmusim", "co-simulation", versions=(2, 3))
def fmusim_cs(fmu, description):
    return simulate_with_fmusim(fmu, description, "cs")


@host("fmusim", "model exchange", versions=(2, 3))
def fmusim_me(fmu, description):
    return simulate_with_fmusim(fmu, description, "me")


@check("ME", has_model_exchange)
def parameters_before_the_initialization(model, fmu):
    """Compares parameters of a model that is only instantiated with their start values."""
    variables = [variable for variable in read_model_description(str(fmu)).modelVariables if has_start(variable)]
    wrong = [variable.name for variable in variables if float(model.get(variable.name)[0]) != number(variable.start)]
    return Cell(f"differs: {', '.join(wrong)}" if wrong else f"{len(variables)} right", not wrong, has_run=True)


def rates_and_outputs(model, names, point):
    """Derivatives of states and values of outputs at a point of states and inputs."""
    states = len(model.continuous_states)
    model.continuous_states = point[:states]
    for name, value in zip(names.inputs, point[states:]):
        model.set(name, value)
    return np.concatenate([model.get_derivatives(), [model.get(name)[0] for name in names.outputs]])


@check("ME", has_fmi2_states)
def linearization(model, fmu):
    """Compares matrices of PyFMI, which come from directional derivatives, with differences.

    PyFMI has differences too, but ignores errors of fmi2SetReal: with an FMU that refuses to set states in Event Mode they are zero.
    """
    names = Names(list(model.get_output_list()), list(model.get_input_list()))
    model.initialize()
    model.event_update()
    model.enter_continuous_time_mode()
    matrices = model.get_state_space_representation(use_structure_info=False)
    exact = np.block([[np.asarray(matrices[0]), np.asarray(matrices[1])], [np.asarray(matrices[2]), np.asarray(matrices[3])]])
    inputs = [model.get(name)[0] for name in names.inputs]
    point = np.concatenate([model.continuous_states, inputs])
    for column, step in enumerate(1e-6 * np.eye(len(point))):
        numeric = (rates_and_outputs(model, names, point + step) - rates_and_outputs(model, names, point - step)) / 2e-6
        exact[:, column] -= numeric
    largest = np.abs(exact).max()
    return Cell(f"{largest:.0e}", bool(largest <= OF_DERIVATIVES), has_run=True)


def couple(models, names, is_corrected):
    """Outputs at the end of two models in a loop, in which each has the other's first output as its first input."""
    from pyfmi import Master

    here, there = models
    for model in models:
        model.reset()
    master = Master(models, [(here, names.outputs[0], there, names.inputs[0]), (there, names.outputs[0], here, names.inputs[0])])
    options = master.simulate_options()
    options.update(step_size=STEP, linear_correction=is_corrected, result_handling="memory")
    results = master.simulate(final_time=END, options=options)
    return np.array([[results[model][name][-1] for name in names.outputs] for model in models])


@check("CS", can_be_coupled)
def linear_correction(model, fmu):
    """Runs a loop of two FMUs with linear correction, and shows how far it moves their outputs: not at all without direct feedthrough."""
    models, names = [model, load_with_pyfmi(fmu, "CS")], reals_of(read_model_description(str(fmu)))
    corrected, plain = [couple(models, names, is_corrected) for is_corrected in (True, False)]
    return Cell(f"runs, moves {np.abs(corrected - plain).max():.0e}", bool(np.isfinite(corrected).all()), has_run=True)


def checked(name, fmu):
    """Cell of a check of an FMU that it is for."""
    silence()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            return CHECKS[name].run(load_with_pyfmi(fmu, CHECKS[name].kind), fmu)
        except Exception as error:
            return failure(error)


def is_built(name):
    module = HOSTS[name].module
    return importlib.util.find_spec("pyfmi") is not None if module == "pyfmi" else (FOLDER / "stamps" / module).exists()


def print_table(fmus, names, cell_of):
    """Prints rows as they are ready, and returns whether nothing is wrong."""
    print("| FMU | " + " | ".join(names) + " |")
    print("|---" * (1 + len(names)) + "|")
    is_fine = True
    for fmu in fmus:
        cells = [cell_of(name, fmu) for name in names]
        print(f"| {fmu.stem} | {' | '.join(of_host.text for of_host in cells)} |", flush=True)
        is_fine = is_fine and all(of_host.is_fine for of_host in cells)
    return is_fine


def cell_of_check(name, fmu):
    """Cell of a check, or a dash if it is not for the FMU."""
    return forked(checked, name, fmu) if CHECKS[name].is_for(read_model_description(str(fmu))) else UNABLE


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("fmus", type=Path, nargs="+", help="FMUs, or folders of FMUs")
    parser.add_argument("--host", nargs="+", choices=HOSTS, default=list(HOSTS), help="only these")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    fmus = [fmu.resolve() for path in options.fmus for fmu in (sorted(path.glob("*.fmu")) if path.is_dir() else [path])]
    names = [name for name in options.host if is_built(name)]
    if len(names) < len(options.host):
        print(f"not built: {', '.join(sorted(set(options.host) - set(names)))}", file=sys.stderr)
    has_pyfmi = any(HOSTS[name].module == "pyfmi" for name in names)
    if has_pyfmi:
        # once rather than in each fork
        import pyfmi  # noqa: F401
    is_fine = print_table(fmus, names, cell)
    if has_pyfmi:
        print()
        is_fine = print_table(fmus, list(CHECKS), cell_of_check) and is_fine
    sys.exit(not is_fine)


if __name__ == "__main__":
    main()
