"""FMUs for model exchange only, sampled by metafmu: largest errors against exact solutions, and FMPy's beside them.

Usage: exchange.py METAFMU FOLDER [--tolerance TOLERANCE]

METAFMU is the command, FOLDER gets FMUs, studies and tables. Needs fmpy and scipy. Prints the table in docs/fmu-source.md.
"""

import argparse
import csv
import subprocess
import tempfile
import zipfile
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

HERE = Path(__file__).resolve().parent
GRAVITY = 9.81


# ---- The models: exchange.c says what they are ----------------------------------------------------------------------


def dahlquist(times, k, x_start, u):
    return {"x": x_start * np.exp(-k * times) + u / k * -np.expm1(-k * times)}


def van_der_pol(times, mu, x0_start):
    rates = lambda _, x: [x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]]
    x0, x1 = solve_ivp(rates, (0, times[-1]), [x0_start, 0.0], "DOP853", times, rtol=1e-13, atol=1e-13).y
    return {"x0": x0, "x1": x1}


def ball(times, e, h_start):
    """Free flights; each begins with e times the speed that the one before ended with."""
    h, v = np.empty_like(times), np.empty_like(times)
    begin, height, speed = 0.0, h_start, 0.0
    while True:
        since = times - begin
        flying = since >= 0
        h[flying] = height + speed * since[flying] - 0.5 * GRAVITY * since[flying] ** 2
        v[flying] = speed - GRAVITY * since[flying]
        impact = np.sqrt(speed**2 + 2 * GRAVITY * height)
        begin += (speed + impact) / GRAVITY
        if begin > times[-1]:
            return {"h": h, "v": v}
        height, speed = 0.0, e * impact


def stair(times, period):
    return {"counter": np.floor(times / period)}


def tank(times, h_start):
    return {"h": (np.sqrt(h_start) - times / 2) ** 2}


def stick_slip(times, stiffness, b, stick, slip):
    """Periods of a mass of 1 kg that sticks to a belt up to the force `stick`, then slips until it is as fast again."""
    rate = np.sqrt(stiffness)
    x, v = np.empty_like(times), np.empty_like(times)
    begin, position = 0.0, 0.0
    while begin <= times[-1]:
        since = times - begin
        x[since >= 0], v[since >= 0] = position + b * since[since >= 0], b
        begin += (stick / stiffness - position) / b
        since = times - begin
        slipping, angle = since >= 0, rate * since[since >= 0]
        reach, speed = (stick - slip) / stiffness, b / rate
        x[slipping] = slip / stiffness + reach * np.cos(angle) + speed * np.sin(angle)
        v[slipping] = rate * (speed * np.cos(angle) - reach * np.sin(angle))
        begin += 2 / rate * (np.pi - np.arctan2(reach, speed))
        position = (2 * slip - stick) / stiffness
    return {"x": x, "v": v}


def relay(times, k, band):
    """Both states decay to u = 2 or -2; what y began apart from that ends within 1/k."""
    x, y = np.empty_like(times), np.empty_like(times)
    begin, u, x_start, y_start = 0.0, 2.0, 0.0, 0.0
    while begin <= times[-1]:
        flows = lambda since: (
            u + (x_start - u) * np.exp(-since),
            u + (x_start - u) * k / (k - 1) * np.exp(-since) + (y_start - u - (x_start - u) * k / (k - 1)) * np.exp(-k * since),
        )
        running = times >= begin
        x[running], y[running] = flows(times[running] - begin)
        length = np.log((u - x_start) / (u - np.copysign(band, u)))
        x_start, y_start = flows(length)
        begin, u = begin + length, -u
    return {"x": x, "y": y}


def gate(times, k, w):
    """The decay to a sine of Prothero and Robinson (1974), the same for every k, and the ends of the gate that it has passed."""
    ends = np.arcsin([0.5 - w, 0.5 + w])
    crossings = [end + 2 * np.pi * turn for turn in range(2) for end in (*ends, *(np.pi - ends))]
    return {"x": np.sin(times), "passes": (times[:, None] >= crossings).sum(1)}


