"""Fitted estimators of scikit-learn, and boosted trees with its interface, read in double precision."""

from __future__ import annotations

import contextlib
import warnings
from typing import Any

import numpy as np

from . import _boosting, _metafmu
from ._graph import Graph
from ._interface import names_in
from ._comparison import DOUBLE, SINGLE
from ._reader import ReaderOptions, surrogate_of
from ._rows import Row, columns_of
from ._surrogate import Names, States, Surrogate, is_frame

Error = _metafmu.Error

_READERS = {
    "XGBRegressor": _boosting.xgboost,
    "XGBRFRegressor": _boosting.xgboost,
    "LGBMRegressor": _boosting.lightgbm,
    "CatBoostRegressor": _boosting.catboost,
}
_PACKAGES = ("sklearn", "xgboost", "lightgbm", "catboost", "metafmu")


def _reads(*names):
    def register(function):
        for name in names:
            _READERS[name] = function
        return function

    return register


def from_sklearn(
    model: Any, inputs: Names = None, outputs: Names = None, data: Any = None, *, states: States = None, sample: float | None = None,
    solver_step: float | None = None, name: str | None = None, description: str = "", step: float | None = None, stop: float = 1.0, domain: str = "data",
) -> Surrogate:
    """Returns the :class:`Surrogate` of a fitted regressor or pipeline of scikit-learn, XGBoost, LightGBM or CatBoost.

    The arguments are those of :func:`metafmu.from_torch`; rows in the place of ``inputs`` are taken for ``data``. A regressor of derivatives, or of next values, has ``states``. Its inputs have
    the names of the DataFrame that it was fitted to, or are ``x[0]``, ``x[1]`` and so on; its outputs are ``output``, or ``output[0]`` and
    so on.

    >>> model = make_pipeline(StandardScaler(), MLPRegressor()).fit(X, y)
    >>> metafmu.from_sklearn(model, data=X, outputs={"force": "N"}).export("model.fmu")
    >>> metafmu.from_sklearn(rate, inputs={"u": (-2, 2)}, states={"x[0]": {"derivative": "output", "start": 0.5}}).export("flow.fmu")

    Raises :class:`metafmu.Error` for an unknown estimator, with the known ones. Also raises if the surrogate and the estimator predict
    different outputs, which an unknown version of the library may cause.
    """
    options = ReaderOptions(inputs, outputs, data, states, sample, solver_step, name, description, step, stop, domain)
    inputs, data = options.inputs, options.data
    _check(model)
    count = _known(model, "n_features_in_")
    if count is None:
        raise Error(f"{type(model).__name__} is not fitted: expected one after `fit`")
    graph = Graph(count)
    value = _read(graph, model, 0)
    names, title = _names(model, count), _title(model)
    given = _as_given(names, inputs, data)
    # of ill-conditioned kernels more than rounding is left
    precision = (SINGLE if graph.is_single else DOUBLE)._replace(share=1e-3)
    return surrogate_of(
        graph, Row(graph, value, (1, graph.width(value))), options, title, what=title, predict=_predict(model, names, data), precision=precision,
        columns=(given or columns_of("x", count), given), producer="scikit-learn",
    )


def _predict(estimator, names, data):
    """Predictions of the estimator for rows, which get its column names if it has some."""
    frame = type(data) if is_frame(data) else None
    if names is not None and frame is None:
        # who chooses columns by name needs them
        with contextlib.suppress(ImportError):
            from pandas import DataFrame as frame

    def predict(rows):
        columns = rows if names is None or frame is None else frame({name: rows[:, place] for place, name in enumerate(names)})
        with warnings.catch_warnings():
            # rows without names, for an estimator that was fitted to names
            warnings.simplefilter("ignore")
            return estimator.predict(columns)

    return predict


def _known(estimator, *attributes):
    """First of these attributes that the estimator has, or that a part with the same input columns has: a wrapped estimator or a first
    step. None if none has one."""
    found = next((found for attribute in attributes if (found := getattr(estimator, attribute, None)) is not None), None)
    steps = [step for _, step in getattr(estimator, "steps", []) if not _does_nothing(step)]
    wrapped = [getattr(estimator, name, None) for name in ("best_estimator_", "regressor_", "estimator_")]
    for part in (*steps[:1], *wrapped, *getattr(estimator, "estimators_", [])[:1]):
        found = _known(part, *attributes) if found is None and part is not None else found
    return found


