"""ONNX graphs for the tests: what fits, and what does not or is malicious."""

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

FLOAT, DOUBLE, INT64 = TensorProto.FLOAT, TensorProto.DOUBLE, TensorProto.INT64
RANDOM = np.random.default_rng(7)


def model(nodes, initializers=(), inputs=(("x", ["n", 3]),), outputs=(("y", None),), kind=FLOAT, opset=20, ml=3, **more):
    """A model of nodes; constants are given by name."""
    value = lambda name, shape: helper.make_tensor_value_info(name, kind, shape)
    graph = helper.make_graph(
        list(nodes),
        "graph",
        [value(*each) for each in inputs],
        [value(*each) for each in outputs],
        [numpy_helper.from_array(array, name) for name, array in dict(initializers).items()],
    )
    sets = [helper.make_opsetid("", opset), helper.make_opsetid("ai.onnx.ml", ml)]
    return helper.make_model(graph, opset_imports=sets, ir_version=9, **more)


def node(operator, inputs, outputs="y", **attributes):
    """A node; names are separated by spaces, `-` is one that is left out."""
    names = lambda text: ["" if name == "-" else name for name in text.split()]
    return helper.make_node(operator, names(inputs), names(outputs), **attributes)


def reals(*shape, low=-1.0, high=1.0, of=np.float32):
    return RANDOM.uniform(low, high, shape).astype(of)


def integers(*values):
    return np.array(values, dtype=np.int64)


def dense(width=3, outputs=2, of=np.float32):
    return {"w": reals(width, outputs, of=of), "b": reals(outputs, of=of)}


