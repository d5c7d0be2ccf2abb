"""Raw C calls to the library of an unpacked FMU, as only a broken host makes them.

Usage: abuse.py FOLDER SCENARIO, in a process of its own: a crash must not take the tests along.
Each scenario is a function below; it ends the process with 0 and prints what it measured.
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
from ctypes import POINTER, byref, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from pathlib import Path

from fmpy import read_model_description

OK, WARNING, DISCARD, ERROR, FATAL = range(5)
FINE = (OK, WARNING)
CO_SIMULATION = 1
KINDS = ("Real", "Integer", "Boolean", "String")
UNKNOWN = 4_000_000_000
LOGGER = ctypes.CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p)


class Callbacks(ctypes.Structure):
    _fields_ = [
        ("logger", LOGGER),
        ("allocate_memory", c_void_p),
        ("free_memory", c_void_p),
        ("step_finished", c_void_p),
        ("environment", c_void_p),
    ]


class Fmi2:
    """The functions of FMI 2.0 co-simulation, with nothing between them and the caller."""

    # argument types behind the component, of every function that takes one and returns a status
    FUNCTIONS = {
        "SetDebugLogging": [c_int, c_size_t, c_void_p],
        "SetupExperiment": [c_int, c_double, c_double, c_int, c_double],
        "EnterInitializationMode": [],
        "ExitInitializationMode": [],
        "Terminate": [],
        "Reset": [],
        **{name + kind: [c_void_p, c_size_t, c_void_p] for name in ("Get", "Set") for kind in KINDS},
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
        **{f"Get{kind}Status": [c_int, c_void_p] for kind in ("", *KINDS)},
    }

    def __init__(self, folder):
        description = read_model_description(str(folder))
        identifier = description.coSimulation.modelIdentifier
        self.library = ctypes.CDLL(str(folder / "binaries" / "linux64" / f"{identifier}.so"))
        self.token = description.guid.encode()
        self.resources = folder / "resources"
        variables = [variable for variable in description.modelVariables if variable.type == "Real"]
        self.parameters = [v.valueReference for v in variables if v.causality == "parameter"]
        self.outputs = [v.valueReference for v in variables if v.causality == "output"]
        self.starts = [float(v.start) for v in variables if v.causality == "parameter"]
        self.logged = []
        self.logger = LOGGER(lambda _, name, status, category, message: self.logged.append((status, category)))
        self.callbacks = Callbacks(self.logger)
        for name, arguments in self.FUNCTIONS.items():
            function = getattr(self.library, f"fmi2{name}")
            function.argtypes, function.restype = [c_void_p, *arguments], c_int
            setattr(self, name, function)
        self.Instantiate = self.library.fmi2Instantiate
        self.Instantiate.argtypes = [c_char_p, c_int, c_char_p, c_char_p, c_void_p, c_int, c_int]
        self.Instantiate.restype = c_void_p
        self.FreeInstance = self.library.fmi2FreeInstance
        self.FreeInstance.argtypes, self.FreeInstance.restype = [c_void_p], None

    def instantiate(self, resources=None):
        uri = (resources or self.resources).as_uri().encode()
        return self.Instantiate(b"instance", CO_SIMULATION, self.token, uri, byref(self.callbacks), 0, 0)

    def initialize(self, component):
        assert self.SetupExperiment(component, 0, 0.0, 0.0, 0, 0.0) in FINE
        assert self.EnterInitializationMode(component) in FINE
        assert self.ExitInitializationMode(component) in FINE

    def ready(self):
        component = self.instantiate()
        assert component
        self.initialize(component)
        return component

    def set(self, component, references, values):
        n = len(references)
        return self.SetReal(component, (c_uint * n)(*references), n, (c_double * n)(*values))

    def get(self, component, references):
        n = len(references)
        values = (c_double * n)()
        return self.GetReal(component, (c_uint * n)(*references), n, values), list(values)

    def outputs_of(self, component):
        status, values = self.get(component, self.outputs)
        assert status in FINE and all(map(math.isfinite, values))
        return values

    def run(self, scale=1.0, steps=3):
        """Creates, sets, steps, reads, frees."""
        component = self.ready()
        assert self.set(component, self.parameters, [scale * value for value in self.starts]) in FINE
        for step in range(steps):
            assert self.DoStep(component, step * 0.01, 0.01, 1) in FINE
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
    components = [fmu.ready() for _ in scales]
    print(f"{count} instances: {(resident() - before) / count / 1024:.0f} KiB each")
    for component, scale in zip(components, scales):
        assert fmu.set(component, fmu.parameters, [scale * value for value in fmu.starts]) in FINE
    for step in range(3):
        for component in components:
            assert fmu.DoStep(component, step * 0.01, 0.01, 1) in FINE
    outputs = [fmu.outputs_of(component) for component in components]
    random.Random(1).shuffle(components)
    for component in components:
        fmu.FreeInstance(component)
    assert outputs == [fmu.run(scale) for scale in scales]


def threads(fmu, count=8, runs=500):
    """Threads that make, step and free instances of their own; ctypes lets go of Python's lock during each call."""
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
        if c_void_p in arguments and name not in ("FreeFMUstate",):
            assert status in (ERROR, DISCARD), f"{name} with null pointers: {status}"
        fmu.FreeInstance(component)
    component = fmu.ready()
    assert fmu.GetReal(component, None, 0, None) == OK and fmu.SetReal(component, None, 0, None) == OK
    fmu.FreeInstance(component)
    uri = fmu.resources.as_uri().encode()
    good = [b"instance", CO_SIMULATION, fmu.token, uri, byref(fmu.callbacks), 0, 0]
    for position in (0, 2, 3, 4):
        arguments = [None if index == position else argument for index, argument in enumerate(good)]
        component = fmu.Instantiate(*arguments)
        # a null name or null callbacks may be borne with; without a token or resources there can be no instance
        assert position in (0, 4) or not component
        fmu.FreeInstance(component)
    silent = Callbacks()
    component = fmu.Instantiate(b"instance", CO_SIMULATION, b"wrong", uri, byref(silent), 0, 1)
    assert not component


