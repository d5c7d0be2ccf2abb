"""`metafmu import`: trained models of other tools give in the FMU what ONNX Runtime and numpy say; what does not fit is refused."""

import json
import os
import resource
import shutil
import subprocess

import fmpy
import graphs
import numpy as np
import onnx
import onnxruntime
import pandas as pd
import pytest
from conftest import METAFMU, OUTPUTS, ROOT, compiled_from_sources, fmu_of, metafmu
from fmpy import simulate_fmu
from fmpy.validation import validate_fmu
from graphs import fitting, integers, malformed, reals, windowed
from onnx.reference import ReferenceEvaluator
from safetensors import safe_open
from safetensors.numpy import save_file
from skl2onnx import to_onnx
from sklearn.decomposition import PCA
from sklearn.ensemble import BaggingRegressor, ExtraTreesRegressor, GradientBoostingRegressor, RandomForestRegressor, VotingRegressor
from sklearn.linear_model import HuberRegressor, Lasso, LinearRegression, Ridge
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import MaxAbsScaler, MinMaxScaler, PolynomialFeatures, RobustScaler, StandardScaler
from sklearn.svm import SVR, NuSVR
from sklearn.tree import DecisionTreeRegressor

TOLERANCE = {np.float32: 1e-6, np.float64: 1e-12}
RANDOM = np.random.default_rng(3)
ROWS = RANDOM.uniform(-1.0, 1.0, (60, 3))


def of_runtime(model, rows):
    """Outputs of ONNX Runtime for these rows."""
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    session = onnxruntime.InferenceSession(model.SerializeToString(), options)
    name = session.get_inputs()[0].name
    # one by one: a graph that was made for a row may mix the rows of a batch
    return np.array([session.run(None, {name: row[None, :]})[0].ravel() for row in rows])


def of_reference(model, rows):
    """Outputs by the definition of ONNX, in numpy: ONNX Runtime does not have all operators in double precision."""
    reference = ReferenceEvaluator(model)
    name = model.graph.input[0].name
    return np.array([reference.run(None, {name: row[None, :]})[0].ravel() for row in rows])


def imported(folder, model, rows, expected, of=np.float32):
    """The model file, compared with what was expected on the way."""
    path = folder / "model.onnx"
    path.write_bytes(model.SerializeToString())
    names = [f"y{k}" for k in range(expected.shape[1])]
    table = pd.DataFrame(np.c_[rows, expected].astype(float), columns=["a", "b", "c", *(f"d{k}" for k in range(3, rows.shape[1])), *names])
    table.to_csv(folder / "rows.csv", index=False, float_format="%.17g")
    metafmu("import", path, "--new", folder / "interface.toml", "--data", folder / "rows.csv", cwd=folder)
    run = metafmu("import", path, "--interface", folder / "interface.toml", "--data", folder / "rows.csv", "--check", folder / "rows.csv",
                  "--tolerance", str(TOLERANCE[of]), "--out", folder / "model.safetensors", cwd=folder)
    assert "largest difference" in run.stdout
    return folder / "model.safetensors"


@pytest.mark.parametrize("of", [np.float32, np.float64], ids=["single", "double"])
def test_operators_are_those_of_onnx(tmp_path, of):
    """The reference is ONNX Runtime in single precision, and the definition in double precision."""
    evaluate = of_runtime if of == np.float32 else of_reference
    count = 0
    for name, model in [*fitting(of), *windowed(of)]:
        folder = tmp_path / name
        folder.mkdir()
        rows = ROWS.astype(of)
        shape = [dim.dim_value for dim in model.graph.input[0].type.tensor_type.shape.dim][1:]
        if shape != [3]:
            rows = np.random.default_rng(6).uniform(-1.0, 1.0, (20, np.prod(shape))).astype(of)
        expected = evaluate(model, rows.reshape(len(rows), *shape))
        try:
            imported(folder, model, rows, expected, of)
        except AssertionError as error:
            raise AssertionError(name) from error
        count += 1
    assert count > 40, count


def far_from_zero(of, mean, spread):
    """Models of inputs that vary little beside how far they are from zero."""
    kind = onnx.TensorProto.FLOAT if of == np.float32 else onnx.TensorProto.DOUBLE
    r = lambda *shape: reals(*shape, of=of)
    make = lambda *nodes, **constants: graphs.model([*nodes, *LAYERS], {**constants, **layers()}, kind=kind)
    layers = lambda: {"w": r(3, 16), "b": r(16), "v": r(16, 2), "c": r(2)}
    each = lambda value: np.array([value, 0.5 * value, 0.25 * value], of)
    yield "by-hand", make(graphs.node("Sub", "x m", "d"), graphs.node("Div", "d s", "z"), m=each(mean), s=each(spread))
    yield "batch-normalization", make(
        graphs.node("BatchNormalization", "x f o m q", "z", epsilon=0.0), f=r(3), o=r(3), m=each(mean), q=each(spread) ** 2
    )
    yield "chosen", make(
        graphs.node("Gather", "x i", "g", axis=1), graphs.node("Sub", "g m", "d"), graphs.node("Mul", "d f", "n"), graphs.node("Neg", "n", "z"),
        i=integers(2, 0, 1), m=each(mean)[[2, 0, 1]], f=1 / each(spread)[[2, 0, 1]],
    )
    yield "residual", make(
        graphs.node("Sub", "x m", "d"), graphs.node("Div", "d s", "n"), graphs.node("Tanh", "n", "t"), graphs.node("Add", "n t", "z"), m=each(mean), s=each(spread)
    )
    if of == np.float32:
        scaler = graphs.node("Scaler", "x", "z", domain="ai.onnx.ml", offset=each(mean).tolist(), scale=(1 / each(spread)).tolist())
        yield "scaler", make(scaler)