# name: solution, stop time, (parameters: start, min, max, causality), states, other outputs, event indicators
MODELS = {
    "dahlquist": (dahlquist, 2.0, {"k": (1, 0.5, 2), "x_start": (1, 1, 3), "u": (0, -1, 1)}, ["x"], [], 0),
    "van_der_pol": (van_der_pol, 10.0, {"mu": (1, 0.5, 2), "x0_start": (2, 1, 3)}, ["x0", "x1"], [], 0),
    "ball": (ball, 1.2, {"e": (0.7, 0.6, 0.8), "h_start": (1, 0.5, 2)}, ["h", "v"], [], 1),
    "stair": (stair, 2.0, {"period": (0.25, 0.1, 0.4), "limit": (1000, None, None)}, [], ["counter"], 0),
    "stick_slip": (
        stick_slip,
        5.0,
        {"stiffness": (20, 10, 30), "b": (0.5, 0.3, 0.7), "stick": (4, 3.5, 5), "slip": (2, 1, 3)},
        ["x", "v"],
        [],
        1,
    ),
    "relay": (relay, 5.0, {"k": (1e6, 1e5, 1e7), "band": (1, 0.5, 1.5)}, ["x", "y"], [], 1),
    "gate": (gate, 8.0, {"k": (1e6, 1e5, 1e7), "w": (0.35, 0.3, 0.4)}, ["x"], ["passes"], 1),
    "tank": (tank, 1.3, {"h_start": (1, 0.5, 2)}, ["h"], [], 1),
}


# models with directional derivatives
DIRECTIONAL = ("van_der_pol", "relay")


def description(name, version):
    """modelDescription.xml: variables in the order of the positions in exchange.c."""
    _, stop, parameters, states, outputs, indicators = MODELS[name]
    real, reference = ("Real", "ScalarVariable") if version == 2 else ("Float64", None)
    lines = []

    def variable(name, causality, variability, more="", numbers=""):
        number = len(lines)
        attributes = f'name="{name}" valueReference="{number}" causality="{causality}" variability="{variability}"{more}'
        if reference:
            lines.append(f"<{reference} {attributes}><{real}{numbers}/></{reference}>")
        else:
            lines.append(f"<{real} {attributes}{numbers}/>")
        return number

    exact = ' initial="exact"'
    variable("time", "independent", "continuous")
    for parameter, (start, least, most) in parameters.items():
        bounds = "" if least is None else f' min="{least}" max="{most}"'
        if parameter == "u":
            variable(parameter, "input", "continuous", numbers=f' start="{start}"{bounds}')
        else:
            variable(parameter, "parameter", "fixed", exact, f' start="{start}"{bounds}')
    first = len(lines)
    for state in states:
        variable(state, "output", "continuous", ' initial="calculated"')
    for index, state in enumerate(states):
        of = first + index + (1 if version == 2 else 0)
        variable(f"der({state})", "local", "continuous", ' initial="calculated"', f' derivative="{of}"')
    derivatives = list(range(first + len(states), first + 2 * len(states)))
    for output in outputs:
        variable(output, "output", "discrete", ' initial="calculated"')
    shown = [*range(first, first + len(states)), *range(len(lines) - len(outputs), len(lines))]
    experiment = f'<DefaultExperiment startTime="0" stopTime="{stop}" stepSize="0.02"/>'
    variables = "\n    ".join(lines)
    if version == 2:
        unknowns = lambda tag, of: f"<{tag}>" + "".join(f'<Unknown index="{i + 1}"/>' for i in of) + f"</{tag}>" if of else ""
        structure = unknowns("Outputs", shown) + unknowns("Derivatives", derivatives)
        structure += unknowns("InitialUnknowns", shown + derivatives)
        head = f'guid="exchange" numberOfEventIndicators="{indicators}"'
    else:
        unknowns = lambda tag, of: "".join(f'<{tag} valueReference="{i}"/>' for i in of)
        structure = unknowns("Output", shown) + unknowns("ContinuousStateDerivative", derivatives)
        structure += unknowns("InitialUnknown", shown + derivatives)
        structure += unknowns("EventIndicator", [first] * indicators)
        head = 'instantiationToken="exchange"'
    provides = f' providesDirectionalDerivative{"" if version == 2 else "s"}="true"' if name in DIRECTIONAL else ""
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="{version}.0" modelName="{name}" {head}>
  <ModelExchange modelIdentifier="{name}"{provides}/>
  {experiment}
  <ModelVariables>
    {variables}
  </ModelVariables>
  <ModelStructure>{structure}</ModelStructure>
