"""Every estimator that is read: the FMU predicts what scikit-learn does, in double precision."""

import types

import numpy as np
import pytest
from conftest import differences, flow_and_temp

import metafmu

pytest.importorskip("sklearn")
pandas = pytest.importorskip("pandas")

from scipy.sparse import csr_matrix
from sklearn import base, ensemble, linear_model, tree
from sklearn.compose import ColumnTransformer, TransformedTargetRegressor
from sklearn.cross_decomposition import PLSRegression
from sklearn.decomposition import PCA
from sklearn.feature_selection import SelectKBest, f_regression
from sklearn.gaussian_process import GaussianProcessRegressor, kernels
from sklearn.kernel_approximation import Nystroem, RBFSampler
from sklearn.kernel_ridge import KernelRidge
from sklearn.model_selection import GridSearchCV
from sklearn.multioutput import MultiOutputRegressor
from sklearn.neighbors import KNeighborsRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import FeatureUnion, Pipeline, make_pipeline
from sklearn.preprocessing import FunctionTransformer, MaxAbsScaler, MinMaxScaler, PolynomialFeatures, PowerTransformer, RobustScaler, StandardScaler
from sklearn.svm import SVR, LinearSVR, NuSVR

MLP = {"max_iter": 60, "random_state": 0}
GP = {"alpha": 1e-4, "optimizer": None}


def gaussian_process(kernel, **options):
    return GaussianProcessRegressor(kernel, **{**GP, **options})


