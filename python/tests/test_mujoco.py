"""Models of MuJoCo as sources, compared with closed forms."""

import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import metafmu

pytest.importorskip("mujoco")

# a cart with a pendulum, pushed by a motor that lags
CART = """<mujoco model="cart">
  <option timestep="0.002"/>
  <worldbody>
    <geom name="floor" type="plane" size="2 2 0.1" pos="0 0 -0.1"/>
    <body name="cart">
      <joint name="rail" type="slide" axis="1 0 0" limited="true" range="-1 1" damping="0.3"/>
      <geom name="block" type="sphere" size="0.05" mass="1"/>
      <body name="pendulum">
        <joint name="swing" axis="0 1 0"/>
        <geom name="load" type="sphere" size="0.02" pos="0 0 -0.5" mass="0.2"/>
        <site name="tip" pos="0 0 -0.5"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <general name="motor" joint="rail" dyntype="filter" dynprm="0.1" gainprm="5" ctrllimited="true" ctrlrange="-1 1"/>
  </actuator>
  <sensor>
    <jointpos name="angle" joint="swing"/>
    <framepos name="tip" objtype="site" objname="tip"/>
    <actuatorfrc name="push" actuator="motor"/>
  </sensor>
</mujoco>
"""
RANGES = {"rail.rate": (-3, 3), "swing": (-1, 1), "swing.rate": (-4, 4), "motor.activation": (-1, 1)}
MASS = {"geom.load.mass": {"min": 0.1, "max": 0.4, "unit": "kg"}}
STATES = ["rail", "rail.rate", "swing", "swing.rate", "motor.activation"]


@pytest.fixture
def cart(tmp_path):
    (tmp_path / "cart.xml").write_text(CART)
    return metafmu.mujoco(tmp_path / "cart.xml", ranges=RANGES, parameters=MASS)


def closed_form(states, control, mass):
    _, speed, angle, turning, activation = states
    length, inertia = 0.5, 0.4 * mass * 0.02**2
    coupling = -mass * length * np.cos(angle)
    matrix = [[1 + mass, coupling], [coupling, mass * length**2 + inertia]]
    forces = [5 * activation - 0.3 * speed - mass * length * np.sin(angle) * turning**2, -mass * 9.81 * length * np.sin(angle)]
    return [speed, *(found := np.linalg.solve(matrix, forces))[:1], turning, found[1], (control - activation) / 0.1]


def test_a_model_without_lag_has_its_mass_matrix(tmp_path):
    text = re.sub(r"<general.*", '<motor name="motor" joint="rail" gear="5" ctrllimited="true" ctrlrange="-1 1"/>', CART)
    (tmp_path / "cart.xml").write_text(re.sub(r".*actuatorfrc.*\n", "", text))
    ranges = {name: ranges for name, ranges in RANGES.items() if name != "motor.activation"}
    cart = metafmu.mujoco(tmp_path / "cart.xml", ranges=ranges, parameters=MASS)
    assert cart._about["states"]["swing.rate"]["rate_of"] == "swing"
    states = {"rail": 0.2, "rail.rate": 1.0, "swing": 0.7, "swing.rate": -2.0}
    _, _, mass = cart.equations({"geom.load.mass": 0.3}, {"motor.control": 0.5}, states)
    coupling = -0.3 * 0.5 * np.cos(0.7)
    np.testing.assert_allclose(mass, [[1.3, coupling], [coupling, 0.3 * 0.25 + 0.4 * 0.3 * 0.02**2]], atol=1e-12)


def test_equations_are_those_of_the_closed_form(cart):
    random = np.random.default_rng(1)
    for _ in range(20):
        states, control, mass = random.uniform(-1, 1, 5), random.uniform(-1, 1), random.uniform(0.1, 0.4)
        rates, outputs = cart.equations({"geom.load.mass": mass}, {"motor.control": control}, dict(zip(STATES, states)))
        np.testing.assert_allclose([rates[name] for name in STATES], closed_form(states, control, mass), rtol=1e-9, atol=1e-9)
        expected = [states[2], states[0] - 0.5 * np.sin(states[2]), 0.0, -0.5 * np.cos(states[2]), 5 * states[4]]
        np.testing.assert_allclose([outputs[name] for name in ("angle", "tip.x", "tip.y", "tip.z", "push")], expected, atol=1e-12)


