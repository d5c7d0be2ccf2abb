"""Raw C calls to the library of an unpacked FMU, as only a broken host makes them.

Usage: abuse.py FOLDER SCENARIO, in a separate process: a crash must not end the tests.
Each scenario is a function below; it ends the process with 0 and prints its measurements.
"""

import ctypes
import gc
import itertools
import math
import random
import shutil
import sys
import tempfile
import threading
from ctypes import POINTER, byref, c_bool, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from pathlib import Path

from fmpy import read_model_description

OK, WARNING, DISCARD, ERROR, FATAL = range(5)
FINE = (OK,)  # no call returns a warning: hosts end simulations on one
CO_SIMULATION = 1
UNKNOWN = 4_000_000_000
# types of variables, that of the outputs first
KINDS_2 = ("Real", "Integer", "Boolean", "String")
INTEGERS = [f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64)]
KINDS_3 = ("Float64", "Float32", *INTEGERS, "Boolean", "String")
LOGGER = ctypes.CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p)
LOGGER_3 = ctypes.CFUNCTYPE(None, c_void_p, c_int, c_char_p, c_char_p)


class Callbacks(ctypes.Structure):
    _fields_ = [
        ("logger", LOGGER),
        ("allocate_memory", c_void_p),
        ("free_memory", c_void_p),
        ("step_finished", c_void_p),
        ("environment", c_void_p),
    ]


class Library:
    """The co-simulation functions of either version, with nothing between them and the caller."""

    # argument types behind the component, of every function that takes one and returns a status
    FUNCTIONS = {}
    PREFIX = PLATFORM = INSTANTIATE = ""
    # arguments of the instantiate function in order
    ARGUMENTS = {}
    # values that some of them cannot have
    WRONG = {}

    def __init__(self, folder):
        description = read_model_description(str(folder))
        identifier = description.coSimulation.modelIdentifier
        self.library = ctypes.CDLL(str(folder / "binaries" / self.PLATFORM / f"{identifier}.so"))
        self.token = (getattr(description, "guid", None) or description.instantiationToken).encode()
        self.resources = folder / "resources"
        variables = [variable for variable in description.modelVariables if variable.type in ("Real", "Float64")]
        self.parameters = [v.valueReference for v in variables if v.causality == "parameter"]
        self.outputs = [v.valueReference for v in variables if v.causality == "output"]
        self.starts = [float(v.start) for v in variables if v.causality == "parameter"]
        self.logged = []
        for name, arguments in self.FUNCTIONS.items():
            function = getattr(self.library, f"{self.PREFIX}{name}")
            function.argtypes, function.restype = [c_void_p, *arguments], c_int
            setattr(self, name, function)
        self.Instantiate = getattr(self.library, self.INSTANTIATE)
        self.Instantiate.argtypes, self.Instantiate.restype = [*self.ARGUMENTS.values()], c_void_p
        self.FreeInstance = getattr(self.library, f"{self.PREFIX}FreeInstance")
        self.FreeInstance.argtypes, self.FreeInstance.restype = [c_void_p], None

    def instantiate(self, folder=None, **changed):
        """An instance, by arguments as they should be but for those changed."""
        arguments = {"name": b"instance", "token": self.token, "resources": self.location(folder or self.resources)}
        arguments |= {"callbacks": self.callbacks, **changed}
        plain = {name: None if kind is c_void_p else kind().value for name, kind in self.ARGUMENTS.items()}
        return self.Instantiate(*(plain | self.FIXED | arguments).values())

    def initialize(self, component):
        for function in self.into_initialization():
            assert function(component) in FINE
        assert self.ExitInitializationMode(component) in FINE

    def ready(self, resources=None, scale=1.0):
        component = self.instantiate(resources)
        assert component
        assert self.set(component, self.parameters, [scale * value for value in self.starts]) in FINE
        self.initialize(component)
        return component

    def outputs_of(self, component):
        status, values = self.get(component, self.outputs)
        assert status in FINE and all(map(math.isfinite, values))
        return values

    def run(self, scale=1.0, steps=3, resources=None):
        """Creates, sets, steps, reads, frees."""
        component = self.ready(resources, scale)
        for step in range(steps):
            assert self.step(component, step * 0.01, 0.01) in FINE
        outputs = self.outputs_of(component)
        self.FreeInstance(component)
        return outputs

    def still_works(self):
        """The library is as good as new, whatever was done to other instances."""
        assert self.run() == self.expected

    def scenario(self, scenario):
        self.expected = self.run()
        scenario(self)
        self.still_works()


