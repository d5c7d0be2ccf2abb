"""Functions of JAX by their jaxpr."""

import subprocess
import sys

import numpy as np
import pytest
from conftest import flow_and_temp

import metafmu

jax = pytest.importorskip("jax")
jax.config.update("jax_enable_x64", True)
from jax import nn
from jax import numpy as jnp


def parameters(sizes, kind):
    random = np.random.default_rng(5)
    return [(jnp.asarray(random.normal(size=(a, b)), kind), jnp.asarray(0.1 * random.normal(size=b), kind)) for a, b in zip(sizes, sizes[1:])]


def network(activation):
    def apply(params, x):
        for w, b in params[:-1]:
            x = activation(x @ w + b)
        w, b = params[-1]
        return x @ w + b

    return apply


def residual(params, x):
    (w, b), (v, c), (u, d) = params
    h = jnp.tanh(jnp.dot(x, w) + b)
    h = h + nn.relu(h @ v + c)
    mean = h.mean(axis=-1, keepdims=True)
    h = (h - mean) / jnp.sqrt(((h - mean) ** 2).mean(axis=-1, keepdims=True) + 1e-5)
    return h @ u + d


def features(params, x):
    z = jnp.concatenate([jnp.sin(x[:, :1]), jnp.cos(x[:, :1]), jnp.log(2.0 + x[:, 1:2] ** 2), jnp.exp(-jnp.abs(x[:, 2:]))], axis=1)
    y = nn.sigmoid(jnp.einsum("bi,ij->bj", z, jnp.linspace(-2.0, 2.0, 24, dtype=x.dtype).reshape(6, 4).T))
    return jnp.stack([y[:, 0] * y[:, 1], y[:, 2] / (1.0 + y[:, 3] ** 3), jnp.maximum(y[:, 4], y[:, 5])], axis=1)


def choices(params, x):
    (w, b), = params
    y = x @ w + b
    y = jnp.where(y > 0.1, y, -0.2 * y) * (x[:, :1] <= 0.5)
    between = (y > -0.5) & ~(y > 0.5) | (x[:, 1:2] < 1.0)
    return jnp.clip(y, -1.0, 2.0) + jnp.where(between, y**2, 0.25)


MODELS = {
    "choices": (choices, [3, 2]),
    **{name: (network(getattr(nn, name)), [3, 12, 12, 2]) for name in ("relu", "sigmoid", "silu", "gelu", "leaky_relu", "elu", "softplus", "selu", "soft_sign", "swish")},
    "tanh": (network(jnp.tanh), [3, 32, 32, 1]),
    "gelu-exact": (network(lambda x: nn.gelu(x, approximate=False)), [3, 8, 2]),
    "softmax": (network(nn.softmax), [3, 8, 2]),
    "residual": (residual, [3, 8, 8, 2]),
    "features": (features, [3, 8, 2]),
}


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("name", MODELS)
def test_the_fmu_predicts_what_jax_does(name, precision, rows, agrees):
    function, sizes = MODELS[name]
    kind = jnp.float64 if precision == "double" else jnp.float32
    params, x = parameters(sizes, kind), jnp.asarray(rows[0], kind)
    with jax.default_matmul_precision("highest"):
        expected = np.asarray(function(params, x))
    surrogate = metafmu.from_jax(function, data=rows[0], example=x[:1], params=params, name=name)
    agrees(surrogate, np.asarray(x), expected, 1e-12 if precision == "double" else 1e-6)
    single = jax.jit(jax.vmap(jax.jacfwd(lambda row: function(params, row[None])[0])))(x[:20])
    found = surrogate.jacobian(np.asarray(x[:20]))
    assert np.abs(found - np.asarray(single)).max() <= (1e-11 if precision == "double" else 1e-4) * max(np.abs(np.asarray(single)).max(), 1.0)


def test_a_row_without_a_batch(rows, agrees):
    params = parameters([3, 8, 2], jnp.float64)
    one = lambda x: jnp.tanh(params[0][0].T @ x + params[0][1]) @ params[1][0] + params[1][1]
    expected = np.stack([np.asarray(one(row)) for row in rows[0]])
    agrees(metafmu.from_jax(one, data=rows[0], example=jnp.asarray(rows[0][0])), rows[0], expected, 1e-12)


