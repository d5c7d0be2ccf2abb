"""structure = "compliant": the force of a flexible part, which creates no energy.

The part is a bushing of two coordinates whose potential and damping are known in closed form. Neither is a polynomial, so the fit has an error.
"""

import ctypes
import json
import os
import sys
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, compiled_from_sources, fmu_of, metafmu
from fmpy import simulate_fmu
from fmpy.ssp.simulation import simulate_ssp
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp

sys.path.insert(0, str(ROOT / "examples" / "embedding"))
import master

# a source in the protocol of docs/command-sources.md, for which Python needs nothing
BUSHING = '''
import json, math, sys

def law(s, y, a, v, w):
    """Force and moment of V = s (4 (cosh(10 y) - 1) + 30 a^2 (1 + 50 y^2) + 40 y a), and D = s [[8 + 600 y^2, 0.5], [0.5, 0.4 exp(4 a)]]."""
    return (
        s * (40 * math.sinh(10 * y) + 3000 * y * a * a + 40 * a + (8 + 600 * y * y) * v + 0.5 * w),
        s * (60 * a * (1 + 50 * y * y) + 40 * y + 0.5 * v + 0.4 * math.exp(4 * a) * w),
    )

PATHS = {f"{of}{key}": limits for of in "ya" for key, limits in
         {"0": [-0.03, 0.03], "1": [0.02, 0.07], "f": [0.3, 3], "p": [-3.15, 3.15]}.items()}
PARAMETERS = {"stiffness": [0.8, 1.2], **PATHS}

def path(p, of, t):
    at = 2 * math.pi * p[of + "f"] * t + p[of + "p"]
    return p[of + "0"] + p[of + "1"] * math.sin(at), 2 * math.pi * p[of + "f"] * p[of + "1"] * math.cos(at)

if __name__ == "__main__":
    for line in sys.stdin:
        request = json.loads(line)
        if request["request"] == "describe":
            reply = {"protocol": 1, "outputs": {name: {} for name in ("y", "a", "v", "w", "force", "moment")}, "stop": 1, "step": 0.05,
                     "parameters": {name: {"min": low, "max": high} for name, (low, high) in PARAMETERS.items()}}
        else:
            rows, p = [], request["parameters"]
            for t in request["times"]:
                (y, v), (a, w) = path(p, "y", t), path(p, "a", t)
                rows.append([y, a, v, w, *law(p["stiffness"], y, a, v, w)])
            names = ("y", "a", "v", "w", "force", "moment")
            reply = {"outputs": {name: [row[i] for row in rows] for i, name in enumerate(names)}}
        print(json.dumps({"id": request["id"], **reply}), flush=True)
'''
MODEL = {}
exec(BUSHING.replace("__main__", "no"), MODEL)

STUDY = f"""name = "bushing"
structure = "compliant"
[source]
command = [{json.dumps(sys.executable)}, "bushing.py"]
[compliant]
positions = ["y", "a"]
velocities = ["v", "w"]
forces = ["force", "moment"]
parameters = ["stiffness"]
[time]
stop = 1.0
step = 0.05
[parameters]
{"".join(f"{name} = {{ min = {low}, max = {high} }}" + chr(10) for name, (low, high) in MODEL["PARAMETERS"].items())}
[outputs]
y = {{}}
a = {{}}
v = {{}}
w = {{}}
force = {{}}
moment = {{}}
[sampling]
method = "latin-hypercube"
runs = 150
test_runs = 50
[accept]
largest_error = 0.005
[export]
fmi = "both"
"""

# a carriage on a rail, and on it a rotor: their motion is that of two masses without coupling
MASS, INERTIA = 2.0, 0.01
CARRIAGE = f"""description = "Carriage and rotor"
[inputs]
force = {{ min = -200, max = 200, unit = "N" }}
moment = {{ min = -30, max = 30, unit = "N.m" }}
[bodies.carriage]
mass = {MASS / 2}
[bodies.rotor]
mass = {MASS / 2}
inertia = {INERTIA}
[joints.rail]
type = "prismatic"
between = ["ground", "carriage"]
axis = [0, 1]
[joints.pivot]
type = "revolute"
between = ["carriage", "rotor"]
[actuators.push]
coordinate = "rail.position"
effort = "-force"
[actuators.turn]
coordinate = "pivot.angle"
effort = "-moment"
[initial]
rail.position = 0.05
pivot.angle = 0.03
[outputs]
y = {{ measure = "rail.position" }}
a = {{ measure = "pivot.angle" }}
v = {{ measure = "rail.velocity" }}
w = {{ measure = "pivot.angular_velocity" }}
"""
CARRIAGE_STUDY = """name = "carriage"
structure = "dynamics"
[source]
mechanism = "carriage.toml"
[time]
stop = 1.0
step = 0.01
[states]
"rail.position" = { min = -1, max = 1 }
"pivot.angle" = { min = -1, max = 1 }
[outputs]
y = {}
a = {}
v = {}
w = {}
[sampling]
test_runs = 2
"""
POSITIONS, VELOCITIES, FORCES = ("y", "a"), ("v", "w"), ("force", "moment")


