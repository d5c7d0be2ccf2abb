"""Models that are fitted here: networks, Gaussian processes, polynomials and so on."""

from __future__ import annotations

import json
import numbers
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from . import _metafmu
from ._interface import as_bytes, interface, number
from ._surrogate import Names, Surrogate, numbers_of

try:
    from sklearn.base import BaseEstimator, RegressorMixin
    from sklearn.utils.validation import check_is_fitted, validate_data
except ImportError:  # scikit-learn is optional

    class RegressorMixin:
        def score(self, X, y, sample_weight=None):
            """The coefficient of determination of the predictions, the mean over the outputs."""
            y, found = np.asarray(y, dtype=np.float64), self.predict(X)
            weights = np.ones(len(y)) if sample_weight is None else np.asarray(sample_weight, dtype=np.float64)
            y, found = y.reshape(len(y), -1), found.reshape(len(y), -1)
            spread = np.sum(weights[:, None] * (y - np.average(y, axis=0, weights=weights)) ** 2, axis=0)
            return float(np.mean(1.0 - np.sum(weights[:, None] * (y - found) ** 2, axis=0) / spread))

    class BaseEstimator:
        def get_params(self, deep=True):
            """The parameters of the constructor."""
            return {name: getattr(self, name) for name in _PARAMETERS}

        def set_params(self, **parameters):
            """Sets parameters of the constructor."""
            for name, value in parameters.items():
                if name not in _PARAMETERS:
                    raise ValueError(f"Invalid parameter {name!r} for estimator {type(self).__name__}")
                setattr(self, name, value)
            return self

    def check_is_fitted(estimator):
        if not hasattr(estimator, "surrogate_"):
            raise _metafmu.Error(f"this {type(estimator).__name__} is not fitted yet: expected `fit` first")

    def validate_data(estimator, X, y=None, reset=True, **_):
        names = [str(column) for column in X.columns] if hasattr(X, "columns") else None
        x = np.asarray(X, dtype=np.float64)
        if x.ndim != 2 or not len(x) or not np.isfinite(x).all():
            raise _metafmu.Error(f"X has the shape {x.shape}, expected finite numbers of shape (rows, columns)")
        if reset:
            estimator.n_features_in_ = x.shape[1]
            vars(estimator).pop("feature_names_in_", None)
            if names is not None:
                estimator.feature_names_in_ = np.array(names, dtype=object)
        else:
            if x.shape[1] != estimator.n_features_in_:
                raise _metafmu.Error(f"X has {x.shape[1]} columns, expected {estimator.n_features_in_}")
            known = getattr(estimator, "feature_names_in_", None)
            if names is not None and known is not None and names != list(known):
                raise _metafmu.Error(f"X has the columns {', '.join(names[:20])}, expected those that it was fitted to, in their order: {', '.join(known[:20])}")
        if y is None:
            return x
        y = np.asarray(y, dtype=np.float64)
        if len(y) != len(x) or not np.isfinite(y).all():
            raise _metafmu.Error(f"y has the shape {y.shape}, expected finite numbers in {len(x)} rows")
        return x, y


class AccuracyWarning(UserWarning):
    """Warning that a surrogate is hardly better than the mean."""


_PARAMETERS = ("hidden", "activation", "epochs", "batch", "learning_rate", "validation", "random_state", "training", "verbose", "model", "std")
# parameters of networks, which only a network can have in other than the default
_OF_NETWORKS = {"hidden": (64, 64), "activation": "tanh", "epochs": None, "batch": 256, "learning_rate": 5e-3, "training": None}


