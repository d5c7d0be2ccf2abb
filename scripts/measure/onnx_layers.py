"""ONNX models with layers of random weights, as other tools write them."""

import numpy as np
from onnx import helper, numpy_helper


class Layers:
    """Nodes and tensors of a model from the input `x`, of one element type."""

    def __init__(self, kind):
        self.kind, self.random = kind, np.random.default_rng(1)
        self.tensors, self.nodes = [], []

    def tensor(self, shape, scale):
        values = (scale * self.random.standard_normal(shape)).astype(self.kind)
        self.tensors.append(numpy_helper.from_array(values, f"t{len(self.tensors)}"))
        return self.tensors[-1].name

    def node(self, operator, *inputs, **attributes):
        self.nodes.append(helper.make_node(operator, inputs, [f"v{len(self.nodes)}"], **attributes))
        return f"v{len(self.nodes) - 1}"

    def dense(self, x, inputs, outputs):
        return self.node("Gemm", x, self.tensor((outputs, inputs), 0.8 / inputs**0.5), self.tensor((outputs,), 0.1), transB=1)

    def model(self, name, inputs, value, outputs):
        """The model whose output is `value`; `inputs` and `outputs` are lengths."""
        dtype = helper.np_dtype_to_tensor_dtype(np.dtype(self.kind))
        ports = [helper.make_tensor_value_info(port, dtype, [1, size]) for port, size in (("x", inputs), (value, outputs))]
        graph = helper.make_graph(self.nodes, name, ports[:1], ports[1:], self.tensors)
        return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