# name: estimator, whether it has several outputs, whether its derivatives are those of a smooth function
MODELS = {
    "mlp-relu": (MLPRegressor(hidden_layer_sizes=(16, 16), **MLP), True, False),
    "mlp-tanh": (MLPRegressor(hidden_layer_sizes=(16,), activation="tanh", **MLP), True, True),
    "mlp-logistic": (MLPRegressor(hidden_layer_sizes=(8, 8), activation="logistic", **MLP), False, True),
    "mlp-identity": (MLPRegressor(hidden_layer_sizes=(8,), activation="identity", **MLP), False, True),
    "standard-mlp": (make_pipeline(StandardScaler(), MLPRegressor(hidden_layer_sizes=(16,), activation="tanh", **MLP)), True, True),
    "min-max-mlp-targets": (
        TransformedTargetRegressor(make_pipeline(MinMaxScaler(clip=True), MLPRegressor(hidden_layer_sizes=(8,), activation="tanh", **MLP)), transformer=StandardScaler()),
        True, False,
    ),
    "targets-exp": (TransformedTargetRegressor(linear_model.Ridge(), func=np.log, inverse_func=np.exp), "positive", True),
    "targets-min-max": (TransformedTargetRegressor(linear_model.Ridge(), transformer=MinMaxScaler()), False, True),
    "linear": (linear_model.LinearRegression(), True, True),
    "ridge": (linear_model.Ridge(), True, True),
    "lasso": (linear_model.Lasso(0.01), False, True),
    "elastic-net": (linear_model.ElasticNet(0.01), True, True),
    "bayesian-ridge": (linear_model.BayesianRidge(), False, True),
    "huber": (linear_model.HuberRegressor(), False, True),
    "sgd": (make_pipeline(StandardScaler(), linear_model.SGDRegressor(random_state=0)), False, True),
    "poisson": (linear_model.PoissonRegressor(), "positive", True),
    "pls": (PLSRegression(2), True, True),
    "linear-svr": (make_pipeline(MaxAbsScaler(), LinearSVR(random_state=0)), False, True),
    "polynomial": (make_pipeline(PolynomialFeatures(3), linear_model.Ridge()), True, True),
    "polynomial-interactions": (make_pipeline(RobustScaler(), PolynomialFeatures(3, interaction_only=True, include_bias=False), linear_model.Ridge()), True, True),
    "pca": (make_pipeline(StandardScaler(), PCA(2, whiten=True), linear_model.LinearRegression()), True, True),
    "union": (make_pipeline(FeatureUnion([("a", StandardScaler()), ("b", PolynomialFeatures(2))]), linear_model.Ridge()), True, True),
    "columns": (
        make_pipeline(ColumnTransformer([("a", StandardScaler(), [0, 2])], remainder="passthrough"), MLPRegressor(hidden_layer_sizes=(8,), activation="tanh", **MLP)), True, True,
    ),
    "selected": (make_pipeline(SelectKBest(f_regression, k=2), linear_model.Ridge()), False, True),
    "power": (make_pipeline(PowerTransformer(), linear_model.Ridge()), True, True),
    "box-cox": (make_pipeline(MinMaxScaler((1, 3)), PowerTransformer("box-cox", standardize=False), linear_model.Ridge()), True, True),
    "random-waves": (make_pipeline(RBFSampler(gamma=0.3, random_state=0), linear_model.Ridge()), True, True),
    "nystroem": (make_pipeline(Nystroem(gamma=0.3, n_components=30, random_state=0), linear_model.Ridge()), True, True),
    "nystroem-poly": (make_pipeline(StandardScaler(), Nystroem(kernel="poly", degree=2, n_components=8, random_state=0), linear_model.Ridge()), True, True),
    "svr-rbf": (make_pipeline(StandardScaler(), SVR()), False, True),
    "svr-linear": (SVR(kernel="linear"), False, True),
    "svr-poly": (make_pipeline(StandardScaler(), SVR(kernel="poly", coef0=0.5)), False, True),
    "svr-sigmoid": (make_pipeline(StandardScaler(), SVR(kernel="sigmoid", gamma=0.1)), False, True),
    "nu-svr": (NuSVR(C=3.0), False, True),
    "kernel-ridge": (KernelRidge(kernel="rbf", gamma=0.5), True, True),
    "tree": (tree.DecisionTreeRegressor(max_depth=6, random_state=0), True, None),
    "tree-best-first": (tree.DecisionTreeRegressor(max_leaf_nodes=20, random_state=0), False, None),
    "random-forest": (ensemble.RandomForestRegressor(30, random_state=0), True, None),
    "extra-trees": (ensemble.ExtraTreesRegressor(20, random_state=0), True, None),
    "gradient-boosting": (ensemble.GradientBoostingRegressor(n_estimators=40, random_state=0), False, None),
    "gradient-boosting-of-ridge": (ensemble.GradientBoostingRegressor(n_estimators=20, init=linear_model.Ridge(), random_state=0), False, None),
    "histogram-boosting": (ensemble.HistGradientBoostingRegressor(max_iter=30), False, None),
    "histogram-boosting-poisson": (ensemble.HistGradientBoostingRegressor(max_iter=20, loss="poisson"), "positive", None),
    "bagging": (ensemble.BaggingRegressor(MLPRegressor(hidden_layer_sizes=(8,), activation="tanh", **MLP), 3, max_features=2, random_state=0), False, True),
    "voting": (ensemble.VotingRegressor([("a", linear_model.Ridge()), ("b", SVR())], weights=[2, 1]), False, True),
    "stacking": (ensemble.StackingRegressor([("a", linear_model.Ridge()), ("b", SVR())], linear_model.Ridge(), passthrough=True), False, True),
    "multi-output": (MultiOutputRegressor(SVR()), True, True),
    "grid-search": (GridSearchCV(linear_model.Ridge(), {"alpha": [0.1, 1.0]}), False, True),
    "gp-rbf": (gaussian_process(kernels.RBF(1.5), normalize_y=True), True, True),
    "gp-anisotropic": (gaussian_process(2.0 * kernels.RBF([1.0, 2.0, 3.0]) + kernels.WhiteKernel(1e-3)), False, True),
    "gp-matern-0.5": (gaussian_process(kernels.Matern(2.0, nu=0.5)), False, False),
    "gp-matern-1.5": (gaussian_process(kernels.ConstantKernel(3.0) * kernels.Matern(2.0, nu=1.5), normalize_y=True), False, True),
    "gp-matern-2.5": (gaussian_process(kernels.Matern(2.0, nu=2.5)), True, True),
    "gp-rational": (gaussian_process(kernels.RationalQuadratic(1.0, 0.7) + kernels.ConstantKernel(0.5)), False, True),
    "gp-dot-product": (gaussian_process(kernels.DotProduct(1.0) ** 2 + kernels.RBF(2.0) * kernels.DotProduct(0.5), alpha=0.1), False, True),
}


