"""Boosted trees of XGBoost, LightGBM and CatBoost, read from their models in JSON."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import numpy as np

from . import _metafmu

Error = _metafmu.Error


def _linked(graph, value, objective, functions):
    """Predictions from sums of trees: applies the function that belongs to a loss, which is given by its name."""
    if objective not in functions:
        raise Error(f"a loss {objective}, expected one of {', '.join(functions)}")
    return value if functions[objective] is None else graph.elementwise(value, functions[objective])


# XGBoost

_XGBOOST = {
    **dict.fromkeys(("reg:squarederror", "reg:squaredlogerror", "reg:absoluteerror", "reg:pseudohubererror", "reg:quantileerror")),
    **dict.fromkeys(("count:poisson", "reg:gamma", "reg:tweedie"), "exp"),
    "reg:logistic": "sigmoid",
}
_MARGINS = {None: lambda score: score, "exp": np.log, "sigmoid": lambda score: np.log(score / (1.0 - score))}


def xgboost(graph, estimator, value):
    """`XGBRegressor`, `XGBRFRegressor`, which compare and add in single precision."""
    graph.is_single = True
    if not np.isnan(estimator.missing):
        raise Error(f"{type(estimator).__name__} with missing={estimator.missing}, expected nan: an FMU has no inputs that are missing")
    learner = json.loads(bytes(estimator.get_booster().save_raw("json")))["learner"]
    booster = learner["gradient_booster"]
    if booster["name"] not in ("gbtree", "dart"):
        raise Error(f"{type(estimator).__name__} with booster={booster['name']!r}, expected trees: gbtree or dart")
    model = booster.get("gbtree", booster)["model"]
    objective, about = learner["objective"]["name"], learner["learner_model_param"]
    margin = _MARGINS[_XGBOOST.get(objective)]
    scores = margin(np.atleast_1d(np.array(json.loads(about["base_score"]), dtype=np.float64)))
    outputs = max(1, int(about["num_target"]), int(about["num_class"]), len(scores))
    trees = []
    for tree, output, factor in zip(model["trees"][: _rounds(estimator, model)], model["tree_info"], _weights(booster, len(model["trees"]))):
        if any(tree["split_type"]):
            raise Error(f"{type(estimator).__name__} with categorical columns, expected numbers only")
        if int(tree["tree_param"]["size_leaf_vector"]) > 1:
            raise Error(f"{type(estimator).__name__} with multi_strategy=\"multi_output_tree\", expected \"one_output_per_tree\"")
        left, numbers = np.array(tree["left_children"]), np.array(tree["split_conditions"], dtype=np.float32)
        leaf = left < 0
        # inputs below the number go left, here those up to it
        below = np.nextafter(numbers, np.float32(-np.inf)).astype(np.float64)
        trees.append(
            {
                "left": left,
                "right": np.array(tree["right_children"]),
                "column": np.where(leaf, -1, tree["split_indices"]),
                "number": np.where(leaf, factor * numbers.astype(np.float64), below),
                "output": output,
            }
        )
    sums = _sums(graph, graph.elementwise(value, "single"), trees, outputs, scores)
    return _linked(graph, sums, objective, _XGBOOST)


def _rounds(estimator, model):
    """How many trees count: up to the best round, where the training was stopped early."""
    try:
        return model["iteration_indptr"][estimator.best_iteration + 1]
    except AttributeError:
        return None


def _weights(booster, count):
    """Weight of each tree; only DART has weights other than 1."""
    return booster.get("weight_drop") or [1.0] * count


# LightGBM

_LIGHTGBM = {
    **dict.fromkeys(("regression", "regression_l2", "regression_l1", "huber", "fair", "quantile", "mape")),
    **dict.fromkeys(("poisson", "gamma", "tweedie"), "exp"),
}


def lightgbm(graph, estimator, value):
    """`LGBMRegressor`, in double precision."""
    model = estimator.booster_.dump_model()
    objective, *options = model.get("objective", "none").split(" ")
    if "sqrt" in options:
        raise Error("LGBMRegressor with reg_sqrt=True, expected False")
    trees = [_lightgbm_tree(tree["tree_structure"]) for tree in model["tree_info"]]
    if model.get("average_output"):
        for tree in trees:
            tree["number"] = np.where(tree["column"] < 0, tree["number"] / len(trees), tree["number"])
    return _linked(graph, _sums(graph, value, trees, 1, [0.0]), objective, _LIGHTGBM)


def _lightgbm_tree(root):
    nodes, waiting = [], [root]
    children = []
    while waiting:
        node = waiting.pop()
        place = len(nodes)
        if "leaf_coeff" in node:
            raise Error("LGBMRegressor with linear_tree=True, expected constant leaves")
        if "left_child" not in node:
            nodes.append((-1, node["leaf_value"]))
            children.append([0, 0])
        else:
            if node["decision_type"] != "<=":
                raise Error("LGBMRegressor with categorical columns, expected numbers only")
            if node["missing_type"] == "Zero":
                raise Error("LGBMRegressor with zero_as_missing=True, expected False")
            nodes.append((node["split_feature"], node["threshold"]))
            children.append([0, 0])
            waiting += [{**node["right_child"], "of": (place, 1)}, {**node["left_child"], "of": (place, 0)}]
        if "of" in node:
            of, side = node["of"]
            children[of][side] = place
    column, number = zip(*nodes)
    left, right = np.array(children).T
    return {"left": left, "right": right, "column": np.array(column), "number": np.array(number)}


# CatBoost

_CATBOOST = {
    **dict.fromkeys(("RMSE", "MAE", "Quantile", "MAPE", "Lq", "Huber", "Expectile", "LogCosh", "MultiRMSE")),
    **dict.fromkeys(("Poisson", "Tweedie"), "exp"),
}


def catboost(graph, estimator, value):
    """`CatBoostRegressor`: it compares in single precision."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.json"
        estimator.save_model(str(path), format="json")
        model = json.loads(path.read_text())
    if any(model["features_info"].get(kind) for kind in ("categorical_features", "text_features", "embedding_features")):
        raise Error("CatBoostRegressor with categorical, text or embedding columns, expected numbers only")
    scale, bias = model["scale_and_bias"]
    bias = np.atleast_1d(bias).astype(np.float64)
    if "oblivious_trees" in model:
        trees = [tree for one in model["oblivious_trees"] for tree in _oblivious(one, scale, len(bias))]
    else:
        trees = [_catboost_tree(root, scale) for root in model["trees"]]
    sums = _sums(graph, graph.elementwise(value, "single"), trees, len(bias), bias)
    return _linked(graph, sums, estimator.get_all_params()["loss_function"].split(":")[0], _CATBOOST)