LAYERS = [graphs.node("Gemm", "z w b", "a"), graphs.node("Tanh", "a", "t1"), graphs.node("Gemm", "t1 v c")]


@pytest.mark.parametrize("of, mean, spread", [(np.float32, 101325.0, 50.0), (np.float64, 1e4, 0.2)], ids=["single", "double"])
def test_inputs_far_from_zero_keep_their_digits(tmp_path, of, mean, spread):
    """A pressure of 101325 Pa that varies by 50: what the model subtracts is subtracted before anything is multiplied."""
    random = np.random.default_rng(8)
    rows = (np.array([1.0, 0.5, 0.25]) * (mean + spread * random.uniform(-1.0, 1.0, (60, 3)))).astype(of)
    for name, model in far_from_zero(of, mean, spread):
        folder = tmp_path / name
        folder.mkdir()
        # ONNX Runtime multiplies before it subtracts in a batch normalization, which the definition does not
        evaluate = of_reference if of == np.float64 or name == "batch-normalization" else of_runtime
        try:
            imported(folder, model, rows, evaluate(model, rows), of)
        except AssertionError as error:
            raise AssertionError(name) from error


@pytest.mark.parametrize("size", [1e-18, 3e-15, 1e15])
def test_small_and_large_numbers_keep_their_digits_in_single_precision(tmp_path, size):
    """A charge in coulomb, as an input and as an output: weights below 1e-15 that are not those of nodes that nothing needs."""
    r = lambda *shape: reals(*shape, of=np.float32)
    constants = {"w": r(3, 16), "b": r(16), "v": r(16, 2) * np.float32(size), "c": r(2) * np.float32(size), "f": np.full(3, 1 / size, np.float32)}
    model = graphs.model([graphs.node("Mul", "x f", "z"), *LAYERS], constants, kind=onnx.TensorProto.FLOAT)
    rows = (size * np.random.default_rng(8).uniform(-1.0, 1.0, (60, 3))).astype(np.float32)
    imported(tmp_path, model, rows, of_runtime(model, rows), np.float32)


def test_the_fmu_keeps_the_digits_of_inputs_far_from_zero(tmp_path):
    """So do its sources, another column being constant."""
    model = dict(far_from_zero(np.float32, 101325.0, 50.0))["chosen"]
    rows = np.array([1.0, 0.5, 0.25]) * (101325.0 + 50.0 * np.random.default_rng(8).uniform(-1.0, 1.0, (20, 3)))
    rows = rows.astype(np.float32)
    rows[:, 1] = rows[0, 1]
    expected = of_runtime(model, rows)
    (tmp_path / "model.onnx").write_bytes(model.SerializeToString())
    limits = [f"{{ min = {rows[:, k].min()}, max = {rows[:, k].max()}, column = 'x[{k}]' }}" for k in (0, 2)]
    (tmp_path / "interface.toml").write_text(
        f"name = 'model'\ninputs.a = {limits[0]}\ninputs.b = {{ value = {rows[0, 1]}, column = 'x[1]' }}\ninputs.c = {limits[1]}\n"
        "outputs = { y0 = {}, y1 = {} }\n"
    )
    pd.DataFrame(np.c_[rows[:, [0, 2]], expected].astype(float), columns=["a", "c", "y0", "y1"]).to_csv(tmp_path / "rows.csv", index=False, float_format="%.17g")
    metafmu("import", "model.onnx", "--interface", "interface.toml", "--check", "rows.csv", "--tolerance", "1e-6", cwd=tmp_path)
    metafmu("export", "model.safetensors", "--out", tmp_path, "--fmi", "2", cwd=tmp_path)
    fmu = fmu_of(tmp_path, "model", 2)
    for row, outputs in zip(rows[:4].astype(float), expected):
        result = simulate_fmu(str(fmu), start_values={"a": row[0], "c": row[2]}, stop_time=0.1, output_interval=0.1)
        found = [result[f"y{k}"][-1] for k in range(2)]
        assert np.abs(found - outputs).max() < 1e-6 * np.ptp(expected, axis=0).max(), (found, outputs)


def test_small_probabilities_keep_their_digits(tmp_path):
    """log(sigmoid(x)) of a very negative x, and what else is nearly 0 there."""
    rows = np.random.default_rng(4).uniform(-40.0, 0.0, (60, 3))
    near = 1e-6 * rows
    of = lambda *nodes: graphs.model(list(nodes), kind=onnx.TensorProto.DOUBLE)
    log = lambda *nodes: of(*nodes, graphs.node("Abs", "s", "a"), graphs.node("Log", "a"))
    cases = {
        "sigmoid": (log(graphs.node("Sigmoid", "x", "s")), rows, -np.log1p(np.exp(-rows))),
        "silu": (log(graphs.node("Sigmoid", "x", "g"), graphs.node("Mul", "x g", "s")), rows, np.log(-rows) - np.log1p(np.exp(-rows))),
        "softplus": (log(graphs.node("Softplus", "x", "s")), rows, np.log(np.log1p(np.exp(rows)))),
        "tanh": (log(graphs.node("Tanh", "x", "s")), near, np.log(np.tanh(-near))),
        "elu": (log(graphs.node("Elu", "x", "s")), near, np.log(-np.expm1(near))),
        "celu": (log(graphs.node("Celu", "x", "s")), near, np.log(-np.expm1(near))),
        "sinh": (log(graphs.node("Sinh", "x", "s")), near, np.log(np.sinh(-near))),
        "asin": (log(graphs.node("Asin", "x", "s")), near, np.log(np.arcsin(-near))),
    }
    for name, (model, points, expected) in cases.items():
        folder = tmp_path / name
        folder.mkdir()
        try:
            imported(folder, model, points, expected, np.float64)
        except AssertionError as error:
            raise AssertionError(name) from error


