"""Models of Keras 3, on JAX unless KERAS_BACKEND says otherwise: the FMU predicts what the model does, and its derivatives are autograd's."""

import os

import numpy as np
import pytest
from conftest import flow_and_temp

os.environ.setdefault("KERAS_BACKEND", "jax")

import metafmu

keras = pytest.importorskip("keras")
from keras import layers


def functional():
    x = keras.Input((3,))
    a = layers.Dense(8, "tanh")(x)
    b = layers.Dense(8, "relu")(x)
    h = layers.Add()([a, b])
    h = layers.Concatenate()([h, x, layers.Multiply()([a, b])])
    h = layers.LayerNormalization()(h)
    h = h + layers.Dense(19, use_bias=False)(h) * 0.5
    return keras.Model(x, [layers.Dense(1)(h), layers.Dense(2, "sigmoid")(h)])


def shared():
    x = keras.Input((3,))
    layer = layers.Dense(3, "tanh")
    inner = keras.Sequential([keras.Input((3,)), layers.Dense(6, "elu"), layers.Dense(3)])
    return keras.Model(x, layers.Average()([layer(layer(x)), inner(x), layers.Subtract()([inner(layer(x)), x])]))


def normalized():
    layer = layers.Normalization(mean=[0.1, 1.2, 0.0], variance=[0.4, 0.3, 3.0])
    return keras.Sequential([keras.Input((3,)), layer, layers.Dense(16, "silu"), layers.BatchNormalization(), layers.Dense(2), layers.Rescaling(2.0, -0.5)])


def dense(*activations):
    return lambda: keras.Sequential([keras.Input((3,)), *(layers.Dense(6, activation) for activation in activations), layers.Dense(2)])


MODELS = {
    "dense-tanh": dense("tanh", "tanh"),
    **{
        name: dense(name) for name in ("relu", "sigmoid", "elu", "selu", "gelu", "softplus", "softsign", "silu", "leaky_relu", "hard_sigmoid", "hard_silu", "mish", "relu6", "softmax", "exponential")
    },
    "layers-of-activations": lambda: keras.Sequential(
        [keras.Input((3,)), layers.Dense(6), layers.LeakyReLU(0.2), layers.Dense(6), layers.PReLU(), layers.Dense(6), layers.ReLU(max_value=1.5), layers.Dropout(0.3),
         layers.Reshape((2, 3)), layers.Dense(4), layers.Flatten(), layers.Activation("tanh"), layers.Dense(2)]
    ),
    "functional": functional,
    "shared": shared,
    "normalized": normalized,
}


def autograd(model, rows):
    """Derivatives by the backend of Keras, of shape (rows, outputs, inputs)."""
    if keras.backend.backend() == "jax":
        import jax

        weights = [variable.value for variable in model.trainable_variables], [variable.value for variable in model.non_trainable_variables]

        def of_row(row):
            outputs, _ = model.stateless_call(*weights, row[None], training=False)
            return jax.numpy.concatenate(jax.tree.leaves(outputs), axis=1)[0]

        return np.asarray(jax.vmap(jax.jacfwd(of_row))(rows))
    import torch

    def of_row(row):
        outputs = model(row[None], training=False)
        return torch.cat(outputs if isinstance(outputs, (list, tuple)) else [outputs], dim=1)[0]

    return np.stack([torch.autograd.functional.jacobian(of_row, torch.tensor(row)).numpy() for row in rows])


@pytest.mark.parametrize("name", MODELS)
def test_the_fmu_predicts_what_keras_does(name, rows, agrees):
    """In single precision: Keras multiplies matrices in no other one, also where weights are doubles."""
    model = MODELS[name]()
    # the same with all versions of Keras; statistics and slopes that are not those of the beginning
    random = np.random.default_rng(6)
    matrix = lambda shape: random.normal(scale=1.5 / np.sqrt(shape[0]), size=shape)
    changed = lambda weight: matrix(weight.shape) if weight.ndim > 1 else weight + 0.1 * np.abs(random.normal(size=weight.shape))
    model.set_weights([changed(weight) for weight in model.get_weights()])
    x = rows[0].astype(np.float32)
    expected = model.predict(x, verbose=0, batch_size=len(x))
    expected = np.concatenate(expected, axis=1) if isinstance(expected, (list, tuple)) else expected
    surrogate = metafmu.from_keras(model, data=rows[0])
    agrees(surrogate, x, expected, 1e-6)
    slopes = autograd(model, x[:20])
    assert np.abs(surrogate.jacobian(x[:20]) - slopes).max() <= 1e-4 * max(np.abs(slopes).max(), 1.0)