class Fmi2(Library):
    KINDS = KINDS_2
    FUNCTIONS = {
        "SetDebugLogging": [c_int, c_size_t, c_void_p],
        "SetupExperiment": [c_int, c_double, c_double, c_int, c_double],
        "EnterInitializationMode": [],
        "ExitInitializationMode": [],
        "Terminate": [],
        "Reset": [],
        **{name + kind: [c_void_p, c_size_t, c_void_p] for name in ("Get", "Set") for kind in KINDS_2},
        "GetFMUstate": [c_void_p],
        "SetFMUstate": [c_void_p],
        "FreeFMUstate": [c_void_p],
        "SerializedFMUstateSize": [c_void_p, c_void_p],
        "SerializeFMUstate": [c_void_p, c_void_p, c_size_t],
        "DeSerializeFMUstate": [c_void_p, c_size_t, c_void_p],
        "GetDirectionalDerivative": [c_void_p, c_size_t, c_void_p, c_size_t, c_void_p, c_void_p],
        "SetRealInputDerivatives": [c_void_p, c_size_t, c_void_p, c_void_p],
        "GetRealOutputDerivatives": [c_void_p, c_size_t, c_void_p, c_void_p],
        "DoStep": [c_double, c_double, c_int],
        "CancelStep": [],
        **{f"Get{kind}Status": [c_int, c_void_p] for kind in ("", *KINDS_2)},
    }
    PREFIX, PLATFORM, INSTANTIATE = "fmi2", "linux64", "fmi2Instantiate"
    ARGUMENTS = {
        "name": c_char_p, "kind": c_int, "token": c_char_p, "resources": c_char_p, "callbacks": c_void_p,
        "visible": c_int, "logging": c_int,
    }  # fmt: skip
    FIXED = {"kind": CO_SIMULATION}
    WRONG = {
        "kind": [-1, 2, 1000],
        "token": [b"", b"{}", b"\xff\xfe", b"x" * 100_000],
        "resources": [b"", b"no uri", b"ftp://x/y", b"file:///%zz", b"file:///" + b"x/" * 50_000, b"\xff"],
    }

    def __init__(self, folder):
        super().__init__(folder)
        self.logger = LOGGER(lambda _, name, status, category, message: self.logged.append((status, category)))
        self.structure = Callbacks(self.logger)
        # of asynchronous steps only
        self.NOT_OFFERED = self.CancelStep
        self.callbacks = byref(self.structure)
        self.silent = byref(Callbacks())

    def location(self, folder):
        return folder.as_uri().encode()

    def set_up(self, component, *arguments):
        return self.SetupExperiment(component, *arguments)

    def into_initialization(self):
        return [lambda component: self.set_up(component, 0, 0.0, 0.0, 0, 0.0), self.EnterInitializationMode]

    def step(self, component, time, size):
        return self.DoStep(component, time, size, 1)

    def set(self, component, references, values):
        n = len(references)
        return self.SetReal(component, (c_uint * n)(*references), n, (c_double * n)(*values))

    def get(self, component, references, kind="Real"):
        n = len(references)
        values = (c_double * n)()
        return getattr(self, f"Get{kind}")(component, (c_uint * n)(*references), n, values), list(values)