def test_sources_keep_the_digits_of_small_probabilities(tmp_path, monkeypatch):
    """log(|x| sigmoid(x)^2), computed by the C sources."""
    nodes = [graphs.node("Sigmoid", "x", "s"), graphs.node("Abs", "x", "m"), graphs.node("Mul", "m s", "w"), graphs.node("Mul", "s w", "p"), graphs.node("Log", "p")]
    (tmp_path / "model.onnx").write_bytes(graphs.model(nodes, inputs=(("x", ["n", 1]),), kind=onnx.TensorProto.DOUBLE).SerializeToString())
    (tmp_path / "i.toml").write_text("name = 'model'\ninputs.x = { min = -40.0, max = -1.0 }\noutputs = { y = {} }\n")
    metafmu("import", "model.onnx", "--interface", "i.toml", cwd=tmp_path)
    metafmu("export", "model.safetensors", "--out", tmp_path, "--fmi", 2, "--sources", cwd=tmp_path)
    unpacked = compiled_from_sources(str(fmu_of(tmp_path, "model", 2)), monkeypatch)
    for x in [-40.0, -35.0, -20.5, -1.0]:
        found = simulate_fmu(str(unpacked), start_values={"x": x}, stop_time=0.1, output_interval=0.1)["y"][-1]
        assert abs(found - (np.log(-x) - 2 * np.log1p(np.exp(-x)))) < 1e-13 * abs(found), x
    shutil.rmtree(unpacked)


def test_inputs_of_fixed_shapes_are_read_as_a_whole(tmp_path):
    """Rows that are mixed with each other are no batch, and an export with a batch of several rows is what it says."""
    mixed = [
        graphs.node("MatMul", "x w", "a"), graphs.node("Tanh", "a", "t"), graphs.node("ReduceMax", "t k", "m"), graphs.node("Sub", "t m", "d"),
        graphs.node("MatMul", "d u", "e"), graphs.node("Add", "e v"),
    ]
    constants = {"w": reals(3, 5), "k": integers(0), "u": reals(5, 2)}
    graph = graphs.model(mixed, constants, inputs=(("x", [4, 3]), ("v", [2])))
    random = np.random.default_rng(3)
    rows = random.uniform(-1.0, 1.0, (20, 14)).astype(np.float32)
    session = onnxruntime.InferenceSession(graph.SerializeToString())
    expected = np.array([session.run(None, {"x": row[:12].reshape(4, 3), "v": row[12:]})[0].ravel() for row in rows])
    assert expected.shape == (20, 8)
    imported(tmp_path, graph, rows, expected)
    (tmp_path / "i.toml").unlink(missing_ok=True)
    metafmu("import", "model.onnx", "--new", "i.toml", cwd=tmp_path)
    text = (tmp_path / "i.toml").read_text()
    assert "# x: 4 rows of 3 numbers, which are all inputs; if they are a batch, export the model with one row" in text and "# v" not in text


REGRESSIONS = {
    "linear": LinearRegression(),
    "lasso": Lasso(alpha=0.01),
    "huber": HuberRegressor(),
    "polynomial": make_pipeline(PolynomialFeatures(3), Ridge()),
    "components": make_pipeline(StandardScaler(), PCA(2), Ridge()),
    "robust": make_pipeline(RobustScaler(), Ridge()),
    "svr": make_pipeline(MinMaxScaler(), SVR()),
    "svr-polynomial": SVR(kernel="poly", degree=2),
    "svr-sigmoid": make_pipeline(MaxAbsScaler(), NuSVR(kernel="sigmoid")),
    "tree": DecisionTreeRegressor(),
    "forest": RandomForestRegressor(10),
    "extra-trees": ExtraTreesRegressor(10),
    "boosting": GradientBoostingRegressor(n_estimators=20),
    "bagging": BaggingRegressor(n_estimators=4),
    "voting": VotingRegressor([("a", Ridge()), ("b", SVR())]),
}


@pytest.mark.parametrize("name", REGRESSIONS)
def test_regressions_of_scikit_learn(tmp_path, name):
    """Beside scikit-learn itself: ONNX Runtime sums in single precision."""
    train = RANDOM.uniform(-1.0, 1.0, (200, 3))
    model = REGRESSIONS[name].fit(train, np.sin(train[:, 0]) + train[:, 1] * train[:, 2])
    rows = ROWS.astype(np.float32)
    graph = to_onnx(model, rows[:1])
    imported(tmp_path, graph, rows, model.predict(rows.astype(float))[:, None])


def test_constants_that_overflow_when_they_are_taken_together_are_refused(tmp_path):
    nodes = [graphs.node("Div", "x c", "d"), graphs.node("Div", "d c")]
    graph = graphs.model(nodes, {"c": np.full(3, 1e-200)}, kind=onnx.TensorProto.DOUBLE)
    (tmp_path / "model.onnx").write_bytes(graph.SerializeToString())
    pd.DataFrame(ROWS, columns=["a", "b", "c"]).to_csv(tmp_path / "rows.csv", index=False)
    written = metafmu("import", "model.onnx", "--new", "interface.toml", "--data", "rows.csv", cwd=tmp_path).stdout
    command = "metafmu import model.onnx --interface interface.toml --data rows.csv"
    assert written == f"interface.toml\nreview it, then import the model with `{command}`\n"
    run = metafmu("import", "model.onnx", "--interface", "interface.toml", "--data", "rows.csv", cwd=tmp_path, check=False)
    assert run.returncode == 2 and "model.onnx: constant folding of the graph produced NaN or infinity" in run.stderr, run.stderr
    assert not list(tmp_path.glob("*.safetensors"))