def fitting(of=np.float32):
    """Names and models of graphs that fit, each with an input `x` of three columns."""
    kind = FLOAT if of == np.float32 else DOUBLE
    make = lambda *nodes, opset=20, **constants: model(nodes, constants, kind=kind, opset=opset)
    r = lambda *shape, **more: reals(*shape, of=of, **more)
    unary = {
        "Abs": {}, "Atan": {}, "Celu": {"alpha": 1.5}, "Cos": {}, "Cosh": {}, "Elu": {"alpha": 0.5}, "Erf": {}, "Exp": {},
        "HardSigmoid": {"alpha": 0.25}, "HardSwish": {}, "LeakyRelu": {"alpha": 0.25}, "LogSoftmax": {}, "Mish": {}, "Neg": {}, "Relu": {},
        "Selu": {}, "Sigmoid": {}, "Sin": {}, "Sinh": {}, "Softmax": {"axis": -1}, "Softplus": {}, "Softsign": {}, "Tan": {},
        "Tanh": {}, "ThresholdedRelu": {"alpha": 0.25}, "Identity": {},
    }
    if of == np.float64:
        # the reference has these, or a constant in them, in single precision
        del unary["Erf"], unary["HardSwish"], unary["Selu"]
    for operator, attributes in unary.items():
        yield operator, make(node(operator, "x", **attributes))
    if of == np.float32:
        yield "Gelu", make(node("Gelu", "x"))
        yield "Gelu-tanh", make(node("Gelu", "x", approximate="tanh"))
    yield "Log", make(node("Abs", "x", "a"), node("Add", "a c", "s"), node("Log", "s"), c=r(3, low=0.5))
    yield "Sqrt", make(node("Abs", "x", "a"), node("Add", "a c", "s"), node("Sqrt", "s"), c=r(3, low=0.5))
    yield "Reciprocal", make(node("Abs", "x", "a"), node("Add", "a c", "s"), node("Reciprocal", "s"), c=r(3, low=0.5))
    yield "Pow", make(node("Pow", "x c"), c=np.array([2.0], of))
    yield "Pow-of-each", make(node("Abs", "x", "a"), node("Pow", "a c"), c=np.array([2.0, 1.5, 3.0], of))
    yield "Pow-of-constant", make(node("Pow", "c x"), c=np.array([2.0, 1.5, 3.0], of))
    yield "Pow-of-two", make(node("Exp", "x", "a"), node("Pow", "a x"))
    yield "PRelu", make(node("PRelu", "x c"), c=r(3))
    yield "Clip", make(node("Clip", "x l u"), l=np.array(-0.5, of), u=np.array(0.25, of))
    yield "Clip-one", make(node("Clip", "x - u"), u=np.array(0.25, of))
    yield "Gemm", make(node("Gemm", "x w b", transB=1, alpha=0.5, beta=2.0), w=r(2, 3), b=r(2))
    yield "Gemm-without-bias", make(node("Gemm", "x w"), w=r(3, 2))
    yield "MatMul-of-constant-first", make(
        node("Transpose", "x", "t", perm=[1, 0]), node("MatMul", "w t", "p"), node("Transpose", "p", perm=[1, 0]), w=r(2, 3)
    )
    yield "MatMul-vector", make(node("MatMul", "x w"), w=r(3))
    yield "perceptron", make(
        node("MatMul", "x w", "a"), node("Add", "a b", "s"), node("Tanh", "s", "t"), node("Gemm", "t v c"),
        w=r(3, 5), b=r(5), v=r(5, 2), c=r(2),
    )
    yield "arithmetic", make(
        node("Sub", "x c", "a"), node("Div", "a d", "e"), node("Sub", "c e", "f"), node("Mul", "f e", "g"), node("Div", "c k"),
        c=r(3), d=r(3, low=0.5), k=r(3, low=0.5),
    )
    yield "arithmetic-of-rows", make(
        node("Exp", "x", "e"), node("Div", "x e", "d"), node("Max", "x d c", "m"), node("Min", "m e", "n"), node("Sum", "n x e", "s"),
        node("Mean", "s d"), c=r(3),
    )
    yield "MatMul-of-rows", make(
        node("Reshape", "x s", "r"), node("Exp", "r", "e"), node("Transpose", "e", "t", perm=[0, 2, 1]), node("MatMul", "r t", "p"), node("MatMul", "p e"),
        s=integers(-1, 3, 1),
    )
    yield "MatMul-of-several", make(
        node("MatMul", "x w", "a"), node("Reshape", "a s", "r"), node("MatMul", "r v", "p"), node("Flatten", "p"), w=r(3, 12), s=integers(-1, 4, 3), v=r(3, 2)
    )
    yield "attention", make(
        node("MatMul", "x w", "a"), node("Reshape", "a s", "r"), node("MatMul", "r q", "u"), node("MatMul", "r k", "v"), node("Transpose", "v", "t", perm=[0, 2, 1]),
        node("MatMul", "u t", "l"), node("Softmax", "l", "p"), node("MatMul", "p r", "o"), node("Flatten", "o"), w=r(3, 15), s=integers(-1, 5, 3), q=r(3, 4), k=r(3, 4),
    )
    yield "residual", make(node("MatMul", "x w", "a"), node("Tanh", "a", "t"), node("Add", "t x", "s"), node("MatMul", "s v"), w=r(3, 3), v=r(3, 2))
    yield "BatchNormalization", make(node("BatchNormalization", "x s b m v", epsilon=2.0**-16), s=r(3), b=r(3), m=r(3), v=r(3, low=0.5))
    yield "LayerNormalization", make(node("LayerNormalization", "x s b", epsilon=2.0**-16), s=r(3), b=r(3))
    yield "Dropout", make(node("Dropout", "x"))
    yield "Flatten", make(node("Unsqueeze", "x a", "u"), node("Flatten", "u"), a=integers(2))
    yield "Reshape", make(node("Reshape", "x s", "r"), node("MatMul", "r w", "p"), node("Reshape", "p t"), s=integers(0, 3, 1), w=r(1, 2), t=integers(-1, 6))
    yield "shapes-computed", make(
        node("Shape", "x", "s"), node("Gather", "s z", "n", axis=0), node("Concat", "n m", "t", axis=0), node("Reshape", "x t"),
        z=integers(0), m=integers(-1),
    )
    yield "Squeeze", make(node("Unsqueeze", "x a", "u"), node("Squeeze", "u a"), a=integers(1))
    yield "Transpose", make(node("Unsqueeze", "x a", "u"), node("Transpose", "u", "t", perm=[0, 2, 1]), node("Flatten", "t"), a=integers(1))
    yield "Where", make(
        node("Greater", "x c", "g"), node("Exp", "x", "e"), node("Where", "g x e", "w"), node("LessOrEqual", "w x", "l"), node("Not", "l", "o"),
        node("And", "g o", "a"), node("Where", "a d w"), c=r(3), d=r(3),
    )
    yield "Sign", make(node("Sign", "x"))
    yield "Concat", make(node("Tanh", "x", "t"), node("Concat", "x t", axis=1))
    yield "Slice", make(node("Slice", "x s e a p"), s=integers(-1), e=integers(-4), a=integers(1), p=integers(-2))
    yield "Split", make(node("Split", "x p", "a c", axis=1), node("MatMul", "c w", "m"), node("Add", "a m"), p=integers(1, 2), w=r(2, 1))
    yield "Gather", make(node("Gather", "x i", axis=1), i=integers(2, 0, -2))
    yield "Expand", make(node("Slice", "x s e a", "c"), node("Expand", "c t"), s=integers(0), e=integers(1), a=integers(1), t=integers(1, 4))
    yield "Tile", make(node("Tile", "x t"), t=integers(1, 2))
    for operator in ["L1", "L2", "LogSumExp", "Max", "Mean", "Min", "Prod", "Sum", "SumSquare"]:
        yield f"Reduce{operator}", make(node(f"Reduce{operator}", "x a"), a=integers(1))
    yield "Reduce-of-many", make(
        node("MatMul", "x w", "m"), node("Reshape", "m s", "r"), node("ReduceMax", "r a", "h"), node("ReduceProd", "h e", "p", keepdims=0),
        node("LogSoftmax", "r", "l", axis=1), node("ReduceMin", "l t", "o", keepdims=0), node("Concat", "p o", axis=1),
        w=r(3, 22), s=integers(-1, 11, 2), a=integers(1), e=integers(2), t=integers(-1),
    )
    yield "ReduceMean-flat", make(node("ReduceMean", "x a", keepdims=0), a=integers(-1))
    # of whole numbers, which become factors: 7 mod -3 with the sign of either, ranges in both directions, a mean
    whole = lambda *nodes, **constants: make(*nodes, node("Cast", "i", "f", to=kind), node("Mul", "x f"), **constants)
    for sign in (0, 1):
        yield f"Mod-{sign}", whole(node("Mod", "a c", "i", fmod=sign), a=integers(-7, 7, 5), c=integers(3, -3, 3))
    for limit, step in ((7, 3), (-7, -3), (6, 2), (-6, -2)):
        range_of = [node("Range", "a e d", "r"), node("ReduceSum", "r", "i", keepdims=0)]
        yield f"Range-{limit}-{step}", whole(*range_of, a=np.int64(0), e=np.int64(limit), d=np.int64(step))
    yield "ReduceMean-whole", whole(node("ReduceMean", "a", "i", keepdims=0), a=integers(*[1] * 10))
    yield "Cast", make(node("Cast", "x", "c", to=DOUBLE), node("Mul", "c d", "p"), node("Cast", "p", to=kind), d=np.array([2.0, 3.0, 4.0]))
    yield "Constant", make(node("Constant", "", "c", value=numpy_helper.from_array(r(3))), node("Mul", "x c"))
    yield "old", make(node("Clip", "x", "c", min=-0.5, max=0.5), node("Slice", "c", starts=[1], ends=[3], axes=[1]), opset=9)
    yield "unused", make(node("MatMul", "x w", "a"), node("Tanh", "x", "t"), node("Identity", "a"), w=r(3, 2))
    for operator in ["L1", "L2", "LogSum", "LogSumExp", "Max", "Mean", "Min", "Prod", "Sum", "SumSquare"]:
        yield f"Reduce{operator}-nothing", make(node("Exp", "x", "e"), node("Neg", "x", "n"), node(f"Reduce{operator}", "e", noop_with_empty_axes=1))
    yield "ReduceLogSum", make(node("Exp", "x", "e"), node("ReduceLogSum", "e a"), a=integers(1))
    for operator in ["Softmax", "LogSoftmax"]:
        yield f"{operator}-axis", make(
            node("MatMul", "x w", "m"), node("Reshape", "m s", "r"), node(operator, "r", "l", axis=1), node("Flatten", "l"), w=r(3, 12), s=integers(-1, 2, 3, 2)
        )
    yield "Asin", make(node("Asin", "x"))
    yield "Acos", make(node("Acos", "x"))
    yield "Equal", make(
        node("Relu", "x", "r"), node("Equal", "r x", "e"), node("Where", "e x c"), c=r(3)
    )