def _title(estimator):
    """Name of the class of an estimator, or of the one that a pipeline ends with or a search has found."""
    if steps := [step for _, step in getattr(estimator, "steps", []) if not _does_nothing(step)]:
        return _title(steps[-1])
    found = next((of for name in ("best_estimator_", "regressor_") if (of := getattr(estimator, name, None)) is not None), None)
    return type(estimator).__name__ if found is None else _title(found)


def _does_nothing(step):
    """Returns True if a step of a pipeline is None or a string, or a pipeline of such steps."""
    return step is None or isinstance(step, str) or hasattr(step, "steps") and all(_does_nothing(part) for _, part in step.steps)


def _names(estimator, count):
    """Names of the columns that the estimator was fitted to; None if they had none."""
    # those of CatBoost and LightGBM
    names = _known(estimator, "feature_names_in_", "feature_names_", "feature_name_")
    names = None if names is None else [str(name) for name in names]
    made_up = lambda place: (str(place), f"Column_{place}")
    return names if names and len(names) == count and any(name not in made_up(place) for place, name in enumerate(names)) else None


def _as_given(names, inputs, data):
    """The names as they are given: LightGBM has `_` for spaces."""
    given = [*names_in(inputs, "input"), *([str(name) for name in data.columns] if is_frame(data) else [])]
    written = {name.replace(" ", "_"): name for name in given}
    return None if names is None else [name if name in given else written.get(name, name) for name in names]


def _check(estimator):
    kind = type(estimator)
    # a class of somebody else may predict otherwise than the one it comes from
    if kind.__name__ in _READERS and kind.__module__.split(".")[0] in _PACKAGES:
        return _READERS[kind.__name__]
    if hasattr(estimator, "classes_") or kind.__name__.endswith("Classifier"):
        raise Error(f"{kind.__name__} is a classifier, expected a regressor: outputs of an FMU are numbers")
    raise Error(
        f"{kind.__name__} of {kind.__module__} is not known, expected one of {', '.join(sorted(_READERS))}; or convert it to ONNX and use from_onnx"
    )


def _read(graph, estimator, value):
    reader = _check(estimator)
    try:
        return reader(graph, estimator, value)
    except AttributeError as error:
        raise Error(f"{type(estimator).__name__} is not fitted, or of a version of scikit-learn that is not known: {error}") from error


# transformers


def _or(array, otherwise):
    return otherwise if array is None else np.asarray(array, dtype=np.float64)


def _kind(part):
    """Name of a class of scikit-learn, with its module if it is from a different package: there, the same name may mean something else."""
    kind = type(part)
    return kind.__name__ if kind.__module__.split(".")[0] in _PACKAGES else f"{kind.__name__} of {kind.__module__}"


def _scaling(estimator):
    """Factors, centres and offsets of a transformer that is linear in each column, ``factor (x - centre) + offset``.

    The centre is subtracted first, as numbers far from zero cancel otherwise.
    """
    name = _kind(estimator)
    if name == "StandardScaler":
        return 1.0 / _or(estimator.scale_, 1.0), _or(estimator.mean_ if estimator.with_mean else None, 0.0), 0.0
    if name == "MinMaxScaler":
        # as scikit-learn computes it, with the same rounding
        return np.asarray(estimator.scale_), 0.0, np.asarray(estimator.min_)
    if name == "MaxAbsScaler":
        return 1.0 / np.asarray(estimator.scale_), 0.0, 0.0
    if name == "RobustScaler":
        return 1.0 / _or(estimator.scale_ if estimator.with_scaling else None, 1.0), _or(estimator.center_ if estimator.with_centering else None, 0.0), 0.0
    return None


