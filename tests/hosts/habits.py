"""Habits of hosts that the standard does not allow, or that surprise an FMU: each as its host has it, a function below.

    cargo run --release --example kinds -- FOLDER
    .venv/bin/python tests/hosts/habits.py FOLDER    # a table: habit by FMU; FMUs may be named instead

Each FMU is run with its own library and, if it has C sources, with a library of them, in co-simulation and model exchange. A habit
passes if the outputs at the end are those of a host that follows the standard. Else its cell has the first call that was refused.
"""

import argparse
import math
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as xml
from ctypes import byref
from pathlib import Path
from typing import Callable, NamedTuple

import numpy as np
from fmpy import extract, fmi2, fmi3, read_model_description
from fmpy.fmi1 import FMICallException
from fmpy.logging import addLoggerProxy

# by name
HABITS = {}
ERROR = 3
STEP, STEPS = 0.02, 10
# of a clock in single precision, relative to the range of an output
CLOCK_ERROR = 1e-5


class Habit(NamedTuple):
    """A function that runs a host to the end and returns its outputs, and who does so; `version`, `interface`: the only ones that have it."""

    run: Callable
    hosts: str
    version: int | None
    interface: str | None


def habit(hosts, version=None, interface=None):
    """Registers a habit of some hosts, of one version of the standard or one interface if it has them only there."""

    def register(function):
        HABITS[function.__name__] = Habit(function, hosts, version, interface)
        return function

    return register


class Host:
    """An instance of an FMU, and the steps of a host that follows the standard. A habit takes another way for one of them."""

    def __init__(self, folder, library, interface, location=None):
        self.description = read_model_description(folder)
        self.version, self.interface, self.folder = int(self.description.fmiVersion[0]), interface, Path(folder)
        self.error, self.now = None, 0.0
        kind = self.description.coSimulation if interface == "cs" else self.description.modelExchange
        module, ending = (fmi2, "2") if self.version == 2 else (fmi3, "3")
        make = getattr(module, f"FMU{ending}{'Slave' if interface == 'cs' else 'Model'}")
        self.fmu = make(
            guid=self.description.guid or getattr(self.description, "instantiationToken", None),
            unzipDirectory=str(folder),
            modelIdentifier=kind.modelIdentifier,
            instanceName="habits",
            libraryPath=str(library) if library else None,
        )
        self.variables = {variable.name: variable for variable in self.description.modelVariables}
        self.instantiate(location)

    def instantiate(self, location):
        """`location` is the argument in place of the folder of resources."""
        raw, instantiate = None, f"fmi{self.version}Instantiate"
        if self.version == 3:
            instantiate += "CoSimulation" if self.interface == "cs" else "ModelExchange"
        if location is not None:
            raw = getattr(self.fmu, instantiate)
            place = 3 if self.version == 2 else 2
            setattr(self.fmu, instantiate, lambda *given: raw(*given[:place], location.encode(), *given[place + 1 :]))
        if self.version == 2:
            self.callbacks = fmi2.fmi2CallbackFunctions()
            self.callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(lambda *message: self.note(message[2], message[4]))
            self.callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
            self.callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
            addLoggerProxy(byref(self.callbacks))
            self.fmu.instantiate(callbacks=self.callbacks)
        else:
            self.fmu.instantiate(logMessage=lambda _, status, category, message: self.note(status, message))

    def note(self, status, message):
        """Keeps the last error."""
        if status >= ERROR:
            self.error = message.decode()

    def free(self):
        self.fmu.freeInstance()

    # ---- variables ----

    def named(self, *causalities, type="Real"):
        """Scalars with a causality and type."""
        types = {"Real": ("Real", "Float64"), "Integer": ("Integer", "Int32"), "Boolean": ("Boolean",)}[type]
        return [v for v in self.description.modelVariables if v.causality in causalities and v.type in types and not v.dimensions]

    def settings(self):
        """Values that the host sets: a quarter of the range of each parameter and input from its start value."""
        values = {}
        for variable in self.named("parameter", "input"):
            low, high = float(variable.min or "nan"), float(variable.max or "nan")
            start = float(variable.start)
            values[variable.name] = start if math.isnan(low + high) else start + 0.25 * (high - start)
        return values

    def parameters(self):
        names = {variable.name for variable in self.named("parameter")}
        return {name: value for name, value in self.settings().items() if name in names}

    def inputs(self):
        names = {variable.name for variable in self.named("input")}
        return {name: value for name, value in self.settings().items() if name in names}

    def references(self, names):
        return [self.variables[name].valueReference for name in names]

    def set(self, values):
        if values:
            (self.fmu.setReal if self.version == 2 else self.fmu.setFloat64)(self.references(values), list(values.values()))

    def get(self, names):
        return list((self.fmu.getReal if self.version == 2 else self.fmu.getFloat64)(self.references(names))) if names else []

    def outputs(self):
        return self.get([variable.name for variable in self.named("output")])

    # ---- modes ----

    def set_up(self, stop=None):
        """In FMI 3.0 the next call has these arguments."""
        self.stop = stop
        if self.version == 2:
            self.fmu.setupExperiment(startTime=0.0, stopTime=stop)

    def enter(self):
        self.fmu.enterInitializationMode(**({} if self.version == 2 else {"startTime": 0.0, "stopTime": self.stop}))

    def exit(self):
        self.fmu.exitInitializationMode()

    def initialize(self, stop=None, values=None):
        self.set_up(stop)
        self.enter()
        self.set(self.settings() if values is None else values)
        self.exit()

    def begin(self):
        """Leaves Event Mode."""
        if self.interface == "me":
            self.update()
            self.fmu.enterContinuousTimeMode()

    def update(self):
        function = self.fmu.newDiscreteStates if self.version == 2 else self.fmu.updateDiscreteStates
        function()

    # ---- time ----

    def step(self, size=STEP):
        """A communication step, or one of the explicit Euler method."""
        if self.interface == "cs":
            self.communicate(self.now, size)
        else:
            states = self.states() + size * self.rates()
            self.now += size
            self.evaluate(self.now, states)
            self.complete()

    def communicate(self, now, size):
        self.fmu.doStep(now, size)
        self.now = now + size

    def states(self):
        return self.read("getContinuousStates")

    def rates(self):
        return self.read("getDerivatives" if self.version == 2 else "getContinuousStateDerivatives")

    def read(self, function):
        count = self.description.numberOfContinuousStates
        values = np.zeros(count)
        self.pass_reals(function, values)
        return values

    def pass_reals(self, function, values):
        pointer = values.ctypes.data_as(fmi2.POINTER(fmi2.c_double))
        getattr(self.fmu, function)(pointer, len(values))

    def set_states(self, states):
        self.pass_reals("setContinuousStates", states)

    def evaluate(self, time, states):
        self.fmu.setTime(time)
        self.set_states(states)

    def complete(self):
        self.fmu.completedIntegratorStep()

    def finish(self, step=None):
        """The steps of a run, and the outputs at its end."""
        self.begin()
        for _ in range(STEPS):
            (step or self.step)()
        return self.outputs()