def stump(of, threshold):
    """A tree of one threshold for the first feature: 1 up to it, 2 above."""
    return graphs.node("TreeEnsembleRegressor", of, domain="ai.onnx.ml", nodes_treeids=[0] * 3, nodes_nodeids=[0, 1, 2], nodes_featureids=[0] * 3,
                       nodes_values=[threshold, 0.0, 0.0], nodes_truenodeids=[1, 0, 0], nodes_falsenodeids=[2, 0, 0], n_targets=1, target_ids=[0, 0],
                       nodes_modes=["BRANCH_LEQ", "LEAF", "LEAF"], target_treeids=[0, 0], target_nodeids=[1, 2], target_weights=[1.0, 2.0])


def test_what_is_cast_before_trees_is_rounded(tmp_path):
    """A double that is above a threshold of single precision, and is it once rounded."""
    threshold = float(np.nextafter(np.float32(0.1), np.float32(0)))
    graph = graphs.model([graphs.node("Cast", "x", "s", to=onnx.TensorProto.FLOAT), stump("s", threshold)], kind=onnx.TensorProto.DOUBLE)
    graph.graph.output[0].type.tensor_type.elem_type = onnx.TensorProto.FLOAT
    rows = np.zeros((3, 3))
    rows[:, 0] = threshold + np.array([-1e-10, 1e-10, 1e-8])
    expected = of_runtime(graph, rows)
    assert expected.ravel().tolist() == [1.0, 1.0, 2.0]
    imported(tmp_path, graph, rows, expected)


def test_numbers_on_a_threshold_are_on_the_side_where_onnx_runtime_has_them(tmp_path):
    """Thresholds that are the number itself, of an input and of what a Scaler makes of it, with rows that are decimals."""
    offset, scale = np.float32(0.37), np.float32(1.7)
    decimals = np.round(0.1 * np.arange(1, 21), 1)
    rows = np.zeros((len(decimals), 3))
    rows[:, 0] = decimals
    for place, number in enumerate(decimals[:8]):
        scaler = graphs.node("Scaler", "x", "s", domain="ai.onnx.ml", offset=[float(offset)], scale=[float(scale)])
        number = np.float32(number)
        trees = graphs.model([scaler, stump("s", float((number - offset) * scale))])
        comparison = graphs.model(
            [graphs.node("GreaterOrEqual", "x c", "g"), graphs.node("Equal", "x c", "e"), graphs.node("Cast", "g", "f", to=onnx.TensorProto.FLOAT),
             graphs.node("Cast", "e", "d", to=onnx.TensorProto.FLOAT), graphs.node("Sum", "f d")], {"c": number})
        for name, graph in (("trees", trees), ("comparison", comparison)):
            folder = tmp_path / f"{name}-{place}"
            folder.mkdir()
            imported(folder, graph, rows, of_runtime(graph, rows.astype(np.float32)))


def test_a_number_that_a_writer_left_out_is_zero(tmp_path):
    """Writers of protocol buffers may leave out what is 0: then the attribute is there, with its kind, but without a number."""
    cases = [
        (graphs.node("Unsqueeze", "x a", "u"), graphs.node("Transpose", "u", "t", perm=[1, 2, 0]), graphs.node("Softmax", "t", "s", axis=0), graphs.node("Flatten", "s")),
        (graphs.node("LeakyRelu", "x", alpha=0.0),),
        (graphs.node("ReduceMean", "x b", keepdims=0),),
    ]
    for place, nodes in enumerate(cases):
        graph = graphs.model(nodes, {"a": integers(2), "b": integers(1)}, inputs=(("x", [1, 3]),))
        expected = of_runtime(graph, ROWS.astype(np.float32))
        for attribute in (attribute for node in graph.graph.node for attribute in node.attribute if attribute.name in ("axis", "alpha", "keepdims")):
            attribute.ClearField("f" if attribute.name == "alpha" else "i")
        folder = tmp_path / str(place)
        folder.mkdir()
        imported(folder, graph, ROWS, expected)


@pytest.mark.parametrize("name", ["tree", "linear", "svm"])
def test_regressors_take_each_row_of_a_fixed_number(tmp_path, name):
    ml = {"domain": "ai.onnx.ml"}
    weights = [0.5, -1.0, 2.0]
    regressor = {
        "tree": stump("s", 0.1),
        "linear": graphs.node("LinearRegressor", "s", coefficients=weights, intercepts=[0.25], targets=1, **ml),
        "svm": graphs.node("SVMRegressor", "s", coefficients=[1.0, -0.5], support_vectors=[*weights, 0.1, 0.2, 0.3], n_supports=2, rho=[0.1], kernel_type="RBF",
                           kernel_params=[0.7, 0.0, 0.0], **ml),
    }[name]
    graph = graphs.model([graphs.node("Scaler", "x", "s", offset=[0.1, 0.2, 0.3], scale=[1.0, 2.0, 3.0], **ml), regressor], inputs=(("x", [2, 3]),))
    rows = np.random.default_rng(4).uniform(-1.0, 1.0, (30, 6)).astype(np.float32)
    session = onnxruntime.InferenceSession(graph.SerializeToString())
    expected = np.array([session.run(None, {"x": row.reshape(2, 3)})[0].ravel() for row in rows])
    assert expected.shape == (30, 2)
    imported(tmp_path, graph, rows, expected)


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("name", ["perceptron", "residual", "LayerNormalization", "Softmax"])
def test_the_fmu_gives_what_onnx_runtime_gives(tmp_path, name, version):
    """The values, and directional derivatives beside differences of ONNX Runtime's."""
    model = dict(fitting(np.float64))[name]
    expected = of_runtime(model, ROWS)
    path = imported(tmp_path, model, ROWS, expected, np.float64)
    metafmu("export", path, "--fmi", str(version), "--out", tmp_path, cwd=tmp_path)
    fmu = fmu_of(tmp_path, "model", version)
    assert not validate_fmu(str(fmu))
    assert metafmu("validate", fmu).returncode == 0
    for row, outputs in zip(ROWS[:5], expected):
        values = dict(zip("abc", row))
        result = simulate_fmu(str(fmu), start_values=values, stop_time=0.1, output_interval=0.1)
        found = [result[f"y{k}"][-1] for k in range(len(outputs))]
        assert np.abs(found - outputs).max() < 1e-12
    derivatives = by_fmpy(fmu, ROWS[0], len(expected[0]))
    for column, found in enumerate(derivatives):
        step = np.eye(3)[column] * 1e-6
        differences = (of_runtime(model, (ROWS[0] + step)[None])[0] - of_runtime(model, (ROWS[0] - step)[None])[0]) / 2e-6
        assert np.abs(found - differences).max() < 1e-8, (column, found, differences)