@dataclass
class Element:
    folder: Path
    fmu: Path
    metrics: dict


@pytest.fixture(scope="module")
def bushing(tmp_path_factory):
    """The bushing, built."""
    folder = tmp_path_factory.mktemp("bushing")
    (folder / "bushing.py").write_text(BUSHING)
    (folder / "bushing.toml").write_text(STUDY)
    metafmu("build", folder / "bushing.toml", "--out", folder / "out")
    return Element(folder / "out", folder / "out" / "bushing.fmu", json.loads((folder / "out" / "metrics.json").read_text()))


@pytest.fixture(scope="module")
def carriage(tmp_path_factory):
    """The carriage's FMU."""
    folder = tmp_path_factory.mktemp("carriage")
    (folder / "carriage.toml").write_text(CARRIAGE)
    (folder / "study.toml").write_text(CARRIAGE_STUDY)
    metafmu("build", folder / "study.toml", "--out", folder / "out")
    return folder / "out" / "carriage.fmu"


class Instance:
    """The element as a function of positions and velocities, with arrays that are allocated once."""

    def __init__(self, fmu, **parameters):
        self.component = master.Component(fmu, "element")
        for name, value in parameters.items():
            self.component.set(name, value)
        self.component.initialize()
        self.slave, references = self.component.slave, self.component.references
        of = lambda names: (ctypes.c_uint * len(names))(*(references[name] for name in names))
        self.inputs, self.outputs = of(POSITIONS + VELOCITIES), of(FORCES)
        self.values, self.found = (ctypes.c_double * 4)(), (ctypes.c_double * 2)()
        self.set, self.get = self.slave.fmi2SetReal, self.slave.fmi2GetReal
        self.handle = self.slave.component

    def __call__(self, y, a, v=0.0, w=0.0):
        values, found = self.values, self.found
        values[0], values[1], values[2], values[3] = y, a, v, w
        assert not self.set(self.handle, self.inputs, 4, values) and not self.get(self.handle, self.outputs, 2, found)
        return found[0], found[1]

    def energy(self, y, a):
        """The potential, by an integral along a line from the origin, which Gauss's formula gives exactly for a polynomial of this degree."""
        nodes, weights = np.polynomial.legendre.leggauss(20)
        powers = (np.dot(self(0.5 * (1 + s) * y, 0.5 * (1 + s) * a), (y, a)) for s in nodes)
        return 0.5 * sum(weight * power for weight, power in zip(weights, powers))


@pytest.fixture
def element(bushing):
    instance = Instance(bushing.fmu)
    yield instance
    instance.component.close()


def points(count, seed=1):
    """Random positions and velocities, also of twice the range of the runs."""
    random = np.random.default_rng(seed)
    return random.uniform(-1, 1, (count, 4)) * [0.2, 0.2, 4, 4]


def test_errors_on_unseen_runs_are_below_half_a_percent_of_the_range(bushing):
    outputs = bushing.metrics["outputs"]
    assert list(outputs) == ["force", "moment"]
    assert all(of["relative_max_error"] < 0.005 for of in outputs.values()), outputs
    assert bushing.metrics["test_runs"] == 50 * 21 and bushing.metrics["rows"] == "of-runs"


def test_forces_are_those_of_the_law_at_points_of_no_run(bushing, element):
    """Against the closed form, where the FMU says that it is inside its domain."""
    component, errors, inside = element.component, [], 0
    for y, a, v, w in points(2000) * 0.5:
        found = element(y, a, v, w)
        if component.slave.getBoolean([component.references["in_domain"]])[0]:
            inside += 1
            errors.append(np.abs(np.subtract(found, MODEL["law"](1.0, y, a, v, w))))
    ranges = [of["max_abs_error"] / of["relative_max_error"] for of in bushing.metrics["outputs"].values()]
    assert inside > 500 and np.all(np.max(errors, axis=0) < 0.01 * np.array(ranges)), (inside, np.max(errors, axis=0), ranges)


