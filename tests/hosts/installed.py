"""Hosts from the package registry run each FMU of a folder as it is: a table of host by FMU.

    cargo run --release --example kinds -- FOLDER
    scripts/venv.sh --hosts && .hosts/bin/python tests/hosts/installed.py FOLDER

Each host takes ten steps of 0.02 s with the start values of the FMU, with its defaults wherever it has some. A cell has the largest difference of an
output from FMPy's at the end, relative to the output's magnitude, or what the host said. Each host runs in a separate process, and each FMU in a fork
of it, so that a crash ends one cell.
"""

import argparse
import importlib
import json
import multiprocessing
import os
import subprocess
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Callable, NamedTuple

import numpy as np
from fmpy import extract, read_model_description, simulate_fmu

STEP, STEPS = 0.02, 10
# by name
HOSTS = {}
# pathsim adds up the time, and the states in CasADi are integrated here
TOLERANCE = 1e-6
# seconds for a cell
PATIENCE = 120


class HostProgram(NamedTuple):
    """A function that runs an FMU and returns its outputs at the end by name, the host's module, and what it can load."""

    run: Callable
    module: str
    interfaces: tuple
    versions: tuple

    def takes(self, description):
        """Returns true if the host has a way to run an FMU with this description."""
        offers = {"co-simulation": description.coSimulation, "model exchange": description.modelExchange}
        return int(description.fmiVersion[0]) in self.versions and any(offers[interface] is not None for interface in self.interfaces)


class Cell(NamedTuple):
    """Text of a cell of the table, whether nothing is wrong, and whether the host ran the FMU to its end."""

    text: str
    is_fine: bool
    has_run: bool


# a host that has no way to run the FMU
UNABLE = Cell("-", is_fine=True, has_run=False)


def host(module, *interfaces, versions=(2,)):
    """Registers a host that runs FMUs by one of these interfaces, of these versions of the standard."""

    def register(function):
        HOSTS[function.__name__.replace("_", "-")] = HostProgram(function, module, interfaces, versions)
        return function

    return register


def starts_of_inputs(description):
    """Start values of real inputs; hosts that have no value for an input set zero."""
    return {v.name: float(v.start) for v in description.modelVariables if v.causality == "input" and v.type in ("Real", "Float64")}


def outputs_of(description):
    return [v.name for v in description.modelVariables if v.causality == "output" and not v.dimensions]


@host("pathsim_fmi", "co-simulation", versions=(2, 3))
def pathsim_fmi(fmu, description):
    from pathsim import Connection, Simulation
    from pathsim.blocks import Constant
    from pathsim_fmi import CoSimulationFMU

    block, starts = CoSimulationFMU(str(fmu), dt=STEP), starts_of_inputs(description)
    inputs = list(block.fmu_wrapper.input_refs)
    constants = [Constant(starts.get(name, 0.0)) for name in inputs]
    wires = [Connection(constant[0], block[place]) for place, constant in enumerate(constants)]
    # the first step is at 0 s
    Simulation([block, *constants], wires, dt=STEP, log=False).run((STEPS - 1) * STEP)
    return dict(zip(block.fmu_wrapper.output_refs, block.outputs.to_array()))


@host("cofmupy.wrappers", "co-simulation", versions=(2, 3))
def cofmupy(fmu, description):
    from cofmupy.wrappers import FmuHandlerFactory

    handler, starts = FmuHandlerFactory(str(fmu))(), starts_of_inputs(description)
    handler.reset()
    for index in range(STEPS):
        values = handler.step(index * STEP, STEP, {name: [starts.get(name, 0.0)] for name in handler.get_input_names()})
    return {name: np.ravel(value)[0] for name, value in values.items()}


@host("gemseo_fmu.disciplines.fmu_discipline", "co-simulation", versions=(2, 3))
def gemseo_fmu(fmu, description):
    from gemseo_fmu.disciplines.fmu_discipline import FMUDiscipline

    data = FMUDiscipline(str(fmu), initial_time=0.0, final_time=STEPS * STEP, time_step=STEP).execute()
    return {name: np.ravel(data[name])[-1] for name in outputs_of(description)}