def windowed(of=np.float32):
    """Names and models of convolutions and what goes with them; inputs `x` of other shapes."""
    kind = FLOAT if of == np.float32 else DOUBLE
    r = lambda *shape: reals(*shape, of=of)

    def make(shape, *nodes, **constants):
        return model(nodes, constants, inputs=(("x", ["n", *shape]),), kind=kind, opset=20)

    conv = lambda *inputs, **more: node("Conv", " ".join(["x", *inputs]), **more)
    yield "conv-1d", make([3, 8], conv("w", "b"), w=r(4, 3, 3), b=r(4))
    yield "conv-padded", make([3, 8], conv("w", pads=[2, 1], strides=[2], dilations=[2]), w=r(4, 3, 3))
    yield "conv-groups", make([4, 7], conv("w", "b", group=2, pads=[1, 1]), w=r(6, 2, 3), b=r(6))
    yield "conv-depthwise", make([3, 5, 4], conv("w", group=3, kernel_shape=[2, 3]), w=r(3, 1, 2, 3))
    for pad in ["SAME_UPPER", "SAME_LOWER", "VALID"]:
        yield f"conv-{pad}", make([2, 6, 5], conv("w", auto_pad=pad, strides=[2, 1]), w=r(3, 2, 3, 2))
    yield "conv-causal", make(
        [3, 8], node("Pad", "x p", "c"), node("Conv", "c w b", "d", dilations=[2]), node("Relu", "d", "e"), node("Slice", "e s t a", "l"), node("Flatten", "l"),
        p=integers(0, 0, 4, 0, 0, 0), w=r(5, 3, 3), b=r(5), s=integers(-1), t=integers(9), a=integers(2),
    )
    pool = lambda operator, **more: node(operator, "x", **more)
    yield "average-pool", make([3, 7], pool("AveragePool", kernel_shape=[3], strides=[2], pads=[1, 1]))
    yield "average-pool-all", make([2, 5, 4], pool("AveragePool", kernel_shape=[3, 2], pads=[1, 0, 1, 1], count_include_pad=1))
    yield "max-pool", make([3, 7], pool("MaxPool", kernel_shape=[3], strides=[2], pads=[1, 1]))
    if of == np.float32:
        # the reference mixes up the dimensions
        yield "max-pool-2d", make([2, 5, 4], pool("MaxPool", kernel_shape=[3, 2], pads=[1, 0, 1, 1]))
        # nor does it take away what is padded by a negative number
        yield "pad-negative", make([2, 4], node("Pad", "x p c"), p=integers(0, 1, 2, 0, 0, -1), c=np.array(0.5, of))
    yield "instance-normalization", make([3, 4, 2], node("InstanceNormalization", "x s b", epsilon=2.0**-16), s=r(3), b=r(3))
    if of == np.float32:
        yield "group-normalization", model(
            [node("GroupNormalization", "x s b", epsilon=2.0**-16, num_groups=2)], {"s": r(4), "b": r(4)}, inputs=(("x", ["n", 4, 3]),), kind=kind, opset=21
        )
    yield "global-average-pool", make([3, 4, 2], pool("GlobalAveragePool"))
    yield "global-max-pool", make([3, 4, 2], pool("GlobalMaxPool"))
    yield "pad-constant", make([2, 4], node("Pad", "x p c"), p=integers(0, 1, 2, 0, 0, 1), c=np.array(0.5, of))
    yield "pad-axes", make([2, 4], node("Pad", "x p - a"), p=integers(1, 2), a=integers(-1))
    yield "pad-edge", make([2, 4], node("Pad", "x p", mode="edge"), p=integers(0, 0, 3, 0, 0, 2))
    yield "pad-reflect", make([2, 4], node("Pad", "x p", mode="reflect"), p=integers(0, 0, 3, 0, 0, 2))