def _oblivious(tree, scale, outputs):
    """Trees, one for each output, of one whose nodes of a level all ask the same."""
    splits = tree.get("splits") or []
    # level by level, the last split at the root: node n has the children 2 n + 1 and 2 n + 2
    inner = 2 ** len(splits) - 1
    level = np.floor(np.log2(np.arange(1, inner + 1))).astype(int)
    asked = [_split(split) for split in reversed(splits)]
    leaves = np.array(tree["leaf_values"], dtype=np.float64).reshape(inner + 1, outputs)
    below = np.arange(inner)
    none = np.zeros(inner + 1, dtype=int)
    return [
        {
            "left": np.concatenate([2 * below + 1, none]),
            "right": np.concatenate([2 * below + 2, none]),
            "column": np.concatenate([np.array([asked[of][0] for of in level], dtype=int), none - 1]),
            "number": np.concatenate([[asked[of][1] for of in level], scale * leaves[:, output]]),
            "output": output,
        }
        for output in range(outputs)
    ]


def _split(split):
    if split["split_type"] != "FloatFeature":
        raise Error(f"CatBoostRegressor with a split of the type {split['split_type']}, expected numbers only")
    return split["float_feature_index"], split["border"]


def _catboost_tree(root, scale):
    """A tree of other growing policies."""
    left, right, column, number = [], [], [], []
    waiting = [(root, None)]
    while waiting:
        node, of = waiting.pop()
        place = len(column)
        if of is not None:
            of[0][of[1]] = place
        left.append(0)
        right.append(0)
        if "split" in node:
            asked = _split(node["split"])
            waiting += [(node["right"], (right, place)), (node["left"], (left, place))]
        else:
            values = np.atleast_1d(node["value"])
            if len(values) > 1:
                raise Error("CatBoostRegressor of several outputs with another grow_policy, expected \"SymmetricTree\"")
            asked = -1, scale * float(values[0])
        column.append(asked[0])
        number.append(asked[1])
    return {"left": np.array(left), "right": np.array(right), "column": np.array(column), "number": np.array(number, dtype=np.float64)}


# all of them


def _sums(graph, value, trees, outputs, offsets):
    """Sums of trees, plus an offset of each output."""
    offsets = np.broadcast_to(np.asarray(offsets, dtype=np.float64), (outputs,))
    if not trees:
        return graph.constant(offsets)
    return graph.linear(graph.forest(value, trees, outputs), 1.0, offsets)
