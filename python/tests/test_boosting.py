"""Boosted trees of XGBoost, LightGBM and CatBoost: the FMU predicts what they do."""

import numpy as np
import pytest
from conftest import flow_and_temp

import metafmu

lightgbm = pytest.importorskip("lightgbm")
xgboost = pytest.importorskip("xgboost")
catboost = pytest.importorskip("catboost")
pandas = pytest.importorskip("pandas")

from sklearn.ensemble import StackingRegressor
from sklearn.linear_model import Ridge
from sklearn.multioutput import MultiOutputRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

XGB, LGBM = {"n_estimators": 30, "max_depth": 4}, {"n_estimators": 30, "verbose": -1, "min_child_samples": 5}
CATBOOST = {"iterations": 30, "verbose": 0, "allow_writing_files": False}


def xgb(**options):
    return xgboost.XGBRegressor(**{**XGB, **options})


def lgbm(**options):
    return lightgbm.LGBMRegressor(**{**LGBM, **options})


def cat(**options):
    return catboost.CatBoostRegressor(**{**CATBOOST, **options})


# name: estimator, which outputs it is fitted to, its precision
MODELS = {
    "xgboost": (xgb(), "one", 1e-6),
    **{f"xgboost-{loss}": (xgb(objective=loss), "positive", 1e-6) for loss in ("reg:absoluteerror", "reg:pseudohubererror", "count:poisson", "reg:gamma", "reg:tweedie")},
    "xgboost-logistic": (xgb(objective="reg:logistic"), "share", 1e-6),
    "xgboost-quantiles": (xgb(objective="reg:quantileerror", quantile_alpha=[0.2, 0.8]), "one", 1e-6),
    "xgboost-outputs": (xgb(), "several", 1e-6),
    "xgboost-dart": (xgb(booster="dart", rate_drop=0.3), "one", 1e-6),
    "xgboost-forest": (xgboost.XGBRFRegressor(n_estimators=20), "one", 1e-6),
    "xgboost-parallel": (xgb(num_parallel_tree=3, base_score=0.7), "one", 1e-6),
    "xgboost-pipeline": (make_pipeline(StandardScaler(), xgb()), "one", 1e-6),
    "lightgbm": (lgbm(), "one", 1e-12),
    **{f"lightgbm-{loss}": (lgbm(objective=loss), "positive", 1e-12) for loss in ("l1", "huber", "quantile", "poisson", "gamma", "tweedie")},
    "lightgbm-dart": (lgbm(boosting_type="dart"), "one", 1e-12),
    "lightgbm-forest": (lgbm(boosting_type="rf", subsample=0.5, subsample_freq=1), "one", 1e-12),
    "lightgbm-outputs": (MultiOutputRegressor(lgbm()), "several", 1e-12),
    "lightgbm-stacked": (StackingRegressor([("a", lgbm()), ("b", Ridge())]), "one", 1e-12),
    "catboost": (cat(), "one", 1e-12),
    **{f"catboost-{loss}": (cat(loss_function=loss), "positive", 1e-12) for loss in ("MAE", "Quantile:alpha=0.3", "Poisson", "Tweedie:variance_power=1.5")},
    "catboost-outputs": (cat(loss_function="MultiRMSE"), "several", 1e-12),
    "catboost-by-depth": (cat(grow_policy="Depthwise"), "one", 1e-12),
    "catboost-by-loss": (cat(grow_policy="Lossguide"), "one", 1e-12),
}


def targets(y, kind):
    one = y[:, 0]
    return {"several": y, "one": one, "positive": np.exp(one), "share": (one - one.min()) / np.ptp(one)}[kind]


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", MODELS)
def test_the_fmu_predicts_what_the_trees_do(name, rows, agrees):
    model, kind, tolerance = MODELS[name]
    x, y = rows
    model.fit(x, targets(y, kind))
    unseen = np.random.default_rng(2).uniform(x.min(axis=0), x.max(axis=0), (300, 3))
    surrogate = metafmu.from_sklearn(model, data=x)
    agrees(surrogate, unseen, model.predict(unseen), tolerance)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("make", [xgb, lgbm, cat])