class Regressor(RegressorMixin, BaseEstimator):
    """A regression model: a network, a Gaussian process, a polynomial or another kind. An estimator of scikit-learn, if that is installed.

    ``model``: ``"auto"`` compares a polynomial, a Gaussian process (of up to 1000 rows) and a network on held-out rows and fits the best to
    all rows. Other values are ``"network"`` and the names of baselines, which have their default options: ``"gaussian-process"``,
    ``"polynomial"``, ``"linear"``, ``"ridge"``, ``"lasso"``, ``"elastic-net"``, ``"svr"``, ``"decision-tree"``, ``"random-forest"``,
    ``"extra-trees"``, ``"gradient-boosting"``. The default is ``"auto"``, or ``"network"`` if a parameter of networks differs from its
    default.

    Networks of few rows are small and trained by Levenberg-Marquardt steps with Bayesian regularization; their hidden layers are chosen
    unless ``hidden`` is given. Networks of many rows are trained by SOAP in single precision, and so are those of few rows if one of
    ``epochs``, ``batch``, ``learning_rate`` and ``training`` differs from its default.

    Parameters of networks:

    - ``hidden``: nodes of each hidden layer
    - ``activation``: tanh, sigmoid, relu, gelu, silu or sine
    - ``epochs``: maximum number of passes over the rows; by default 150, for few rows the number that makes 2000 steps
    - ``batch``: rows of a step
    - ``learning_rate``
    - ``training``: further keys of `[training]` in a study file, as a dict

    ``std``: fit a Gaussian process, to at most 1000 rows, that predicts standard deviations. They are returned by ``predict(X,
    return_std=True)`` and are outputs ``NAME_std`` of the FMU.

    ``validation``: share of the rows held out to choose the best epoch and, for 1000 or more rows, the kind of model; ``random_state``: an
    integer, 0 by default; ``verbose``: lines of progress on stderr.

    >>> model = metafmu.Regressor().fit(X, y)
    >>> model.model_                            # "gaussian-process", say
    >>> model.score(X_test, y_test)
    >>> model.export("model.fmu")

    Attributes after `fit`:

    - `surrogate_`
    - `model_`: kind of model
    - `candidates_`: list of dicts with ``model``, ``one_minus_r2`` (mean over outputs of 1 - R² on unseen rows), ``fit_seconds`` (processor time), ``note``
    - `history_`: dict with the losses of each epoch; its lists are empty unless a network was trained in epochs
    - `n_features_in_` and, for a DataFrame, `feature_names_in_`
    """

    def __init__(self, hidden=(64, 64), activation="tanh", epochs=None, batch=256, learning_rate=5e-3, validation=0.1, random_state=None,
                 training=None, verbose=False, model=None, std=False):
        self.hidden = hidden
        self.activation = activation
        self.epochs = epochs
        self.batch = batch
        self.learning_rate = learning_rate
        self.validation = validation
        self.random_state = random_state
        self.training = training
        self.verbose = verbose
        self.model = model
        self.std = std

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.target_tags.multi_output = True
        return tags

    def fit(self, X, y):
        """Fits the model and returns it.

        ``X``: shape (rows, inputs); ``y``: shape (rows,) or (rows, outputs). Both are arrays or DataFrames of finite numbers, else a
        ValueError is raised.
        """
        names = [str(name) for name in y.columns] if hasattr(y, "columns") else [str(y.name)] if getattr(y, "name", None) else None
        _refuse_times(X, y)
        x, y = validate_data(self, X, y, multi_output=True, y_numeric=True, dtype=np.float64)
        y = np.asarray(y, dtype=np.float64)
        self._is_vector = y.ndim == 1
        columns = y.reshape(len(y), -1)
        features = getattr(self, "feature_names_in_", None)
        self._names = None if features is None else [str(name) for name in features], names if names and len(names) == columns.shape[1] else None
        self.surrogate_, self.history_ = self._trained(x, columns)
        self.model_, self.candidates_ = self.surrogate_.model, self.surrogate_.candidates
        return self

    def _trained(self, x, y, measure=False, **about):
        about = {"inputs": None, "outputs": None, "name": "surrogate", "description": "", "step": 0.01, "stop": 1.0, **about}
        if not isinstance(self.training or {}, Mapping):
            raise _metafmu.Error(f"training: {self.training!r}, expected a dict with keys of [training]")
        inputs, outputs = self._names
        text, rows = interface(x.shape[1], y.shape[1], data=x, input_names=inputs, output_names=outputs, **about)
        options = {
            "model": self._kind(),
            "std": bool(self.std),
            "network": {"hidden": [_whole(nodes, "hidden") for nodes in np.atleast_1d(np.asarray(self.hidden, dtype=object)).ravel()], "activation": self.activation},
            "training": {
                "epochs": self._epochs(len(x)), "batch": _whole(self.batch, "batch"), "learning_rate": number(self.learning_rate, "learning_rate"),
                "validation": number(self.validation, "validation"),
                # of few rows the losses of restarts go up and down too much to judge by
                "schedule": "cosine", **(self.training or {}),
            },
            "small_networks": self._small_networks(),
            "seed": self._seed(),
            "measure": measure,
        }
        core, fit = _metafmu.fit(as_bytes(rows), np.ascontiguousarray(y).tobytes(), text, json.dumps(options), bool(self.verbose))
        fit = json.loads(fit)
        return Surrogate(core, fit.pop("accuracy"), {key: fit.pop(key) for key in ("model", "candidates")}), fit

    def _kind(self):
        """Kind of model: a network if a parameter of networks is given."""
        given = [name for name, default in _OF_NETWORKS.items() if not _is_same(getattr(self, name), default)]
        if self.model is None:
            return "network" if given else "auto"
        if not isinstance(self.model, str):
            raise _metafmu.Error(f"model: {self.model!r}, expected None or a text: \"auto\", \"network\", \"gaussian-process\", ...")
        if given and self.model not in ("auto", "network"):
            raise _metafmu.Error(f"{', '.join(given)}: belongs to networks, expected the default with model=\"{self.model}\"")
        return self.model

    def _small_networks(self):
        """Networks of few rows that are trained by Levenberg-Marquardt steps: none if a parameter of the training is given."""
        given = {name for name, default in _OF_NETWORKS.items() if not _is_same(getattr(self, name), default)}
        if given & {"epochs", "batch", "learning_rate", "training"}:
            return "never"
        return "of-given-size" if "hidden" in given else "of-chosen-size"

    def _epochs(self, rows):
        if self.epochs is not None:
            return _whole(self.epochs, "epochs")
        steps = max(1, -(-int(rows * (1.0 - number(self.validation, "validation"))) // max(1, _whole(self.batch, "batch"))))
        return max(150, -(-2000 // steps))

    def _seed(self):
        if self.random_state is None:
            return 0
        if isinstance(self.random_state, numbers.Integral):
            return int(self.random_state)
        if not hasattr(self.random_state, "randint"):
            raise _metafmu.Error(f"random_state: {self.random_state!r}, expected an integer, a RandomState of numpy or None")
        return int(self.random_state.randint(2**31 - 1))

    def predict(self, X, return_std=False):
        """Predicts outputs for rows of inputs, of shape (rows,) or (rows, outputs) as ``y`` was. With ``return_std`` it also returns the
        predicted standard deviation of a new observation, noise included, in the same shape, for a model fitted with ``std=True``.

        Raises an error if the model is not fitted, or if ``X`` has other columns than in :meth:`Regressor.fit`.
        """
        check_is_fitted(self)
        _refuse_times(X)
        x = validate_data(self, X, reset=False, dtype=np.float64)
        found = self.surrogate_.predict(x, return_std)
        shaped = (lambda columns: columns[:, 0]) if self._is_vector else (lambda columns: columns)
        return tuple(map(shaped, found)) if return_std else shaped(found)

    def to_surrogate(self):
        """The fitted model as a :class:`Surrogate`."""
        check_is_fitted(self)
        return self.surrogate_

    def export(self, path, **options):
        """Writes FMUs and returns their paths. ``path`` and ``options`` are the arguments of :meth:`Surrogate.export`."""
        return self.to_surrogate().export(path, **options)


def _refuse_times(*arrays):
    """Raises for dates and durations, which scikit-learn would convert to numbers."""
    for array in arrays:
        kinds = np.ravel(np.array(getattr(array, "dtypes", getattr(array, "dtype", None)), dtype=object))
        if wrong := [kind for kind in kinds if getattr(kind, "kind", "f") in "mM"]:
            raise _metafmu.Error(f"rows of the type {wrong[0]}, expected real numbers")


def _is_same(value, default):
    if isinstance(default, tuple):
        return isinstance(value, (tuple, list, np.ndarray)) and list(value) == list(default)
    return value is None or value == {} if default is None else value == default


def _whole(value, what):
    if not isinstance(value, numbers.Integral) or isinstance(value, bool) or value < 0:
        raise _metafmu.Error(f"{what}: {value!r}, expected a whole number")
    return int(value)


def fit(
    X: Any,
    y: Any,
    inputs: Names = None,
    outputs: Names = None,
    *,
    name: str = "surrogate",
    description: str = "",
    step: float = 0.01,
    stop: float = 1.0,
    domain: str = "data",
    **options: Any,
) -> Surrogate:
    """Fits a model to rows of inputs and outputs; returns a :class:`Surrogate`.

    ``X``, ``y``: arrays or DataFrames. ``inputs``, ``outputs``: names, or dicts of names to units, ranges or dicts; by default the names of
    the DataFrames. ``options``: those of :class:`Regressor`, among them ``model``, by default the best of a polynomial, a Gaussian process
    and a network on unseen rows, and ``std``, predicted standard deviations.

    A share of the rows is held out: half of them choose the kind of model and the best epoch, the other half measure `Surrogate.accuracy`.
    With fewer than 1000 rows, five-fold cross-validation does both: each row is predicted by a model fitted without it, of the kind chosen
    by the other folds. An :class:`AccuracyWarning` names outputs of which less than half of the variance is explained.

    Raises :class:`metafmu.Error` for rows that do not match, numbers that are not finite, and if no kind of model can be fitted.

    >>> surrogate = metafmu.fit(frame[["x", "v"]], frame["force"], outputs={"force": "N"})
    >>> surrogate.model, surrogate.candidates       # the kind of model, and how the others compare
    >>> surrogate.accuracy["force"]["r2"]
    >>> surrogate.export("force.fmu")
    """
    model = Regressor(**options)
    names = [str(part) for part in y.columns] if hasattr(y, "columns") else [str(y.name)] if getattr(y, "name", None) else None
    x, columns = numbers_of(X, "X"), numbers_of(y, "y")
    if columns.ndim not in (1, 2):
        raise _metafmu.Error(f"y has the shape {columns.shape}, expected (rows, outputs)")
    columns = columns.reshape(len(columns), -1) if len(columns) else columns.reshape(0, 1)
    if x.ndim != 2 or len(x) != len(columns) or not len(x):
        raise _metafmu.Error(f"X has the shape {x.shape} and y {np.shape(y)}, expected (rows, inputs) and as many rows of outputs")
    if not np.isfinite(columns).all():
        raise _metafmu.Error("y has numbers that are not finite")
    model._names = [str(column) for column in X.columns] if hasattr(X, "columns") else None, names
    surrogate, _ = model._trained(x, columns, measure=True, inputs=inputs, outputs=outputs, name=name, description=description, step=step, stop=stop, domain=domain)
    measured = surrogate.accuracy or {}
    spread = dict(zip(measured, columns.std(axis=0)))
    # of equal rows there is no R²
    r2 = {name: of["r2"] if of["r2"] is not None else 1.0 - (of["rmse"] / max(spread[name], 1e-300)) ** 2 for name, of in measured.items()}
    poor = [f"`{name}` {value:.3g}" for name, value in r2.items() if value < 0.5 and spread[name] > 0.0]
    if poor:
        message = f"a poor surrogate: R² on unseen rows of {', '.join(poor)}, where the mean would have 0; more rows, or other inputs, may be needed"
        warnings.warn(message, AccuracyWarning, stacklevel=2)
    return surrogate