def mixed():
    """Names, nodes, constants and messages of graphs whose rows depend on each other, or on their place in the batch."""
    yield "mean", [node("ReduceMean", "x a", "m"), node("Sub", "x m")], {"a": integers(0)}, "node 0 (ReduceMean): it mixes rows of the batch"
    yield "sum-of-all", [node("ReduceSum", "x", "s"), node("Mul", "x s")], {}, "node 0 (ReduceSum): it mixes rows of the batch"
    yield "gram", [node("Transpose", "x", "t", perm=[1, 0]), node("MatMul", "x t")], {}, "node 1 (MatMul): it mixes rows of the batch"
    yield "last", [node("Slice", "x s e a")], {"s": integers(-1), "e": integers(9), "a": integers(0)}, "node 0 (Slice): it acts along the batch dimension"
    yield "first", [node("Gather", "x i", axis=0)], {"i": integers(0)}, "node 0 (Gather): it acts along the batch dimension"
    yield "softmax", [node("Softmax", "x", axis=0)], {}, "node 0 (Softmax): it mixes rows of the batch"
    yield "twice", [node("Concat", "x x", axis=0)], {}, "node 0 (Concat): it puts rows together along the batch dimension"
    yield "tiled", [node("Tile", "x t")], {"t": integers(3, 1)}, "node 0 (Tile): it repeats rows along the batch dimension"
    yield "expanded", [node("Expand", "x t")], {"t": integers(3, 3)}, "node 0 (Expand): it repeats rows along the batch dimension"
    for rows in [2, 3]:
        yield f"constant-{rows}", [node("Add", "x c")], {"c": reals(rows, 3)}, f"node 0 (Add): a constant of shape [{rows}, 3] along the batch dimension"
    yield "bias", [node("Gemm", "x w b")], {"w": reals(3, 2), "b": reals(2, 2)}, "node 0 (Gemm): a constant of shape [2, 2] along the batch dimension"
    yield "normalized", [node("LayerNormalization", "x c c", axis=0)], {"c": reals(1, 3)}, "node 0 (LayerNormalization): it mixes rows of the batch"
    scaler = node("Scaler", "x", "s", domain="ai.onnx.ml", offset=[0.0], scale=[2.0])
    yield "scaled", [scaler, node("Softmax", "s", axis=0)], {}, "node 1 (Softmax): it mixes rows of the batch"
    size = [node("Shape", "x", "s", start=0, end=1), node("Cast", "s", "f", to=FLOAT)]
    yield "size", [*size, node("Mul", "x f")], {}, "node 2 (Mul): a constant that changes along the batch dimension"
    place = [node("Shape", "x", "s", start=0, end=1), node("Squeeze", "s", "n"), node("Range", "a n b", "r"), node("Cast", "r", "f", to=FLOAT)]
    yield "place", [*place, node("Unsqueeze", "f c", "g"), node("Add", "x g")], {"a": np.int64(0), "b": np.int64(1), "c": integers(1)}, \
        "node 5 (Add): a constant that changes along the batch dimension"
    yield "moved", [
        node("Unsqueeze", "x a", "u"), node("Transpose", "u", "t", perm=[2, 0, 1]), node("ReduceMax", "t b", "m"), node("Squeeze", "m b"),
    ], {"a": integers(1), "b": integers(1)}, "node 2 (ReduceMax): it mixes rows of the batch"


