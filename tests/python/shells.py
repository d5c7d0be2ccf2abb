"""Equal calls to two libraries of one FMU: random walks over all functions, with good and bad arguments.

Usage: shells.py FOLDER LIBRARY OTHER INTERFACE SEED[,SEED]..., in a separate process: a crash must not take the tests along. FOLDER is the unpacked
FMU of both libraries. Prints each kind of difference once, with the calls before the first one, and ends with 1 if there are any.

Statuses, messages and values, also of calls that fail, must be the same; numbers, also in messages, agree to TOLERANCE. Tokens are not varied: that
message names the model file, which the sources do not have.
"""

import ctypes
import math
import random
import re
import sys
from ctypes import CFUNCTYPE, POINTER, byref, c_bool, c_char_p, c_double, c_float, c_int, c_size_t, c_uint, c_void_p
from dataclasses import dataclass, field
from pathlib import Path

from fmpy import read_model_description

OK = 0
ERROR = 3
TOLERANCE = 1e-6
CALLS = 1500
UNKNOWN = 4_000_000_000
NUMBER = re.compile(r"(?<![\w.])-?(?:\d+\.?\d*(?:e[-+]?\d+)?|inf|nan)(?![\w])", re.IGNORECASE)
CATEGORIES = [b"logStatusError", b"logStatusWarning", b"logAll", b"bogus"]
LOGGERS = {
    # the message is the argument of the format "%s"
    2: CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p, c_char_p),
    3: CFUNCTYPE(None, c_void_p, c_int, c_char_p, c_char_p),
}
UPDATE = CFUNCTYPE(None, c_void_p, c_double, c_bool, c_bool, c_bool, c_bool, POINTER(c_bool), POINTER(c_double))
TYPES = {
    "Float32": c_float, "Int8": ctypes.c_int8, "UInt8": ctypes.c_uint8, "Int16": ctypes.c_int16, "UInt16": ctypes.c_uint16,
    "UInt32": ctypes.c_uint32, "Int64": ctypes.c_int64, "UInt64": ctypes.c_uint64, "String": c_char_p, "Float64": c_double, "Int32": c_int,
    "Boolean": c_bool,
}  # fmt: skip


class Callbacks(ctypes.Structure):
    _fields_ = [
        ("logger", LOGGERS[2]),
        ("allocate_memory", c_void_p),
        ("free_memory", c_void_p),
        ("step_finished", c_void_p),
        ("environment", c_void_p),
    ]


class EventInfo(ctypes.Structure):
    _fields_ = [*((f"flag{index}", c_int) for index in range(5)), ("time", c_double)]


@dataclass
class Array:
    """Values that a call reads or writes; more memory than the count says is never touched."""

    kind: type
    values: list

    def make(self, shell):
        return (self.kind * max(len(self.values), 1))(*self.values)


@dataclass
class State:
    """A stored state, or a pointer to it."""

    slot: object
    pointed: bool = False

    def make(self, shell):
        state = shell.states.setdefault(self.slot, c_void_p())
        return byref(state) if self.pointed else c_void_p(state.value)


@dataclass
class Bytes:
    """The bytes of a serialized state, of which one is changed."""

    damaged: int | None = None

    def make(self, shell):
        if self.damaged is not None:
            shell.bytes[self.damaged] ^= 0x10
        return shell.bytes


@dataclass
class Event:
    """An action of a shell: a message, an update in the middle of a step, or the end of a call."""

    kind: str
    text: str
    numbers: list = field(default_factory=list)

    def differs(self, other):
        def close(a, b):
            return a == b or math.isclose(a, b, rel_tol=TOLERANCE, abs_tol=TOLERANCE) or (math.isnan(a) and math.isnan(b))

        return (self.kind, self.text, len(self.numbers)) != (other.kind, other.text, len(other.numbers)) or not all(
            map(close, self.numbers, other.numbers)
        )


def parsed(text):
    """A message with its numbers apart."""
    return NUMBER.sub("<number>", text), [float(number) for number in NUMBER.findall(text)]