@_reads("StandardScaler", "MinMaxScaler", "MaxAbsScaler", "RobustScaler")
def _scaler(graph, estimator, value):
    factor, centre, offset = _scaling(estimator)
    scaled = graph.linear(graph.linear(value, 1.0, -np.asarray(centre)) if np.any(centre) else value, factor, offset)
    if getattr(estimator, "clip", False):
        low, high = estimator.feature_range if hasattr(estimator, "feature_range") else (-1.0, 1.0)
        scaled = graph.elementwise(scaled, "clip", low, high)
    return scaled


def _by_numpy(graph, function, value):
    """A function of numpy or scipy, number by number; functions with the same name from other modules are refused."""
    import scipy.special

    name = getattr(function, "__name__", repr(function))
    if not any(function is getattr(module, name, None) for module in (np, scipy.special)):
        name = f"{name} of {getattr(function, '__module__', '?')}"
    if name in ("exp", "log", "sin", "cos", "tanh", "absolute"):
        return graph.elementwise(value, "abs" if name == "absolute" else name)
    if name == "expm1":
        return graph.linear(graph.elementwise(value, "exp"), 1.0, -1.0)
    if name == "log1p":
        return graph.elementwise(graph.linear(value, 1.0, 1.0), "log")
    if name in ("square", "sqrt"):
        return graph.elementwise(value, "power", 2.0 if name == "square" else 0.5)
    raise Error(f"the function {name}, expected numpy's exp, expm1, log, log1p, square, sqrt, absolute, sin, cos or tanh")


@_reads("FunctionTransformer")
def _function(graph, estimator, value):
    if estimator.func is None:
        return value
    if estimator.kw_args:
        raise Error("a FunctionTransformer with kw_args, expected none")
    return _by_numpy(graph, estimator.func, value)


@_reads("PolynomialFeatures")
def _polynomial(graph, estimator, value):
    terms = [np.repeat(np.arange(len(powers)), powers) for powers in estimator.powers_]
    one = graph.constant([1.0])
    factor = lambda place: [(value, term[place]) if place < len(term) else (one, 0) for term in terms]
    product = graph.columns(factor(0))
    for place in range(1, max(map(len, terms))):
        product = graph.combine(product, graph.columns(factor(place)), "multiply")
    return product


@_reads("PCA")
def _pca(graph, estimator, value):
    weight = np.asarray(estimator.components_, dtype=np.float64)
    if estimator.whiten:
        scale = np.sqrt(estimator.explained_variance_)
        weight = weight / np.maximum(scale, np.finfo(scale.dtype).eps)[:, None]
    mean = _or(estimator.mean_, np.zeros(weight.shape[1]))
    return graph.affine(graph.linear(value, 1.0, -mean), weight)


@_reads("Pipeline")
def _pipeline(graph, estimator, value):
    for _, step in estimator.steps:
        if step is not None and not (isinstance(step, str) and step == "passthrough"):
            value = _read(graph, step, value)
    return value


@_reads("FeatureUnion")
def _union(graph, estimator, value):
    parts = []
    weights = estimator.transformer_weights or {}
    for name, step in estimator.transformer_list:
        if isinstance(step, str) and step == "drop":
            continue
        part = value if isinstance(step, str) else _read(graph, step, value)
        parts.append(graph.linear(part, weights[name]) if name in weights else part)
    return graph.concatenate(parts)


@_reads("ColumnTransformer")
def _columns(graph, estimator, value):
    weights = estimator.transformer_weights or {}
    parts = []
    for name, step, _ in estimator.transformers_:
        # names, slices, masks and functions became places
        columns = estimator._transformer_to_input_indices[name]
        if isinstance(step, str) and step == "drop" or not len(columns):
            continue
        part = graph.select(value, columns)
        if not isinstance(step, str):
            part = _read(graph, step, part)
        parts.append(graph.linear(part, weights[name]) if name in weights else part)
    return graph.concatenate(parts)


