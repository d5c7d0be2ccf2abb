"""Tables beside `metafmu import`: which of their columns are which of the model, what is compared with them, and starters that import as they are."""

import tomllib
import zipfile

import numpy as np
import pandas as pd
import pytest
from conftest import fmu_of, metafmu
from graphs import DOUBLE, model, node

def weighted(*names):
    """y = 1 first + 10 second + 100 third, of one column each."""
    nodes = [node("Concat", " ".join(names), "all", axis=1), node("MatMul", "all weights")]
    return model(nodes, {"weights": 10.0 ** np.arange(len(names))[:, None]}, inputs=[(name, [1, 1]) for name in names], kind=DOUBLE)


def starter(folder, graph, table=None, name="m.onnx", check=True):
    """The text of the interface that `--new` writes, beside the table's file; or what is wrong with the table."""
    (folder / name).write_bytes(graph.SerializeToString())
    (folder / "i.toml").unlink(missing_ok=True)
    more = []
    if table is not None:
        table.to_csv(folder / "t.csv", index=False, float_format="%.17g")
        more = ["--data", "t.csv"]
    run = metafmu("import", name, "--new", "i.toml", *more, cwd=folder, check=check)
    return (folder / "i.toml").read_text() if run.returncode == 0 else run.stderr


def columns(text):
    interface = tomllib.loads(text)
    return [{name: entry["column"] for name, entry in interface[of].items()} for of in ("inputs", "outputs")]


def rows(*names):
    return pd.DataFrame(np.random.default_rng(3).uniform(-1.0, 1.0, (20, len(names))), columns=list(names))


def compared(folder, interface, table, *more, code=0):
    (folder / "i.toml").write_text(interface)
    table.to_csv(folder / "c.csv", index=False, float_format="%.17g")
    run = metafmu("import", "m.onnx", "--interface", "i.toml", "--check", "c.csv", "--out", "m.safetensors", *more, cwd=folder, check=False)
    assert run.returncode == code, (run.stdout, run.stderr)
    return run.stdout + run.stderr


def test_columns_with_the_names_of_the_model_are_these(tmp_path):
    graph = weighted("pressure", "temp", "flow.in")
    table = rows("flow_in", "id", "pressure", "temp")
    table["y"] = table["pressure"] + 10 * table["temp"] + 100 * table["flow_in"]
    text = starter(tmp_path, graph, table)
    assert columns(text) == [{"pressure": "pressure", "temp": "temp", "flow_in": "flow.in"}, {"y": "y"}]
    compared(tmp_path, text, table, "--data", "t.csv")
    # by position where none has a name of the model; those of outputs may have one
    table = table[["temp", "pressure", "flow_in", "y"]].set_axis(["a", "b", "c", "d"], axis=1)
    expected = {"a": "pressure", "b": "temp", "c": "flow.in"}
    for names, outputs in [(list("abc"), {"y": "y"}), (list("abcd"), {"d": "y"})]:
        assert columns(starter(tmp_path, graph, table[names])) == [expected, outputs]
    assert columns(starter(tmp_path, graph, table.rename(columns={"d": "y"})[["y", *"abc"]])) == [expected, {"y": "y"}]
    # two may be meant
    text = starter(tmp_path, graph, rows("flow_in", "flow-in", "temp", "pressure"), check=False)
    assert "t.csv: has columns for pressure, temp of the model's inputs, but none for flow.in" in text
    # some of them
    for names, some, others in [("abc", "pressure", "temp, flow.in"), ("acb", "temp", "pressure, flow.in")]:
        text = starter(tmp_path, graph, table[[*names]].rename(columns={names[1]: some}), check=False)
        assert f"t.csv: has columns for {some} of the model's inputs, but none for {others}: expected one for each" in text


def test_columns_of_states_are_in_no_table(tmp_path):
    nodes = [node("Add", "h0 u", "h1"), node("Mul", "h1 u", "y")]
    graph = model(nodes, inputs=[("h0", [1, 1]), ("u", [1, 1])], outputs=[("y", None), ("h1", None)], kind=DOUBLE)
    for names in (["time", "u", "y"], ["time", "run", "y", "u", "other"]):
        assert columns(starter(tmp_path, graph, rows(*names))) == [{"u": "u"}, {"y": "y"}]
    assert "time" not in columns(starter(tmp_path, graph, rows("time", "force")))[0]


@pytest.mark.parametrize("name", ["time", "in_domain", "domain_policy", "domain_distance", "domain_policy_1"])
def test_starters_have_names_that_import(tmp_path, name):
    expected = ["time" if name == "time" else "input", "input"]
    text = starter(tmp_path, weighted(name, "domain_policy" if name.endswith("1") else "z"))
    text = text.replace("# min =       # the training range\n# max =\n", "min = -1.0\nmax = 1.0\n")
    assert [entry["causality"] for entry in tomllib.loads(text)["inputs"].values()] == expected
    (tmp_path / "i.toml").write_text(text)
    metafmu("import", "m.onnx", "--interface", "i.toml", cwd=tmp_path)
    # of a column of the table
    text = starter(tmp_path, weighted("x", "z"), rows(name, "second"))
    inputs = tomllib.loads(text)["inputs"]
    assert [entry["causality"] for entry in inputs.values()] == expected
    assert (f"`{name}` in the table" in text) == (name not in inputs)
    rows(*inputs).to_csv(tmp_path / "t.csv", index=False)
    metafmu("import", "m.onnx", "--interface", "i.toml", "--data", "t.csv", cwd=tmp_path)