def test_what_is_not_known_is_refused(rows):
    model = keras.Sequential([keras.Input((3, 1)), layers.LSTM(4), layers.Dense(1)])
    with pytest.raises(metafmu.Error, match=r"the layer LSTM .* is not known, expected one of .*Dense"):
        metafmu.from_keras(model, data=rows[0])
    with pytest.raises(metafmu.Error, match=r"axis \(1, 2\), expected a single one"):
        metafmu.from_keras(keras.Sequential([keras.Input((3, 1)), layers.Softmax(axis=(1, 2))]), data=rows[0])

    class Doubled(keras.Sequential):
        def call(self, x, training=None, mask=None):
            return 2 * super().call(x)

    with pytest.raises(metafmu.Error, match="Doubled `.*` was read wrongly"):
        metafmu.from_keras(Doubled([keras.Input((3,)), layers.Dense(1)]), data=rows[0])
    with pytest.raises(metafmu.Error, match="not built"):
        metafmu.from_keras(keras.Sequential([layers.Dense(2)]), data=rows[0])


@pytest.mark.parametrize("take", [dict, lambda inputs: list(inputs.values())])
def test_columns_go_by_the_names_of_inputs(take, goes_by_names):
    frame, y = flow_and_temp()
    inputs = {name: keras.Input((1,), name=name) for name in ("flow", "temp")}
    heat = layers.Add()([layers.Rescaling(100.0)(inputs["flow"]), layers.Rescaling(2.0)(inputs["temp"])])
    model = keras.Model(take(inputs), {"left": layers.Identity()(inputs["flow"]), "heat": heat})
    names = [item.name for item in metafmu.from_keras(model, data=frame).outputs]
    expected = lambda rows: np.column_stack([{"heat": y, "left": rows.flow}[name] for name in names])
    goes_by_names(lambda **given: metafmu.from_keras(model, **given), expected, 1e-6, True)
    for outputs in (["left", "heat"], ["heat", "left"], {"left": "m3", "heat": "W"}):
        assert [item.name for item in metafmu.from_keras(model, outputs=outputs, data=frame).outputs] == names


def test_columns_without_names_have_the_order_of_a_data_frame(goes_by_names):
    model = keras.Sequential([keras.Input((2,)), layers.Dense(1)])
    model.set_weights([np.array([[100.0], [2.0]], np.float32), np.zeros(1, np.float32)])
    goes_by_names(lambda **given: metafmu.from_keras(model, **given), lambda rows: flow_and_temp()[1], 1e-6, False)


def relu(x):
    """Not that of Keras."""
    return keras.activations.relu(x, max_value=20.0)


def test_a_name_alone_does_not_make_a_function_one_of_keras():
    model = keras.Sequential([keras.Input((2,)), layers.Dense(4, activation=relu)])
    with pytest.raises(metafmu.Error, match="activation relu of test_keras is not known"):
        metafmu.from_keras(model, inputs={"a": (0, 1), "b": (0, 1)})


def test_gelu_of_the_operations_is_the_approximate_one():
    model = keras.Sequential([keras.Input((2,)), layers.Dense(4, activation=keras.ops.gelu), layers.Dense(2, activation="gelu")])
    metafmu.from_keras(model, inputs={"a": (-3, 3), "b": (-3, 3)})


def test_an_operation_in_another_form_is_an_error():
    x = keras.Input((4,))
    for make in (lambda: keras.ops.reshape(x, (-1, 2, 2)), lambda: keras.ops.average(x, axis=1)):
        with pytest.raises(metafmu.Error, match="in a form that is not known"):
            metafmu.from_keras(keras.Model(x, layers.Identity()(make())), inputs={name: (0, 1) for name in "abcd"})
