#!/usr/bin/env python3
"""Prints docs/bad-input.md: malformed descriptions, plans, tables and FMUs, each with what `metafmu` says to it.

Needs target/release/metafmu, and pandas with pyarrow: `.venv/bin/python scripts/bad-input.py`. Every case must end with exit code 2, without a panic, and write no file.
"""

import argparse
import datetime
import io
import os
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import pandas as pd

ROOT = Path(__file__).resolve().parents[1]
STUDY = """name = "s"
[source]
system = "single-pendulum"
[time]
stop = 1
step = 0.5
[parameters]
L = { min = 0.1, max = 0.2, unit = "m" }
[outputs]
theta = { unit = "rad" }
[sampling]
method = "sobol"
runs = 8
test_runs = 1
"""
RECORDED = STUDY.replace('system = "single-pendulum"', 'table = "runs.csv"').replace('method = "sobol"\nruns = 8\n', "")
INDEX = RECORDED.replace('table = "runs.csv"', 'index = "index.csv"')
LIST = STUDY.replace('"sobol"\nruns = 8', '"list"\nfile = "points.csv"')
MECHANISM = STUDY.replace('system = "single-pendulum"', 'mechanism = "m.toml"')
FOUR_BAR = MECHANISM.replace("L = {", "crank_length = {").replace("max = 0.2", "max = 0.25")
CRANK_STUDY = MECHANISM.replace("L = { min = 0.1, max = 0.2", "r = { min = 1, max = 2").replace("stop = 1\n", "stop = 5\n")
FMU_STUDY = STUDY.replace('system = "single-pendulum"', 'fmu = "model.fmu"').replace("L = { min = 0.1, max = 0.2, unit = \"m\" }", "mu = { min = 0.5, max = 1 }")
FMU_STUDY = FMU_STUDY.replace('theta = { unit = "rad" }', "x0 = {}")
COMMAND = STUDY.replace('system = "single-pendulum"', 'command = ["python3", "model.py"]')
PROGRAM = """import json, sys
DESCRIPTION = {"protocol": 1, "parameters": {"L": {"min": 0.15, "max": 0.2, "unit": "mm"}}, "outputs": {"omega": {}}}
for line in sys.stdin:
    request = json.loads(line)
    print(json.dumps({"id": request["id"]} | (DESCRIPTION if request["request"] == "describe" else {"outputs": {"theta": [0, 1]}})), flush=True)
"""
RUNS = "run,time,L,theta\na,0,0.1,1\na,0.5,0.1,2\na,1,0.1,3\nb,0,0.2,4\nb,1,0.2,5\nc,0,0.15,6\nc,1,0.15,7\n"
# in the place of a file's content: it is a pipe
PIPE = object()
PENDULUM = (ROOT / "examples" / "mechanisms" / "single-pendulum.toml").read_text()
CRANK = (ROOT / "examples" / "mechanisms" / "slider-crank.toml").read_text()
LINKAGE = (ROOT / "examples" / "mechanisms" / "four-bar.toml").read_text()
TROLLEY = (ROOT / "examples" / "dynamics" / "crane.toml").read_text()
DYNAMICS = """name = "crane"
structure = "dynamics"
[source]
mechanism = "crane.toml"
[time]
stop = 1
step = 0.05
[states]
"rail.position" = { min = -5, max = 5 }
"rope.angle" = { min = -1, max = 1, start = [-0.5, 0.5] }
[inputs]
force = { bandwidth = 1.0, excitation = ["steps"] }
[parameters]
l = { min = 1, max = 2 }
[outputs]
x = {}
theta = {}
[sampling]
test_runs = 2
"""
MOTOR = '[actuators.motor]\ncoordinate = "rail.position"\neffort = "force"\n'
MOTIONS = """name = "motion"
structure = "dynamics"
[source]
table = "motion.csv"
[time]
stop = 5.9
step = 0.1
[states]
x = { rate = "v" }
[inputs]
u = { min = -1, max = 1 }
[outputs]
x = {}
[sampling]
train_stop = 5.0
"""
ROWS = "time,x,v,u\n" + "".join(f"{k / 10},{k % 7},{k % 5},{k % 3}\n" for k in range(60))


OSCILLATOR = (ROOT / "examples" / "fmu-source" / "van-der-pol" / "modelDescription.xml").read_text()
BINARY = {"binaries/linux64/van_der_pol.so": "no machine code"}


def fmu(old="", new="", more=BINARY):
    """An archive with a changed model description."""
    assert old in OSCILLATOR, old
    return {"model.fmu": {"modelDescription.xml": OSCILLATOR.replace(old, new, 1) if old else OSCILLATOR, **more}}


def of_fmu(old, new, **changes):
    """A study of an FMU."""
    return {**study(old, new, FMU_STUDY), **fmu(**changes)}


def parquet(change=lambda runs: runs, cut=None, **options):
    """The recorded runs as Parquet, some rows changed, the file cut off."""
    rows = change(pd.read_csv(io.StringIO(RUNS)))
    return {"study.toml": RECORDED.replace("runs.csv", "runs.parquet"), "runs.parquet": rows.to_parquet(**options)[:cut]}


def cell(row, column, value):
    """Sets the value of a row, counted from 1."""
    return lambda runs: runs.assign(**{column: runs[column].where(runs.index != row - 1, value)})


def study(old, new, text=STUDY):
    assert old in text, old
    return {"study.toml": text.replace(old, new, 1)}


def command(old="", new="", program=PROGRAM):
    """A study of a program, and the program."""
    return study(old, new, COMMAND) | {"model.py": program}


def mechanism(old, new, text=PENDULUM, about=MECHANISM):
    assert old in text, old
    return {"study.toml": about, "m.toml": text.replace(old, new, 1)}


DISCRETE = """name = "s"
structure = "discrete"
[source]
table = "runs.csv"
[time]
stop = 1
step = 0.5
[inputs]
force = { min = -2, max = 2 }
[outputs]
y = {}
[sampling]
test_runs = 1
"""


