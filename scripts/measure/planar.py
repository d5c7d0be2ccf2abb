"""Mechanism files in Cartesian coordinates by scipy: separate equations, to compare metafmu's runs with.

Unknowns are position and angle of every body, and the actuator states. Each evaluation solves `[M C_q^T; C_q 0] [a; -f] = [F; c]` with the
acceleration side stabilized (Baumgarte 1972). Gradients and second derivatives come from differentiated numbers, not from formulas for each joint.
"""

import math
import re
import tomllib

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

# rate in 1/s at which violated constraints decay: a tenth of it changes no digit that is compared
STABILIZATION = 20.0
NAME = re.compile(r"(?<![\w.])[A-Za-z_][\w.]*")
RATES = {"angular_velocity": "angle", "velocity": ("position", "length"), "vx": "x", "vy": "y"}
ACCELERATIONS = {"angular_acceleration": "angle", "acceleration": "position", "ax": "x", "ay": "y"}


class Moving:
    """A value with its gradient, its rate, and the part of its second derivative that accelerations do not enter."""

    __slots__ = ("curvature", "gradient", "rate", "value")

    def __init__(self, value, gradient=0.0, rate=0.0, curvature=0.0):
        self.value, self.gradient, self.rate, self.curvature = value, gradient, rate, curvature

    def through(self, value, first, second):
        """A function of this value, by its derivatives."""
        return Moving(value, first * self.gradient, first * self.rate, first * self.curvature + second * self.rate**2)

    def __add__(self, other):
        if not isinstance(other, Moving):
            return Moving(self.value + other, self.gradient, self.rate, self.curvature)
        return Moving(self.value + other.value, self.gradient + other.gradient, self.rate + other.rate, self.curvature + other.curvature)

    def __neg__(self):
        return Moving(-self.value, -self.gradient, -self.rate, -self.curvature)

    def __pos__(self):
        return self

    def __sub__(self, other):
        return self + -other

    def __rsub__(self, other):
        return -self + other

    def __mul__(self, other):
        if not isinstance(other, Moving):
            return Moving(self.value * other, self.gradient * other, self.rate * other, self.curvature * other)
        a, b = self.value, other.value
        curvature = self.curvature * b + 2.0 * self.rate * other.rate + a * other.curvature
        return Moving(a * b, self.gradient * b + a * other.gradient, self.rate * b + a * other.rate, curvature)

    def __truediv__(self, other):
        return self * (other**-1 if isinstance(other, Moving) else 1.0 / other)

    def __rtruediv__(self, other):
        return self**-1 * other

    def __pow__(self, n):
        if isinstance(n, Moving):
            return exp(log(self) * n)
        a = self.value
        return self.through(a**n, n * a ** (n - 1) if n else 0.0, n * (n - 1) * a ** (n - 2) if n not in (0, 1) else 0.0)

    def __rpow__(self, base):
        return exp(self * math.log(base))

    __radd__, __rmul__ = __add__, __mul__


def lifted(function, derivatives):
    """A function of one number, also for `Moving`; `derivatives` gives the first and the second."""

    def call(x):
        return x.through(function(x.value), *derivatives(x.value)) if isinstance(x, Moving) else function(x)

    return call


def sign(x):
    return (x > 0) - (x < 0)


sin = lifted(math.sin, lambda x: (math.cos(x), -math.sin(x)))
cos = lifted(math.cos, lambda x: (-math.sin(x), -math.cos(x)))
exp = lifted(math.exp, lambda x: (math.exp(x), math.exp(x)))
log = lifted(math.log, lambda x: (1 / x, -1 / x**2))
root = lifted(math.sqrt, lambda x: (0.5 / math.sqrt(x), -0.25 * x**-1.5))


def plain(x):
    return x.value if isinstance(x, Moving) else x


def smooth(x):
    at = min(max(plain(x), 0.0), 1.0)
    is_inside = 0.0 < plain(x) < 1.0
    return x**2 * (3.0 - 2.0 * x) if is_inside else at


def step(x, x0, y0, x1, y1):
    return y0 + (y1 - y0) * smooth((x - x0) / (x1 - x0))