def by_fmpy(fmu, row, outputs):
    """Directional derivatives along each input."""
    description = fmpy.read_model_description(str(fmu))
    unpacked = fmpy.extract(str(fmu))
    reference = {variable.name: variable.valueReference for variable in description.modelVariables}
    instance = fmpy.instantiate_fmu(unpacked, description, "CoSimulation")
    is_new = description.fmiVersion.startswith("3")
    names = [f"y{k}" for k in range(outputs)]
    if is_new:
        instance.setFloat64([reference[name] for name in "abc"], list(row))
        instance.enterInitializationMode(startTime=0.0)
        instance.exitInitializationMode()
        return [np.array(instance.getDirectionalDerivative([reference[name] for name in names], [reference[along]], [1.0])) for along in "abc"]
    instance.setReal([reference[name] for name in "abc"], list(row))
    instance.setupExperiment(startTime=0.0)
    instance.enterInitializationMode()
    instance.exitInitializationMode()
    return [np.array(instance.getDirectionalDerivative([reference[name] for name in names], [reference[along]], [1.0])) for along in "abc"]


def test_tensors_by_name(tmp_path):
    """Arrays in .npz and .safetensors files, whose rows or columns are outputs, give the outputs of numpy."""
    w0, b0, w1, b1 = RANDOM.normal(size=(3, 8)), RANDOM.normal(size=8), RANDOM.normal(size=(8, 2)), RANDOM.normal(size=2)
    expected = np.tanh(ROWS @ w0 + b0) @ w1 + b1
    pd.DataFrame(np.c_[ROWS, expected], columns=["a", "b", "c", "u", "v"]).to_csv(tmp_path / "rows.csv", index=False, float_format="%.17g")
    interface = """name = "layers"
    inputs = { a = {}, b = {}, c = {} }
    outputs = { u = {}, v = { unit = "N" } }
    [[layers]]
    weight = "w0"
    bias = "b0"
    activation = "tanh"
    [[layers]]
    weight = "w1"
    bias = "b1"
    """
    (tmp_path / "interface.toml").write_text(interface)
    np.savez(tmp_path / "columns.npz", w0=w0, b0=b0, w1=np.asfortranarray(w1), b1=b1)
    save_file({"w0": np.ascontiguousarray(w0.T), "b0": b0, "w1": np.ascontiguousarray(w1.T), "b1": b1}, tmp_path / "rows.safetensors")
    for name in ["columns.npz", "rows.safetensors"]:
        run = metafmu("import", name, "--interface", "interface.toml", "--data", "rows.csv", "--check", "rows.csv", "--tolerance", "1e-13", cwd=tmp_path)
        assert run.stdout.endswith("layers.safetensors\n")
        predicted = metafmu("predict", "layers.safetensors", "rows.csv", cwd=tmp_path).stdout
        assert predicted.startswith("u,v,")


def test_a_column_may_be_constant_and_columns_may_be_in_another_order(tmp_path):
    model = dict(fitting(np.float64))["perceptron"]
    (tmp_path / "model.onnx").write_bytes(model.SerializeToString())
    (tmp_path / "interface.toml").write_text(
        'name = "arranged"\n'
        'inputs.c = { column = "x[2]", min = -1.0, max = 1.0 }\n'
        'inputs.fixed = { column = "x[1]", value = 0.25 }\n'
        'inputs.a = { column = "x[0]", min = -1.0, max = 1.0, causality = "parameter" }\n'
        'outputs.second = { column = "y[1]" }\n'
    )
    metafmu("import", "model.onnx", "--interface", "interface.toml", cwd=tmp_path)
    pd.DataFrame(ROWS[:, [2, 0]], columns=["c", "a"]).to_csv(tmp_path / "rows.csv", index=False, float_format="%.17g")
    run = metafmu("predict", "arranged.safetensors", "rows.csv", "--out", "out.csv", cwd=tmp_path)
    assert run.returncode == 0
    found = pd.read_csv(tmp_path / "out.csv")["second"].to_numpy()
    rows = np.c_[ROWS[:, 0], np.full(len(ROWS), 0.25), ROWS[:, 2]]
    assert np.abs(found - of_runtime(model, rows)[:, 1]).max() < 1e-12