@host("estim8.models", "co-simulation", "model exchange", versions=(2, 3))
def estim8(fmu, description):
    from estim8.models import FmuModel

    kind = "CoSimulation" if description.coSimulation else "ModelExchange"
    simulation = FmuModel(str(fmu), fmi_type=kind).simulate(0.0, STEPS * STEP, STEP)
    # outputs that begin with an exact value are parameters here
    shown = {variable.name for variable in description.modelVariables if variable.initial != "exact"}
    return {name: float(simulation[name].values[-1]) for name in outputs_of(description) if name in shown}


@host("sofirpy", "co-simulation")
def sofirpy(fmu, description):
    from sofirpy import simulate

    logged = {"fmu": outputs_of(description)}
    frame = simulate(stop_time=STEPS * STEP, step_size=STEP, fmu_paths={"fmu": str(fmu)}, parameters_to_log=logged)
    return {name: float(frame[f"fmu.{name}"].iloc[-1]) for name in logged["fmu"]}


@host("syssimx.components.fmu", "co-simulation")
def syssimx(fmu, description):
    from syssimx.components.fmu import FMUComponent

    component = FMUComponent("fmu", str(fmu))
    component.initialize(0.0)
    starts = starts_of_inputs(description)
    for index in range(STEPS):
        component.set_inputs(starts, index * STEP)
        component.do_step(index * STEP, STEP)
    return {name: float(getattr(value, "magnitude", value)) for name, value in component.get_outputs().items()}


@host("fmugym.fmugym", "co-simulation", versions=(2, 3))
def fmugym(fmu, description):
    from fmugym.fmugym import FMUGym
    from fmugym.fmugym_config import FMUGymConfig, VarSpace

    class Environment(FMUGym):
        init_states, observation = {}, {}

        def compute_reward(self, observation, info):
            return 0.0

    starts = starts_of_inputs(description)
    spaces = {"inputs": starts, "input_noise": [], "outputs": outputs_of(description), "output_noise": [], "random_vars": []}
    boxes = {name: VarSpace(name) for name in spaces}
    for name, variables in spaces.items():
        for variable in variables:
            boxes[name].add_var_box(variable, -1e6, 1e6)
    environment = Environment(FMUGymConfig(str(fmu), 0.0, 2 * STEPS * STEP, STEP, STEP, **boxes))
    environment.reset()
    for _ in range(STEPS):
        environment.step(np.array(list(starts.values())))
    return environment._get_fmu_output()


@host("casadi", "model exchange", versions=(2, 3))
def casadi(fmu, description):
    from casadi import DaeBuilder

    model = DaeBuilder("fmu", str(extract(str(fmu))))
    end = STEPS * STEP
    inputs, parameters = [np.ravel([model.start(name) for name in names]) for names in (model.u(), model.p())]
    if model.nx() == 0:
        values = model.create("outputs", ["t", "u", "p"], ["y"])(end, inputs, parameters)
    else:
        equations = model.create("equations", ["t", "x", "u", "p"], ["ode", "y"])
        starts = {variable.name: variable.start for variable in description.modelVariables}
        # CasADi takes states without a start value for zero; those of metafmu are parameters
        state, size = np.array([float(starts.get(f"{name}_start", np.ravel(model.start(name))[0])) for name in model.x()]), STEP / 4
        for time in size * np.arange(4 * STEPS):
            # Runge-Kutta's classical method
            slope, total = np.zeros_like(state), np.zeros_like(state)
            for share, weight in ((0.0, 1 / 6), (0.5, 1 / 3), (0.5, 1 / 3), (1.0, 1 / 6)):
                slope = np.ravel(equations(time + share * size, state + share * size * slope, inputs, parameters)[0])
                total += weight * slope
            state = state + size * total
        _, values = equations(end, state, inputs, parameters)
    return dict(zip(model.y(), np.ravel(values)))