def fitted(name, rows):
    model, outputs, _ = MODELS[name]
    x, y = rows
    y = np.exp(y[:, 0]) if outputs == "positive" else y if outputs else y[:, 0]
    return model.fit(x, y)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", MODELS)
def test_the_fmu_predicts_what_scikit_learn_does(name, rows, agrees):
    model = fitted(name, rows)
    x = np.random.default_rng(2).uniform(rows[0].min(axis=0), rows[0].max(axis=0), (300, 3))
    surrogate = metafmu.from_sklearn(model, data=rows[0])
    # scikit-learn computes the ridge regression of rounded inputs in single precision
    agrees(surrogate, x, model.predict(x), 1e-6 if "of-ridge" in name else 1e-12)
    smooth = MODELS[name][2]
    found = surrogate.jacobian(x[:30])
    if smooth:
        expected = differences(model.predict, x[:30])
        assert np.abs(found - expected).max() <= 1e-5 * max(np.abs(expected).max(), 1.0)
    elif smooth is None and "of-ridge" not in name:
        assert not found.any()


@pytest.mark.filterwarnings("ignore")
def test_models_of_a_constant_target_are_constant(rows):
    x = rows[0][:60]
    kernels = {f"{kind.__name__}-{kernel}": kind(kernel=kernel) for kind in (SVR, NuSVR) for kernel in ("rbf", "linear", "poly", "sigmoid")}
    models = {name: model for name, (model, _, _) in MODELS.items()} | kernels
    for name, model in models.items():
        model = base.clone(model).fit(x, np.full((60, 2) if name in MODELS and MODELS[name][1] is True else 60, 3.25))
        assert "SVR" not in name or not len(model.support_vectors_)
        expected = model.predict(rows[0])
        found = metafmu.from_sklearn(model, data=x).predict(rows[0]).reshape(expected.shape)
        assert np.abs(found - expected).max() < 1e-9, name
    sparse = SVR().fit(csr_matrix(x), np.full(60, 3.25))
    assert (metafmu.from_sklearn(sparse, data=x).predict(rows[0]) == 3.25).all()


def test_an_onnx_regressor_without_support_vectors_is_its_constant(rows):
    onnx = pytest.importorskip("onnx")
    helper, single = onnx.helper, onnx.TensorProto.FLOAT
    node = helper.make_node("SVMRegressor", ["x"], ["y"], domain="ai.onnx.ml", kernel_type="RBF", n_supports=0, rho=[3.25])
    graph = helper.make_graph([node], "constant", [helper.make_tensor_value_info("x", single, [1, 3])], [helper.make_tensor_value_info("y", single, [1, 1])])
    versions = [helper.make_opsetid("", 17), helper.make_opsetid("ai.onnx.ml", 3)]
    surrogate = metafmu.from_onnx(helper.make_model(graph, opset_imports=versions, ir_version=8), data=rows[0])
    assert (surrogate.predict(rows[0]) == 3.25).all()


def test_thresholds_are_compared_as_scikit_learn_does(rows):
    """Inputs between two single-precision numbers around a threshold."""
    model = tree.DecisionTreeRegressor(random_state=0).fit(*rows)
    thresholds = model.tree_.threshold[model.tree_.feature == 0][:50]
    x = np.repeat(rows[0][:1], 5 * len(thresholds), axis=0)
    near = [thresholds, np.nextafter(thresholds, 9), np.nextafter(thresholds, -9), thresholds + 1e-9, thresholds - 1e-9]
    x[:, 0] = np.concatenate(near)
    assert np.array_equal(metafmu.from_sklearn(model, data=rows[0]).predict(x), model.predict(x))


def test_an_estimator_that_predicts_otherwise_than_it_was_read_is_refused(rows):
    """As one of a version whose fields mean something else."""
    model = linear_model.Ridge().fit(*rows)
    model.predict = lambda x: x @ model.coef_.T
    for options in ({"data": rows[0]}, {"inputs": {"a": (-1, 1), "b": (0.5, 2), "c": (-3, 3)}}):
        with pytest.raises(metafmu.Error, match="Ridge was read wrongly: predictions differ by"):
            metafmu.from_sklearn(model, **options)