def test_the_domain_knows_where_the_training_data_are(tmp_path, capsys):
    """Rows on a ring: in the FMU, by fmpy, as in `predict`, its middle is in the ranges and outside the domain."""
    angle, radius = RANDOM.uniform(0, 2 * np.pi, 800), RANDOM.uniform(0.9, 1.0, 800)
    ring = np.c_[radius * np.cos(angle), radius * np.sin(angle), RANDOM.uniform(-1, 1, 800)]
    model = dict(fitting(np.float64))["perceptron"]
    path = imported(tmp_path, model, ring, of_runtime(model, ring), np.float64)
    asked = np.r_[ring[:50], [[0, 0, 0], [0.1, -0.2, 0.9], [0.2, 0.1, -0.3]]]
    pd.DataFrame(asked, columns=["a", "b", "c"]).to_csv(tmp_path / "asked.csv", index=False, float_format="%.17g")
    metafmu("predict", path, "asked.csv", "--out", "out.csv", cwd=tmp_path)
    predicted = pd.read_csv(tmp_path / "out.csv")
    assert predicted.in_domain[:50].all() and not predicted.in_domain[50:].any()
    assert (predicted.domain_distance[:50] == 0).all() and (predicted.domain_distance[50:] > 0.1).all()
    for version, options in [(2, []), (3, ["--sources"])]:
        metafmu("export", path, "--fmi", str(version), "--out", tmp_path, *options, cwd=tmp_path)
        fmu = fmu_of(tmp_path, "model", version)
        assert not validate_fmu(str(fmu)) and metafmu("validate", fmu).returncode == 0
        starts = [float(variable.start) for variable in fmpy.read_model_description(str(fmu)).modelVariables[:3]]
        assert 0.9 < np.hypot(*starts[:2]) < 1.0, "a row, not the middle of the ranges"
        for row in (0, 50, 51):
            capsys.readouterr()
            result = simulate_fmu(str(fmu), start_values=dict(zip("abc", asked[row])), output=["in_domain", "domain_distance"], stop_time=0.1,
                                  output_interval=0.05, debug_logging=True)
            said = capsys.readouterr().out
            assert (result["in_domain"] == predicted.in_domain[row]).all()
            assert np.abs(result["domain_distance"] - predicted.domain_distance[row]).max() < 1e-12
            assert said.count("away from where training data are near") == (row > 0), said
            refused = lambda: simulate_fmu(str(fmu), start_values=dict(zip("abc", asked[row]), domain_policy=2), stop_time=0.1)
            if row > 0:
                with pytest.raises(Exception, match="fmi"):
                    refused()
            else:
                refused()
    text = (tmp_path / "interface.toml").read_text()
    (tmp_path / "interface.toml").write_text('domain = "ranges"\n' + text)
    metafmu("import", "model.onnx", "--interface", "interface.toml", "--data", "rows.csv", "--out", "model.safetensors", cwd=tmp_path)
    metafmu("predict", path, "asked.csv", "--out", "out.csv", cwd=tmp_path)
    assert pd.read_csv(tmp_path / "out.csv").in_domain.all()


def test_a_model_that_gives_something_else_is_not_written(tmp_path):
    model = dict(fitting(np.float64))["perceptron"]
    expected = of_runtime(model, ROWS)
    imported(tmp_path, model, ROWS, expected, np.float64)
    (tmp_path / "model.safetensors").unlink()
    table = pd.read_csv(tmp_path / "rows.csv")
    table.loc[7, "y1"] += 1e-6
    table.to_csv(tmp_path / "rows.csv", index=False)
    run = metafmu("import", "model.onnx", "--interface", "interface.toml", "--data", "rows.csv", "--check", "rows.csv", cwd=tmp_path, check=False)
    assert run.returncode == 1
    assert "in row 8: not what was expected" in run.stdout
    assert not (tmp_path / "model.safetensors").exists()


def test_a_tolerance_is_a_number(tmp_path):
    for value in ["nan", "-1", "inf", "much"]:
        run = metafmu("import", "m.onnx", "--interface", "i.toml", "--check", "c.csv", f"--tolerance={value}", cwd=tmp_path, check=False)
        assert run.returncode == 2 and "expected 0 or a positive number" in run.stderr, run.stderr


def test_rows_with_a_fixed_first_dimension_may_be_mixed(tmp_path):
    """Models that are refused with a free first dimension are read as a whole if it is a number."""
    for name, nodes, constants, _ in graphs.mixed():
        if name == "constant-3":
            # ONNX Runtime broadcasts one row to three
            continue
        (tmp_path / "model.onnx").write_bytes(graphs.model(nodes, constants, inputs=(("x", [1, 3]),)).SerializeToString())
        (tmp_path / "i.toml").unlink(missing_ok=True)
        metafmu("import", "model.onnx", "--new", "i.toml", cwd=tmp_path)


def test_an_export_for_one_row_with_a_free_batch_is_read(tmp_path):
    """It fits no other number of rows, so there is nothing to mix: a reshape to a fixed shape, a batch that is squeezed."""
    flat = [graphs.node("Reshape", "x s", "r"), graphs.node("MatMul", "r w", "m"), graphs.node("Tanh", "m", "t"), graphs.node("ReduceSum", "t a")]
    squeezed = [graphs.node("Squeeze", "x z", "r"), graphs.node("Softmax", "r", "m"), graphs.node("Unsqueeze", "m z")]
    for name, nodes in [("flat", flat), ("squeezed", squeezed)]:
        folder = tmp_path / name
        folder.mkdir()
        constants = {"s": integers(1, 3), "w": reals(3, 4), "a": integers(0), "z": integers(0)}
        model = graphs.model(nodes, constants)
        imported(folder, model, ROWS.astype(np.float32), of_runtime(model, ROWS.astype(np.float32)))