</fmiModelDescription>
"""


def build(name, version, folder, *defines):
    """The FMU of a model for 64-bit Linux, by the compiler `cc`, with more definitions for the preprocessor."""
    options = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "-fvisibility=hidden"]
    platform = {2: "linux64", 3: "x86_64-linux"}[version]
    fmu = folder / f"{name}-fmi{version}.fmu"
    with tempfile.TemporaryDirectory() as temporary:
        library = Path(temporary) / f"{name}.so"
        defined = [f"-DMODEL={name.upper()}", f"-DFMI={version}", *defines]
        subprocess.run(["cc", *options, *defined, "-o", library, HERE / "exchange" / "exchange.c", "-lm"], check=True)
        with zipfile.ZipFile(fmu, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("modelDescription.xml", description(name, version))
            archive.write(library, f"binaries/{platform}/{library.name}")
    return fmu


# ---- The comparison -------------------------------------------------------------------------------------------------


def sample(metafmu, fmu, folder, tolerance=None, runs=30):
    """The runs that `metafmu new` and `metafmu sample` make of an FMU: parameters, times, outputs."""
    run = lambda *arguments: subprocess.run([metafmu, *arguments], cwd=folder, check=True, capture_output=True, text=True)
    study = folder / f"{fmu.stem}.toml"
    study.unlink(missing_ok=True)
    run("new", fmu.stem, "--fmu", fmu.name)
    text = study.read_text().replace("runs = 1000", f"runs = {runs}").replace("test_runs = 200", "test_runs = 5")
    if tolerance:
        text = text.replace("[source]", f"[source]\ntolerance = {tolerance}")
    study.write_text(text)
    run("sample", study.name, "--out", fmu.stem)
    name = fmu.stem.rpartition("-")[0]
    parameters = [parameter for parameter, (_, least, _) in MODELS[name][2].items() if least is not None]
    found = {}
    with open(folder / fmu.stem / "train.csv") as file:
        for row in csv.DictReader(file):
            found.setdefault(row["run"], []).append(row)
    for rows in found.values():
        values = {key: np.array([float(row[key]) for row in rows]) for key in rows[0] if key != "run"}
        yield {name: values[name][0] for name in parameters}, values["time"], values


def errors(metafmu, name, version, folder, tolerance=None):
    """Largest error of an output at any row of any run, metafmu's and FMPy's at the same tolerance (CVode's is relative)."""
    from fmpy import simulate_fmu

    fmu = build(name, version, folder)
    solution, _, _, states, outputs, _ = MODELS[name]
    ours = theirs = 0.0
    for index, (parameters, times, found) in enumerate(sample(metafmu, fmu, folder, tolerance)):
        exact = solution(times, **parameters)
        # at the very instant of a jump the last bit of a time decides
        near = np.zeros(len(times), bool)
        if name == "stair":
            near = np.abs(times / parameters["period"] - np.round(times / parameters["period"])) < 1e-9
        error = lambda values: max(np.abs(values[key] - exact[key])[~near].max() for key in [*states, *outputs])
        ours = max(ours, error(found))
        if index < 5:
            options = {"fmi_type": "ModelExchange", "output_interval": times[1], "relative_tolerance": tolerance or 1e-8}
            result = simulate_fmu(fmu, stop_time=times[-1], start_values=parameters, record_events=False, **options)
            theirs = max(theirs, error({key: result[key][: len(times)] for key in [*states, *outputs]}))
    return ours, theirs


def single(metafmu, name, version, folder, tolerance=None):
    """Error at the stop time of a run with one row, so that nothing but the tolerance and the events decide the steps."""
    solution, stop, parameters, states, outputs, _ = MODELS[name]
    arguments = ["--interface", "me", "--step-size", stop, *(["--tolerance", tolerance] if tolerance else [])]
    command = [metafmu, "simulate", folder / f"{name}-fmi{version}.fmu", *arguments]
    result = subprocess.run(list(map(str, command)), check=True, capture_output=True, text=True)
    last = list(csv.DictReader(result.stdout.splitlines()))[-1]
    starts = {parameter: start for parameter, (start, least, _) in parameters.items() if least is not None}
    exact = solution(np.array([0.0, stop]), **starts)
    return max(abs(float(last[key]) - exact[key][-1]) for key in [*states, *outputs])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("metafmu", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--tolerance", type=float)
    arguments = parser.parse_args()
    folder = arguments.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    print("| model | FMI | largest error | FMPy's | with one row |")
    print("|---|---|---|---|---|")
    for name in MODELS:
        for version in (2, 3):
            command = arguments.metafmu.resolve(), name, version, folder, arguments.tolerance
            ours, theirs = errors(*command)
            print(f"| {name} | {version}.0 | {ours:.1e} | {theirs:.1e} | {single(*command):.1e} |", flush=True)


if __name__ == "__main__":
    main()
