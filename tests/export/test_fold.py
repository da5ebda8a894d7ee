"""Folding a traced graph: removed nodes change nothing, and rotations stay."""

from __future__ import annotations

import onnx
import onnx_ir as ir
from onnx import TensorProto, helper

from gapmes.export.fold import folded


def test_transposes_that_turn_nothing_go_and_others_stay() -> None:
    nodes = [
        helper.make_node("Transpose", ["x"], ["same"], perm=[0, 1]),
        helper.make_node("Transpose", ["same"], ["turned"], perm=[1, 0]),
        helper.make_node("Relu", ["turned"], ["y"]),
        helper.make_node("Transpose", ["x"], ["z"], perm=[0, 1]),  # an output's own name has to be made by something
    ]
    values = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [2, 2]) for name in "xyz"]
    graph = helper.make_graph(nodes, "g", values[:1], values[1:])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    result = ir.to_proto(folded(ir.from_proto(model)))
    onnx.checker.check_model(result, full_check=True)
    orders = [list(node.attribute[0].ints) for node in result.graph.node if node.op_type == "Transpose"]
    assert sorted(orders) == [[0, 1], [1, 0]]
    assert {output.name for output in result.graph.output} == {"y", "z"}