MALFORMED = list(malformed())


@pytest.mark.parametrize("name, model, message", MALFORMED, ids=[name for name, *_ in MALFORMED])
def test_what_does_not_fit_is_refused(tmp_path, name, model, message):
    """With a message to act on, within 2 GB of memory."""
    (tmp_path / "data.bin").write_bytes(b"123456789012")
    (tmp_path / "folder").mkdir()
    (tmp_path / "link.bin").symlink_to("/etc/passwd")
    os.mkfifo(tmp_path / "pipe")
    content = model if isinstance(model, bytes) else model.SerializeToString()
    (tmp_path / "model.onnx").write_bytes(content)
    limited = lambda: resource.setrlimit(resource.RLIMIT_AS, (2 << 30, 2 << 30))
    run = subprocess.run([METAFMU, "import", "model.onnx", "--new", "i.toml"], cwd=tmp_path, capture_output=True, text=True,
                         preexec_fn=limited, timeout=60)
    assert run.returncode == 2, run
    assert run.stderr.startswith("error: model.onnx: ") and message in run.stderr, run.stderr
    assert not (tmp_path / "i.toml").exists()


INTERFACES = {
    "unknown": ('inputs.a = { column = "x[9]" }', 'interface.toml:2: inputs.a.column: "x[9]" is no column of the model'),
    "twice": (
        'inputs = { a = { column = "x[0]" }, b = { column = "x[0]" }, c = { column = "x[1]" } }',
        'inputs.b.column: "x[0]" is the column of `a` already',
    ),
    "missing": ('inputs = { a = { column = "x[0]" }, b = { column = "x[1]" } }', "no input for the columns x[2]"),
    "count": ("inputs = { a = {}, b = {} }", "2 inputs, but the model has 3 columns of inputs"),
    "order": ("inputs = { X_1 = {}, X_0 = {}, X_2 = {} }", "inputs: the order of the interface is X_1, X_0, X_2, that of the model x[0], x[1], x[2]: by position `X_1` would be `x[0]`"),
    "some": ('inputs = { a = { column = "x[0]" }, b = {}, c = {} }', "inputs.b: no `column`, which others have"),
    "no-range": ("inputs = { a = {}, b = { min = 0.0, max = 1.0 }, c = {} }", "inputs.a: has no range"),
    "empty-range": ("inputs = { a = { min = 1.0, max = 0.0 }, b = {}, c = {} }", "inputs.a.max: 0, expected at least min, which is 1"),
    "start": ("inputs = { a = { min = 0.0, max = 1.0, start = 2.0 }, b = {}, c = {} }", "inputs.a.start: 2, expected a value from 0 to 1"),
    "variability": ('inputs = { a = { variability = "fixed" }, b = {}, c = {} }', 'inputs.a.variability: belongs to causality = "parameter"'),
    "times": (
        'inputs = { a = { causality = "time" }, b = { causality = "time" }, c = {} }',
        'inputs.b.causality: "time", but `a` is the time already',
    ),
    "time-unit": (
        'inputs = { a = { causality = "time", unit = "ms" }, b = {}, c = {} }',
        'inputs.a.unit: "ms", expected "s", as hosts give the time in seconds',
    ),
    "key": ("inputs = { a = { unti = 1 }, b = {}, c = {} }", "did you mean `unit`?"),
    "value": ("inputs = { a = { value = 1.0, min = 0.0 }, b = {}, c = {} }", "inputs.a.min: belongs to a variable"),
    "layers": ('inputs = { a = {}, b = {}, c = {} }\nlayers = [{ weight = "w" }]', "layers: belongs to models that are only tensors"),
    "name": ("inputs = { in_domain = {}, b = {}, c = {} }", "`in_domain` is the name of a variable that every FMU of metafmu has"),
    "same-names": ("inputs = { u = {}, b = {}, c = {} }", "outputs.u: `u` is an input already"),
    "study": ("source = { system = 'single-pendulum' }\ninputs = { a = {}, b = {}, c = {} }", "this is a study, expected an interface"),
}


@pytest.mark.parametrize("name", INTERFACES)
def test_mistakes_of_an_interface(tmp_path, name):
    text, message = INTERFACES[name]
    (tmp_path / "model.onnx").write_bytes(dict(fitting(np.float32))["perceptron"].SerializeToString())
    # top-level keys go before tables
    (tmp_path / "interface.toml").write_text(f'name = "x"\n{text}\noutputs = {{ u = {{}}, v = {{}} }}\n')
    run = metafmu("import", "model.onnx", "--interface", "interface.toml", cwd=tmp_path, check=False)
    assert run.returncode == 2 and message in run.stderr, run.stderr
    assert "interface.toml:" in run.stderr


def test_a_table_of_another_order_or_outside_of_the_ranges_is_refused(tmp_path):
    (tmp_path / "model.onnx").write_bytes(dict(fitting(np.float32))["perceptron"].SerializeToString())
    pd.DataFrame(ROWS, columns=["X_2", "X_1", "X_0"]).to_csv(tmp_path / "rows.csv", index=False)
    pd.DataFrame(ROWS, columns=["a", "b", "c"]).to_csv(tmp_path / "abc.csv", index=False)
    (tmp_path / "interface.toml").write_text('name = "x"\ninputs = { a = { min = 0.9, max = 5.0 }, b = { max = 2.0 }, c = {} }\noutputs = { u = {}, v = {} }\n')
    outside = f"{np.mean(ROWS[:, 0] < 0.9):.0%}".replace("%", " %")
    for arguments, message in [
        (("--new", "i.toml", "--data", "rows.csv"), "rows.csv: the order of its columns is"),
        (("--interface", "interface.toml", "--data", "abc.csv"), f"inputs.a: {outside} of the rows of training data are outside of its range from 0.9 to 5"),
    ]:
        run = metafmu("import", "model.onnx", *arguments, cwd=tmp_path, check=False)
        assert run.returncode == 2 and message in run.stderr, run.stderr
        assert not list(tmp_path.glob("*.safetensors")) and not (tmp_path / "i.toml").exists()