def reference(fmu, description):
    """FMPy's values at the end, none if it does not run the FMU."""
    names = outputs_of(description)
    kind = "CoSimulation" if description.coSimulation else "ModelExchange"
    options = {"fmi_type": kind, "stop_time": STEPS * STEP, "output_interval": STEP, "output": names, "relative_tolerance": 1e-10}
    try:
        result = simulate_fmu(str(fmu), validate=False, **options)
        return {name: float(result[name][-1]) for name in names}
    except Exception:
        return None


def failure(error):
    """Cell of an exception."""
    return Cell(f"{type(error).__name__}: {' '.join(str(error).split())[:160]}", is_fine=False, has_run=False)


def silence():
    """Discards what this process prints from now on."""
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        os.dup2(nowhere.fileno(), 2)


def difference(name, fmu):
    """Cell of a host that can load the FMU."""
    description = read_model_description(str(fmu), validate=False)
    expected = reference(fmu, description)
    silence()
    try:
        found = HOSTS[name].run(fmu, description)
    except Exception as error:
        return failure(error)
    if expected is None:
        return Cell("runs, and FMPy does not", is_fine=False, has_run=True)
    missing = set(expected) - set(found)
    if missing:
        return Cell(f"does not show {', '.join(sorted(missing))}", is_fine=False, has_run=True)
    largest = max((abs(float(found[name]) - value) / max(1.0, abs(value)) for name, value in expected.items()), default=0.0)
    return Cell(f"{largest:.0e}", largest <= TOLERANCE, has_run=True)


def send(to, compute, name, fmu):
    to.send(compute(name, fmu))


def forked(compute, name, fmu):
    """Cell that a function computes, in a fork as a crash ends one cell."""
    fork = multiprocessing.get_context("fork")
    here, there = fork.Pipe(duplex=False)
    process = fork.Process(target=send, args=(there, compute, name, fmu))
    process.start()
    there.close()
    try:
        return here.recv() if here.poll(PATIENCE) else Cell(f"no answer in {PATIENCE} s", is_fine=False, has_run=False)
    except EOFError:
        process.join()
        return Cell(f"the process ended with {process.exitcode}", is_fine=False, has_run=False)
    finally:
        process.kill()


def cell(name, fmu):
    """Difference or message of a host, or a dash if it has no way to run the FMU."""
    try:
        description = read_model_description(str(fmu), validate=False)
    except Exception as error:
        return failure(error)
    return forked(difference, name, fmu) if HOSTS[name].takes(description) else UNABLE


def column(name, fmus):
    """Cells of a host in a separate process, which imports it once."""
    command = [sys.executable, __file__, "--column", name, *map(str, fmus)]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return [Cell(*line) for line in map(json.loads, printed.splitlines())]


def print_column(name, fmus):
    # hosts print what they like
    cells = os.fdopen(os.dup(1), "w")
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
    importlib.import_module(HOSTS[name].module)
    for fmu in fmus:
        print(json.dumps(cell(name, fmu)), file=cells, flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("fmus", type=Path, nargs="+", help="FMUs, or folders of FMUs")
    parser.add_argument("--host", nargs="+", choices=HOSTS, default=list(HOSTS), help="only these")
    parser.add_argument("--column", choices=HOSTS, help=argparse.SUPPRESS)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    fmus = [fmu for path in options.fmus for fmu in (sorted(path.glob("*.fmu")) if path.is_dir() else [path])]
    if options.column:
        return print_column(options.column, fmus)
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        columns = list(threads.map(column, options.host, [fmus] * len(options.host)))
    print("| FMU | " + " | ".join(options.host) + " |")
    print("|---" * (1 + len(options.host)) + "|")
    for fmu, cells in zip(fmus, zip(*columns)):
        print(f"| {fmu.stem} | {' | '.join(of_host.text for of_host in cells)} |")
    sys.exit(not all(of_host.is_fine for cells in columns for of_host in cells))


if __name__ == "__main__":
    main()