@_reads("PowerTransformer")
def _power(graph, estimator, value):
    lambdas = np.asarray(estimator.lambdas_, dtype=np.float64)
    one, minus = np.ones(len(lambdas)), -np.ones(len(lambdas))
    if estimator.method == "box-cox":
        powers = _box_cox(graph, value, lambdas)
    else:
        # Yeo and Johnson 2000: of (1 + x) where x is positive, of (1 - x) where it is negative; each is 0 where the other one is not
        above = _box_cox(graph, graph.linear(graph.elementwise(value, "relu"), one, one), lambdas)
        below = _box_cox(graph, graph.linear(graph.elementwise(graph.linear(value, minus), "relu"), one, one), 2.0 - lambdas)
        powers = graph.combine(above, below, "subtract")
    return _read(graph, estimator._scaler, powers) if estimator.standardize else powers


def _box_cox(graph, value, lambdas):
    """``(x^a - 1) / a``, the logarithm where a = 0, of positive numbers."""
    parts = []
    for place, exponent in enumerate(lambdas):
        part = graph.select(value, [place])
        if abs(exponent) < np.spacing(1.0):
            parts.append(graph.elementwise(part, "log"))
        else:
            parts.append(graph.linear(graph.elementwise(part, "power", exponent), 1.0 / exponent, -1.0 / exponent))
    return graph.concatenate(parts)


@_reads("RBFSampler")
def _random_kitchen_sinks(graph, estimator, value):
    waves = graph.affine(value, np.asarray(estimator.random_weights_).T, np.asarray(estimator.random_offset_))
    return graph.linear(graph.elementwise(waves, "cos"), np.sqrt(2.0 / estimator.n_components))


@_reads("Nystroem")
def _nystroem(graph, estimator, value):
    if estimator.kernel_params:
        raise Error("a Nystroem with kernel_params, expected gamma, coef0 and degree")
    vectors = np.asarray(estimator.components_, dtype=np.float64)
    gamma = 1.0 / vectors.shape[1] if estimator.gamma is None else estimator.gamma
    coef0, degree = (1.0 if estimator.coef0 is None else estimator.coef0), (3 if estimator.degree is None else estimator.degree)
    kernel = _kernel_of_vectors(graph, value, vectors, estimator.kernel, gamma, coef0, degree)
    return graph.affine(kernel, np.asarray(estimator.normalization_, dtype=np.float64))


@_reads("SelectKBest", "SelectPercentile", "SelectFromModel", "VarianceThreshold")
def _selection(graph, estimator, value):
    return graph.select(value, estimator.get_support(indices=True))


# linear models


def _affine(graph, value, coefficients, intercept):
    if hasattr(coefficients, "toarray"):
        coefficients = coefficients.toarray()
    weight = np.atleast_2d(np.asarray(coefficients, dtype=np.float64))
    return graph.affine(value, weight, np.broadcast_to(np.asarray(intercept, dtype=np.float64).ravel(), (len(weight),)))


@_reads(
    "LinearRegression", "Ridge", "RidgeCV", "Lasso", "LassoCV", "ElasticNet", "ElasticNetCV", "Lars", "LarsCV", "LassoLars", "LassoLarsCV",
    "LassoLarsIC", "OrthogonalMatchingPursuit", "OrthogonalMatchingPursuitCV", "BayesianRidge", "ARDRegression", "HuberRegressor",
    "SGDRegressor", "TheilSenRegressor", "MultiTaskLasso", "MultiTaskLassoCV", "MultiTaskElasticNet", "MultiTaskElasticNetCV",
    "QuantileRegressor", "LinearSVR", "PassiveAggressiveRegressor",
)
def _linear(graph, estimator, value):
    return _affine(graph, value, estimator.coef_, estimator.intercept_)


@_reads("PoissonRegressor", "GammaRegressor", "TweedieRegressor")
def _generalized(graph, estimator, value):
    return _linked(graph, estimator._base_loss.link, _affine(graph, value, estimator.coef_, estimator.intercept_))


def _linked(graph, link, value):
    name = _kind(link)
    if name == "IdentityLink":
        return value
    if name == "LogLink":
        return graph.elementwise(value, "exp")
    raise Error(f"a link function {name}, expected IdentityLink or LogLink")


@_reads("PLSRegression")
def _pls(graph, estimator, value):
    return _affine(graph, graph.linear(value, 1.0, -np.asarray(estimator._x_mean)), estimator.coef_, estimator.intercept_)


