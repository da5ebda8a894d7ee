"""Models of one node in place of the network's; nothing else is imported here, since processes of tests wait for it."""

from __future__ import annotations

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper


def small() -> onnx.ModelProto:
    """Without weights."""
    x, y = (helper.make_tensor_value_info(name, TensorProto.FLOAT, [1]) for name in "xy")
    return helper.make_model(helper.make_graph([helper.make_node("Identity", ["x"], ["y"])], "small", [x], [y]))


def product(seed: int) -> onnx.ModelProto:
    """y = x @ w with 16 KB of weights."""
    weights = np.random.default_rng(seed).normal(size=(64, 64)).astype(np.float32)
    x, y = (helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 64]) for name in "xy")
    node = helper.make_node("MatMul", ["x", "w"], ["y"])
    return helper.make_model(helper.make_graph([node], "product", [x], [y], [numpy_helper.from_array(weights, "w")]))