class Shell:
    """One of the libraries, with its instance, stored states and events."""

    def __init__(self, library, version):
        self.library, self.version = ctypes.CDLL(str(library)), version
        self.instance, self.states, self.bytes, self.events = None, {}, (ctypes.c_uint8 * 4096)(), []
        log = (lambda _, name, *message: self.log(*message, name)) if version == 2 else (lambda _, *message: self.log(*message))
        self.logger = LOGGERS[version](log)
        self.callbacks = Callbacks(self.logger) if version == 2 else None
        self.update, self.updates, self.seed = UPDATE(self.updated), 0, None

    def log(self, status, category, *rest):
        text, *name = rest if self.version == 3 else rest[1:]
        self.events.append(Event("message", f"{status} {category.decode()} {name}: " + parsed(text.decode())[0], parsed(text.decode())[1]))

    def call(self, name, arguments):
        """Calls a function with arguments made for this library, and notes the status and the values that arrays have then."""
        made = [argument.make(self) if hasattr(argument, "make") else argument for argument in arguments]
        function = getattr(self.library, f"fmi{self.version}{name}")
        function.restype = None if name == "FreeInstance" else c_int
        status = function(c_void_p(self.instance), *made)
        returned = [value for array in made if isinstance(array, ctypes.Array) and array is not self.bytes for value in flat(array)]
        numbers = [float(value) for value in returned if isinstance(value, (int, float))]
        self.events.append(Event("end", f"{name} returns {status}", numbers))
        return status

    def instantiate(self, name, arguments):
        function = getattr(self.library, f"fmi{self.version}{name}")
        function.restype = c_void_p
        made = [getattr(self, argument) if argument in ("logger", "update") else argument for argument in arguments]
        self.instance = function(*(byref(self.callbacks) if argument == "callbacks" else argument for argument in made))
        self.events.append(Event("end", f"{name} gives {'an instance' if self.instance else 'none'}"))

    def free(self):
        if self.instance:
            self.call("FreeInstance", [])
        self.instance = None

    def updated(self, _, time, *rest):
        """Called in the middle of a step: gets, sets, returns early or makes illegal calls, as the seed says."""
        *flags, requested, return_time = rest
        self.events.append(Event("update", str(flags), [time]))
        self.updates += 1
        chance = random.Random(f"{self.seed} {self.updates}")
        inputs, outputs = self.variables
        if chance.random() < 0.7:
            self.call("GetFloat64", [Array(c_uint, outputs), c_size_t(len(outputs)), Array(c_double, [0.0] * len(outputs)), c_size_t(len(outputs))])
        if inputs and chance.random() < 0.5:
            self.call("SetFloat64", [Array(c_uint, inputs[:1]), c_size_t(1), Array(c_double, [chance.uniform(-2, 2)]), c_size_t(1)])
        if chance.random() < 0.1:
            self.call(chance.choice(["Terminate", "Reset", "EnterEventMode", "EnterStepMode"]), [])
        if chance.random() < 0.2:
            requested[0], return_time[0] = True, time + chance.choice([-0.01, 0.0, 0.003, 10.0])


def flat(array):
    for value in array:
        if isinstance(value, ctypes.Structure):
            yield from (getattr(value, name) for name, _ in value._fields_)
        else:
            yield value