def as_the_standard_says(host):
    """a host that follows the standard"""
    host.initialize()
    return host.finish()


# ---- habits, in the order of docs/calls.md ----


@habit("FMI Kit for Simulink")
def endless(host):
    """a stop time of infinity"""
    host.initialize(stop=math.inf)
    return host.finish()


@habit("preCICE; OpenModelica until 2022", version=2)
def no_experiment(host):
    """no `fmi2SetupExperiment`"""
    host.enter()
    host.set(host.settings())
    host.exit()
    return host.finish()


@habit("OpenModelica until 2022", version=2, interface="me")
def time_instead_of_an_experiment(host):
    """no `fmi2SetupExperiment`"""
    host.fmu.setTime(0.0)
    return no_experiment(host)


@habit("PyFMI", version=2)
def early_reading(host):
    """start values are read before the initialization, in FMI 2.0"""
    starts = {variable.name: float(variable.start) for variable in host.named("parameter", "input")}
    assert host.get(list(starts)) == list(starts.values())
    host.initialize()
    return host.finish()


@habit("OpenModelica until mid-2026")
def late_parameters(host):
    """fixed parameters are set after the initialization"""
    host.initialize(values={})
    host.set(host.settings())
    return host.finish()


@habit("gemseo-fmu, FMI.jl")
def parameters_at_each_step(host):
    """a fixed parameter is set to the value that it has"""
    host.initialize()

    def step():
        host.set(host.settings() if host.interface == "cs" else host.inputs())
        host.step()

    return host.finish(step)