def test_a_differential_equation_has_states():
    """With the arguments that solvers for JAX want: time, states, input."""
    scipy = pytest.importorskip("scipy.integrate")
    ((w, b), (v, c)) = parameters([3, 8, 2], jnp.float64)

    def flow(t, x, u):
        return jnp.tanh(jnp.concatenate([x, u]) @ w + b) @ v + c - jnp.array([[0.4, 2.0], [-2.0, 0.4]]) @ x

    surrogate = metafmu.from_jax(
        flow, inputs={"t": {"value": 0.0}, "u": (-2, 2)}, example=(0.0, jnp.zeros(2), jnp.zeros(1)),
        states={"x": {"derivative": "output", "start": 0.5}}, solver_step=0.002,
    )
    assert surrogate.name == "flow" and [item.name for item in surrogate.inputs] == ["x[0]_start", "x[1]_start", "u"]
    time = np.linspace(0.0, 5.0, 101)
    expected = scipy.solve_ivp(lambda t, x: np.asarray(flow(t, x, jnp.array([0.8]))), (0.0, 5.0), [0.5, 0.5], t_eval=time, rtol=1e-10, atol=1e-12).y.T
    assert np.abs(surrogate.simulate(time, {"u": 0.8}) - expected).max() < 1e-8


def test_examples_of_numpy_are_what_jax_makes_of_them(rows):
    """Without doubles, which JAX has only if configured."""
    code = (
        "import jax.numpy as jnp, numpy as np, metafmu; w = np.random.default_rng(0).normal(size=(3, 2)); "
        "s = metafmu.from_jax(lambda x: jnp.tanh(x @ jnp.array(w)), inputs={k: (-1, 1) for k in 'abc'}, example=np.zeros((1, 3))); "
        "assert abs(s.predict([[0.1, 0.2, 0.3]]) - np.tanh(np.array([0.1, 0.2, 0.3]) @ w)).max() < 1e-6"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_several_arguments(rows, agrees):
    function = lambda a, b: {"sum": a + b, "difference": a[0] - b[0]}
    x = rows[0][:, :2]
    surrogate = metafmu.from_jax(function, data=x, example=(jnp.zeros(1), jnp.zeros(1)))
    agrees(surrogate, x, np.stack([x[:, 0] - x[:, 1], x.sum(axis=1)], axis=1), 1e-12)


def test_what_is_not_known_is_refused(rows):
    with pytest.raises(metafmu.Error, match="primitive `sort`.*expected one of"):
        metafmu.from_jax(lambda x: jnp.sort(x), data=rows[0], example=jnp.asarray(rows[0][:1]))
    for function, message in [
        (lambda x: x.astype(int) * 1.0, "a conversion of inputs to int"),
        (lambda x: x - x.mean(axis=0), "was read wrongly: predictions differ by .* or its rows depend on each other"),
        (lambda x: jnp.select([x < -1, x < 1], [x, 2 * x], 3 * x), "of a comparison"),
        (lambda x: jnp.take(x, jnp.array([1, 7]), axis=-1), "primitive `gather`, in a form that is not known"),
    ]:
        with pytest.raises(metafmu.Error, match=message):
            metafmu.from_jax(function, data=rows[0], example=jnp.asarray(rows[0][:1]))
    with pytest.raises(metafmu.Error, match="an example of the shape"):
        metafmu.from_jax(lambda x: x, data=rows[0], example=jnp.ones((1, 2, 3)))


def test_columns_go_by_the_names_of_arguments(goes_by_names):
    frame, y = flow_and_temp()
    column = np.zeros((1, 1))
    named = lambda **names: metafmu.from_jax(lambda flow, temp: {"left": flow, "heat": 100 * flow + 2 * temp}, example=(column, column), **names)
    goes_by_names(named, lambda rows: np.column_stack([y, rows.flow]), 1e-12, True)
    goes_by_names(lambda **names: metafmu.from_jax(lambda x: x @ jnp.array([100.0, 2.0]), example=np.zeros((1, 2)), **names), lambda rows: y, 1e-12, False)
    for outputs in (None, ["left", "heat"], {"left": "m3", "heat": "W"}):
        assert [item.name for item in named(outputs=outputs, data=frame).outputs] == ["heat", "left"]


def test_what_jax_does_not_follow_is_an_error():
    with pytest.raises(metafmu.Error, match="cannot be followed by JAX: TypeError"):
        metafmu.from_jax(lambda x: x.reshape(64, 3), inputs={name: (0, 1) for name in "abc"}, example=np.zeros((64, 3)))