def refused_instances(fmu):
    """No instance for a wrong token, an unknown kind or a location that cannot be: null, and a message."""
    good = [b"instance", CO_SIMULATION, fmu.token, fmu.resources.as_uri().encode(), byref(fmu.callbacks), 0, 0]
    wrong = {
        1: [-1, 2, 1000],
        2: [b"", b"{}", b"\xff\xfe", b"x" * 100_000],
        3: [b"", b"no uri", b"ftp://x/y", b"file:///%zz", b"file:///" + b"x/" * 50_000, b"\xff"],
    }
    for position, values in wrong.items():
        for value in values:
            fmu.logged.clear()
            component = fmu.Instantiate(*good[:position], value, *good[position + 1 :])
            assert not component, (position, value[:40])
            assert any(status == ERROR for status, _ in fmu.logged), (position, value)


def unknown_references(fmu):
    """Unknown or unsuitable value references are refused, and nothing of the call is carried out."""
    for references in ([UNKNOWN], [fmu.parameters[0], UNKNOWN]):
        component = fmu.ready()
        assert fmu.get(component, references)[0] == ERROR
        fmu.FreeInstance(component)
        component = fmu.ready()
        assert fmu.set(component, references, [1.01 * fmu.starts[0]] * len(references)) == ERROR
        assert fmu.Reset(component) == OK
        fmu.initialize(component)
        assert fmu.get(component, [fmu.parameters[0]]) == (OK, [fmu.starts[0]])
        fmu.FreeInstance(component)
    component = fmu.ready()
    assert fmu.set(component, fmu.outputs[:1], [0.0]) == ERROR, "an output was set"
    fmu.FreeInstance(component)
    for kind in ("Integer", "Boolean", "String"):
        component = fmu.ready()
        assert getattr(fmu, f"Get{kind}")(component, (c_uint * 1)(fmu.outputs[0]), 1, (c_void_p * 1)()) == ERROR
        fmu.FreeInstance(component)


def wrong_order(fmu):
    """Calls in states that do not allow them are refused; a reset makes the instance good again."""

    def setup(component):
        return fmu.SetupExperiment(component, 0, 0.0, 0.0, 0, 0.0)

    def step(component):
        return fmu.DoStep(component, 0.0, 0.01, 1)

    enter, leave = fmu.EnterInitializationMode, fmu.ExitInitializationMode
    for before, call in [
        ([], step),
        ([], leave),
        ([], fmu.Terminate),
        ([setup, enter], step),
        ([setup, enter], enter),
        ([setup, enter], setup),
        ([setup, enter, leave], enter),
        ([setup, enter, leave], leave),
        ([setup, enter, leave], setup),
        ([setup, enter, leave, fmu.Terminate], step),
        ([setup, enter, leave, fmu.Terminate], fmu.Terminate),
        ([setup, enter, leave, fmu.CancelStep], step),
    ]:
        component = fmu.instantiate()
        statuses = [function(component) for function in before]
        assert all(status in FINE for status in statuses) or before[-1] is fmu.CancelStep
        assert call(component) == ERROR
        # again, now that it is in the error state
        assert call(component) == ERROR
        assert fmu.Reset(component) == OK
        fmu.initialize(component)
        for index in range(3):
            assert fmu.DoStep(component, index * 0.01, 0.01, 1) in FINE
        assert fmu.outputs_of(component) == fmu.expected
        fmu.FreeInstance(component)


def odd_numbers(fmu):
    """NaN, infinities, huge and tiny numbers wherever a number goes: refused, or carried out with finite outputs."""
    odd = [math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, -0.0]
    for value in odd:
        component = fmu.ready()
        status = fmu.set(component, fmu.parameters[:1], [value])
        assert status in (*FINE, DISCARD, ERROR) and (math.isfinite(value) or status not in FINE), value
        if status in FINE:
            fmu.outputs_of(component)
        fmu.FreeInstance(component)
        component = fmu.instantiate()
        for arguments in itertools.product((0, 1), [value, 1.0], [value, 0.0], (0, 1), [value, 1.0]):
            status = fmu.SetupExperiment(component, *arguments)
            assert math.isfinite(arguments[2]) or status not in FINE, arguments
            fmu.Reset(component)
        fmu.FreeInstance(component)
    for time, size in itertools.product([*odd, 0.0, 0.01], [*odd, 0.0, 0.01, -0.01, 1e9]):
        component = fmu.ready()
        status = fmu.DoStep(component, time, size, 1)
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
            fmu.GetReal(component, (c_uint * 1)(fmu.outputs[0]), 1, (c_double * 1)())
            fmu.DoStep(component, 0.0, 0.01, 1)
        fmu.FreeInstance(component)


def damaged_resources(fmu):
    """A model file that is missing, cut short or senseless gives no instance, but a message; flipped bits crash nothing."""
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
            # a bit of a weight or of a description makes another surrogate, which is no error to an FMU
            component = fmu.instantiate(resources)
            if component:
                fmu.SetupExperiment(component, 0, 0.0, 0.0, 0, 0.0)
                fmu.EnterInitializationMode(component)
                fmu.ExitInitializationMode(component)
                fmu.DoStep(component, 0.0, 0.01, 1)
                fmu.get(component, fmu.outputs)
                fmu.FreeInstance(component)
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
    Fmi2(Path(folder)).scenario(scenario)