def test_names_belong_to_the_columns_of_that_name(rows):
    frame = pandas.DataFrame(rows[0] * [1.0, 10.0, 100.0], columns=["x", "v", "mass"])
    targets = pandas.DataFrame({"force": rows[1][:, 0], "power": -rows[1][:, 0]})
    model = linear_model.Ridge().fit(frame, targets)
    given = {"inputs": {"mass": "kg", "x": "m", "v": "m/s"}, "data": frame}
    surrogate = metafmu.from_sklearn(model, **given)
    assert [(item.name, item.unit) for item in surrogate.inputs] == [("x", "m"), ("v", "m/s"), ("mass", "kg")]
    assert np.abs(surrogate.predict(frame) - model.predict(frame)).max() < 1e-12
    assert [item.unit for item in metafmu.from_sklearn(model, inputs={"mass": "kg"}, data=frame).inputs] == ["", "", "kg"]
    with pytest.raises(metafmu.Error, match="inputs: `mass` is of the model, `b`, `c` are not; expected all of its names, in any order: x, v, mass"):
        metafmu.from_sklearn(model, inputs=["mass", "b", "c"], data=frame)
    renamed = metafmu.from_sklearn(model, inputs=["a", "b", "c"], data=frame)
    assert [(item.name, item.max) for item in renamed.inputs] == [(name, frame[old].max()) for name, old in zip("abc", frame)]
    fitted = metafmu.fit(frame, targets, inputs=given["inputs"], outputs={"power": "W", "force": "N"}, epochs=100, hidden=(8,))
    assert [(item.name, item.unit) for item in fitted.outputs] == [("force", "N"), ("power", "W")]
    assert [item.name for item in fitted.inputs] == ["x", "v", "mass"] and fitted.accuracy["force"]["r2"] > 0.5


@pytest.mark.filterwarnings("ignore")
def test_numbers_far_from_zero_do_not_cancel(rows, agrees):
    """A pressure around 1e5 Pa, and seconds since 1970."""
    x = rows[0] * [50.0, 1.0, 1e3] + [101325.0, 0.0, 1.7e9]
    model = make_pipeline(StandardScaler(), MLPRegressor(hidden_layer_sizes=(16,), activation="tanh", **MLP)).fit(x, rows[1])
    agrees(metafmu.from_sklearn(model, data=x), x, model.predict(x), 1e-12)


def test_pipelines_of_all_kinds_are_read(rows, agrees):
    x, y = rows[0], rows[1][:, 0]
    own = metafmu.Regressor(hidden=(16,), epochs=50)
    negative = ColumnTransformer([("last", StandardScaler(), [-1])], remainder="passthrough")
    sparse = linear_model.SGDRegressor(random_state=0).fit(x, y).sparsify()
    missing = np.where(np.random.default_rng(1).random(x.shape) < 0.1, np.nan, x)
    for model in (
        make_pipeline(StandardScaler(), own).fit(x, y), ensemble.BaggingRegressor(own, 2, random_state=0).fit(x, y), make_pipeline("passthrough", linear_model.Ridge()).fit(x, y),
        make_pipeline(negative, linear_model.Ridge()).fit(x, y), sparse, tree.DecisionTreeRegressor(max_depth=5, random_state=0).fit(missing, y),
    ):
        agrees(metafmu.from_sklearn(model, data=x), x, model.predict(x), 1e-12)


def test_names_and_ranges_are_those_of_a_data_frame(rows):
    frame = pandas.DataFrame(rows[0], columns=["x", "v", "mass"])
    model = linear_model.Ridge().fit(frame, rows[1][:, 0])
    surrogate = metafmu.from_sklearn(model, data=frame, outputs={"force": "N"}, name="spring force")
    assert [item.name for item in surrogate.inputs] == ["x", "v", "mass"]
    assert surrogate.inputs[1].min == frame["v"].min() and surrogate.inputs[1].max == frame["v"].max()
    assert (surrogate.outputs[0].name, surrogate.outputs[0].unit, surrogate.name) == ("force", "N", "spring_force")
    # columns by name, in any order
    assert np.array_equal(surrogate.predict(frame[["mass", "x", "v"]]), surrogate.predict(rows[0]))
    with pytest.raises(metafmu.Error, match="no column `v`"):
        surrogate.predict(frame[["x", "mass"]])