@_reads("RANSACRegressor")
def _ransac(graph, estimator, value):
    return _read(graph, estimator.estimator_, value)


@_reads("GridSearchCV", "RandomizedSearchCV", "HalvingGridSearchCV", "HalvingRandomSearchCV")
def _search(graph, estimator, value):
    return _read(graph, estimator.best_estimator_, value)


@_reads("DummyRegressor")
def _dummy(graph, estimator, value):
    return graph.constant(np.ravel(estimator.constant_))


# networks, kernels


@_reads("MLPRegressor")
def _mlp(graph, estimator, value):
    functions = {"logistic": "sigmoid", "tanh": "tanh", "relu": "relu", "identity": "identity", "exp": "exp"}
    last = len(estimator.coefs_) - 1
    for layer, (weight, bias) in enumerate(zip(estimator.coefs_, estimator.intercepts_)):
        value = graph.affine(value, np.asarray(weight, dtype=np.float64).T, np.asarray(bias, dtype=np.float64))
        activation = estimator.out_activation_ if layer == last else estimator.activation
        if activation not in functions:
            raise Error(f"an activation {activation}, expected one of {', '.join(functions)}")
        value = graph.elementwise(value, functions[activation])
    return value


@_reads("Regressor")
def _regressor(graph, estimator, value):
    return graph.surrogate(value, estimator.to_surrogate())


def _kernel_of_vectors(graph, value, vectors, kernel, gamma, coef0, degree):
    """Values of a kernel of libsvm for each of the vectors."""
    if kernel == "rbf":
        return graph.elementwise(graph.linear(graph.distances(value, vectors), -gamma), "exp")
    if kernel == "linear":
        return graph.affine(value, vectors)
    if kernel in ("poly", "polynomial", "sigmoid"):
        inner = graph.affine(value, gamma * vectors, np.full(len(vectors), float(coef0)))
        return graph.elementwise(inner, "tanh") if kernel == "sigmoid" else graph.elementwise(inner, "power", degree)
    raise Error(f"a kernel {kernel!r}, expected linear, poly, rbf or sigmoid")


@_reads("SVR", "NuSVR")
def _svr(graph, estimator, value):
    vectors = estimator.support_vectors_
    if not vectors.shape[0]:
        # all rows are within epsilon of the intercept
        return graph.constant(np.ravel(estimator.intercept_))
    if hasattr(vectors, "toarray"):
        raise Error("support vectors in a sparse matrix, expected an estimator that was fitted to an array")
    kernel = _kernel_of_vectors(graph, value, np.asarray(vectors), estimator.kernel, estimator._gamma, estimator.coef0, estimator.degree)
    return _affine(graph, kernel, estimator.dual_coef_, estimator.intercept_)


@_reads("KernelRidge")
def _kernel_ridge(graph, estimator, value):
    vectors = np.asarray(estimator.X_fit_, dtype=np.float64)
    gamma = 1.0 / vectors.shape[1] if estimator.gamma is None else estimator.gamma
    kernel = _kernel_of_vectors(graph, value, vectors, estimator.kernel, gamma, estimator.coef0, estimator.degree)
    return _affine(graph, kernel, np.asarray(estimator.dual_coef_).T, 0.0)


@_reads("GaussianProcessRegressor")
def _gaussian_process(graph, estimator, value):
    points = np.asarray(estimator.X_train_, dtype=np.float64)
    alpha = np.asarray(estimator.alpha_, dtype=np.float64).reshape(len(points), -1)
    scale, mean = np.ravel(estimator._y_train_std), np.ravel(estimator._y_train_mean)
    kind, kernel = _kernel(graph, estimator.kernel_, value, points)
    if kind == "number":
        kernel = graph.constant(np.full(len(points), kernel))
    weight = alpha.T * np.broadcast_to(scale, (alpha.shape[1],))[:, None]
    return _affine(graph, kernel, weight, np.broadcast_to(mean, (alpha.shape[1],)))


_KERNELS = "RBF, Matern (0.5, 1.5, 2.5, inf), RationalQuadratic, ConstantKernel, WhiteKernel, DotProduct, Sum, Product, Exponentiation"