def test_starters_have_different_names_of_states(tmp_path):
    nodes = [node("Mul", "h.0 h_0", "h.1"), node("Mul", "h.0 h.0", "h_1")]
    graph = model(nodes, inputs=[("h.0", [1, 1]), ("h_0", [1, 1])], outputs=[("h.1", None), ("h_1", None)], kind=DOUBLE)
    long = "q" * 150 + ".onnx"
    text = starter(tmp_path, graph, name=long)
    assert list(tomllib.loads(text)["states"]) == list(tomllib.loads(text)["outputs"]) == ["h_0", "h_0_2"]
    metafmu("import", long, "--interface", "i.toml", cwd=tmp_path)
    assert (tmp_path / ("q" * 100 + ".safetensors")).exists()


SAMPLES = """name = "m"
[time]
sample = 0.1
[inputs.u]
column = "u"
unit = "N"
min = -1.0
max = 1.0
[states.h]
column = "h0"
next = "h1"
start = 0.5
[outputs.y]
column = "y"
"""


def test_a_check_compares_something(tmp_path):
    """The first row of a run of a discrete-time model is not an output of the model."""
    graph = model([node("Mul", "h0 u", "h1"), node("Add", "h0 u", "y")], inputs=[("u", [1, 1]), ("h0", [1, 1])], outputs=[("y", None), ("h1", None)], kind=DOUBLE)
    (tmp_path / "m.onnx").write_bytes(graph.SerializeToString())
    table = pd.DataFrame({"time": [0.0, 0.1, 0.2], "u [N]": [1.0, 0.5, 0.0], "y": [99.0, 1.5, 1.0]})
    compared(tmp_path, SAMPLES, table)
    for wrong, runs in [(table[:1], "one run of one row"), (table[::-1], "3 runs of one row each"), (table.assign(run=["a", "b", "c"]), "3 runs of")]:
        said = compared(tmp_path, SAMPLES, wrong, code=2)
        assert f"c.csv: no row to compare in {runs}" in said
    assert "no rows, expected at least one" in compared(tmp_path, SAMPLES, table[:0], code=2)
    said = compared(tmp_path, SAMPLES, table.rename(columns={"u [N]": "u [kN]"}), code=2)
    assert "c.csv:1: column `u`: unit `kN`, expected `N`" in said


PLAIN = """name = "m"
[inputs.x]
column = "x"
unit = "m"
[inputs.clock]
column = "t"
causality = "time"
[outputs.y]
column = "y"
unit = "K"
"""


def test_units_of_tables_are_those_of_the_interface(tmp_path):
    (tmp_path / "m.onnx").write_bytes(weighted("x", "t").SerializeToString())
    table = rows("x", "time")
    table["y"] = table["x"] + 10 * table["time"]
    good = table.set_axis(["x [m]", "time [s]", "y [K]"], axis=1)
    # names of the time: that of the variable, and that of its column in the interface
    for names in (table.columns, good.columns, ["x", "clock", "y"]):
        compared(tmp_path, PLAIN, table.set_axis(names, axis=1), "--data", "c.csv")
    wrong = good.rename(columns={"x [m]": "x [mm]", "time [s]": "time [ms]"})
    for said in (
        compared(tmp_path, PLAIN, wrong, "--data", "c.csv", code=2),
        compared(tmp_path, PLAIN.replace('"m"\n[inputs.c', '"m"\nmin = -1.0\nmax = 1.0\n[inputs.c'), wrong, code=2),
    ):
        assert "c.csv:1: column `x`: unit `mm`, expected `m`; column `time`: unit `ms`, expected `s`" in said
    assert "column `y`: unit `degC`, expected `K`" in compared(tmp_path, PLAIN, good.rename(columns={"y [K]": "y [degC]"}), "--data", "c.csv", code=2)
    # a row of missing values has no units
    lines = ["x,time,y", "NA,NA,NA", "0.5,1.0,10.5"]
    (tmp_path / "t.csv").write_text("\n".join(lines))
    run = metafmu("import", "m.onnx", "--interface", "i.toml", "--data", "t.csv", cwd=tmp_path, check=False)
    assert run.returncode == 2 and "unit `NA`, expected `m`" in run.stderr
    # starters have them
    text = starter(tmp_path, weighted("x", "t"), good.rename(columns={"time [s]": "t [s]"}))
    assert [entry["unit"] for of in ("inputs", "outputs") for entry in tomllib.loads(text)[of].values()] == ["m", "s", "K"]