def malformed():
    """Names, bytes or models, and a part of the message of what is refused."""
    make = lambda *nodes, **constants: model(nodes, constants)
    tanh = make(node("Tanh", "x"))
    data = tanh.SerializeToString()

    def changed(change, of=tanh):
        copy = onnx.ModelProto()
        copy.CopyFrom(of)
        change(copy)
        return copy

    def tensor(**fields):
        return changed(lambda m: m.graph.initializer.append(TensorProto(name="c", **fields)), make(node("Add", "x c")))

    def external(**entries):
        pairs = [onnx.StringStringEntryProto(key=key, value=str(value)) for key, value in entries.items()]
        return tensor(dims=[3], data_type=FLOAT, data_location=1, external_data=pairs)

    w = reals(3, 2)
    yield "empty", b"", "no graph"
    yield "text", b"hello, this is no model at all", "not an ONNX model"
    yield "cut", make(node("MatMul", "x w"), w=reals(3, 200)).SerializeToString()[:700], "not an ONNX model, or cut short"
    yield "noise", bytes(RANDOM.integers(0, 256, 4000, dtype=np.uint8)), ""
    yield "nested", b"\x3a\x80\x80\x80\x80\x10" + data, "not an ONNX model"
    yield "no-graph", changed(lambda m: m.ClearField("graph")), "no graph"
    yield "old-opset", changed(lambda m: setattr(m.opset_import[0], "version", 5)), "operators of version (opset) 5, expected 7 to 24"
    yield "new-opset", changed(lambda m: setattr(m.opset_import[0], "version", 99)), "(opset) 99"
    yield "no-inputs", model([node("Identity", "c")], {"c": reals(1, 3)}, inputs=()), "the graph has no inputs"
    yield "no-outputs", model([node("Tanh", "x")], outputs=()), "the graph has no outputs"
    yield "output-of-nothing", model([node("Tanh", "x", "z")]), "output `y` is made by no node"
    yield "cycle", make(node("Add", "x b", "a"), node("Tanh", "a", "b"), node("Identity", "b")), "node 0 (Add): input `b` is made by no earlier node"
    yield "out-of-order", make(node("Identity", "t"), node("Tanh", "x", "t")), "input `t` is made by no earlier node"
    yield "twice", make(node("Tanh", "x"), node("Sin", "x")), "output `y` is made twice"
    yield "input-twice", model([node("Tanh", "x")], inputs=[("x", ["n", 3]), ("x", ["n", 2])]), "input `x` is there twice, expected names that are unique"
    yield "missing-input", make(node("Add", "x -")), "input 1 is missing"
    yield "unknown-operator", make(node("Tanhh", "x")), "operator `Tanhh` (node 0 (Tanhh)) is not supported; did you mean `Tanh`?"
    yield "other-domain", changed(lambda m: setattr(m.graph.node[0], "domain", "com.microsoft")), "operator `com.microsoft.Tanh`"
    yield "lstm", make(node("LSTM", "x w w"), w=w), "node 0 (LSTM): a sequence of shape [1, 3], expected three dimensions"
    yield "conv", make(node("Conv", "x w"), w=w), "expected the batch, channels, and other dimensions"
    yield "conv-transposed", make(node("ConvTranspose", "x w"), w=w), "operator `ConvTranspose` (node 0 (ConvTranspose)) is not supported"
    yield "branch", make(node("If", "x")), "expected a graph without branches"
    yield "classifier", make(node("ArgMax", "x")), "expected a regression"
    yield "dropout-in-training", make(node("Dropout", "x r t"), r=np.array(0.5, np.float32), t=np.array(True)), "a network in training"
    yield "wrong-width", make(node("MatMul", "x w"), w=reals(4, 2)), "a product of shapes [1, 3] and [4, 2]"
    yield "wrong-bias", make(node("Gemm", "x w b"), w=w, b=reals(3)), "shapes [1, 2] and [3]"
    yield "gemm-of-three", make(node("Gemm", "x w"), w=reals(1, 3, 2)), "expected two dimensions"
    yield "wrong-add", make(node("Add", "x c"), c=reals(4)), "that do not fit each other"
    yield "wrong-reshape", make(node("Reshape", "x s"), s=integers(2, 2)), "is to become [2, 2]"
    yield "two-rests", make(node("Reshape", "x s"), s=integers(-1, -1)), "a dimension of -1"
    yield "negative-reshape", make(node("Reshape", "x s"), s=integers(-3, -1)), "a dimension of -3"
    yield "shape-of-input", make(node("Reshape", "x x")), "follows from the graph's inputs, expected a constant"
    yield "real-shape", make(node("Reshape", "x s"), s=reals(2)), "expected whole ones"
    yield "huge-reshape", make(node("Expand", "x s"), s=integers(1 << 40, 3)), "expected at most"
    yield "huge-tile", make(node("Tile", "x t"), t=integers(1, 1 << 62)), "expected at most"
    yield "huge-constant", make(node("ConstantOfShape", "s", "c"), node("Add", "x c"), s=integers(1 << 20, 1 << 20)), "expected at most"
    yield "large-expand", make(node("Slice", "x s e a", "c"), node("Expand", "c t"), s=integers(0), e=integers(1), a=integers(1), t=integers(11_075_713, 12)), "expected at most"
    yield "large-constants", make(
        node("ConstantOfShape", "s", "c"), node("Neg", "c", "d"), node("Neg", "d", "e"), node("Gather", "e i", "f"), node("Add", "x f"),
        s=integers(1 << 24), i=integers(0),
    ), "constants of"
    yield "huge-range", make(node("Range", "a e d", "r"), node("Gather", "x r"), a=integers(0), e=integers(1 << 62), d=integers(1)), "expected at most"
    yield "many-values", make(node("Expand", "x s", "e"), node("Tanh", "e"), s=integers(1 << 22, 3)), "expected at most"
    yield "wide-product", model(
        [node("Expand", "x s", "e"), node("ReduceSum", "e a", "r"), node("Expand", "r s")], {"s": integers(1 << 20, 3), "a": integers(1)},
        inputs=(("x", [1, 3]),),
    ), "expected at most"
    image = lambda *nodes, shape=(1, 2, 5), **constants: model(nodes, constants, inputs=(("x", shape),))
    yield "conv-channels", image(node("Conv", "x w"), w=reals(4, 3, 2)), "do not fit each other in these groups"
    yield "conv-too-wide", image(node("Conv", "x w"), w=reals(4, 2, 7)), "a window of [7] elements for dimensions [5]"
    yield "conv-bias", image(node("Conv", "x w b"), w=reals(4, 2, 3), b=reals(3)), "a bias of 3 numbers, expected 4"
    yield "conv-of-image", image(node("Conv", "x w"), shape=(1, 3, 224, 224), w=reals(4, 3, 3, 3)), "expected at most 4096"
    yield "conv-dilated", image(node("Conv", "x w", dilations=[1 << 62]), w=reals(4, 2, 3)), "attribute `dilations`"
    yield "conv-without-groups", image(node("Conv", "x w", group=0), w=reals(4, 2, 3)), "do not fit each other in these groups"
    yield "pool-of-padding", image(node("MaxPool", "x", kernel_shape=[2], pads=[4, 0])), "a window that has nothing of the tensor"
    yield "pool-indices", image(node("MaxPool", "x", "m i", kernel_shape=[2]), node("Cast", "i", to=FLOAT)), (
        "node 1 (Cast): input `i` is output 1 of operator `MaxPool`, which is not supported: only its first is"
    )
    yield "normalization-mean", make(node("LayerNormalization", "x c c", "n y"), c=reals(3)), "output `y` is output 1 of operator `LayerNormalization`, which is not supported"
    yield "pool-without-kernel", image(node("MaxPool", "x")), "attribute `kernel_shape` is missing"
    yield "pool-rounded-up", image(node("MaxPool", "x", kernel_shape=[2], strides=[2], ceil_mode=1)), "attribute `ceil_mode` is not 0"
    yield "pool-of-nothing", image(
        node("ConstantOfShape", "s", "c"), node("MaxPool", "c", kernel_shape=[2], auto_pad="SAME_UPPER"), s=integers(1, 2, 0)
    ), "a shape of [1, 2, 0], expected the batch, channels, and other dimensions"
    yield "pad-huge", image(node("Pad", "x p"), p=integers(0, 0, 1 << 62, 0, 0, 1 << 62)), "pads of"
    yield "pad-reflect-twice", image(node("Pad", "x p", mode="reflect"), p=integers(0, 0, 9, 0, 0, 0)), "pads of"
    yield "wrong-axis", make(node("Gather", "x i", axis=5), i=integers(0)), "axis 5 of a tensor of 2 dimensions"
    yield "wrong-index", make(node("Gather", "x i", axis=1), i=integers(3)), "index 3 of 3"
    yield "wrong-permutation", make(node("Transpose", "x", perm=[0, 0])), "perm [0, 0] of 2 dimensions"
    yield "wrong-split", make(node("Split", "x s", "y z", axis=1), s=integers(1, 1)), "3 elements in parts of [1, 1]"
    yield "step-of-zero", make(node("Slice", "x s e a p"), s=integers(0), e=integers(3), a=integers(1), p=integers(0)), "a step of 0"
    yield "empty-slice", make(node("Slice", "x s e a"), s=integers(2), e=integers(1), a=integers(1)), "nothing is left"
    yield "by-zero", make(node("Div", "x c"), c=np.zeros(3, np.float32)), "a division by a constant that is 0"
    yield "log-of-negative", make(node("Log", "c", "l"), node("Add", "x l"), c=-np.ones(3, np.float32)), "not finite"
    yield "training", make(node("BatchNormalization", "x s s s s", training_mode=1), s=np.ones(3, np.float32)), "export it after `eval()`"
    yield "channels", make(node("BatchNormalization", "x s s s s"), s=np.ones(4, np.float32)), "has 4 elements, expected 3"
    yield "features", make(node("FeatureVectorizer", "x", domain="ai.onnx.ml", inputdimensions=[2])), "`inputdimensions` is [2] for inputs of [3] columns"
    for name, nodes, constants, place in mixed():
        yield f"batch-{name}", model(nodes, constants), place
    yield "batch-softmax-old", model([node("Softmax", "x", axis=0)], opset=11), "node 0 (Softmax): it mixes rows of the batch"
    yield "not-a-number", make(node("Add", "x c"), c=np.array([1.0, np.nan, 0.0], np.float32)), "initializer `c`: a number is not finite"
    yield "cast-to-integer", make(node("Cast", "x", to=INT64)), "a cast to int64, expected float or double"
    yield "cast-like-integer", make(node("CastLike", "x c", "i"), node("Cast", "i", to=FLOAT), c=integers(1)), "node 0 (CastLike): a cast to whole numbers or truth values"
    yield "cast-like-truth", make(node("CastLike", "x c", "i"), node("Cast", "i", to=FLOAT), c=np.array([True])), "node 0 (CastLike): a cast to whole numbers or truth values"
    yield "too-few-numbers", tensor(dims=[3], data_type=FLOAT, raw_data=b"1234"), "1 elements of data, its shape has 3"
    yield "odd-bytes", tensor(dims=[3], data_type=FLOAT, raw_data=b"12345678901"), "elements of data"
    yield "huge-tensor", tensor(dims=[1 << 31, 1 << 31], data_type=FLOAT), "expected at most"
    yield "negative-tensor", tensor(dims=[-3], data_type=FLOAT), "a negative dimension"
    yield "deep-tensor", tensor(dims=[1] * 99, data_type=FLOAT), "99 dimensions"
    yield "half", tensor(dims=[3], data_type=TensorProto.FLOAT16, raw_data=b"123456"), "elements of type float16"
    yield "strings", tensor(dims=[1], data_type=TensorProto.STRING, string_data=[b"a"]), "elements of type string"
    yield "external-above", external(location="../secret.bin"), "expected a file in the folder of the model"
    yield "external-absolute", external(location="/etc/passwd"), "expected a file in the folder of the model"
    yield "external-link", external(location="link.bin", length=12), "expected a file in the folder of the model"
    yield "external-device", external(location="folder"), "external data in `folder`: is a directory"
    yield "external-pipe", external(location="pipe"), "it is not a regular file but a pipe"
    yield "external-missing", external(location="none.bin"), "`none.bin`: "
    yield "external-without-location", external(offset=0), "without a `location`"
    yield "external-beyond", external(location="data.bin", offset=8, length=1 << 40), "but the file has 12"
    yield "external-offset", external(location="data.bin", offset="ten"), '`offset` "ten", expected a number'
    yield "no-width", model([node("Tanh", "x")], inputs=(("x", ["n", 0]),)), "dimension 1 is 0, expected a positive number"
    yield "free-width", model([node("Tanh", "x")], inputs=(("x", ["n", "m"]),)), "dimension 1 is free (`m`)"
    yield "integer-input", model([node("Tanh", "x")], kind=INT64), "input `x`: elements of type int64"
    yield "wide-input", model([node("Tanh", "x")], inputs=(("x", ["n", 1 << 26]),)), "expected at most"
    tree = dict(nodes_treeids=[0] * 3, nodes_nodeids=[0, 1, 2], nodes_featureids=[0] * 3, nodes_values=[0.0] * 3, nodes_truenodeids=[1, 0, 0],
                nodes_falsenodeids=[2, 0, 0], nodes_modes=["BRANCH_LEQ", "LEAF", "LEAF"], target_treeids=[0, 0], target_nodeids=[1, 2],
                target_ids=[0, 0], target_weights=[1.0, 2.0], n_targets=1)
    trees = lambda **changes: model([node("TreeEnsembleRegressor", "x", domain="ai.onnx.ml", **{**tree, **changes})])
    yield "tree-cycle", trees(nodes_truenodeids=[0, 0, 0]), "tree 0 has a cycle"
    yield "tree-without-node", trees(nodes_truenodeids=[7, 0, 0]), "no node 7 in tree 0"
    yield "tree-feature", trees(nodes_featureids=[9, 0, 0]), "looks at feature 9, of 3"
    yield "tree-mode", trees(nodes_modes=["BRANCH_EQ", "LEAF", "LEAF"]), "a node of mode BRANCH_EQ"
    yield "tree-lengths", trees(nodes_values=[0.0]), "expected the same number of each"
    yield "tree-target", trees(target_ids=[0, 5]), "target 5 of 1"
    yield "tree-transform", trees(post_transform="LOGISTIC"), "post_transform LOGISTIC, expected NONE"
    yield "tree-many-targets", trees(n_targets=1 << 40), "targets"
    yield "svm-kernel", model([node("SVMRegressor", "x", domain="ai.onnx.ml", kernel_type="OWN", n_supports=1, support_vectors=[0.0] * 3, coefficients=[1.0], rho=[0.0])]), "kernel OWN"
    yield "svm-lengths", model([node("SVMRegressor", "x", domain="ai.onnx.ml", n_supports=2, support_vectors=[0.0] * 3, coefficients=[1.0], rho=[0.0])]), "expected 2 and 2 times 3"
    yield "scaler", model([node("Scaler", "x", domain="ai.onnx.ml", offset=[0.0] * 2, scale=[1.0])]), "attribute `offset` has 2 elements, expected 3"
    imputer = lambda **replaced: model([node("Imputer", "x", domain="ai.onnx.ml", imputed_value_floats=[5.0], **replaced)])
    yield "imputer", imputer(replaced_value_float=-1.0), "values of -1 are replaced, expected NaN"
    yield "imputer-of-zeros", imputer(), "values of 0 are replaced, expected NaN"
    yield "linear", model([node("LinearRegressor", "x", domain="ai.onnx.ml", coefficients=[1.0], targets=1)]), "expected 1 times 3 and 1"