def test_what_is_not_known_is_refused_with_what_is(rows):
    x, y = rows
    with pytest.raises(metafmu.Error, match="KNeighborsRegressor .* is not known, expected one of .*MLPRegressor"):
        metafmu.from_sklearn(KNeighborsRegressor().fit(x, y), data=x)
    with pytest.raises(metafmu.Error, match="KNeighborsRegressor"):
        metafmu.from_sklearn(make_pipeline(StandardScaler(), KNeighborsRegressor()).fit(x, y), data=x)
    with pytest.raises(metafmu.Error, match="not fitted"):
        metafmu.from_sklearn(MLPRegressor(), data=x)
    with pytest.raises(metafmu.Error, match="ExpSineSquared"):
        metafmu.from_sklearn(gaussian_process(kernels.ExpSineSquared(), alpha=10.0).fit(x[:20], y[:20]), data=x)
    with pytest.raises(metafmu.Error, match="no range of the inputs `x0`"):
        metafmu.from_sklearn(linear_model.Ridge().fit(x, y))
    with pytest.raises(metafmu.Error, match="2 inputs .*the model has 3"):
        metafmu.from_sklearn(linear_model.Ridge().fit(x, y), inputs=["a", "b"], data=x)

    with pytest.raises(metafmu.Error, match="LogisticRegression is a classifier, expected a regressor"):
        metafmu.from_sklearn(linear_model.LogisticRegression().fit(x, y[:, 0] > 0), data=x)

    class Doubled(linear_model.Ridge):
        def predict(self, X):
            return 2 * super().predict(X)

    with pytest.raises(metafmu.Error, match="Doubled"):
        metafmu.from_sklearn(Doubled().fit(x, y), data=x)
    logarithm = TransformedTargetRegressor(linear_model.Ridge(), transformer=FunctionTransformer(np.cbrt, lambda y: y**3, check_inverse=False))
    with pytest.raises(metafmu.Error, match="lambda"):
        metafmu.from_sklearn(logarithm.fit(x, y), data=x)


PASSED = Pipeline([("nothing", "passthrough"), ("model", linear_model.Ridge())])


@pytest.mark.parametrize(
    "model, knows",
    [
        (linear_model.Ridge(), False), (linear_model.Ridge(), True), (PASSED, True), (make_pipeline(make_pipeline("passthrough", None), PASSED), True),
        (GridSearchCV(PASSED, {"model__alpha": [1.0]}, cv=2), True), (TransformedTargetRegressor(PASSED), True), (ensemble.VotingRegressor([("only", PASSED)]), True),
        (make_pipeline(ColumnTransformer([("of", StandardScaler(), ["temp"])], remainder="passthrough"), linear_model.Ridge()), True),
        (make_pipeline(ColumnTransformer([("of", StandardScaler(), slice("flow", "temp"))]), linear_model.Ridge()), True),
        (make_pipeline(ColumnTransformer([("of", StandardScaler(), slice(0, 1))], remainder="passthrough"), linear_model.Ridge()), True),
    ],
)
def test_columns_go_by_the_names_that_an_estimator_knows(model, knows, goes_by_names):
    frame, y = flow_and_temp()
    model.fit(frame if knows else frame.to_numpy(), y)
    goes_by_names(lambda **names: metafmu.from_sklearn(model, **names), lambda rows: model.predict(rows if knows else rows.to_numpy()), 1e-12, knows)


def log(x):
    """Not that of numpy."""
    return np.log(x + 1e-4)


def exp(x):
    return np.exp(np.clip(x, -2, 2))


class StandardScalerOfMine(StandardScaler):
    def inverse_transform(self, X):
        return np.maximum(super().inverse_transform(X), 0.0)


StandardScalerOfMine.__name__ = "StandardScaler"