def test_an_output_that_is_always_the_same_has_a_scale(tmp_path):
    interface = 'name = "m"\n[inputs.x]\nmin = -1.0\nmax = 1.0\n[outputs.y]\n'
    for value, difference, code in [(0.0, 3e-13, 0), (0.0, 3e-6, 1), (1e6, 1e-6, 0), (1e6, 1.0, 1)]:
        graph = model([node("Mul", "x k", "d"), node("Add", "d c", "y")], {"k": np.array([0.0]), "c": np.array([value + difference])}, inputs=[("x", [1, 1])], kind=DOUBLE)
        (tmp_path / "m.onnx").write_bytes(graph.SerializeToString())
        compared(tmp_path, interface, pd.DataFrame({"x": [0.0, 1.0], "y": value}), code=code)


def test_columns_of_outputs_of_the_same_name_are_refused(tmp_path):
    nodes = [node("Mul", "x k", "y"), node("Neg", "z", "y[1]")]
    graph = model(nodes, {"k": np.array([2.0, 3.0])}, inputs=[("x", [1, 2]), ("z", [1, 1])], outputs=[("y", None), ("y[1]", None)], kind=DOUBLE)
    text = starter(tmp_path, graph, rows("a", "b", "c"))
    run = metafmu("import", "m.onnx", "--interface", "i.toml", "--data", "t.csv", cwd=tmp_path, check=False)
    assert run.returncode == 2 and "outputs: two columns of the model's outputs are called `y[1]`" in run.stderr
    # by their position they are known
    table = rows("a", "b", "c")
    table = table.assign(u=2 * table["a"], v=3 * table["b"], w=-table["c"])
    text = 'name = "m"\ninputs = { a = {}, b = {}, c = {} }\noutputs = { u = {}, v = {}, w = {} }\n'
    compared(tmp_path, text, table, "--data", "c.csv")


LAYERS = """name = "m"
[inputs.x]
min = -1.0
max = 1.0
[outputs.y]
[[layers]]
weight = "w"
transposed = true

[[layers]]
activation = "tanh"
weight = "w"
transposed = false
"""


def test_tensors_that_do_not_fit_are_named(tmp_path):
    def refused(text=LAYERS, name="m.npz", **arrays):
        if arrays:
            np.savez(tmp_path / name, **arrays)
        (tmp_path / "i.toml").write_text(text)
        run = metafmu("import", name, "--interface", "i.toml", "--out", "m.safetensors", cwd=tmp_path, check=False)
        assert run.returncode == 2, (run.stdout, run.stderr)
        return run.stderr

    second = LAYERS[::-1].replace('"w"'[::-1], '"v"'[::-1], 1)[::-1]
    assert "i.toml:12: layers[1].weight: no tensor `v`" in refused(second, w=np.ones((1, 1)))
    assert "i.toml:11: layers[1].activation: \"tanhh\"" in refused(LAYERS.replace("tanh", "tanhh"), w=np.ones((1, 1)))
    assert "i.toml:7: layers[0].weight: `w` has the shape [0, 2], expected at least one number" in refused(w=np.ones((0, 2)))
    assert "`w` has the shape [2], expected 2 dimensions" in refused(w=np.ones(2))
    # `.npy` belongs to the archive once
    second = second.replace('"v"', '"w.npy"')
    run_of = lambda *more: metafmu("import", "m.npz", "--interface", "i.toml", "--out", "m.safetensors", *more, cwd=tmp_path)
    np.savez(tmp_path / "m.npz", **{"w": np.array([[2.0]]), "w.npy": np.array([[0.25]])})
    pd.DataFrame({"x": [0.5, 1.0], "y": np.tanh([0.25, 0.5])}).to_csv(tmp_path / "c.csv", index=False, float_format="%.17g")
    (tmp_path / "i.toml").write_text(second)
    run_of("--check", "c.csv")
    with zipfile.ZipFile(tmp_path / "m.npz") as archive:
        content = archive.read("w.npy")
    with zipfile.ZipFile(tmp_path / "m.npz", "w") as archive:
        archive.writestr("w", content)
        archive.writestr("w.npy", content)
    assert "m.npz: `w`: two entries of this name, expected one" in refused()


def test_what_is_a_surrogate_already_is_not_imported(tmp_path):
    text = starter(tmp_path, weighted("x", "z"), rows("x", "z"))
    run = metafmu("import", "m.onnx", "--interface", "i.toml", "--data", "t.csv", "--out", "m.fmu", cwd=tmp_path, check=False)
    assert run.returncode == 2 and "m.fmu: expected a name that ends in .safetensors" in run.stderr
    metafmu("import", "m.onnx", "--interface", "i.toml", "--data", "t.csv", cwd=tmp_path)
    metafmu("export", "m.safetensors", "--out", tmp_path, cwd=tmp_path)
    for name, said in [("m.safetensors", "is a model file of metafmu already"), (fmu_of(tmp_path, "m", 2), "is an FMU")]:
        for more in (["--new", "n.toml"], ["--interface", "i.toml"]):
            run = metafmu("import", name, *more, cwd=tmp_path, check=False)
            assert run.returncode == 2 and said in run.stderr and "`metafmu export`" in run.stderr and run.stderr.count("\n") == 1, run.stderr