class Walk:
    """Chooses calls. Follows the state of the instance, so that most of them are allowed."""

    def __init__(self, folder, interface, seed):
        description = read_model_description(str(folder))
        self.version = int(float(description.fmiVersion))
        self.chance = random.Random(f"{interface} {seed}")
        self.interface, self.seed = interface, seed
        self.token = (getattr(description, "guid", None) or description.instantiationToken).encode()
        self.resources = (folder / "resources").as_uri() if self.version == 2 else f"{folder}/resources/"
        self.all = description.modelVariables
        self.reals = [v for v in self.all if v.type in ("Real", "Float64")]
        self.references = [v.valueReference for v in self.all]
        of = lambda *causalities: [v.valueReference for v in self.reals if v.causality in causalities]
        self.inputs, self.outputs, self.settable = of("input"), of("output"), of("input", "parameter")
        # that for measured outputs, of discrete-time models
        self.switches = [v.valueReference for v in self.all if (v.type, v.causality) == ("Boolean", "input")]
        self.later = [v.valueReference for v in self.reals if v.causality == "input" or (v.causality, v.variability) == ("parameter", "tunable")]
        self.states = len(description.derivatives)
        self.mode, self.time, self.stored, self.mischief = "none", 0.0, {}, 1.0

    # ---- Arguments ----

    def is_(self, probability):
        return self.chance.random() < probability

    def bad(self, probability):
        """Returns True to make a mistake: seldom in half of the runs, so that these get far."""
        return self.is_(probability * self.mischief)

    def some(self, references):
        """References, now and then with one that is unknown or of another kind."""
        chosen = [self.chance.choice(references or self.references) for _ in range(self.chance.choice([1, 1, 2, 3]))]
        if self.bad(0.12):
            chosen[self.chance.randrange(len(chosen))] = self.chance.choice([0, UNKNOWN, max(self.references) + 1, *self.references])
        return [] if self.bad(0.03) else chosen

    def value(self, reference):
        variable = next((v for v in self.all if v.valueReference == reference), None)
        start = float(variable.start) if variable is not None and variable.start not in (None, "true", "false") else 0.0
        low, high = (float(bound) if bound is not None else start + side for bound, side in (
            (getattr(variable, "min", None), -1.0), (getattr(variable, "max", None), 1.0)))  # fmt: skip
        # not so large that products overflow: fused or not, they do so differently
        odd = [math.nan, math.inf, -math.inf, 1e30, -1e30, start + 3 * (high - low), low - 0.1, high, -1e-9]
        return self.chance.choice(odd) if self.bad(0.12) else self.chance.choice([start, self.chance.uniform(low, high)])

    def array(self, kind, values, count):
        """An array, now and then null."""
        return c_void_p() if count and self.bad(0.03) else Array(kind, values)

    def numbered(self, references, values, kind, order=None):
        """References, orders if there are any, and values, with their counts as the version has them."""
        n = len(references)
        arguments = [self.array(c_uint, references, n), c_size_t(n)]
        if order is not None:
            arguments.append(self.array(c_int, order, n))
        room = values + [values[-1] if values else 0] * 2
        if self.version == 2:
            return [*arguments, self.array(kind, room, n)]
        count = n if not self.bad(0.05) else max(n + self.chance.choice([-1, 1]), 0)
        return [*arguments, self.array(kind, room, count), c_size_t(count)]

    def out(self, kind, *initial):
        return c_void_p() if self.bad(0.03) else Array(kind, list(initial))

    def orders(self, n):
        return [self.chance.choice([1, 1, 2, 2, 2, 0, 3, -1] if self.bad(0.3) else [1, 2]) for _ in range(n)]

    def span(self):
        return self.chance.choice([-0.1, math.nan, math.inf, -1e-12, 5e-324, 1e-31, 1e300] if self.bad(0.06) else [0.01, 0.05, 0.1, 0.1, 0.13, 0.0, 0.5])

    def odd_time(self, time):
        return self.chance.choice([math.nan, math.inf, -1.0, time + 0.01, time - 0.2, 1e300]) if self.bad(0.06) else time

    # ---- Calls ----

    @property
    def is_early(self):
        return self.mode in ("instantiated", "ready")

    def get(self, kind):
        real = kind in ("Real", "Float64")
        references = self.some(self.settable if real and self.is_early and not self.bad(0.3) else self.references_of(kind))
        return f"Get{kind}", self.numbered(references, [self.sentinel(kind)] * len(references), self.type(kind))

    def set(self, kind):
        real = kind in ("Real", "Float64")
        settable = self.settable if self.is_early or self.mode == "initialization" or self.bad(0.2) else self.later
        others = self.switches if kind == "Boolean" and self.switches and not self.bad(0.2) else self.references_of(kind)
        references = self.some(settable if real else others)
        integer = lambda: self.chance.choice([0, 1, 2, 3, -1] if self.bad(0.2) else [0, 0, 1, 2])
        values = [self.value(reference) if real else integer() % 2 if kind == "Boolean" else None if kind == "String" else integer() for reference in references]
        return f"Set{kind}", self.numbered(references, values, self.type(kind))

    def references_of(self, kind):
        kinds = {"Real": ("Real",), "Float64": ("Float64",), "Integer": ("Integer",), "Int32": ("Int32",), "Boolean": ("Boolean",)}.get(kind, ())
        return [v.valueReference for v in self.all if v.type in kinds]

    def type(self, kind):
        if self.version == 2:
            return {"Real": c_double, "Integer": c_int, "Boolean": c_int, "String": c_char_p}[kind]
        return TYPES[kind]

    def sentinel(self, kind):
        return None if kind == "String" else False if kind == "Boolean" and self.version == 3 else 77

    def logging(self):
        names = [self.chance.choice(CATEGORIES) for _ in range(self.chance.choice([0, 1, 1, 2, 3]))]
        if self.bad(0.05):
            names.append(None)
        on = self.is_(0.8)
        return "SetDebugLogging", [c_int(on) if self.version == 2 else c_bool(on), c_size_t(len(names)), self.array(c_char_p, names, len(names))]

    def experiment(self):
        tolerance = self.chance.choice([1e-4, 1e-6, 1e-3, 0.0, -1.0, math.nan] if self.bad(0.2) else [1e-4, 1e-6])
        start = self.chance.choice([math.nan, 1.0, -3.0] if self.bad(0.1) else [0.0, 0.0, 0.5])
        stop = start + self.chance.choice([0.0, -1.0, math.nan] if self.bad(0.1) else [1.0, 4.0])
        flag = c_int if self.version == 2 else c_bool
        arguments = [flag(self.is_(0.3)), c_double(tolerance), c_double(start), flag(self.is_(0.4)), c_double(stop)]
        return ("SetupExperiment" if self.version == 2 else "EnterInitializationMode"), arguments

    def step(self):
        time = self.odd_time(self.time)
        arguments = [c_double(time), c_double(self.span()), c_int(1) if self.version == 2 else c_bool(True)]
        if self.version == 3:
            arguments += [self.out(c_bool, True), self.out(c_bool, True), self.out(c_bool, True), self.out(c_double, 77.0)]
        return "DoStep", arguments

    def slot(self):
        stored = [slot for slot in (0, 1) if slot in self.stored]
        return self.chance.choice(["foreign", "null", 0, 1] if self.bad(0.1) or not stored else stored)

    def state_call(self, what):
        name = {2: "FMUstate", 3: "FMUState"}[self.version]
        if what in ("Get", "Free"):
            return f"{what}{name}", [c_void_p() if self.bad(0.05) else State(self.chance.choice([0, 1]), pointed=True)]
        if what == "Set":
            return f"Set{name}", [State(self.slot())]
        if what == "Size":
            return f"Serialized{name}Size", [State(self.slot()), self.out(c_size_t, 77)]
        size = self.size if not self.bad(0.15) else self.chance.choice([0, 3, 12, 17, self.size - 1, self.size + 1])
        if what == "Serialize":
            return f"Serialize{name}", [State(self.slot()), c_void_p() if self.bad(0.05) else Bytes(), c_size_t(size)]
        damaged = self.chance.randrange(self.size) if self.bad(0.2) else None
        pointer = c_void_p() if self.bad(0.05) else State(self.chance.choice([0, 1]), pointed=True)
        verb = {2: "DeSerialize", 3: "Deserialize"}[self.version]
        return f"{verb}{name}", [c_void_p() if self.bad(0.03) else Bytes(damaged), c_size_t(size), pointer]

    def derivative(self, way):
        unknowns = self.some(self.outputs)
        knowns = self.some(self.settable)
        seeded, answered = (knowns, unknowns) if way == "Directional" else (unknowns, knowns)
        arguments = [self.array(c_uint, unknowns, len(unknowns)), c_size_t(len(unknowns)), self.array(c_uint, knowns, len(knowns)), c_size_t(len(knowns))]
        for values in ([self.chance.choice([1.0, -0.5, math.nan if self.bad(0.05) else 2.0]) for _ in seeded], [77.0] * len(answered)):
            count = len(values) if self.version == 2 or not self.bad(0.03) else len(values) + 1
            arguments.append(self.array(c_double, values + [0.0], count))
            if self.version == 3:
                arguments.append(c_size_t(count))
        return f"Get{way}Derivative", arguments

    def output_derivatives(self):
        references = self.some(self.outputs)
        n = len(references)
        return ("GetRealOutputDerivatives" if self.version == 2 else "GetOutputDerivatives"), self.numbered(references, [77.0] * n, c_double, self.orders(n))

    def input_derivatives(self):
        references = self.some(self.inputs)
        n = len(references)
        values = [self.chance.choice([0.5, -0.3, 0.0, math.nan if self.bad(0.1) else 1.0]) for _ in range(n)]
        return "SetRealInputDerivatives", self.numbered(references, values, c_double, self.orders(n))

    def states_call(self, name, set_=False):
        n = self.states if not self.bad(0.07) else self.states + self.chance.choice([-1, 1])
        n = max(n, 0)
        value = lambda: self.chance.choice([math.nan, math.inf, 1e9]) if self.bad(0.04) else self.chance.uniform(-0.4, 0.4)
        return name, [self.array(c_double, [value() if set_ else 77.0 for _ in range(n)], n), c_size_t(n)]

    def solver_time(self):
        return "SetTime", [c_double(self.odd_time(self.time + self.chance.choice([0.0, 0.01, 0.1])))]

    def completed(self):
        flag = c_int if self.version == 2 else c_bool
        return "CompletedIntegratorStep", [flag(1), self.out(flag, 1), self.out(flag, 1)]

    def absent(self, kind):
        way = self.chance.choice(["Get", "Set"])
        n = self.chance.choice([0, 0, 1, 2])
        count = n if not self.bad(0.2) else n + 1
        if kind in ("IntervalDecimal", "IntervalFraction", "ShiftDecimal", "ShiftFraction", "Clock"):
            return f"{way}{kind}", [Array(c_uint, [0] * n), c_size_t(n), *[c_void_p()] * 3]
        more = [c_void_p()] if kind == "Binary" else []
        return f"{way}{kind}", [Array(c_uint, [0] * n), c_size_t(n), *more, c_void_p(), c_size_t(count)]

    def dependencies(self):
        reference = self.chance.choice([0, UNKNOWN]) if self.bad(0.1) else self.chance.choice(self.references)
        if self.is_(0.4) or (reference not in self.counted and not self.bad(0.3)):
            return "GetNumberOfVariableDependencies", [c_uint(reference), self.out(c_size_t, 77)]
        n = self.chance.choice([0, 1]) if self.bad(0.1) else self.counted.get(reference, 0)
        room = max(n, 1)
        arrays = [self.array(kind, [77] * room, n) for kind in (c_size_t, c_uint, c_size_t, c_int)]
        return "GetVariableDependencies", [c_uint(reference), *arrays, c_size_t(n)]

    def status(self):
        kind = self.chance.choice(["", "Real", "Integer", "Boolean", "String"])
        value = {"Real": c_double, "String": c_char_p}.get(kind, c_int)
        return f"Get{kind}Status", [c_int(self.chance.choice([0, 1, 2, 3, 4])), self.out(value, None if kind == "String" else 77)]

    def plain(self, name):
        return name, []

    def discrete(self):
        if self.version == 2:
            return "NewDiscreteStates", [self.out(EventInfo)]
        return "UpdateDiscreteStates", [*(self.out(c_bool, True) for _ in range(5)), self.out(c_double, 77.0)]

    def count_of(self, name):
        return name, [self.out(c_size_t, 77)]

    def catalogue(self):
        """All calls, each with the modes that it is mostly made in."""
        two, step, solver = self.version == 2, self.interface == "CoSimulation", self.interface == "ModelExchange"
        real, integer = ("Real", "Integer") if two else ("Float64", "Int32")
        runs = ("step", "event", "continuous")
        prefix = [
            (self.logging, (), 1),
            (self.experiment, ("instantiated",), 6),
            (lambda: self.get(real), ("initialization", *runs), 8),
            (lambda: self.get(real), ("instantiated", "ended"), 1),
            (lambda: self.get(integer), ("initialization", *runs), 1),
            (lambda: self.get("Boolean"), ("initialization", *runs), 3),
            (lambda: self.get("String"), (), 1),
            (lambda: self.set(real), ("instantiated", "ready", "initialization", *runs), 5),
            (lambda: self.set(integer), ("instantiated", "ready", "initialization", "step"), 1),
            (lambda: self.set("Boolean"), ("instantiated", "ready", "initialization", "step") if self.switches else (), 3),
            (lambda: self.set("String"), (), 1),
            (lambda: self.plain("ExitInitializationMode"), ("initialization",), 8),
            (lambda: self.plain("Terminate"), runs, 0.2),
            (lambda: self.plain("Reset"), ("ended",), 4),
            (lambda: self.plain("EnterEventMode"), ("continuous", "step"), 2 if solver or not two else 0.1),
            (lambda: self.plain("EnterContinuousTimeMode"), ("event",), 6 if solver else 0.1),
            *((lambda what=what: self.state_call(what), (*runs, "ended"), weight) for what, weight in
              [("Get", 1), ("Set", 1), ("Free", 0.3), ("Size", 0.3), ("Serialize", 0.5), ("Deserialize", 0.5)]),
            (lambda: self.derivative("Directional"), ("initialization", *runs), 2),
            (self.output_derivatives, ("step",) if step else (), 2),
            (self.step, ("step",) if step else (), 20),
            (self.solver_time, ("continuous",), 4),
            (self.completed, ("continuous",), 4),
            (self.discrete, ("event",), 3),
            (lambda: self.states_call("SetContinuousStates", True), ("continuous",), 5),
            (lambda: self.states_call("GetContinuousStates"), ("continuous", "event"), 2),
            (lambda: self.states_call("GetDerivatives" if two else "GetContinuousStateDerivatives"), ("continuous", "event"), 4),
            (lambda: self.states_call("GetNominalsOfContinuousStates"), ("event",), 1),
            (lambda: ("GetEventIndicators", [c_void_p(), c_size_t(self.chance.choice([0, 0, 1]))]), ("event",), 1),
        ]  # fmt: skip
        if two:
            return prefix + [
                (lambda: self.plain("EnterInitializationMode"), ("ready",), 6),
                (lambda: self.plain("EnterInitializationMode"), ("instantiated",), 0.1),
                (self.input_derivatives, ("instantiated", "step") if step else (), 2),
                (self.status, ("step",) if step else (), 1),
                (lambda: self.plain("CancelStep"), (), 0.5),
            ]
        absent = [kind for kind in TYPES if kind not in ("Float64", "Int32", "Boolean")]
        absent += ["Binary", "Clock", "IntervalDecimal", "IntervalFraction", "ShiftDecimal", "ShiftFraction"]
        return prefix + [
            (lambda: self.absent(self.chance.choice(absent)), (), 6),
            (lambda: self.derivative("Adjoint"), ("initialization", *runs), 2),
            (self.dependencies, ("instantiated", *runs), 2),
            (lambda: self.count_of("GetNumberOfEventIndicators"), ("event",), 0.5),
            (lambda: self.count_of("GetNumberOfContinuousStates"), ("event",), 0.5),
            (lambda: self.plain("EnterStepMode"), ("event",) if step else (), 6),
            (lambda: self.plain("EvaluateDiscreteStates"), ("event",), 0.5),
            (lambda: self.plain("EnterConfigurationMode"), (), 0.3),
            (lambda: self.plain("ExitConfigurationMode"), (), 0.3),
            (lambda: ("ActivateModelPartition", [c_uint(0), c_double(0.0)]), (), 0.3),
        ]

    def choose(self):
        """The next call, mostly one that is allowed."""
        calls = self.catalogue()
        if not self.bad(0.2):
            likely = [call for call in calls if self.mode in call[1]]
            calls = likely or calls
        (call, *_), = self.chance.choices(calls, [weight for *_, weight in calls])
        return call()

    def instantiation(self, interface, bad=True):
        name = self.chance.choice([b"", b" \t", None, b"#1"]) if bad and self.is_(0.1) else b"instance"
        token = None if bad and self.is_(0.05) else self.token
        logging = self.is_(0.8)
        resources = c_char_p(self.resources.encode())
        if self.version == 2:
            kind = self.chance.choice([2, -1]) if bad and self.is_(0.05) else int(interface == "CoSimulation")
            return "Instantiate", [c_char_p(name), c_int(kind), c_char_p(token), resources, "callbacks", c_int(0), c_int(logging)]
        arguments = [c_char_p(name), c_char_p(token), resources, c_bool(False), c_bool(logging)]
        if interface == "ModelExchange":
            return "InstantiateModelExchange", [*arguments, c_void_p(), "logger"]
        required = self.some(self.outputs) if self.is_(0.5) else []
        null = required and self.is_(0.1)
        return "InstantiateCoSimulation", [
            *arguments, c_bool(self.is_(0.5)), c_bool(self.is_(0.7)),
            c_void_p() if null or not required else (c_uint * len(required))(*required), c_size_t(len(required)),
            c_void_p(), "logger", "update" if self.is_(0.5) else UPDATE(),
        ]  # fmt: skip

    def follow(self, name, status, arguments):
        """Follows the state of the instance."""
        if status == ERROR:
            self.mode = "ended"
        if status != OK:
            return
        if name in ("EnterInitializationMode", "SetupExperiment"):
            self.time = arguments[2].value if arguments else self.time
        self.mode = {
            "EnterInitializationMode": "initialization",
            "ExitInitializationMode": "event" if self.starts_at_event else "step",
            "EnterEventMode": "event", "EnterContinuousTimeMode": "continuous", "EnterStepMode": "step", "Terminate": "ended",
            "Reset": "instantiated",
        }.get(name, self.mode)  # fmt: skip
        if name == "Reset":
            self.time, self.mischief = 0.0, self.chance.choice([0.1, 1.0])
        if name == "SetupExperiment":
            self.mode = "ready"
        if name == "SetTime":
            self.time = arguments[0].value
        if name == "DoStep":
            self.time = arguments[0].value + arguments[1].value if self.version == 2 else arguments[6].made
        if name in ("GetFMUstate", "GetFMUState"):
            self.stored[arguments[0].slot] = (self.mode, self.time)
        if name in ("FreeFMUstate", "FreeFMUState") and isinstance(arguments[0], State):
            self.stored.pop(arguments[0].slot, None)
        if name in ("SetFMUstate", "SetFMUState"):
            self.mode, self.time = self.stored.get(arguments[0].slot, (self.mode, self.time))