def test_thresholds_are_compared_as_there(make, rows):
    """Inputs that are single-precision neighbors of thresholds."""
    x, y = rows[0].astype(np.float32), rows[1][:, 0]
    x = np.round(x, 1)
    model = make().fit(x, y)
    places = np.concatenate([x, np.nextafter(x, np.float32(9)), np.nextafter(x, np.float32(-9)), x + np.float32(0.05)])
    found, expected = metafmu.from_sklearn(model, data=x).predict(places)[:, 0], model.predict(places)
    assert np.abs(found - expected).max() <= 1e-6 * np.ptp(expected)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("make", [xgb, lgbm])
def test_a_training_that_was_stopped_early_counts_up_to_its_best_round(make, rows, agrees):
    x, y = rows[0], rows[1][:, 0] + np.random.default_rng(3).normal(scale=0.5, size=len(rows[0]))
    if make is xgb:
        model = xgb(n_estimators=300, learning_rate=0.5, early_stopping_rounds=3).fit(x[:100], y[:100], eval_set=[(x[100:], y[100:])], verbose=0)
        assert model.best_iteration + 1 < model.get_booster().num_boosted_rounds()
    else:
        stop = lightgbm.early_stopping(3, verbose=False)
        model = lgbm(n_estimators=300, learning_rate=0.5).fit(x[:100], y[:100], eval_set=[(x[100:], y[100:])], callbacks=[stop])
        assert model.best_iteration_ < 300
    agrees(metafmu.from_sklearn(model, data=x), x, model.predict(x), 1e-6)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("make", [xgb, lgbm, cat])
def test_names_are_those_of_a_data_frame(make, rows):
    # LightGBM replaces spaces
    frame = pandas.DataFrame(rows[0], columns=["x", "v", "mass of it"])
    surrogate = metafmu.from_sklearn(make().fit(frame, rows[1][:, 0]), data=frame)
    assert [item.name.replace("_", " ") for item in surrogate.inputs] == ["x", "v", "mass of it"]


@pytest.mark.filterwarnings("ignore")
def test_what_cannot_be_read_is_refused(rows):
    x, y = rows
    one = y[:, 0]
    kinds = pandas.DataFrame({"a": pandas.Categorical(np.arange(200) % 5), "b": x[:, 1]})
    of_kinds = one + np.array([0.0, 3.0, 1.0, 4.0, 2.0])[np.arange(200) % 5]
    for model, message in [
        (xgb(booster="gblinear", max_depth=None).fit(x, one), "booster='gblinear', expected trees"),
        (xgb(multi_strategy="multi_output_tree", tree_method="hist").fit(x, y), "multi_output_tree"),
        (xgb(missing=0.0).fit(x, one), "missing=0.0, expected nan"),
        (xgb(enable_categorical=True).fit(kinds, of_kinds), "categorical columns"),
        (lgbm(linear_tree=True).fit(x, one), "linear_tree=True"),
        (lgbm(reg_sqrt=True).fit(x, one), "reg_sqrt=True"),
        (lgbm(min_data_per_group=1, cat_smooth=0).fit(kinds, of_kinds), "categorical columns"),
        (cat(loss_function="RMSEWithUncertainty").fit(x, one), "a loss RMSEWithUncertainty, expected one of RMSE"),
        (cat(cat_features=[0]).fit(kinds.astype({"a": int}), of_kinds), "categorical, text or embedding"),
        (xgb(), "XGBRegressor is not fitted"),
        (xgboost.XGBClassifier(n_estimators=3).fit(x, one > 0), "XGBClassifier is a classifier, expected a regressor"),
    ]:
        with pytest.raises(metafmu.Error, match=message):
            metafmu.from_sklearn(model, data=x)


@pytest.mark.parametrize("make", [cat, lgbm, xgb, lambda: make_pipeline("passthrough", cat()), lambda: StackingRegressor([("one", cat())])])
@pytest.mark.parametrize("knows", [True, False])
def test_columns_go_by_the_names_that_trees_know(make, knows, goes_by_names):
    frame, y = flow_and_temp()
    model = make().fit(frame if knows else frame.to_numpy(), y)
    goes_by_names(lambda **names: metafmu.from_sklearn(model, **names), lambda rows: model.predict(rows if knows else rows.to_numpy()), 1e-6, knows)


def test_lightgbm_has_no_spaces_in_its_names():
    frame, y = flow_and_temp()
    frame = frame.rename(columns={"flow": "flow rate"})
    surrogate = metafmu.from_sklearn(lgbm().fit(frame, y), data=frame[["temp", "flow rate"]])
    assert [item.name for item in surrogate.inputs] == ["flow rate", "temp"] and surrogate.inputs[0].max < 1.0