class Fmi3(Library):
    KINDS = KINDS_3
    FUNCTIONS = {
        "SetDebugLogging": [c_bool, c_size_t, c_void_p],
        "EnterInitializationMode": [c_bool, c_double, c_double, c_bool, c_double],
        "ExitInitializationMode": [],
        "Terminate": [],
        "Reset": [],
        "EnterEventMode": [],
        "EnterStepMode": [],
        "EnterConfigurationMode": [],
        "ExitConfigurationMode": [],
        **{name + kind: [c_void_p, c_size_t, c_void_p, c_size_t] for name in ("Get", "Set") for kind in KINDS_3},
        **{name + "Binary": [c_void_p, c_size_t, c_void_p, c_void_p, c_size_t] for name in ("Get", "Set")},
        **{name + "Clock": [c_void_p, c_size_t, c_void_p] for name in ("Get", "Set")},
        "GetNumberOfVariableDependencies": [c_uint, c_void_p],
        "GetVariableDependencies": [c_uint, c_void_p, c_void_p, c_void_p, c_void_p, c_size_t],
        "GetFMUState": [c_void_p],
        "SetFMUState": [c_void_p],
        "FreeFMUState": [c_void_p],
        "SerializedFMUStateSize": [c_void_p, c_void_p],
        "SerializeFMUState": [c_void_p, c_void_p, c_size_t],
        "DeserializeFMUState": [c_void_p, c_size_t, c_void_p],
        **{f"Get{way}Derivative": [c_void_p, c_size_t] * 4 for way in ("Directional", "Adjoint")},
        "GetOutputDerivatives": [c_void_p, c_size_t, c_void_p, c_void_p, c_size_t],
        "UpdateDiscreteStates": [c_void_p] * 6,
        "EvaluateDiscreteStates": [],
        "GetIntervalDecimal": [c_void_p, c_size_t, c_void_p, c_void_p],
        "GetShiftDecimal": [c_void_p, c_size_t, c_void_p],
        "EnterContinuousTimeMode": [],
        "CompletedIntegratorStep": [c_bool, c_void_p, c_void_p],
        "SetTime": [c_double],
        **{f"{name}ContinuousState{end}": [c_void_p, c_size_t] for name, end in (("Set", "s"), ("Get", "s"), ("Get", "Derivatives"))},
        "GetEventIndicators": [c_void_p, c_size_t],
        "GetNominalsOfContinuousStates": [c_void_p, c_size_t],
        "GetNumberOfEventIndicators": [c_void_p],
        "GetNumberOfContinuousStates": [c_void_p],
        "DoStep": [c_double, c_double, c_bool, c_void_p, c_void_p, c_void_p, c_void_p],
    }
    PREFIX, PLATFORM, INSTANTIATE = "fmi3", "x86_64-linux", "fmi3InstantiateCoSimulation"
    ARGUMENTS = {
        "name": c_char_p, "token": c_char_p, "resources": c_char_p, "visible": c_bool, "logging": c_bool,
        "event_mode": c_bool, "early_return": c_bool, "intermediate": c_void_p, "intermediates": c_size_t,
        "environment": c_void_p, "callbacks": c_void_p, "update": c_void_p,
    }  # fmt: skip
    FIXED = {}
    WRONG = {
        "token": [b"", b"{}", b"\xff\xfe", b"x" * 100_000],
        "resources": [b"", b"/nowhere/", b"nowhere/", b"x/" * 50_000, b"\xff"],
    }

    def __init__(self, folder):
        super().__init__(folder)
        self.callbacks = LOGGER_3(lambda _, status, category, message: self.logged.append((status, category)))
        self.silent = None
        # of model exchange only
        self.NOT_OFFERED = self.EnterContinuousTimeMode
        # the names of FMI 2.0, so that a scenario needs one only
        self.GetFMUstate, self.SetFMUstate, self.FreeFMUstate = self.GetFMUState, self.SetFMUState, self.FreeFMUState
        self.SerializedFMUstateSize, self.SerializeFMUstate = self.SerializedFMUStateSize, self.SerializeFMUState
        self.DeSerializeFMUstate = self.DeserializeFMUState

    def location(self, folder):
        return f"{folder}/".encode()

    def set_up(self, component, *arguments):
        return self.EnterInitializationMode(component, *arguments)

    def into_initialization(self):
        return [lambda component: self.set_up(component, False, 0.0, 0.0, False, 0.0)]

    def step(self, component, time, size):
        flags, last = (c_bool * 3)(), c_double()
        pointers = [byref(flags, index) for index in range(3)]
        return self.DoStep(component, time, size, True, *pointers, byref(last))

    def set(self, component, references, values):
        n = len(references)
        return self.SetFloat64(component, (c_uint * n)(*references), n, (c_double * n)(*values), n)

    def get(self, component, references, kind="Float64"):
        n = len(references)
        values = (c_double * n)()
        return getattr(self, f"Get{kind}")(component, (c_uint * n)(*references), n, values, n), list(values)