def _kernel(graph, kernel, value, points):
    """A number, or the value with the kernel between the inputs and each of the points."""
    name = _kind(kernel)
    if name == "ConstantKernel":
        return "number", float(kernel.constant_value)
    if name == "WhiteKernel":
        # of different points
        return "number", 0.0
    if name in ("Sum", "Product"):
        parts = [_kernel(graph, part, value, points) for part in (kernel.k1, kernel.k2)]
        numbers = [part for kind, part in parts if kind == "number"]
        values = [part for kind, part in parts if kind == "value"]
        if len(numbers) == 2:
            return "number", numbers[0] + numbers[1] if name == "Sum" else numbers[0] * numbers[1]
        if numbers:
            return "value", graph.linear(values[0], 1.0, numbers[0]) if name == "Sum" else graph.linear(values[0], numbers[0])
        return "value", graph.combine(*values, "add" if name == "Sum" else "multiply")
    if name == "Exponentiation":
        kind, base = _kernel(graph, kernel.kernel, value, points)
        return (kind, base**kernel.exponent) if kind == "number" else (kind, graph.elementwise(base, "power", kernel.exponent))
    if name == "DotProduct":
        return "value", graph.affine(value, points, np.full(len(points), float(kernel.sigma_0) ** 2))
    if name == "RationalQuadratic":
        squares = graph.distances(value, points, kernel.length_scale)
        return "value", graph.elementwise(graph.linear(squares, 0.5 / kernel.alpha, 1.0), "power", -kernel.alpha)
    if name == "RBF" or name == "Matern" and kernel.nu == np.inf:
        squares = graph.distances(value, points, kernel.length_scale)
        return "value", graph.elementwise(graph.linear(squares, -0.5), "exp")
    if name == "Matern" and kernel.nu in (0.5, 1.5, 2.5):
        # the slope of the root is finite at the points themselves, where the squares have the slope 0
        squares = graph.linear(graph.distances(value, points, kernel.length_scale), 2.0 * kernel.nu, 1e-200)
        distance = graph.elementwise(squares, "power", 0.5)
        decay = graph.elementwise(graph.linear(distance, -1.0), "exp")
        if kernel.nu == 0.5:
            return "value", decay
        factor = graph.linear(distance, 1.0, 1.0)
        if kernel.nu == 2.5:
            factor = graph.combine(factor, graph.linear(squares, 1.0 / 3.0), "add")
        return "value", graph.combine(factor, decay, "multiply")
    about = f" with nu = {kernel.nu}" if name == "Matern" else ""
    raise Error(f"a kernel {name}{about}, expected sums and products of {_KERNELS}")


# trees


def _tree(tree, scale=1.0):
    """The trees of an estimator's `tree_`, one for each output."""
    left, right = tree.children_left, tree.children_right
    leaf = left < 0
    values = tree.value[:, :, 0]
    threshold = _finite(tree.threshold)
    return [
        {
            "left": left,
            "right": right,
            "column": np.where(leaf, -1, tree.feature),
            "number": np.where(leaf, scale * values[:, output], threshold),
            "output": output,
        }
        for output in range(values.shape[1])
    ]


def _finite(thresholds):
    """Finite thresholds: a split that separates only missing values has an infinite one."""
    largest = np.finfo(np.float64).max
    return np.clip(thresholds, -largest, largest)


def _rounded(graph, value):
    # trees compare inputs in single precision with thresholds in double precision
    return graph.elementwise(value, "single")


@_reads("DecisionTreeRegressor", "ExtraTreeRegressor")
def _decision_tree(graph, estimator, value):
    return graph.forest(_rounded(graph, value), _tree(estimator.tree_), estimator.n_outputs_)


@_reads("RandomForestRegressor", "ExtraTreesRegressor")
def _random_forest(graph, estimator, value):
    share = 1.0 / len(estimator.estimators_)
    trees = [tree for member in estimator.estimators_ for tree in _tree(member.tree_, share)]
    return graph.forest(_rounded(graph, value), trees, estimator.n_outputs_)