FUNCTIONS = {
    "sin": sin, "cos": cos, "exp": exp, "ln": log, "sqrt": root, "smooth": smooth, "step": step,
    "tan": lifted(math.tan, lambda x: (1 + math.tan(x) ** 2, 2 * math.tan(x) * (1 + math.tan(x) ** 2))),
    "tanh": lifted(math.tanh, lambda x: (1 - math.tanh(x) ** 2, -2 * math.tanh(x) * (1 - math.tanh(x) ** 2))),
    "atan": lifted(math.atan, lambda x: (1 / (1 + x * x), -2 * x / (1 + x * x) ** 2)),
    "asin": lifted(math.asin, lambda x: ((1 - x * x) ** -0.5, x * (1 - x * x) ** -1.5)),
    "acos": lifted(math.acos, lambda x: (-((1 - x * x) ** -0.5), -x * (1 - x * x) ** -1.5)),
    "abs": lifted(abs, lambda x: (sign(x), 0.0)), "sign": lifted(sign, lambda x: (0.0, 0.0)),
    "floor": lifted(math.floor, lambda x: (0.0, 0.0)), "atan2": lambda y, x: math.atan2(y, x),
    "min": lambda a, b: a if plain(a) <= plain(b) else b, "max": lambda a, b: a if plain(a) >= plain(b) else b,
    "mod": lambda a, b: a - b * math.floor(plain(a) / plain(b)),
}  # fmt: skip


def table(options):
    """Function of a `[tables.NAME]`."""
    x, values = np.array(options["x"], float), np.array(options["values"], float)
    is_cubic, beyond = options.get("interpolation") == "cubic", options.get("extrapolation", "hold")

    def curve(x, values):
        if is_cubic and len(x) > 2:
            spline = CubicSpline(x, values, bc_type="periodic" if beyond == "periodic" else "not-a-knot")
            return lambda at, order: float(spline(at, order))

        def line(at, order):
            k = min(max(int(np.searchsorted(x, at, "right")) - 1, 0), len(x) - 2)
            slope = (values[k + 1] - values[k]) / (x[k + 1] - x[k])
            return float([values[k] + slope * (at - x[k]), slope, 0.0][order])

        return line

    def placed(knots, at):
        low, high = knots[0], knots[-1]
        return low + (at - low) % (high - low) if beyond == "periodic" else min(max(at, low), high)

    def evaluated(of, knots, at):
        inside = placed(knots, at)
        if beyond == "periodic" or inside == at:
            return [of(inside, order) for order in range(3)]
        slope = of(inside, 1) if beyond == "linear" else 0.0
        return [of(inside, 0) + slope * (at - inside), slope, 0.0]

    if "y" not in options:
        of = curve(x, values)
        return lambda a: a.through(*evaluated(of, x, a.value)) if isinstance(a, Moving) else evaluated(of, x, a)[0]
    y = np.array(options["y"], float)

    def surface(a, b):
        row = np.array([evaluated(curve(x, column), x, a)[0] for column in values.T])
        return evaluated(curve(y, row), y, b)[0]

    return surface


class Planar:
    """A mechanism file with numbers in it."""

    def __init__(self, text, parameters=None, inputs=None):
        self.file = tomllib.loads(text)
        part = lambda name: self.file.get(name, {})
        self.constants = {name: options["default"] for name, options in part("parameters").items()} | (parameters or {})
        self.inputs = {name: options.get("start", 0.0) for name, options in part("inputs").items()} | (inputs or {})
        self.functions = FUNCTIONS | {name: table(options) for name, options in part("tables").items()}
        self.compiled, self.numbers = {}, {}
        self.bodies = list(self.file["bodies"])
        self.count = 3 * len(self.bodies)
        mass = [[self.number(body.get(key, 0)) for key in ("mass", "mass", "inertia")] for body in part("bodies").values()]
        self.mass = np.array(mass).ravel()
        self.gravity = [self.number(component) for component in self.file.get("gravity", [0, 0])]
        self.locals = {"ground": (None, 0.0, 0.0)}
        for owner, options in [("ground", self.file.get("ground", {})), *part("bodies").items()]:
            index = None if owner == "ground" else self.bodies.index(owner)
            self.locals[owner] = (index, 0.0, 0.0)
            for name, (x, y) in options.get("points", {}).items():
                self.locals[f"{owner}.{name}"] = (index, self.number(x), self.number(y))
        self.units = np.eye(self.count)

    def number(self, expression):
        """Value of an expression of the parameters, which stays the same."""
        if isinstance(expression, (int, float)):
            return expression
        if expression not in self.numbers:
            self.numbers[expression] = float(self.evaluate(expression, None))
        return self.numbers[expression]

    def evaluate(self, expression, state, is_moving=False):
        """Value of an expression in a state, or its `Moving` number if `is_moving` is true."""
        if isinstance(expression, (int, float)):
            return expression
        if expression not in self.compiled:
            names = set()

            def replaced(match):
                name = match[0]
                if expression[match.end() :].lstrip().startswith("("):
                    return f"F[{name!r}]"
                names.add(name)
                return f"v[{name!r}]"

            code = NAME.sub(replaced, expression)
            self.compiled[expression] = compile(code.replace("^", "**"), expression, "eval"), names
        code, names = self.compiled[expression]
        values = {name: self.value(name, state, is_moving) for name in names}
        return eval(code, {"F": self.functions, "v": values})

    def value(self, name, state, is_moving):
        if name == "pi":
            return math.pi
        for known in (self.constants, self.inputs):
            if name in known:
                return known[name]
        if name in self.file.get("variables", {}):
            return self.evaluate(self.file["variables"][name], state, is_moving)
        if name == "time":
            return Moving(state.t, 0.0, 1.0, 0.0) if is_moving else state.t
        if name in self.file.get("states", {}):
            return state.z[list(self.file["states"]).index(name)]
        owner, what = name.rsplit(".", 1)
        if what in RATES:
            return state.position_of_rate(owner, what).rate
        found = state.coordinate(name)
        return found if is_moving else found.value