def test_the_fmu_reports_positions_and_velocities_outside_of_its_domain(element):
    component = element.component
    inside = lambda *at: element(*at) and component.slave.getBoolean([component.references["in_domain"]])[0]
    assert inside(0, 0, 0, 0) and not inside(0.5, 0, 0, 0) and not inside(0, 0, 9, 0)


def test_damping_takes_power_at_any_point_inside_and_outside_of_the_domain(element):
    """By construction: the power of F(q, v) - F(q, 0) is a sum of squares. Rounding of the difference of two forces remains."""
    for y, a, v, w in points(20_000):
        moving, still = element(y, a, v, w), element(y, a)
        power = np.dot(np.subtract(moving, still), (v, w))
        assert power > -1e-13 * np.abs(still).max() * np.abs((v, w)).max(), (y, a, v, w)


def test_the_elastic_force_is_a_gradient_and_its_derivatives_those_of_differences(bushing, element):
    """d force / d a is d moment / d y at v = 0, and directional derivatives are those of central differences."""
    slave, references = element.slave, element.component.references
    h = 1e-5
    for y, a, v, w in points(200):
        for velocities in ((0.0, 0.0), (v, w)):
            at = np.array([y, a, *velocities])
            exact, found = [], []
            for column, name in enumerate(POSITIONS + VELOCITIES):
                step = h * (np.arange(4) == column)
                found.append(np.subtract(element(*at + step), element(*at - step)) / (2 * h))
            element(*at)
            for name in POSITIONS + VELOCITIES:
                derivatives = slave.getDirectionalDerivative([references[o] for o in FORCES], [references[name]], [1.0])
                exact.append(derivatives)
            exact, found = np.array(exact), np.array(found)
            assert np.allclose(exact, found, rtol=1e-6, atol=1e-6 * np.abs(found).max())
            if velocities == (0.0, 0.0):
                assert abs(exact[0, 1] - exact[1, 0]) < 1e-12 * np.abs(exact).max()
            # D is symmetric
            assert abs(exact[2, 1] - exact[3, 0]) < 1e-12 * np.abs(exact).max()


def test_a_closed_cycle_gives_no_work(element):
    """The trapezoidal rule is exact for a periodic integrand of few harmonics: a polynomial along a path of three."""
    random = np.random.default_rng(2)
    angles = 2 * np.pi * np.arange(512) / 512
    for _ in range(40):
        sines, cosines = random.normal(size=(2, 3, 2)) * 0.02
        orders = np.arange(1, 4)
        path = np.sin(np.outer(angles, orders)) @ sines + np.cos(np.outer(angles, orders)) @ cosines
        rates = np.cos(np.outer(angles, orders)) @ (orders[:, None] * sines) - np.sin(np.outer(angles, orders)) @ (orders[:, None] * cosines)
        slow = np.array([np.dot(element(*q), v) for q, v in zip(path, rates)])
        assert abs(slow.mean()) < 1e-13 * np.abs(slow).max()
        moving = np.array([np.dot(element(*q, *v), v) for q, v in zip(path, rates)])
        assert moving.mean() > 1e-3 * np.abs(slow).mean()


def energy(element, state):
    y, a, v, w = state
    return 0.5 * MASS * v * v + 0.5 * INERTIA * w * w + element.energy(y, a)