def test_an_imported_model_is_exported_to_onnx_again(tmp_path):
    """In double precision, but for operators that ONNX Runtime has in single precision only."""
    count = 0
    for name, model in fitting(np.float64):
        folder = tmp_path / name
        folder.mkdir()
        expected = of_reference(model, ROWS)
        path = imported(folder, model, ROWS, expected, np.float64)
        metafmu("export", path, "--onnx", folder / "again.onnx", cwd=folder)
        again = onnx.load(folder / "again.onnx")
        onnx.checker.check_model(again)
        limit = 1e-6 if name in ("Acos", "Asin", "Atan", "Erf", "Gelu") else 1e-12
        scale = np.ptp(expected, axis=0)
        assert np.all(np.abs(of_runtime(again, ROWS) - expected) <= limit * scale), name
        count += 1
    assert count > 40


@pytest.mark.parametrize("name", ["forest", "svr", "polynomial"])
def test_regressions_are_exported_to_onnx_again(tmp_path, name):
    model = REGRESSIONS[name].fit(ROWS, np.sin(ROWS[:, 0]))
    rows = ROWS.astype(np.float32)
    graph = to_onnx(model, rows[:1])
    path = imported(tmp_path, graph, rows, of_runtime(graph, rows))
    metafmu("export", path, "--onnx", tmp_path / "again.onnx", cwd=tmp_path)
    found = of_runtime(onnx.load(tmp_path / "again.onnx"), rows.astype(float))
    assert np.abs(found - of_runtime(graph, rows)).max() < 1e-6


def test_our_surrogates_are_exported_to_onnx(pendulum, tmp_path):
    """The network of the paper's pendulum at rows of its test runs."""
    table = pd.read_csv(pendulum.folder / "test.csv")
    points = table[["L", "c", "thetad0", "time"]].to_numpy()[::97]
    pd.DataFrame(points, columns=["L", "c", "thetad0", "time"]).to_csv(tmp_path / "points.csv", index=False, float_format="%.17g")
    path = pendulum.folder / "single-pendulum.safetensors"
    metafmu("export", path, "--onnx", tmp_path / "network.onnx")
    metafmu("predict", path, tmp_path / "points.csv", "--out", tmp_path / "out.csv")
    expected = pd.read_csv(tmp_path / "out.csv")[OUTPUTS].to_numpy()
    model = onnx.load(tmp_path / "network.onnx")
    assert {entry.key: entry.value for entry in model.metadata_props}["output_names"] == '["theta","thetad","thetadd"]'
    found = of_runtime(model, points)
    assert np.all(np.abs(found - expected) <= 1e-12 * np.ptp(expected, axis=0))
    # and imported again: names, units and ranges are those of before
    metafmu("import", "network.onnx", "--new", "interface.toml", cwd=tmp_path)
    metafmu("import", "network.onnx", "--interface", "interface.toml", "--out", "again.safetensors", cwd=tmp_path)
    variables = []
    for file in (path, tmp_path / "again.safetensors"):
        with safe_open(file, "numpy") as opened:
            metadata = json.loads(opened.metadata()["metafmu"])
        inputs = [[item[key] for key in ("name", "unit", "min", "max")] for item in metadata["inputs"]]
        variables.append((inputs, [[item[key] for key in ("name", "unit")] for item in metadata["outputs"]]))
    assert variables[0] == variables[1] and variables[0][0][0][0] == "L"


def test_what_has_states_is_not_exported_to_onnx(tmp_path):
    study = ROOT / "examples/dynamics/crane-study.toml"
    run = metafmu("export", study, "--onnx", tmp_path / "crane.onnx", check=False)
    assert run.returncode == 2


@pytest.mark.parametrize("version", [2, 3])
def test_outputs_that_follow_inputs_at_once_are_those_of_fmpy_in_a_simulation(tmp_path, version):
    """The outputs at the end of a step belong to the inputs at its beginning. A tree shows any other reading."""
    rows = ROWS.astype(np.float32)
    graph = to_onnx(DecisionTreeRegressor().fit(rows, np.sin(3.0 * rows[:, 0])), rows[:1])
    path = imported(tmp_path, graph, rows, of_runtime(graph, rows))
    metafmu("export", path, "--fmi", str(version), "--out", tmp_path, cwd=tmp_path)
    times = np.linspace(0.0, 2.0, 41)
    signal = np.array([*zip(times, 0.9 * np.sin(5.0 * times))], dtype=[("time", float), ("a", float)])
    pd.DataFrame(signal).to_csv(tmp_path / "inputs.csv", index=False, float_format="%.17g")
    fmu = fmu_of(tmp_path, "model", version)
    expected = simulate_fmu(str(fmu), input=signal, stop_time=2.0, output_interval=0.1)
    metafmu("simulate", fmu, "--input", "inputs.csv", "--default", "b", "--default", "c", "--interface", "cs", "--stop-time", 2, "--step-size", 0.1, "--output", "out.csv", cwd=tmp_path)
    found = pd.read_csv(tmp_path / "out.csv")
    assert np.ptp(expected["y0"]) > 1.0 and len(found) == 21
    np.testing.assert_allclose(found.y0, expected["y0"], rtol=0, atol=1e-12)