class State:
    """A mechanism at a time, with what its parts need of it."""

    def __init__(self, planar, t, y):
        n = planar.count
        self.planar, self.t, self.q, self.v, self.z = planar, t, y[:n], y[n : 2 * n], y[2 * n :]
        units = planar.units
        self.frames = []
        for k in range(0, n, 3):
            x, y, angle = (Moving(float(self.q[k + i]), units[k + i], float(self.v[k + i])) for i in range(3))
            self.frames.append((x, y, angle, cos(angle), sin(angle)))
        self.known = {}

    def turned(self, index, x, y):
        if index is None:
            return x, y
        _, _, _, c, s = self.frames[index]
        return c * x - s * y, s * x + c * y

    def point(self, name):
        if name not in self.known:
            index, x, y = self.planar.locals[name]
            if index is None:
                self.known[name] = x, y
            else:
                dx, dy = self.turned(index, x, y)
                self.known[name] = self.frames[index][0] + dx, self.frames[index][1] + dy
        return self.known[name]

    def angle_between(self, one, other):
        angles = [0.0 if (index := self.planar.locals[name][0]) is None else self.frames[index][2] for name in (one, other)]
        return angles[1] - angles[0]

    def difference(self, ends):
        (x0, y0), (x1, y1) = map(self.point, ends)
        return x1 - x0, y1 - y0

    def along(self, ends, axis):
        """Component of the difference of two points along an axis of the first one's body."""
        dx, dy = self.difference(ends)
        ax, ay = self.turned(self.planar.locals[ends[0]][0], *axis)
        return dx * ax + dy * ay

    def axis(self, joint):
        x, y = map(self.planar.number, joint["axis"])
        return x / math.hypot(x, y), y / math.hypot(x, y)

    def coordinate(self, name):
        """The coordinate of a name such as `pivot.angle`."""
        if name not in self.known:
            self.known[name] = self.found(name)
        return self.known[name]

    def found(self, name):
        file = self.planar.file
        owner, what = name.rsplit(".", 1)
        if owner in file.get("joints", {}):
            joint = file["joints"][owner]
            return self.angle_between(*joint["between"]) if what == "angle" else self.along(joint["between"], self.axis(joint))
        if owner in file.get("springs", {}):
            dx, dy = self.difference(file["springs"][owner]["between"])
            return root(dx * dx + dy * dy)
        if owner in file.get("bushings", {}):
            return self.bushing(file["bushings"][owner])[("x", "y", "angle").index(what)]
        if what == "angle":
            return self.angle_between("ground", owner)
        return self.point(owner)[("x", "y").index(what)]

    def position_of_rate(self, owner, what):
        of = RATES[what]
        if isinstance(of, tuple):
            of = of[1] if owner in self.planar.file.get("springs", {}) else of[0]
        return self.coordinate(f"{owner}.{of}")

    def bushing(self, bushing):
        ends = bushing["between"]
        return self.along(ends, (1.0, 0.0)), self.along(ends, (0.0, 1.0)), self.angle_between(*ends)

    def constraints(self):
        """Owner and what is zero, of joints, couplings and motions."""
        planar = self.planar
        file = planar.file
        rows = []
        for name, joint in file.get("joints", {}).items():
            ends, kind = joint["between"], joint["type"]
            angle = planar.number(joint.get("angle", 0.0))
            if kind == "prismatic":
                x, y = self.axis(joint)
                rows += [(name, self.along(ends, (-y, x))), (name, self.angle_between(*ends) - angle)]
            else:
                dx, dy = self.difference(ends)
                rows += [(name, dx), (name, dy)]
                if kind == "fixed":
                    rows.append((name, self.angle_between(*ends) - angle))
        for name, coupling in file.get("couplings", {}).items():
            rows.append((name, self.coordinate(coupling["coordinate"]) - planar.evaluate(coupling["follows"], self, True)))
        for name, driver in file.get("drivers", {}).items():
            if "motion" in driver:
                rows.append((name, self.coordinate(driver["coordinate"]) - planar.evaluate(driver["motion"], self, True)))
        return rows

    def spring_force(self, spring, stretch):
        number = self.planar.number
        force = -number(spring.get("stiffness", 0)) * (stretch.value - number(spring.get("rest", 0))) - number(spring.get("damping", 0)) * stretch.rate
        return force + (self.planar.evaluate(spring["force"], self) if "force" in spring else 0.0)

    def stretch(self, name):
        spring = self.planar.file["springs"][name]
        return self.coordinate(f"{name}.length" if "between" in spring else spring["coordinate"])

    def bushing_forces(self, bushing):
        number = self.planar.number
        rests = 0.0, 0.0, number(bushing.get("angle", 0.0))
        damping = bushing.get("damping", [0, 0, 0])
        stretches = self.bushing(bushing)
        return [-number(k) * (s.value - rest) - number(c) * s.rate for k, c, s, rest in zip(bushing["stiffness"], damping, stretches, rests)]

    def stop_force(self, stop):
        number, s = self.planar.number, self.coordinate(stop["coordinate"])
        stiffness, damping, force = number(stop["stiffness"]), number(stop.get("damping", 0)), 0.0
        if "min" in stop and (depth := number(stop["min"]) - s.value) > 0:
            force += stiffness * depth * max(1 - damping * s.rate, 0.0)
        if "max" in stop and (depth := s.value - number(stop["max"])) > 0:
            force -= stiffness * depth * max(1 + damping * s.rate, 0.0)
        return force

    def forces(self):
        planar, file = self.planar, self.planar.file
        total = np.zeros(planar.count)
        total[0::3], total[1::3] = planar.mass[0::3] * planar.gravity[0], planar.mass[1::3] * planar.gravity[1]
        for name, spring in file.get("springs", {}).items():
            stretch = self.stretch(name)
            total += self.spring_force(spring, stretch) * stretch.gradient
        for bushing in file.get("bushings", {}).values():
            for force, stretch in zip(self.bushing_forces(bushing), self.bushing(bushing)):
                total += force * stretch.gradient
        for force in file.get("forces", {}).values():
            for component, coordinate in zip(force["force"], self.point(force["point"])):
                total += planar.evaluate(component, self) * coordinate.gradient
        for actuator in file.get("actuators", {}).values():
            total += planar.evaluate(actuator["effort"], self) * self.coordinate(actuator["coordinate"]).gradient
        for stop in file.get("stops", {}).values():
            total += self.stop_force(stop) * self.coordinate(stop["coordinate"]).gradient
        return total

    def solve(self):
        """Accelerations, and forces of constraints and of drivers of accelerations by their owners."""
        planar = self.planar
        rows = self.constraints()
        owners = [owner for owner, _ in rows]
        gradients = [row.gradient for _, row in rows]
        side = [-row.curvature - 2 * STABILIZATION * row.rate - STABILIZATION**2 * row.value for _, row in rows]
        for name, driver in planar.file.get("drivers", {}).items():
            if "acceleration" in driver:
                s = self.coordinate(driver["coordinate"])
                owners.append(name)
                gradients.append(s.gradient)
                side.append(planar.evaluate(driver["acceleration"], self) - s.curvature)
        n, m = planar.count, len(owners)
        matrix = np.zeros((n + m, n + m))
        matrix[range(n), range(n)] = planar.mass
        if m:
            jacobian = np.array(gradients)
            matrix[n:, :n], matrix[:n, n:] = jacobian, -jacobian.T
        found = np.linalg.solve(matrix, np.concatenate([self.forces(), side]))
        held = {}
        for owner, force in zip(owners, found[n:]):
            held.setdefault(owner, []).append(force)
        return found[:n], held

    def derivative(self):
        rates = [self.planar.evaluate(state["rate"], self) for state in self.planar.file.get("states", {}).values()]
        return np.concatenate([self.v, self.solve()[0], rates])

    def measures(self, names):
        """Values of measures; the equations are solved once."""
        planar, file = self.planar, self.planar.file
        accelerations, held = self.solve()
        values = []
        for name in names:
            owner, _, what = name.rpartition(".")
            if name in file.get("states", {}):
                values.append(self.z[list(file["states"]).index(name)])
            elif name == "kinetic_energy":
                values.append(0.5 * self.v @ (planar.mass * self.v))
            elif what in ACCELERATIONS:
                s = self.coordinate(f"{owner}.{ACCELERATIONS[what]}")
                values.append(s.gradient @ accelerations + s.curvature)
            elif what in RATES:
                values.append(self.position_of_rate(owner, what).rate)
            elif what == "effort":
                values.append(held[owner][0])
            elif what == "force":
                values.append(self.spring_force(file["springs"][owner], self.stretch(owner)))
            elif what in ("fx", "fy", "moment"):
                values.append(self.reaction(owner, held, ("fx", "fy", "moment").index(what)))
            else:
                values.append(self.coordinate(name).value)
        return values

    def reaction(self, owner, held, component):
        file = self.planar.file
        if owner in file.get("bushings", {}):
            return self.bushing_forces(file["bushings"][owner])[component]
        joint = file["joints"][owner]
        if joint["type"] == "prismatic":
            if component == 2:
                return held[owner][1]
            x, y = self.axis(joint)
            across = self.turned(self.planar.locals[joint["between"][0]][0], -y, x)
            return held[owner][0] * plain(across[component])
        return held[owner][component]