@_reads("GradientBoostingRegressor")
def _gradient_boosting(graph, estimator, value):
    trees = [tree for member in estimator.estimators_[:, 0] for tree in _tree(member.tree_, estimator.learning_rate)]
    # the first estimator gets rounded inputs as well
    value = _rounded(graph, value)
    sums = graph.forest(value, trees)
    if isinstance(estimator.init_, str):
        return sums
    if type(estimator.init_).__name__ == "DummyRegressor":
        return graph.linear(sums, 1.0, float(np.ravel(estimator.init_.constant_)[0]))
    # scikit-learn computes it of rounded inputs
    graph.is_single = True
    return graph.combine(sums, _read(graph, estimator.init_, value), "add")


@_reads("HistGradientBoostingRegressor")
def _histogram_boosting(graph, estimator, value):
    if estimator.is_categorical_ is not None and np.any(estimator.is_categorical_):
        raise Error("HistGradientBoostingRegressor with categorical columns, expected numbers only")
    trees = []
    for (predictor,) in estimator._predictors:
        nodes = predictor.nodes
        leaf = nodes["is_leaf"].astype(bool)
        trees.append(
            {
                "left": nodes["left"].astype(np.int64),
                "right": nodes["right"].astype(np.int64),
                "column": np.where(leaf, -1, nodes["feature_idx"].astype(np.int64)),
                "number": np.where(leaf, nodes["value"], _finite(nodes["num_threshold"])),
            }
        )
    baseline = float(np.ravel(estimator._baseline_prediction)[0])
    sums = graph.linear(graph.forest(value, trees), 1.0, baseline) if trees else graph.constant([baseline])
    return _linked(graph, estimator._loss.link, sums)


# several of them


def _mean(graph, values, weights=None):
    """A weighted mean of values of one length."""
    weights = np.ones(len(values)) if weights is None else np.asarray(weights, dtype=np.float64)
    width = graph.width(values[0])
    weight = np.kron((weights / weights.sum())[None, :], np.eye(width))
    return graph.affine(graph.concatenate(values), weight)


@_reads("BaggingRegressor")
def _bagging(graph, estimator, value):
    everything = list(range(graph.width(value)))
    part = lambda places: value if list(places) == everything else graph.select(value, places)
    members = zip(estimator.estimators_, estimator.estimators_features_)
    return _mean(graph, [_read(graph, member, part(places)) for member, places in members])


@_reads("VotingRegressor")
def _voting(graph, estimator, value):
    return _mean(graph, [_read(graph, member, value) for member in estimator.estimators_], estimator._weights_not_none)


@_reads("StackingRegressor")
def _stacking(graph, estimator, value):
    parts = [_read(graph, member, value) for member in estimator.estimators_]
    if estimator.passthrough:
        parts.append(value)
    return _read(graph, estimator.final_estimator_, graph.concatenate(parts))


@_reads("MultiOutputRegressor")
def _multi_output(graph, estimator, value):
    return graph.concatenate([_read(graph, member, value) for member in estimator.estimators_])


@_reads("TransformedTargetRegressor")
def _transformed_target(graph, estimator, value):
    value = _read(graph, estimator.regressor_, value)
    return _inverse(graph, estimator.transformer_, value)


def _inverse(graph, transformer, value):
    """Inverse of a transformer of targets."""
    scaling = _scaling(transformer)
    if scaling is not None:
        if getattr(transformer, "clip", False):
            raise Error(f"a {type(transformer).__name__} of targets with clip=True, expected one that is linear")
        factor, centre, offset = (np.asarray(part, dtype=np.float64) for part in scaling)
        return graph.linear(value, 1.0 / factor, centre - offset / factor)
    name = _kind(transformer)
    if name == "Pipeline":
        for _, step in reversed(transformer.steps):
            value = _inverse(graph, step, value)
        return value
    if name == "FunctionTransformer":
        return value if transformer.inverse_func is None else _by_numpy(graph, transformer.inverse_func, value)
    raise Error(
        f"targets by {name}, expected StandardScaler, MinMaxScaler, MaxAbsScaler, RobustScaler, a Pipeline of them, or functions of numpy"
    )