def discrete(*changes, more="", rows="a,0,0,1\na,0.5,1,1\na,1,0,1\n"):
    """Recorded runs with an input, with parts of the study replaced."""
    text = DISCRETE
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    return {"study.toml": text + more, "runs.csv": "run,time,force,y\n" + rows}


STATIC = """name = "map"
structure = "static"
[source]
table = "points.csv"
[inputs]
a = {}
b = {}
[outputs]
y = { unit = "N" }
"""


def static(*changes, more="", rows="1,2,3\n2,1,5\n3,3,4\n"):
    """Rows of a static map, with parts of the study replaced."""
    text = STATIC
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    return {"study.toml": text + more, "points.csv": "a,b,y\n" + rows}


def discrete_fmu(*changes, fmu_of=None):
    """A study of an FMU that has the input, with parts of the study or of the FMU replaced."""
    text = DISCRETE.replace('table = "runs.csv"', 'fmu = "model.fmu"').replace("y = {}", "x0 = {}")
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    force = '<ScalarVariable name="force" valueReference="9" causality="input" variability="continuous"><Real start="0"/></ScalarVariable>'
    description = OSCILLATOR.replace("</ModelVariables>", f"{force}</ModelVariables>").replace(*(fmu_of or ("", "")))
    return {"study.toml": text, "model.fmu": {"modelDescription.xml": description, **BINARY}}


# a crank of 1 m and a rod of 0.8 m
SHORT_ROD = """[bodies]
crank = { mass = 1, inertia = 0.1, position = [0.5, 0], points = { pin = [-0.5, 0], tip = [0.5, 0] } }
rod = { mass = 1, inertia = 0.1, position = [1.4, 0], points = { a = [-0.4, 0], b = [0.4, 0] } }
slider = { mass = 1, position = [1.8, 0] }
[joints]
A = { type = "revolute", between = ["ground", "crank.pin"] }
B = { type = "revolute", between = ["crank.tip", "rod.a"] }
C = { type = "revolute", between = ["rod.b", "slider"] }
guide = { type = "prismatic", between = ["ground", "slider"], axis = [1, 0] }
[outputs]
x = { measure = "guide.position" }
"""
SHORT_STUDY = """name = "s"
structure = "dynamics"
[source]
mechanism = "m.toml"
[time]
stop = 1
step = 0.1
[states]
A.angle = { min = -0.9, max = 1.0 }
[outputs]
x = {}
"""


def dynamics(*changes, more="", **of_mechanism):
    """A study with states, some lines changed, and of its mechanism."""
    texts = {"study.toml": DYNAMICS + more, "crane.toml": TROLLEY}
    for name, pairs in [("study.toml", changes), ("crane.toml", of_mechanism.get("trolley", []))]:
        for old, new in pairs:
            assert old in texts[name], old
            texts[name] = texts[name].replace(old, new, 1)
    return texts


def driver(*lines, **options):
    """A study as of `dynamics`, with a driver of the trolley instead of its motor."""
    return dynamics(trolley=[(MOTOR, "\n".join(["[drivers.servo]", *lines, ""]))], **options)


def motions(*changes, rows=("", "")):
    """A study of motions in a table, some lines changed, and of its table."""
    texts = {"study.toml": MOTIONS, "motion.csv": ROWS.replace(*rows, 1)}
    assert rows[0] in ROWS, rows
    for old, new in changes:
        assert old in MOTIONS, old
        texts["study.toml"] = texts["study.toml"].replace(old, new, 1)
    return texts


def recording(rows, name="recorded.csv", options=""):
    """The crane driven by a recorded force."""
    return {**dynamics(('bandwidth = 1.0, excitation = ["steps"]', f'recording = "recorded.csv"{options}')), name: rows}


def runs(old, new):
    assert old in RUNS, old
    return {"study.toml": RECORDED, "runs.csv": RUNS.replace(old, new, 1)}