def test_no_energy_is_created_in_a_million_steps(element):
    """Masses on the elastic force, by the leapfrog method, whose energy oscillates but does not drift; then damped."""
    h, steps, parts = 2e-4, 1_000_000, 100
    y, a, v, w = 0.06, -0.05, 0.0, 0.0
    force, moment = element(y, a)
    energies = []
    for part in range(parts + 1):
        energies.append(energy(element, (y, a, v, w)))
        for _ in range(steps // parts if part < parts else 0):
            v, w = v - 0.5 * h / MASS * force, w - 0.5 * h / INERTIA * moment
            y, a = y + h * v, a + h * w
            force, moment = element(y, a)
            v, w = v - 0.5 * h / MASS * force, w - 0.5 * h / INERTIA * moment
    changes = np.array(energies) / energies[0] - 1
    first, last = np.abs(changes[:11]).max(), np.abs(changes[-10:]).max()
    assert np.abs(changes).max() < 1e-4 and last < 2 * first, (first, last)
    slope = np.polyfit(np.arange(parts + 1), changes, 1)[0] * parts
    assert abs(slope) < first, (slope, first)

    decay = []
    for _ in range(60):
        decay.append(energy(element, (y, a, v, w)))
        for _ in range(50):
            force, moment = element(y, a, v, w)
            v, w = v - h / MASS * force, w - h / INERTIA * moment
            y, a = y + h * v, a + h * w
    assert decay[-1] < 0.5 * decay[0] and np.all(np.diff(decay) < 1e-3 * decay[0]), decay


def reference(start, times):
    """Masses on the bushing's law, by scipy."""

    def rates(_, state):
        y, a, v, w = state
        force, moment = MODEL["law"](1.0, y, a, v, w)
        return [v, w, -force / MASS, -moment / INERTIA]

    return solve_ivp(rates, (0, times[-1]), start, "DOP853", times, rtol=1e-10, atol=1e-12).y.T


# [initial] of the carriage, which is at rest
START = [0.05, 0.03, 0.0, 0.0]


def coupled(bushing, carriage, step, stop):
    """A master loop: both step over the same interval, with what the other one gave at its beginning."""
    spring, body = master.Component(bushing.fmu, "spring"), master.Component(carriage, "body")
    rows = []
    try:
        for component in (spring, body):
            component.initialize()
        for index in range(round(stop / step) + 1):
            motion = body.get("y", "a", "v", "w")
            rows.append(motion)
            for name, value in zip(POSITIONS + VELOCITIES, motion):
                spring.set(name, value)
            for name, value in zip(FORCES, spring.get(*FORCES)):
                body.set(name, value)
            spring.slave.doStep(index * step, step)
            body.slave.doStep(index * step, step)
    finally:
        spring.close()
        body.close()
    return np.array(rows)


def test_coupled_with_a_rigid_body_it_moves_as_the_law(bushing, carriage):
    """Against scipy with the law. Forces that are held for a step make an error of the first order in the step, and the element the rest."""
    stop, worst = 0.5, []
    for step in (4e-4, 2e-4):
        found = coupled(bushing, carriage, step, stop)
        exact = reference(START, step * np.arange(len(found)))
        worst.append(np.max(np.abs(found - exact) / np.ptp(exact, axis=0)))
    assert worst[0] < 0.02 and 2 * worst[1] - worst[0] < 0.005, worst


SYSTEM = """<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription"
  xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon" version="1.0" name="carriage-on-bushing">
  <ssd:System name="system">
    <ssd:Connectors>{outer}</ssd:Connectors>
    <ssd:Elements>{components}</ssd:Elements>
    <ssd:Connections>{connections}</ssd:Connections>
  </ssd:System>
  <ssd:DefaultExperiment startTime="0" stopTime="0.5"/>
</ssd:SystemStructureDescription>
"""


def ssp(path, spring, body):
    connector = lambda name, kind: f'<ssd:Connector name="{name}" kind="{kind}"><ssc:Real/></ssd:Connector>'
    motion = POSITIONS + VELOCITIES

    def component(name, inputs, outputs):
        connectors = "".join([connector(of, "input") for of in inputs] + [connector(of, "output") for of in outputs])
        kind = "application/x-fmu-sharedlibrary"
        return (
            f'<ssd:Component name="{name}" type="{kind}" source="resources/{name}.fmu">'
            f"<ssd:Connectors>{connectors}</ssd:Connectors></ssd:Component>"
        )

    connection = '<ssd:Connection startElement="{}" startConnector="{}" endElement="{}" endConnector="{}"/>'.format
    connections = [connection("body", name, "spring", name) for name in motion]
    connections += [connection("spring", name, "body", name) for name in FORCES]
    connections += [f'<ssd:Connection startElement="body" startConnector="{name}" endConnector="{name}"/>' for name in motion]
    structure = SYSTEM.format(
        outer="".join(connector(name, "output") for name in motion),
        components=component("spring", motion, FORCES) + component("body", FORCES, motion),
        connections="".join(connections),
    )
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("SystemStructure.ssd", structure)
        archive.write(spring, "resources/spring.fmu")
        archive.write(body, "resources/body.fmu")


def test_as_a_component_of_a_system_it_moves_as_the_law(bushing, carriage, tmp_path):
    """The SSP in fmpy, beside scipy with the law."""
    ssp(tmp_path / "system.ssp", bushing.fmu, carriage)
    result = simulate_ssp(str(tmp_path / "system.ssp"), stop_time=0.5, step_size=2e-4)
    found = np.array([result[name] for name in POSITIONS + VELOCITIES]).T
    exact = reference(START, np.asarray(result["time"]))
    assert np.ptp(exact[:, 0]) > 0.01
    assert np.max(np.abs(found - exact) / np.ptp(exact, axis=0)) < 0.02


def test_its_fmus_are_valid_and_the_c_sources_give_the_same_forces(bushing, tmp_path, monkeypatch):
    for version in (2, 3):
        fmu = fmu_of(bushing.folder, "bushing", version)
        assert validate_fmu(str(fmu)) == []
        assert metafmu("validate", fmu).stdout.splitlines()[-1] == "no problems found"
    metafmu("export", bushing.folder.parent / "bushing.toml", "--out", bushing.folder, "--sources", "--fmi", "2")
    unpacked = compiled_from_sources(bushing.fmu, monkeypatch)
    signals = np.zeros(101, [("time", float), *((name, float) for name in POSITIONS + VELOCITIES)])
    signals["time"] = np.linspace(0, 1, 101)
    for name, row in zip(POSITIONS + VELOCITIES, points(101).T * 0.5):
        signals[name] = row
    simulate = lambda of: simulate_fmu(str(of), input=signals, stop_time=1.0, output_interval=0.01, output=FORCES)
    library, compiled = simulate(bushing.fmu), simulate(unpacked)
    for name in FORCES:
        assert np.allclose(library[name], compiled[name], rtol=1e-12, atol=1e-12 * np.abs(library[name]).max())


@pytest.mark.parametrize(
    "old, new, problem",
    [
        ('forces = ["force", "moment"]', 'forces = ["force"]', "compliant.forces: 1 forces, expected one for each of 2 positions"),
        ('velocities = ["v", "w"]', 'velocities = ["v"]', "compliant.velocities: 1 velocities, expected none or one for each of 2 positions"),
        ('positions = ["y", "a"]', 'positions = ["y", "b"]', "compliant.positions: `b`, expected one of the outputs"),
        ('parameters = ["stiffness"]', 'parameters = ["mass"]', "compliant.parameters: `mass`, expected one of the parameters"),
        ("[time]", "potential = 40\n[time]", "compliant.potential: 40, expected a degree from 1 to 20"),
        ("[accept]", "[bounds]\n[accept]", "bounds: belongs to other structures: a compliant element has no error bounds"),
        ("[accept]", "[network]\nhidden = [8]\n[accept]", "network: belongs to networks: a compliant element is a sum of polynomials"),
        ('structure = "compliant"', 'structure = "response"', 'compliant: belongs to the structure "compliant"'),
    ],
)
def test_mistakes_in_the_section_are_named(old, new, problem, tmp_path):
    (tmp_path / "bushing.py").write_text(BUSHING)
    assert old in STUDY
    (tmp_path / "study.toml").write_text(STUDY.replace(old, new))
    result = metafmu("sample", tmp_path / "study.toml", "--out", tmp_path / "out", check=False)
    assert result.returncode != 0 and problem in result.stderr, result.stderr


def test_without_velocities_the_element_is_elastic(bushing, tmp_path):
    """The training runs as a table of recorded runs, with the degree given."""
    study = STUDY.replace('velocities = ["v", "w"]\n', "potential = 6\n").replace("v = {}\nw = {}\n", "")
    source = study[study.index("command") : study.index("\n[compliant]")]
    study = study.replace(source, 'table = "runs.csv"').replace('method = "latin-hypercube"\nruns = 150\n', "")
    study = study.replace("largest_error = 0.005", "r2 = 0.5").replace("test_runs = 50", "test_runs = 30")
    rows = (bushing.folder / "train.csv").read_text().splitlines()
    names = rows[0].split(",")
    kept = [names.index(name) for name in names if name not in VELOCITIES]
    (tmp_path / "runs.csv").write_text("\n".join(",".join(row.split(",")[at] for at in kept) for row in rows) + "\n")
    (tmp_path / "study.toml").write_text(study)
    metafmu("build", tmp_path / "study.toml", "--out", tmp_path / "out")
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["compliant"]["exported"] == "potential 6"


@pytest.mark.thorough
def test_the_leaf_spring_of_exudyn_is_as_good_as_the_documentation_says(tmp_path, monkeypatch):
    pytest.importorskip("exudyn")
    (tmp_path / "package").mkdir()
    (tmp_path / "package" / "metafmu.py").write_text((ROOT / "python/python/metafmu/_source.py").read_text())
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "package"))
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    metafmu("build", ROOT / "examples/compliant/leaf-spring.toml", "--out", tmp_path / "out")
    outputs = json.loads((tmp_path / "out" / "metrics.json").read_text())["outputs"]
    assert all(of["relative_max_error"] < 0.001 for of in outputs.values()), outputs