def start(planar):
    """Unknowns at the start: the guesses, moved as little as possible to where joints and initial conditions hold."""
    file, number = planar.file, planar.number
    bodies = file["bodies"].values()
    q = np.array([[*map(number, body.get("position", [0, 0])), number(body.get("angle", 0))] for body in bodies]).ravel()
    v = np.array([[*map(number, body.get("velocity", [0, 0])), number(body.get("angular_velocity", 0))] for body in bodies]).ravel()
    z = [number(state.get("start", 0)) for state in file.get("states", {}).values()]
    conditions = {f"{owner}.{what}": number(value) for owner, all_of in file.get("initial", {}).items() for what, value in all_of.items()}

    def rows(q, v, is_rate):
        state = State(planar, 0.0, np.concatenate([q, v, z]))
        gaps = [(row.gradient, row.rate if is_rate else row.value) for _, row in state.constraints()]
        for name, value in conditions.items():
            owner, what = name.rsplit(".", 1)
            if (what in RATES) == is_rate:
                s = state.position_of_rate(owner, what) if is_rate else state.coordinate(name)
                gaps.append((s.gradient, (s.rate if is_rate else s.value) - value))
        return np.array([gradient for gradient, _ in gaps]).reshape(-1, len(q)), np.array([gap for _, gap in gaps])

    for _ in range(50):
        jacobian, gaps = rows(q, v, False)
        if not len(gaps) or abs(gaps).max() < 1e-14:
            break
        q = q - np.linalg.lstsq(jacobian, gaps, rcond=1e-10)[0]
    for _ in range(2):
        jacobian, gaps = rows(q, v, True)
        if len(gaps):
            v = v - np.linalg.lstsq(jacobian, gaps, rcond=1e-10)[0]
    return np.concatenate([q, v, z])


class OutOfTime(Exception):
    """More evaluations than allowed."""


def simulate(planar, times, names, tolerance=1e-10, evaluations=20000, method="DOP853", perturbation=0.0, longest_step=0.02):
    """Measures at times: shape `[times, names]`."""
    count = 0

    def derivative(t, y):
        nonlocal count
        count += 1
        if count > evaluations:
            raise OutOfTime(f"{evaluations} evaluations until t = {t:.3g} s")
        return State(planar, t, y).derivative()

    y = start(planar) + perturbation
    solution = solve_ivp(derivative, (times[0], times[-1]), y, method, times, rtol=tolerance, atol=1e-2 * tolerance, max_step=longest_step)
    if not solution.success:
        raise ArithmeticError(solution.message)
    return np.array([State(planar, t, y).measures(names) for t, y in zip(times, solution.y.T)])