def resident():
    """Memory of this process in bytes."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


def cycles(fmu, count=100_000):
    """Create, step, free: memory stays flat. A leak of a dozen bytes in each cycle would show."""
    for _ in range(count // 10):
        fmu.run(steps=1)
    before = resident()
    for _ in range(count - count // 10):
        fmu.run(steps=1)
    growth = resident() - before
    print(f"{count} cycles: {growth / 1024:.0f} KiB more than after the first {count // 10}")
    assert growth < 2**20


def instances(fmu, count=1000):
    """Many instances at once, stepped in turn and freed in any order, know nothing of each other."""
    scales = [1 + 0.0001 * index for index in range(count)]
    before = resident()
    components = [fmu.ready(scale=scale) for scale in scales]
    print(f"{count} instances: {(resident() - before) / count / 1024:.0f} KiB each")
    for step in range(3):
        for component in components:
            assert fmu.step(component, step * 0.01, 0.01) in FINE
    outputs = [fmu.outputs_of(component) for component in components]
    random.Random(1).shuffle(components)
    for component in components:
        fmu.FreeInstance(component)
    assert outputs == [fmu.run(scale) for scale in scales]


def threads(fmu, count=8, runs=500):
    """Threads that each make, step and free separate instances; ctypes releases Python's lock during each call."""
    expected = {scale: fmu.run(scale) for scale in (1.0, 1.01, 1.02)}
    failures = []

    def work(number):
        try:
            for _, scale in zip(range(runs), itertools.cycle(expected)):
                assert fmu.run(scale) == expected[scale]
        except BaseException as error:
            failures.append((number, error))

    workers = [threading.Thread(target=work, args=[number]) for number in range(count)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert not failures, failures


def null_pointers(fmu):
    """Every pointer argument once null: refused, unless nothing is asked of it."""
    fmu.FreeInstance(None)
    for name, arguments in fmu.FUNCTIONS.items():
        zeros = [None if argument is c_void_p else argument(1).value for argument in arguments]
        assert getattr(fmu, name)(None, *zeros) in (ERROR, FATAL), f"{name} without an instance"
        component = fmu.ready()
        status = getattr(fmu, name)(component, *zeros)
        # each of these is given a null pointer that it has to follow; to free no state is allowed
        if c_void_p in arguments and name.lower() != "freefmustate":
            assert status in (ERROR, DISCARD), f"{name} with null pointers: {status}"
        fmu.FreeInstance(component)
    component = fmu.ready()
    assert fmu.get(component, []) == (OK, []) and fmu.set(component, [], []) == OK
    fmu.FreeInstance(component)
    for name in ("name", "token", "resources", "callbacks"):
        component = fmu.instantiate(**{name: None})
        # a null name or null callbacks may be borne with; without a token or resources there can be no instance
        assert name in ("name", "callbacks") or not component
        fmu.FreeInstance(component)
    assert not fmu.instantiate(token=b"wrong", callbacks=fmu.silent, logging=1)


def refused_instances(fmu):
    """No instance for a wrong token, an unknown kind or a location that cannot be: null, and a message."""
    for name, values in fmu.WRONG.items():
        for value in values:
            fmu.logged.clear()
            assert not fmu.instantiate(**{name: value}), (name, value)
            assert any(status == ERROR for status, _ in fmu.logged), (name, value)


def unknown_references(fmu):
    """Unknown or unsuitable value references are refused, and nothing of the call is carried out."""
    for references in ([UNKNOWN], [0], [fmu.parameters[0], UNKNOWN]):
        component = fmu.ready()
        assert fmu.step(component, 0.0, 0.01) in FINE and fmu.set(component, fmu.parameters[:1], fmu.starts[:1]) == OK, "unchanged"
        assert fmu.set(component, fmu.parameters[:1], [1.01 * fmu.starts[0]]) == ERROR, "parameters are fixed"
        fmu.FreeInstance(component)
        component = fmu.ready()
        assert fmu.get(component, references)[0] == ERROR
        fmu.FreeInstance(component)
        component = fmu.instantiate()
        assert fmu.set(component, references, [1.01 * fmu.starts[0]] * len(references)) == ERROR
        assert fmu.Reset(component) == OK
        fmu.initialize(component)
        assert fmu.get(component, [fmu.parameters[0]]) == (OK, [fmu.starts[0]])
        fmu.FreeInstance(component)
    component = fmu.ready()
    assert fmu.set(component, fmu.outputs[:1], [0.0]) == ERROR, "an output was set"
    fmu.FreeInstance(component)
    for kind in fmu.KINDS[1:]:
        component = fmu.ready()
        assert fmu.get(component, fmu.outputs[:1], kind)[0] == ERROR, kind
        fmu.FreeInstance(component)


def wrong_order(fmu):
    """Calls in states that do not allow them are refused and change nothing; what has ended may be ended again."""

    def step(component):
        return fmu.step(component, 0.0, 0.01)

    into, leave, end = fmu.into_initialization(), fmu.ExitInitializationMode, fmu.Terminate
    running = [*into, leave]
    cases = [([], call) for call in (step, leave)]
    cases += [(into, call) for call in (step, *into)]
    cases += [(running, call) for call in (*into, leave, fmu.NOT_OFFERED)]
    cases += [([*running, end], step)]
    for before, call in cases:
        component = fmu.instantiate()
        assert all(function(component) in FINE for function in before)
        assert call(component) == ERROR
        assert call(component) == ERROR
        if before == running:
            assert fmu.step(component, 0.0, 0.01) in FINE, "the refusal ended the run"
        assert fmu.Terminate(component) == OK and fmu.Terminate(component) == OK
        assert fmu.Reset(component) == OK
        fmu.initialize(component)
        for index in range(3):
            assert fmu.step(component, index * 0.01, 0.01) in FINE
        assert fmu.outputs_of(component) == fmu.expected
        fmu.FreeInstance(component)


def odd_numbers(fmu):
    """NaN, infinities, huge and tiny numbers wherever a number goes: refused, or carried out with finite outputs."""
    odd = [math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, -0.0]
    for value in odd:
        component = fmu.instantiate()
        status = fmu.set(component, fmu.parameters[:1], [value])
        assert status in (*FINE, DISCARD, ERROR) and (math.isfinite(value) or status not in FINE), value
        if status in FINE:
            fmu.initialize(component)
            fmu.outputs_of(component)
        fmu.FreeInstance(component)
        component = fmu.instantiate()
        for arguments in itertools.product((0, 1), [value, 1.0], [value, 0.0], (0, 1), [value, 1.0]):
            status = fmu.set_up(component, *arguments)
            assert math.isfinite(arguments[2]) or status not in FINE, arguments
            fmu.Reset(component)
        fmu.FreeInstance(component)
    for time, size in itertools.product([*odd, 0.0, 0.01], [*odd, 0.0, 0.01, -0.01, 1e9]):
        component = fmu.ready()
        status = fmu.step(component, time, size)
        senseless = not math.isfinite(time) or not math.isfinite(size) or size < 0
        assert status in ((DISCARD, ERROR) if senseless else (*FINE, DISCARD, ERROR)), (time, size, status)
        if status in FINE:
            fmu.outputs_of(component)
        fmu.FreeInstance(component)


def damaged_states(fmu):
    """Serialized states that were damaged are refused, or at least crash nothing."""
    chance = random.Random(2)
    component = fmu.ready()
    state, size = c_void_p(), c_size_t()
    assert fmu.GetFMUstate(component, byref(state)) == OK
    assert fmu.SerializedFMUstateSize(component, state, byref(size)) == OK
    good = (ctypes.c_char * size.value)()
    assert fmu.SerializeFMUstate(component, state, good, size.value) == OK
    assert fmu.FreeFMUstate(component, byref(state)) == OK
    fmu.FreeInstance(component)
    damaged = [bytes(good)[:length] for length in range(size.value)]
    damaged += [bytes(size.value), b"\xff" * size.value, bytes(good) * 2]
    for _ in range(2000):
        content = bytearray(good)
        for _ in range(chance.randint(1, 4)):
            content[chance.randrange(size.value)] = chance.randrange(256)
        damaged.append(bytes(content))
    for content in damaged:
        component = fmu.ready()
        state = c_void_p()
        status = fmu.DeSerializeFMUstate(component, content, len(content), byref(state))
        assert status in (OK, ERROR) and (len(content) == size.value or status == ERROR)
        if status == OK and fmu.SetFMUstate(component, state) == OK:
            fmu.get(component, fmu.outputs[:1])
            fmu.step(component, 0.0, 0.01)
        fmu.FreeInstance(component)


def damaged_resources(fmu):
    """A model file that is missing, cut short or senseless gives no instance, but a message; so does one with flipped bits."""
    chance = random.Random(3)
    (model,) = fmu.resources.glob("*.safetensors")
    good = model.read_bytes()
    senseless = [good[:length] for length in (0, 1, 7, 8, 9, 100, len(good) // 2, len(good) - 1)]
    senseless += [good + b"\0", b"\xff" * 64, bytes(len(good))]
    # the length of the header, with which the file begins
    senseless += [length.to_bytes(8, "little") + good[8:] for length in (0, 1, len(good), 2**32, 2**63, 2**64 - 1)]
    with tempfile.TemporaryDirectory() as folder:
        resources = Path(folder) / "resources"
        copy = resources / model.name

        def refuse(why):
            fmu.logged.clear()
            assert not fmu.instantiate(resources), why
            assert any(status == ERROR for status, _ in fmu.logged), why

        refuse("there is no folder")
        resources.mkdir()
        refuse("there is no model file")
        for number, content in enumerate(senseless):
            copy.write_bytes(content)
            refuse(f"damage {number}")
        header = 8 + int.from_bytes(good[:8], "little")
        for number in range(1000):
            content = bytearray(good)
            for _ in range(chance.choice([1, 1, 2, 16])):
                content[chance.randrange(header if number % 2 else len(good))] ^= 1 << chance.randrange(8)
            copy.write_bytes(content)
            component = fmu.instantiate(resources)
            if component:
                # what changed says the same: the `e` of a number became an `E`, or a digit beyond those of a double
                fmu.FreeInstance(component)
                assert fmu.run(resources=resources) == fmu.expected, f"flipped bits {number}"
        copy.unlink()
        copy.mkdir()
        refuse("it is a folder")
        shutil.rmtree(resources)
        resources.write_text("")
        refuse("resources are no folder")


SCENARIOS = [
    cycles,
    instances,
    threads,
    null_pointers,
    refused_instances,
    unknown_references,
    wrong_order,
    odd_numbers,
    damaged_states,
    damaged_resources,
]

if __name__ == "__main__":
    folder, name = sys.argv[1:]
    (scenario,) = (scenario for scenario in SCENARIOS if scenario.__name__ == name)
    folder = Path(folder)
    version = read_model_description(str(folder)).fmiVersion
    (Fmi2 if version == "2.0" else Fmi3)(folder).scenario(scenario)