def compare(shells, before, report):
    """Returns true if both calls ended alike. Differences of any event since the last comparison go to the report."""
    mine, other = (shell.events for shell in shells)
    same = len(mine) == len(other) and not any(map(Event.differs, mine, other))
    if not same:
        kind = tuple(tuple(event.kind + event.text for event in events) for events in (mine, other))
        report.setdefault(kind, (list(before[-6:]), list(mine), list(other)))
    statuses = [[event.text for event in events if event.kind == "end"] for events in (mine, other)]
    for shell in shells:
        shell.events.clear()
    return statuses[0] == statuses[1]


def walk(folder, libraries, interface, seed):
    """Makes the calls, and returns the differences."""
    path = Walk(folder, interface, seed)
    shells = [Shell(library, path.version) for library in libraries]
    report, before, statuses = {}, [], {}
    other = {"CoSimulation": "ModelExchange", "ModelExchange": "CoSimulation"}[interface]

    def both(do):
        for shell in shells:
            do(shell)
        return compare(shells, before, report)

    for shell in shells:
        shell.seed, shell.variables = seed, (path.inputs, path.outputs)
    # a state of the other interface, if the model has that
    instantiation = path.instantiation(other, bad=False)
    before.append(str(instantiation))
    both(lambda shell: shell.instantiate(*instantiation))
    get, size = path.state_call("Get")[0], path.state_call("Size")[0]
    if shells[0].instance:
        both(lambda shell: shell.call(get, [State("foreign", pointed=True)]))
    both(Shell.free)
    path.size, path.counted = 64, {}

    for _ in range(CALLS):
        if path.mode == "none" or path.is_(0.01):
            both(Shell.free)
            instantiation = path.instantiation(interface)
            before.append(str(instantiation))
            if not both(lambda shell: shell.instantiate(*instantiation)):
                break
            if not shells[0].instance:
                path.mode = "none"
                continue
            path.mode, path.time = "instantiated", 0.0
            path.starts_at_event = interface == "ModelExchange" or (path.version == 3 and instantiation[1][5].value)
        name, arguments = path.choose()
        before.append(f"{path.mode} {path.time}: {name}{arguments}")
        if name.endswith("Size") or name == "DoStep" or name == "GetNumberOfVariableDependencies":
            arguments = [Kept(argument) if isinstance(argument, Array) else argument for argument in arguments]
        if not both(lambda shell: statuses.update({shell: shell.call(name, arguments)})):
            break
        status = statuses[shells[0]]
        if name.endswith("Size") and status == OK:
            path.size = arguments[1].made
        if name == "GetNumberOfVariableDependencies" and status == OK:
            path.counted[arguments[0].value] = arguments[1].made
        path.follow(name, status, arguments)
    return report


class Kept:
    """An array of one value that is read after the call."""

    def __init__(self, array):
        self.array, self.memory = array, None

    def make(self, shell):
        self.memory = self.array.make(shell)
        return self.memory

    @property
    def made(self):
        return self.memory[0]


if __name__ == "__main__":
    folder, *libraries, interface, seeds = sys.argv[1:]
    differences = {}
    for seed in seeds.split(","):
        differences |= walk(Path(folder), libraries, interface, seed)
    for calls, mine, other in differences.values():
        print("after\n   ", "\n    ".join(calls))
        print("library:", *mine, sep="\n    ")
        print("sources:", *other, sep="\n    ")
    sys.exit(bool(differences))