SECTIONS = {
    "Studies and plans": {
        "no TOML": study("[time]", "[time"),
        "a key that is not known": study("step =", "stp ="),
        "text for a number": study("stop = 1", 'stop = "1"'),
        "a decimal comma": study("step = 0.5", "step = 0,5"),
        "a text without quotes": study('"sobol"', "sobol"),
        "two mistakes in the syntax": study("stop = 1\nstep = 0.5", "stop = one\nstep ="),
        "a number that is not whole": study("runs = 8", "runs = 1e3"),
        "a number for a table": study('{ unit = "rad" }', "3"),
        "a key that is missing": study("step = 0.5\n", ""),
        "a key twice": study("step = 0.5", "step = 0.5\nstop = 2"),
        "a path with backslashes": study('system = "single-pendulum"', 'table = "C:\\data.csv"'),
        "an FMU for a study": {"study.toml": {"modelDescription.xml": "hello"}},
        "a mechanism for a study": {"study.toml": PENDULUM},
        "a step that does not divide the time": study("step = 0.5", "step = 0.3"),
        "an empty range": study("min = 0.1", "min = 0.3"),
        "values beside a range": study("min = 0.1", "values = [0.1, 0.2], min = 0.1"),
        "a nominal value twice": study("min = 0.1, max = 0.2", "values = [0.1, 0.2, 0.1]"),
        "nominal parameters only": study("min = 0.1, max = 0.2", "values = [0.1, 0.2]"),
        "another unit than the system's": study('"m"', '"mm"'),
        "a parameter the system has not": study("L = {", "length = {"),
        "a parameter that is nearly the system's": study("L = {", "thetad = {"),
        "an output the system has not": study("theta = {", "omega = {"),
        "a system that is not there": study("single", "triple"),
        "a system and a table": study("[time]", 'table = "runs.csv"\n[time]'),
        "a plan that is not there": study('"sobol"', '"grid"'),
        "levels for a plan without levels": study("runs = 8", "runs = 8\nlevels = 3"),
        "a mesh without levels": study('"sobol"\nruns = 8', '"mesh"'),
        "a list without a parameter": {"study.toml": LIST, "points.csv": "c\n0\n1\n"},
        "a point out of range": {"study.toml": LIST, "points.csv": "L\n0.1\n0.3\n"},
        "a duplicated point": {"study.toml": LIST, "points.csv": "L\n0.1\n0.2\n0.10\n"},
        "options of the training that make no sense": {
            "study.toml": STUDY + '[training]\noptimizer = "sgd"\ndropout = 2\nweight_decay = 0.01\nhuber_delta = 0.5\n'
        },
        "dropout without hidden layers": {"study.toml": STUDY + "[network]\nhidden = []\n[training]\ndropout = 0.1\n"},
        "a billion epochs": {"study.toml": STUDY + "[training]\nepochs = 1000000000\n"},
        "a trillion test runs": study("test_runs = 1", "test_runs = 1000000000000"),
        "more rows than fit": study("step = 0.5", "step = 1e-6", STUDY.replace("runs = 8", "runs = 2000")),
        "a network larger than any": {"study.toml": STUDY + "[network]\nhidden = [16384, 16384]\n"},
        "a name of 300 characters": study('"s"', f'"{"s" * 300}"'),
        "an output with the name of a variable that every FMU has": study("theta = {", "in_domain = {"),
        "limits that no surrogate reaches": {"study.toml": STUDY + "[accept]\nr2 = 1.0\ngood = 1.0\n"},
        "a target judged by one run": {"study.toml": STUDY + "[target]\nr2 = 0.99\nruns = 8\nmax_runs = 100\n"},
    },
    "Other files for a study": {
        "a table": {"runs.csv": RUNS},
        "a spreadsheet": {"runs.xlsx": {"xl/workbook.xml": ""}},
        "an FMU": {"model.fmu": {"modelDescription.xml": "hello"}},
        "an ONNX model": {"net.onnx": b"\x08\x08"},
        "a network of PyTorch": {"net.pt": {"net/data.pkl": ""}},
        "a network of Keras": {"net.keras": {"config.json": ""}},
        "an estimator of scikit-learn": {"model.pkl": b"\x80\x04"},
        "a model in Modelica": {"Pendulum.mo": "model Pendulum\nend Pendulum;\n"},
        "a model of Simulink": {"pendulum.slx": {"simulink/blockdiagram.xml": ""}},
        "a notebook": {"study.ipynb": "{}"},
        "a system": {"system.ssp": {"SystemStructure.ssd": ""}},
    },
    "Other files for a trained model": {
        "a table": {"runs.csv": RUNS},
        "a network of PyTorch": {"net.pt": {"net/data.pkl": ""}},
        "a study": {"study.toml": STUDY},
    },
    "Other files for an FMU": {
        "a model of Simulink": {"pendulum.slx": {"simulink/blockdiagram.xml": ""}},
        "a study": {"study.toml": STUDY},
    },
    "Several mistakes at once": {
        "unknown keys in three sections": study(
            "step = 0.5", "step = 0.5\nmargn = 0.1", STUDY.replace("test_runs", "tests") + "[network]\nnodes = [64, 64]\n"
        ),
        "a wrong type beside a wrong limit": study("runs = 8", 'runs = "8"', STUDY + "[training]\ndropout = 2\nepochs = 0\n"),
        "missing keys in two sections": study(
            "stop = 1\nstep = 0.5\n", "", STUDY + "[target]\nr2 = 0.9\n[accept]\nr2 = 2\n"
        ),
        "ranges without an end": study(
            "L = { min = 0.1, max = 0.2,", "c = { max = 0.1 }\nthetad0 = { values = [] }\nL = { min = 0.1,"
        ),
        "options of the training, and names that the system does not know": study(
            "theta = {", "omega = {", STUDY.replace("L = {", "length = {") + "[training]\ndropout = 2\n"
        ),
        "a study and its mechanism": {
            "study.toml": MECHANISM.replace("step = 0.5", "step = 0.3"),
            "m.toml": PENDULUM.replace('mass = "m"', 'mass = "m*"').replace('damping = "', 'daming = "'),
        },
        "several mistakes in a mechanism": mechanism(
            'mass = "m"', 'mass = "m*"\nangle = true', PENDULUM.replace('"revolute"', '"hinge"').replace('damping = "', 'daming = "')
        ),
        "an FMU that is not there, and a time": study("step = 0.5", "step = 0.3", FMU_STUDY),
        "a point out of range, and a training": {
            "study.toml": LIST + "[training]\nvalidation = 1.5\n", "points.csv": "L\n0.1\n0.3\n"
        },
        "a search whose values no study can have": {
            "study.toml": STUDY + '[search]\ntrials = 2\n[search.space]\n"training.epoch" = [10, 20]\n'
            '"network.activation" = ["tanh", "rele"]\n"training.batch" = ["64"]\n'
        },
        "a search whose range ends where no study can be": {
            "study.toml": STUDY + '[search]\ntrials = 2\n[search.space]\n"training.dropout" = { min = 0.0, max = 2.0 }\n'
            '"parameters.L.max" = [0.2, 0.01]\n'
        },
        "a polynomial of more terms than can be fitted": {
            "study.toml": STUDY.replace("[outputs]", "c = { min = 0, max = 0.1 }\nthetad0 = { min = 0, max = 1 }\n[outputs]")
            + "[baselines]\npolynomial = { degree = 20 }\nridge = { alpha = -1 }\n"
        },
    },
    "Searches": {
        "a value that no study can have": {
            "study.toml": STUDY + '[search]\ntrials = 2\n[search.space]\n"network.activation" = ["tanh", "rele"]\n'
        },
        "a range whose end no study can have": {
            "study.toml": STUDY + '[search]\ntrials = 2\n[search.space]\n"training.dropout" = { min = 0.0, max = 2.0 }\n'
        },
        "a key that is not known": {
            "study.toml": STUDY + '[search]\ntrials = 2\n[search.space]\n"training.epoch" = [10, 20]\n'
        },
        "more trials than anyone can wait for": {
            "study.toml": STUDY + '[search]\ntrials = 1000000000000\n[search.space]\n"training.batch" = [1]\n'
        },
    },
    "Mechanisms": {
        "an expression that ends early": mechanism('mass = "m"', 'mass = "m*"'),
        "an expression of something unknown": mechanism('mass = "m"', 'mass = "n"'),
        "a table whose knots do not ascend": mechanism("[initial]", "[tables.cam]\nx = [0, 2, 1]\nvalues = [1, 2, 3]\n[initial]"),
        "a table with too few values": mechanism("[initial]", "[tables.cam]\nx = [0, 1]\nvalues = [1]\n[initial]"),
        "a negative mass": mechanism('mass = "m"', 'mass = "-m"'),
        "a vector of three components": mechanism('[0, "-g"]', '[0, 0, "-g"]'),
        "a point of three components": mechanism('[0, "L"]', '[0, "L", 0]'),
        "a joint between three points": mechanism('"rod.top"]', '"rod.top", "rod"]'),
        "a parameter without a `max`": mechanism("min = 0.1, max = 0.2,", "min = 0.1,"),
        "a default outside its range": mechanism("L = { default = 0.15", "L = { default = 0.25"),
        "an output with the name of a parameter": mechanism("theta = {", "L = {"),
        "negative damping": mechanism('damping = "', 'damping = "-'),
        "a spring without stiffness and damping": mechanism('damping = "', '# "'),
        "a spring between points of one body": mechanism('coordinate = "pivot.angle"', 'between = ["rod", "rod.top"]'),
        "a force on the ground": mechanism("[initial]", '[forces.push]\npoint = "ground"\nforce = [1, 0]\n[initial]'),
        "a body that nothing keeps from moving": mechanism("[initial]", "[bodies.bob]\n[initial]"),
        "a study for a mechanism": {"study.toml": MECHANISM, "m.toml": STUDY},
        "a parameter without its default": mechanism("default = 0.15, ", ""),
        "an expression with a slip of the pen": mechanism('mass = "m"', 'mass = "Thetad0"'),
        "a division by zero": mechanism('mass = "m"', 'mass = "m/0"'),
        "a function that is not there": mechanism('mass = "m"', 'mass = "sine(m)"'),
        "a joint at a point that is not there": mechanism('"rod.top"', '"rod.tip"'),
        "a joint of a body with itself": mechanism('"ground"', '"rod"'),
        "a joint of an unknown kind": mechanism('"revolute"', '"hinge"'),
        "a measure that is not there": mechanism('"rod.x"', '"rod.z"'),
        "a name for two things": mechanism("[springs.damper]", "[springs.rod]"),
        "a reaction that a redundant joint leaves open": mechanism(
            "[springs.return]",
            '[joints.E]\ntype = "revolute"\nbetween = ["ground.right", "rocker.bottom"]\n[outputs.load]\nmeasure = "D.fx"\n[springs.return]',
            LINKAGE,
            FOUR_BAR,
        ),
        "bars that do not reach": mechanism("default = 0.5, unit", "default = 5.5, unit", LINKAGE, FOUR_BAR),
        "a rod shorter than its driven crank": mechanism("default = 3.0, min = 2.5", "default = 0.6, min = 0.5", CRANK, CRANK_STUDY),
        "a motion that ends": mechanism("time/tau - sin(tau*time)/tau^2", "sqrt(2 - time)", CRANK, CRANK_STUDY),
    },
    "Surrogates with states": {
        "a coordinate that is not there": dynamics(('"rope.angle"', '"rod.angle"')),
        "a coordinate that the part has not": dynamics(('"rope.angle"', '"rope.position"')),
        "a velocity for a coordinate": dynamics(('"rope.angle"', '"rope.angular_velocity"')),
        "an empty range": dynamics(("min = -5, max = 5", "min = 5, max = -5")),
        "not a number": dynamics(("min = -5, max = 5", "min = nan, max = 5")),
        "a start outside the range": dynamics(("[-0.5, 0.5]", "[-0.5, 1.5]")),
        "a start that is no range": dynamics(("[-0.5, 0.5]", "[0.5, -0.5]")),
        "a velocity that is no range": dynamics(("max = 5 ", "max = 5, velocity = [1, inf] ")),
        "a start of one number": dynamics(("[-0.5, 0.5]", "0.5")),
        "no state": dynamics(('"rail.position" = { min = -5, max = 5 }\n"rope.angle" = { min = -1, max = 1, start = [-0.5, 0.5] }\n', "")),
        "too few coordinates": dynamics(('"rail.position" = { min = -5, max = 5 }\n', "")),
        "too many coordinates": dynamics(("[inputs]", '"load.x" = { min = -5, max = 5 }\n[inputs]')),
        "coordinates that are not independent": dynamics(('"rope.angle" = { min = -1, max = 1, start = [-0.5, 0.5] }', '"trolley.x" = { min = -5, max = 5 }')),
        "a coordinate twice": dynamics(("[inputs]", '"rope.angle" = { min = -5, max = 5 }\n[inputs]')),
        "a number for a coordinate": dynamics(('"rail.position" = { min = -5, max = 5 }', '"rail.position" = 5')),
        "an unknown key of a coordinate": dynamics(("start = [", "starts = [")),
        "an input that is not there": dynamics(("force = {", "torque = {")),
        "an input that is nearly the mechanism's": dynamics(("force = {", "Force = {")),
        "another unit than the input's": dynamics(("bandwidth = 1.0", 'unit = "kN"')),
        "an empty range of an input": dynamics(("bandwidth = 1.0", "min = 20")),
        "a start outside the input's range": dynamics(("bandwidth = 1.0", "start = 11")),
        "an input that is not finite": dynamics(("bandwidth = 1.0", "max = inf")),
        "a bandwidth above half the rows' frequency": dynamics(("bandwidth = 1.0", "bandwidth = 11")),
        "a bandwidth that is not positive": dynamics(("bandwidth = 1.0", "bandwidth = 0")),
        "a signal that is not there": dynamics(('["steps"]', '["step"]')),
        "no signal": dynamics(('["steps"]', "[]")),
        "a signal that is no list": dynamics(('["steps"]', '"steps"')),
        "a recording that is not there": recording("time,force\n0,1\n1,2\n", name="r.csv"),
        "a recording of something else": recording("time,torque\n0,1\n1,2\n"),
        "a recording without times": recording("t,force\n0,1\n1,2\n"),
        "a recording in another unit": recording("time,force [kN]\n0,1\n1,2\n"),
        "a recording with a gap": recording("time,force\n0,1\n0.5,nan\n1,2\n"),
        "a recording that goes back in time": recording("time,force\n0,1\n1,2\n0.5,3\n"),
        "a recording shorter than a run": recording("time,force\n0,1\n0.9,2\n"),
        "a recording outside the input's range": recording("time,force\n0,1\n1,12\n"),
        "a bandwidth of a recording": recording("time,force\n0,1\n1,2\n", options=", bandwidth = 1.0"),
        "networks for each instant": dynamics(more='[network]\nstructure = "fixed"\n'),
        "a model that is not there": dynamics(more='[dynamics]\nmodel = "forest"\n'),
        "a comparison that is no truth value": dynamics(more="[dynamics]\ncompare = 1\n"),
        "a step of the solver that is not positive": dynamics(more="[dynamics]\nsolver_step = 0\n"),
        "an empty range of a velocity": dynamics(("max = 5 ", "max = 5, velocity_range = [1, 1] ")),
        "a range of a velocity that is no range": dynamics(("max = 5 ", "max = 5, velocity_range = [-1, nan] ")),
        "a force that is NaN at some velocities": dynamics(trolley=[('effort = "force"', 'effort = "force - sqrt(rail.velocity)"')]),
        "bounds of too few runs": dynamics(more="[bounds]\ncoverage = 0.9\nruns = 5\n"),
        "an input with the name of a bound": dynamics(
            ("force = {", "x_bound = {"), more="[bounds]\n", trolley=[("force = {", "x_bound = {"), ('"force"', '"x_bound"')]
        ),
        "a target": dynamics(more="[target]\nr2 = 0.9\nruns = 8\nmax_runs = 100\n"),
        "a search": dynamics(more='[search]\ntrials = 2\n[search.space]\n"training.batch" = [64]\n'),
        "baselines": dynamics(more='[baselines]\nbuild = ["ridge"]\n'),
        "arrays": dynamics(more='[arrays]\nboth = ["x", "theta"]\n'),
        "single precision": dynamics(more='[export]\nprecision = "single"\n'),
        "a margin": dynamics(("stop = 1\n", "stop = 1\nmargin = 0.1\n")),
        "a parameter with values": dynamics(("l = { min = 1, max = 2 }", "l = { values = [1, 2] }")),
        "a parameter that varies during a run": dynamics(("max = 2 }", 'max = 2, variability = "continuous" }')),
        "a periodic parameter": dynamics(("max = 2 }", "max = 2, periodic = true }")),
        "a parameter with the name of a start": dynamics(("[outputs]", '"rope.angle_start" = { min = 0, max = 1 }\n[outputs]')),
        "a parameter that acts at the start only": dynamics(("[outputs]", "theta0 = { min = 0, max = 0.5 }\n[outputs]")),
        "an input for a parameter": dynamics(("[outputs]", "force = { min = 0, max = 1 }\n[outputs]")),
        "a method": dynamics(("[sampling]\n", '[sampling]\nmethod = "sobol"\n')),
        "no test runs": dynamics(("test_runs = 2", "test_runs = 0")),
        "coordinates that a system has not": dynamics(('mechanism = "crane.toml"', 'system = "single-pendulum"')),
        "states without the structure": dynamics(('structure = "dynamics"\n', "")),
        "another structure": dynamics(('"dynamics"', '"dynamic"')),
        "an output that is not there": dynamics(("theta = {}", "omega = {}")),
        "a motion that is prescribed": dynamics(
            ('"rail.position" = { min = -5, max = 5 }\n', ""),
            trolley=[
                ('rail.position = "x0"\nrail.velocity = 0\n', ""),
                ("[actuators", '[drivers.push]\ncoordinate = "rail.position"\nmotion = "x0 + time"\n[actuators'),
            ],
        ),
        "a driver with a motion and an acceleration": driver('coordinate = "rail.position"', 'acceleration = "force"', 'motion = "time"'),
        "a driver with neither": driver('coordinate = "rail.position"'),
        "a driver's acceleration of what it has not": driver('coordinate = "rail.position"', 'acceleration = "forse"'),
        "a driver's acceleration of another acceleration": driver('coordinate = "rail.position"', 'acceleration = "load.ax"'),
        "a driver's acceleration that depends on time": driver('coordinate = "rail.position"', 'acceleration = "force * sin(time)"'),
        "a driver's acceleration that is not finite": driver('coordinate = "rail.position"', 'acceleration = "sqrt(force)"'),
        "a driver of a coordinate that is not among the states": driver('coordinate = "load.x"', 'acceleration = "force"'),
        "a driver of a velocity": driver('coordinate = "rail.velocity"', 'acceleration = "force"'),
        "two drivers of one motion": driver(
            'coordinate = "rail.position"', 'acceleration = "force"', "[drivers.other]", 'coordinate = "trolley.x"', "acceleration = 1"
        ),
        "a driver of what a joint holds": driver('coordinate = "trolley.y"', 'acceleration = "force"'),
        "a table for a mechanism": {**dynamics(('mechanism = "crane.toml"', 'table = "runs.csv"')), "runs.csv": "run,time,l,x,theta\na,0,1,2,3\n"},
        "a method and a file": dynamics(("[sampling]\n", '[sampling]\nmethod = "list"\nfile = "points.csv"\nlevels = 3\nfaces = 0.1\n')),
        "an input's range in the mechanism": dynamics(trolley=[("min = -10.0, max = 10.0", "min = 10.0, max = -10.0")]),
        "a force that is not finite": dynamics(trolley=[('effort = "force"', 'effort = "sqrt(force)"')]),
        "a range with singular positions": {"study.toml": SHORT_STUDY, "m.toml": SHORT_ROD},
        "a force that depends on time": dynamics(trolley=[('effort = "force"', 'effort = "force + sin(time)"')]),
        "mistakes in five sections": dynamics(
            ("step = 0.05", "step = 0.03"),
            ('"rail.position" = { min = -5', '"rail.position" = { min = 7'),
            ("bandwidth = 1.0, excitation = [\"steps\"]", "bandwidth = 100, excitation = []"),
            ("l = { min = 1", "l = { min = 3"),
            more="[bounds]\ncoverage = 1.5\n",
        ),
        "keys that are not known in three sections": dynamics(
            ("max = 5 }", "max = 5, units = \"m\" }"), ("bandwidth = 1.0", "frequency = 1.0"), ("test_runs", "tests")
        ),
        "names that the mechanism does not know": dynamics(
            ('"rope.angle"', '"rod.angle"'), ("force = {", "torque = {"), ("l = {", "length = {"), ("theta = {", "omega = {")
        ),
        "a study and its mechanism": dynamics(("bandwidth = 1.0", "bandwidth = -1"), trolley=[('mass = "m"', 'mass = "m*"')]),
    },
    "Tables of motions": {
        "a row that is not where it is expected": motions(rows=("\n5.0,", "\n5.01,")),
        "a rate that is not there": motions(('"v"', '"w"')),
        "a coordinate that is not there": motions(("x = { rate", "y = { rate")),
        "a rate that is not a number": motions(rows=("\n5.0,1,0", "\n5.0,1,none")),
        "an output that is no state": motions(("x = {}", "x = {}\nu = {}")),
        "another unit than the coordinate's": motions(("x = {}", 'x = { unit = "mm" }'), rows=("x", "x [m]")),
        "too few rows": motions(("train_stop = 5.0", "train_stop = 2.0")),
        "no rows for the test": motions(("train_stop = 5.0", "train_stop = 6")),
        "too few runs": motions(("train_stop = 5.0", "test_runs = 3")),
        "both ways to divide runs": motions(("train_stop = 5.0", "train_stop = 5.0\ntest_runs = 3")),
        "a rate that is another column": motions(('"v"', '"u"')),
        "a start": motions(('"v" }', '"v", start = [0, 1], velocity = [0, 1] }')),
        "a bandwidth": motions(("max = 1 }", "max = 1, bandwidth = 1 }")),
        "a network": motions(("[sampling]", "[network]\nhidden = [8]\n[sampling]")),
        "an index": {**motions(("table =", "index =")), "motion.csv": "file,case\nrun.csv,1\n", "run.csv": ROWS},
        "a part of the runs of a mechanism": dynamics(("test_runs = 2", "train_stop = 0.5")),
        "a rate of a mechanism": dynamics(("max = 5 }", 'max = 5, rate = "v" }')),
        "no range of a mechanism's coordinate": dynamics(("min = -5, max = 5", "")),
    },
    "Recorded runs with inputs": {
        "rows that are not a sample time apart": discrete(rows="a,0,0,1\na,0.5,0,1\na,0.9,0,1\n"),
        "an input that is empty": discrete(rows="a,0,0,1\na,0.5,,1\na,1,0,1\n"),
        "an input out of range": discrete(rows="a,0,0,1\na,0.5,3,1\na,1,0,1\n"),
        "no column of an input": discrete(("force = {", "torque = {")),
        "no input": discrete(("force = { min = -2, max = 2 }\n", "")),
        "an empty range of an input": discrete(("max = 2", "max = -3")),
        "a start outside the input's range": discrete(("max = 2", "max = 2, start = 4")),
        "signals for recorded inputs": discrete(("max = 2", 'max = 2, bandwidth = 1, excitation = ["steps"]')),
        "no history": discrete(more="[discrete]\nhistory = 0\n"),
        "a model that is not there": discrete(more='[discrete]\nmodel = "narx"\n'),
        "a simulated source": discrete(('table = "runs.csv"', 'system = "single-pendulum"')),
        "an input that the FMU has not": discrete_fmu(("force = {", "torque = {")),
        "an input without a range": discrete_fmu((" min = -2, max = 2 ", "")),
        "an output as an input": discrete_fmu(("force = {", "x1 = {")),
        "a start outside the input's range of an FMU": discrete_fmu(("max = 2", "max = 2, start = 4")),
        "a constant that is an input": discrete_fmu(('fmu"\n', 'fmu"\nconstants = { force = 1 }\n')),
        "a tolerance of co-simulation": discrete_fmu(('fmu"\n', 'fmu"\ntolerance = 1e-6\n')),
        "a margin": discrete_fmu(("step = 0.5", "step = 0.5\nmargin = 0.1")),
        "a plan": discrete_fmu(("test_runs = 1", 'test_runs = 1\nmethod = "mesh"\nlevels = 3')),
        "one run": discrete_fmu(("test_runs = 1", "test_runs = 1\nruns = 1")),
        "states": discrete(more="[states]\nx = { min = 0, max = 1 }\n"),
        "no hidden layer": discrete(more="[network]\nhidden = []\n"),
        "an option without the structure": discrete(('structure = "discrete"\n', ""), ("[inputs]\nforce = { min = -2, max = 2 }\n", "[parameters]\nL = { min = 0, max = 1 }\n"), more="[discrete]\nhistory = 3\n"),
        "too few runs": discrete(rows="a,0,0,1\na,0.5,0,1\na,1,0,1\n"),
    },
    "Static maps": {
        "sections of runs": static(more="[time]\nstop = 1\nstep = 0.1\n[parameters]\nc = { min = 0, max = 1 }\n[sampling]\ntest_runs = 3\n[search]\ntrials = 5\n[search.space]\n\"training.batch\" = [1, 2]\n"),
        "options of other structures": static(("a = {}", "a = { bandwidth = 1 }"), more='[network]\nstructure = "fixed"\n[bounds]\nruns = 50\n[export]\nprecision = "single"\n'),
        "an index": static(('table = "points.csv"', 'index = "points.csv"')),
        "no input": static(("a = {}\nb = {}\n", "")),
        "a model that cannot be exported": static(more='[static]\nmodel = "knn"\n'),
        "a standard deviation of a model without one": static(more='[static]\nmodel = "network"\nstd = true\n'),
        "an input with the name of a standard deviation": static(("a = {}", "y_std = {}"), more="[static]\nstd = true\n"),
        "the structure is missing": static(('structure = "static"\n', ""), more="[static]\n"),
        "columns that are not there": static(("a = {}", "c = {}"), ("y = {", "z = {")),
        "a name of no variable": static(("[inputs]", 'columns = { speed = "a" }\n[inputs]')),
        "cells without numbers": static(rows="1,,3\n2,1,x\n3,NaN,4\n4,5,6\n"),
        "inputs that do not vary": static(rows="1,2,3\n1,2,5\n"),
        "a single row": static(rows="1,2,3\n1,2,3\n"),
        "bounds of too few rows": static(more="[bounds]\n"),
        "a range of another column": static(("a = {}", "a = { min = 100, max = 200 }")),
    },
    "Tables": {
        "no file": {"study.toml": RECORDED},
        "an empty file": {"study.toml": RECORDED, "runs.csv": ""},
        "no header": runs("run,time,L,theta\n", ""),
        "a column that is not there": runs("theta", "angle"),
        "another unit": runs("theta", "theta [deg]"),
        "a missing value": runs("a,0.5,0.1,2", "a,0.5,0.1,"),
        "not a number": runs("a,0.5,0.1,2", "a,0.5,0.1,NaN"),
        "a short row": runs("a,0.5,0.1,2", "a,0.5,0.1"),
        "rows out of order": runs("a,0.5", "a,1.5"),
        "a duplicated time": runs("a,0.5", "a,0"),
        "a parameter that changes in a run": runs("a,0.5,0.1", "a,0.5,0.2"),
        "a run that broke off": runs("a,1,0.1,3\n", ""),
        "a run whose rows are apart": runs("c,0,0.15,6\nc,1", "a,0,0.15,6\na,1"),
        "two runs with one set of parameters": runs("b,0,0.2", "b,0,0.1"),
        "a parameter out of range": runs("b,0,0.2", "b,0,0.3"),
        "outputs too large to compute with": runs("a,0.5,0.1,2", "a,0.5,0.1,1e155"),
        "outputs too small to compute with": {
            "study.toml": RECORDED,
            "runs.csv": "run,time,L,theta\n" + "".join(f"{i},{t},0.{10 + i},1e-200\n" for i in range(4) for t in (0, 1)),
        },
        "too few runs": runs("c,0,0.15,6\nc,1,0.15,7\n", ""),
        "decimal points and commas": {
            "study.toml": RECORDED,
            "runs.csv": RUNS.replace(",", ";").replace("a;0.5;0.1", "a;0,5;0.1"),
        },
        "a name that is nearly the column's": runs("theta", "Theta"),
        "a quote that is not closed": runs("a,0.5", '"a,0.5'),
        "Parquet: a missing value": parquet(cell(2, "theta", None)),
        "Parquet: infinity": parquet(cell(2, "theta", float("inf"))),
        "Parquet: a column that is not there": parquet(lambda runs: runs.rename(columns={"theta": "angle"})),
        "Parquet: another unit": parquet(lambda runs: runs.rename(columns={"theta": "theta [deg]"})),
        "Parquet: rows out of order": parquet(cell(2, "time", 1.5)),
        "Parquet: a parameter that changes in a run": parquet(cell(2, "L", 0.2)),
        "Parquet: a run that broke off": parquet(lambda runs: runs.drop(index=2)),
        "Parquet: a run whose rows are apart": parquet(lambda runs: runs.replace({"run": {"c": "a"}})),
        "Parquet: text for numbers": parquet(lambda runs: runs.astype({"theta": "str"})),
        "Parquet: points of time": parquet(lambda runs: runs.assign(theta=datetime.datetime(2026, 1, 1))),
        "Parquet: lists": parquet(lambda runs: runs.assign(theta=[[1.0, 2.0]] * len(runs))),
        "Parquet: another codec": parquet(compression="zstd"),
        "Parquet: a file that is cut off": parquet(cut=1000),
        "a file of the index that is not there": {"study.toml": INDEX, "index.csv": "file,L\na.csv,0.1\n"},
    },
    "FMUs": {
        "no FMU": {"model.fmu": "hello"},
        "an archive without a model description": {"model.fmu": {"readme.txt": "hello"}},
        "a file that is not there": {},
        "a model description that is no XML": {"model.fmu": {"modelDescription.xml": "hello"}},
        "a model description that ends early": fmu("</ModelVariables>", "<!--"),
        "FMI 1.0": fmu('fmiVersion="2.0"', 'fmiVersion="1.0"'),
        "no interface": fmu("<CoSimulation", "<Simulation"),
        "no binary for this platform": fmu(more={"binaries/win64/van_der_pol.dll": ""}),
        "a binary that is not named after modelIdentifier": fmu(more={"binaries/linux64/van.der.pol.so": ""}),
        "a file that leads out of the archive": fmu(more={**BINARY, "../escape": "hello"}),
        "a value reference that is not a number": fmu('valueReference="0"', 'valueReference="mu"'),
        "an empty modelIdentifier": fmu('modelIdentifier="van_der_pol"', 'modelIdentifier=""'),
        "a start value that is not a number": fmu('start="1"', 'start="one"'),
    },
    "Studies of FMUs": {
        "no file": {"study.toml": FMU_STUDY},
        "no FMU": {"study.toml": FMU_STUDY, "model.fmu": "hello"},
        "no binary for this platform": of_fmu("mu", "mu", more={}),
        "a parameter the FMU has not": of_fmu("\nmu =", "\nnu ="),
        "a parameter that is calculated": of_fmu("\nmu =", '\n"der(x1)" ='),
        "an output the FMU has not": of_fmu("x0 =", "x2 ="),
        "an output that is a parameter": of_fmu("x0 =", "x0_start ="),
        "a range beyond the FMU's": of_fmu("max = 1 ", "max = 3 "),
        "another unit than the FMU's": of_fmu("x0 = {}", 'x0 = { unit = "m" }'),
        "a parameter that is constant as well": of_fmu("[time]", "constants = { mu = 1 }\n[time]"),
        "a step that does not divide that between rows": of_fmu("[time]", "step = 0.3\n[time]"),
        "a tolerance that is none": of_fmu("[time]", "tolerance = 1\n[time]"),
        "a share of failed runs that is none": of_fmu("[time]", "max_failed = 10\n[time]"),
        "retries without an FMU": study("[time]", "retries = 2\n[time]"),
        "a time limit of recorded runs": {"study.toml": RECORDED.replace("[time]", "time_limit = 10\n[time]"), "runs.csv": RUNS},
    },
    "Studies of programs": {
        "a program and an FMU": command("[time]", 'fmu = "model.fmu"\n[time]'),
        "no program": command('["python3", "model.py"]', "[]"),
        "a program that is not there": command('"python3", "model.py"', '"./model"'),
        "a file that is not there": command("[time]", 'files = ["data.csv"]\n[time]'),
        "a tolerance for a program": command("[time]", "tolerance = 1e-6\n[time]"),
        "names, units and ranges that the program has not": command(),
        "a program that prints": command(program="print('loading')"),
        "a program that ends": command(program="raise SystemExit('no license')"),
        "a program without a protocol": command(program="input(); print('{\"id\": 1}')"),
        "a parameter that no argument has": command('"model.py"', '"model.py", "{result}"'),
    },
    "Files without an end, and archives beyond the limits": {
        "a pipe": {"model.fmu": PIPE},
        "entries": fmu(more={**BINARY, **{f"resources/{index}": "" for index in range(50_000)}}),
        "bytes": fmu(more={**BINARY, "resources/zeros": bytes(64 << 20)}),
    },
    "Outputs": {
        "in a folder that is not there": {},
        "in a file": {"runs": "no folder"},
        "a folder": {"runs/run.csv/file": ""},
    },
}
# of the sections whose cases are no studies; FILE is the case's file
ARGUMENTS = {
    "Other files for a study": ["build", "FILE"],
    "Other files for a trained model": ["import", "FILE", "--new", "interface.toml"],
    "Other files for an FMU": ["validate", "FILE"],
    "Static maps": ["train", "study.toml", "--out", "out"],
    "Searches": ["search", "study.toml", "--out", "out"],
    "FMUs": ["simulate", "model.fmu"],
    "Files without an end, and archives beyond the limits": ["simulate", "FILE"],
    "Outputs": ["simulate", "model.fmu", "--output", "runs/run.csv"],
}