def test_runs_are_of_order_four_and_of_order_two_in_changes_of_inputs(tmp_path):
    times, start = np.linspace(0, 2, 81), [0.1, 0.2, 0.3, -0.4, 0.5]

    def largest_error(control, step):
        (tmp_path / "cart.xml").write_text(CART.replace('timestep="0.002"', f'timestep="{step}"'))
        cart = metafmu.mujoco(tmp_path / "cart.xml", ranges=RANGES, parameters=MASS)
        found = cart(times, {"geom.load.mass": 0.3}, {"motor.control": control}, dict(zip(STATES, start)))
        rates = lambda t, x: closed_form(x, np.interp(t, times, control), 0.3)
        expected = solve_ivp(rates, (0, 2), start, "DOP853", times, rtol=1e-12, atol=1e-12, max_step=0.025).y
        assert np.ptp(expected[2]) > 0.3
        return np.abs(found["angle"] - expected[2]).max()

    coarse, fine = (largest_error(np.full(81, 0.3), step) for step in (0.004, 0.002))
    assert fine < 1e-9 and 12 < coarse / fine < 22
    coarse, fine = (largest_error(np.sin(3 * times), step) for step in (0.004, 0.002))
    assert fine < 1e-5 and 3.5 < coarse / fine < 4.8


def test_a_model_without_actuators_moves_from_its_start(tmp_path):
    text = re.sub(r"<actuator>.*</actuator>", "", CART, flags=re.DOTALL).replace('<actuatorfrc name="push" actuator="motor"/>', "")
    (tmp_path / "free.xml").write_text(text)
    free = metafmu.mujoco(tmp_path / "free.xml", ranges={name: RANGES[name] for name in STATES[1:4]})
    times, start = np.linspace(0, 1, 41), dict(zip(STATES[:4], (0.0, 0.0, 0.5, 0.0)))
    rates = lambda t, x: closed_form([*x, 0.0], 0.0, 0.2)[:4]
    expected = solve_ivp(rates, (0, 1), list(start.values()), "DOP853", times, rtol=1e-12, atol=1e-12).y
    assert np.abs(free(times, {}, None, start)["angle"] - expected[2]).max() < 1e-8


def test_what_no_equations_describe_is_refused(tmp_path):
    path = tmp_path / "model.xml"

    def refusal(*changes, **arguments):
        text = CART
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path.write_text(text)
        with pytest.raises(ValueError) as error:
            metafmu.mujoco(path, **{"ranges": RANGES, **arguments})
        return str(error.value)

    assert "no range of rail.rate, swing, swing.rate, motor.activation: expected" in refusal(ranges={})
    assert "ranges of elbow: unknown, expected some of rail, rail.rate," in refusal(ranges=RANGES | {"elbow": (0, 1)})
    assert "joint `swing` is of the type ball, expected hinge or slide" in refusal(('name="swing" axis="0 1 0"', 'name="swing" type="ball"'), ("jointpos", "ballquat"))
    weld = '<equality><weld body1="pendulum" body2="world"/></equality></mujoco>'
    assert "1 equality constraints, expected none" in refusal(("</mujoco>", weld))
    assert "has no sensor" in refusal((re.search(r"<sensor>.*</sensor>", CART, re.DOTALL)[0], ""))
    assert "joint 0 has no name" in refusal(('name="rail" ', ""), (' joint="rail"', ' site="tip"'))
    for attribute in ("geom.load.weight", "wheel.load.mass", "geom.lode.mass"):
        assert f"no attribute `{attribute}`" in refusal(parameters={attribute: {"min": 1, "max": 2}})
    assert "has 3 values, expected one of them, as in `body.pendulum.pos[0]`" in refusal(parameters={"body.pendulum.pos": {"min": 1, "max": 2}})


def test_a_model_becomes_a_component_with_states(cart, tmp_path):
    tomllib = pytest.importorskip("tomllib")
    pytest.importorskip("cloudpickle")
    study = metafmu.Study(cart, structure="dynamics", folder=tmp_path, sampling={"states": 3000, "test_runs": 5}, training={"epochs": 300})
    text = tomllib.loads(study.path.read_text())
    assert list(text["states"]) == STATES and list(text["inputs"]) == ["motor.control"]
    assert [file.rpartition("/")[2] for file in text["source"]["files"]] == ["cart.xml"] and text["outputs"]["tip.x"] == {"unit": "m"}
    result = study.build(tmp_path / "out", verbose=False)
    assert result.accepted, result