@habit("CasADi, pathsim-fmi, cofmupy, gemseo-fmu")
def reals_only(host):
    """Booleans and integers are read or set as reals"""
    integers = {variable.name: float(variable.start) for variable in host.named("parameter", "input", type="Integer")}
    booleans = {variable.name: float(variable.start == "true") for variable in host.named("parameter", "input", type="Boolean")}
    shown = [variable.name for variable in host.named("output", type="Boolean")]
    host.set_up()
    host.enter()
    host.set(host.settings() | integers | booleans)
    host.exit()
    outputs = host.finish()
    assert all(value in (0.0, 1.0) for value in host.get(shown))
    return outputs


@habit("CasADi", interface="me")
def tunable_parameters_of_a_solver(host):
    """tunable parameters are set in Continuous-Time Mode"""
    tunable = {variable.name for variable in host.named("parameter") if variable.variability == "tunable"}
    late = {name: value for name, value in host.parameters().items() if name in tunable}
    host.initialize(values={name: value for name, value in host.settings().items() if name not in late})
    host.begin()
    host.set(late)
    host.fmu.enterEventMode()
    return host.finish()


@habit("Modelica-FMI", interface="cs")
def time_as_a_variable(host):
    """the independent variable is set to the present time"""
    times = [variable.name for variable in host.named("independent")]
    host.initialize()

    def step():
        host.set(dict.fromkeys(times, host.now))
        host.step()

    return host.finish(step)


@habit("Dymola, OpenModelica", interface="me")
def states_before_the_solver(host):
    """states are set in Initialization Mode or Event Mode"""
    host.set_up()
    host.enter()
    host.set(host.settings())
    host.set_states(host.states())
    host.exit()
    host.set_states(host.states())
    return host.finish()


@habit("OpenModelica", version=3, interface="me")
def event_in_an_event(host):
    """FMI 3.0: `fmi3SetTime`, `fmi3EnterEventMode` in Event Mode"""
    host.initialize()
    host.fmu.setTime(0.0)
    host.fmu.enterEventMode()
    return host.finish()


@habit("FMI Kit for Simulink", version=3)
def configuration(host):
    """FMI 3.0: `fmi3EnterConfigurationMode`"""
    host.fmu.enterConfigurationMode()
    host.fmu.exitConfigurationMode()
    host.initialize()
    return host.finish()


@habit("CasADi", interface="me")
def before_the_start(host):
    """a time before the start, or before the last event, in model exchange"""
    host.initialize()
    host.begin()
    states = host.states()
    host.evaluate(-1e-6, states)
    host.outputs()
    host.evaluate(0.0, states)
    host.fmu.enterEventMode()
    return host.finish()


@habit("Unity-FMI-Addon", interface="cs")
def clock_in_single_precision(host):
    """communication points in single precision"""
    host.initialize()

    def step():
        host.communicate(float(np.float32(host.now)), float(np.float32(STEP)))

    return host.finish(step)


def folder_of_the_fmu(host):
    return host.folder.as_uri() if host.version == 2 else str(host.folder)


def other_notation(host):
    resources = host.folder / "resources"
    return str(resources) if host.version == 2 else resources.as_uri()


@habit("Unity-FMI-Addon")
def location_of_the_fmu(host):
    """the folder of the FMU, a path in FMI 2.0, or a URI in FMI 3.0 as the location of resources"""
    return at_location(host, folder_of_the_fmu(host))


@habit("FMI.jl")
def location_in_the_other_notation(host):
    """the folder of the FMU, a path in FMI 2.0, or a URI in FMI 3.0 as the location of resources"""
    return at_location(host, other_notation(host))


def at_location(host, location):
    getattr(host.fmu, f"fmi{host.version}FreeInstance")(host.fmu.component)
    host.instantiate(location)
    return as_the_standard_says(host)


@habit("PyFMI, CasADi")
def whole_jacobian(host):
    """derivatives of `in_domain` or of a constant bound, or with respect to an integer or Boolean"""
    host.initialize()
    unknowns = [v for v in host.description.modelVariables if v.causality == "output" and not v.dimensions]
    switches = host.named("parameter", type="Integer") + host.named("input", type="Boolean")
    for known in host.named("input", type="Real") + switches:
        slopes = host.fmu.getDirectionalDerivative([v.valueReference for v in unknowns], [known.valueReference], [1.0])
        for unknown, slope in zip(unknowns, slopes, strict=True):
            is_constant = unknown.type == "Boolean" or unknown.variability == "constant" or known in switches
            assert slope == 0.0 or not is_constant, (unknown.name, known.name, slope)
    return host.finish()