def message(folder, files, arguments):
    """Message of the command about the files, without `error: `."""
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        if isinstance(text, dict):
            with zipfile.ZipFile(folder / name, "w", zipfile.ZIP_DEFLATED) as archive:
                for entry, content in text.items():
                    archive.writestr(entry, content)
        elif text is PIPE:
            os.mkfifo(folder / name)
        elif isinstance(text, bytes):
            (folder / name).write_bytes(text)
        else:
            (folder / name).write_text(text)
    command = [ROOT / "target" / "release" / "metafmu", *arguments]
    result = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert (result.returncode, result.stdout) == (2, ""), (files, result)
    written = sum(not path.is_dir() for path in folder.rglob("*"))
    assert "panicked" not in result.stderr and written == len(files), (files, result.stderr)
    return [line.removeprefix("error: ") for line in result.stderr.splitlines() if line.startswith("error: ")]


INTRODUCTION = """# Bad input

What `metafmu` says to malformed input: file, line, key or column, what was found, what was expected. All of them end
with exit code 2 and write nothing. `scripts/bad-input.py` makes this page, `tests/python/test_bad_input.py` keeps it true.

## Limits

Files must be regular ones: a pipe, a device or a socket is refused before it is opened. Only the table of `predict` and the inputs of `simulate`
may also be pipes and devices, such as `/dev/stdin` and `<(command)` of a shell; they are read once, up to their end, after a note on stderr.

| of | at most |
|---|---|
| a study, a mechanism, an interface of `import`, the description of a system | 64 MiB |
| a trained model, a model file, a library, the inputs of `simulate` | 2 GiB |
| a line of a table in CSV | 64 MiB |
| an archive: FMU, SSP, `.npz` | 50,000 entries and 4 GiB when it is unpacked, and 100 times its size if that is more than 64 MiB |
| the time to unpack an FMU | 60 s; `--time-limit`; `source.time_limit` of a study if that is longer |
| a run of an FMU or a program in a sampling | `source.time_limit`, 60 s without it |
| each check of `validate` | `--time-limit`, 60 s without it |

A communication step of an exported FMU is 0 or at least 1e-30 s; a shorter one is an error at once, in C sources too.

Of an FMU only the part that a run may need is unpacked, into the temporary folder: neither documents and source code nor libraries for other
operating systems. The folder is removed when `metafmu` ends. If it was killed meanwhile, the next `metafmu` that unpacks an FMU removes it.
"""


def document():
    """The text of docs/bad-input.md."""
    parts = [INTRODUCTION]
    for section, cases in SECTIONS.items():
        parts.append(f"\n## {section}\n\n| what | message |\n|---|---|\n")
        for what, files in cases.items():
            arguments = ARGUMENTS.get(section, ["sample", "study.toml", "--out", "out"])
            arguments = [next(iter(files)) if argument == "FILE" else argument for argument in arguments]
            with tempfile.TemporaryDirectory() as folder:
                lines = message(Path(folder), files, arguments)
            text = "<br>".join(line.replace("|", "\\|") for line in lines)
            parts.append(f"| {what} | {text} |\n")
    return "".join(parts)


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    sys.stdout.write(document())