@pytest.mark.parametrize(
    "model",
    [
        make_pipeline(FunctionTransformer(log), linear_model.Ridge()), TransformedTargetRegressor(linear_model.Ridge(), func=np.log, inverse_func=exp),
        TransformedTargetRegressor(linear_model.Ridge(), transformer=StandardScalerOfMine()),
    ],
)
def test_a_name_alone_does_not_make_a_function_one_of_numpy(model):
    x = np.random.default_rng(0).uniform(0.5, 3.0, (200, 2))
    model.fit(x, np.exp(0.3 * x[:, 0] + 0.2 * x[:, 1]))
    with pytest.raises(metafmu.Error, match="(log|exp|StandardScaler) of "):
        metafmu.from_sklearn(model, data=x)


def test_the_same_function_of_scipy_is_read(rows, agrees):
    special = pytest.importorskip("scipy.special")
    x = np.abs(rows[0])
    model = make_pipeline(FunctionTransformer(special.log1p), linear_model.Ridge()).fit(x, rows[1])
    agrees(metafmu.from_sklearn(model, data=x), x, model.predict(x), 1e-12)


@pytest.mark.parametrize("kind", ["datetime64[s]", "timedelta64[s]", complex, object])
def test_what_is_no_number_is_refused(kind):
    frame, y = flow_and_temp()
    model = linear_model.Ridge().fit(frame, y)
    surrogate = metafmu.from_sklearn(model, data=frame)
    bad = frame.astype(int).astype("datetime64[s]").astype(object) if kind is object else frame.astype(int).astype(kind)
    for use in (
        surrogate.predict, lambda rows: surrogate.predict(rows.to_numpy()), lambda rows: metafmu.from_sklearn(model, data=rows), lambda rows: metafmu.fit(rows, y),
        lambda rows: metafmu.fit(frame, rows["flow"]), lambda rows: surrogate.evaluate(frame, rows["flow"]),
    ):
        with pytest.raises(metafmu.Error, match="expected real numbers"):
            use(bad)
    if kind in ("datetime64[s]", "timedelta64[s]"):
        with pytest.raises(metafmu.Error, match="expected real numbers"):
            metafmu.Regressor().fit(bad, y)


def test_names_are_given_as_a_dict_a_series_or_a_list(rows):
    model = linear_model.Ridge().fit(*rows)
    of = lambda names: [(item.name, item.unit) for item in metafmu.from_sklearn(model, inputs=names, data=rows[0]).inputs]
    units = {"a": "m", "b": "s", "c": "kg"}
    assert of(units) == of(types.MappingProxyType(units)) == of(pandas.Series(units)) == list(units.items())
    assert of(units.keys()) == of(pandas.Index(["a", "b", "c"])) == of(("a", "b", "c")) == [("a", ""), ("b", ""), ("c", "")]
    for wrong in ({"a", "b", "c"}, (name for name in "abc"), 3):
        with pytest.raises(metafmu.Error, match="inputs: .*expected a list of names"):
            of(wrong)


def test_rows_in_the_place_of_names_are_the_data(rows):
    model = linear_model.Ridge().fit(*rows)
    expected = metafmu.from_sklearn(model, data=rows[0])
    for given in (rows[0], pandas.DataFrame(rows[0], columns=[item.name for item in expected.inputs])):
        surrogate = metafmu.from_sklearn(model, given)
        assert [(item.name, item.min, item.max) for item in surrogate.inputs] == [(item.name, item.min, item.max) for item in expected.inputs]
    with pytest.raises(metafmu.Error, match="inputs: a table of rows, as `data` is"):
        metafmu.from_sklearn(model, rows[0], data=rows[0])


@pytest.mark.parametrize("wrap", [lambda model: model, lambda model: make_pipeline(StandardScaler(), model), lambda model: GridSearchCV(make_pipeline(model), {}, cv=2), TransformedTargetRegressor])
def test_an_fmu_has_the_name_of_the_estimator_that_predicts(wrap, rows):
    model = wrap(linear_model.Ridge()).fit(*rows)
    assert metafmu.from_sklearn(model, data=rows[0]).name == "Ridge"