@habit("FMI4cpp, OMSimulator, PyFMI")
def terminate_twice(host):
    """`Terminate` at any time, also twice"""
    host.initialize()
    outputs = host.finish()
    host.fmu.terminate()
    host.fmu.terminate()
    host.fmu.reset()
    host.fmu.terminate()
    return outputs


@habit("Hopsan, OMSimulator, ecos")
def status_ignored(host):
    """a refused call whose status nobody looks at"""
    host.initialize()

    def step():
        try:
            host.exit()
        except FMICallException:
            return host.step()
        raise AssertionError("ExitInitializationMode was accepted after the initialization")

    return host.finish(step)


@habit("simple solvers", interface="me")
def no_completed_step(host):
    """`CompletedIntegratorStep` is never called"""
    host.initialize()

    def step():
        states = host.states() + STEP * host.rates()
        host.now += STEP
        host.evaluate(host.now, states)

    return host.finish(step)


# ---- the table ----


def library_of_sources(folder, version, to):
    """The library compiled from the C sources of an unpacked FMU, None if it has none."""
    sources = folder / "sources"
    if not sources.is_dir():
        return None
    listed = folder / "modelDescription.xml" if version == 2 else sources / "buildDescription.xml"
    tag = "File" if version == 2 else "SourceFile"
    files = sorted({str(sources / element.get("name")) for element in xml.parse(listed).iter(tag) if element.get("name", "").endswith(".c")})
    library = to / f"{folder.name}.so"
    subprocess.run(["cc", "-std=c99", "-O0", "-fPIC", "-shared", "-I", sources, *files, "-lm", "-o", library], check=True)
    return library


def outcome(function, folder, library, interface):
    """Outputs at the end, or a text that says why there are none."""
    host = Host(folder, library, interface)
    try:
        return function(host)
    except FMICallException as error:
        return host.error or str(error)
    finally:
        host.free()


def matches(found, expected, is_rounded):
    if isinstance(found, str) or not is_rounded:
        return found == expected
    return all(abs(a - b) <= CLOCK_ERROR * max(1.0, abs(b)) for a, b in zip(found, expected, strict=True))


def cells(fmu, to):
    """Failures of an FMU by habit; None for a habit that its version and interfaces do not have."""
    folder = Path(extract(str(fmu), to / fmu.name))
    description = read_model_description(folder)
    version = int(description.fmiVersion[0])
    libraries = {"library": None, "C sources": library_of_sources(folder, version, to)}
    wrong = dict.fromkeys(HABITS)
    for interface, kind in (("cs", description.coSimulation), ("me", description.modelExchange)):
        for what, library in libraries.items():
            if kind is None or what == "C sources" and library is None:
                continue
            expected = outcome(as_the_standard_says, folder, library, interface)
            if isinstance(expected, str):
                raise SystemExit(f"error: {fmu}: a run as the standard has it failed: {expected}")
            for name, of in HABITS.items():
                if of.version in (None, version) and of.interface in (None, interface):
                    found = outcome(of.run, folder, library, interface)
                    wrong[name] = wrong[name] or []
                    if not matches(found, expected, of.run is clock_in_single_precision):
                        wrong[name].append(f"FMI {version} {interface}, {what}: {found}")
    return wrong


def table(fmus, to):
    """Habits by FMU as Markdown, and the number of cells that have something wrong."""
    found = {fmu.stem: cells(fmu, to) for fmu in fmus}
    lines = ["| host | habit | " + " | ".join(found) + " |", "|---" * (2 + len(found)) + "|"]
    for name, habit_of in HABITS.items():
        texts = ["-" if of[name] is None else "; ".join(of[name]) or "✓" for of in found.values()]
        lines.append(f"| {habit_of.hosts} | {habit_of.run.__doc__} | " + " | ".join(texts) + " |")
    return "\n".join(lines), sum(bool(of[name]) for of in found.values() for name in HABITS)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("fmus", type=Path, nargs="+", metavar="FMU", help="FMUs, or folders of FMUs")
    options = parser.parse_args()
    fmus = [fmu for path in options.fmus for fmu in (sorted(path.glob("*.fmu")) if path.is_dir() else [path])]
    with tempfile.TemporaryDirectory() as to:
        text, wrong = table(fmus, Path(to))
    print(text)
    sys.exit(wrong > 0)


if __name__ == "__main__":
    main()
