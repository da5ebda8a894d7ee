"""Folding a traced graph: removed nodes change nothing, and rotations stay."""

from __future__ import annotations

import numpy as np
import onnx
import onnx_ir as ir
from onnx import TensorProto, helper, numpy_helper

from gapmes.export.fold import GATES, folded


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


def test_equal_constants_become_one_but_those_of_the_gates() -> None:
    """Verification replaces them one by one: expert and task gate may both be zeros of one shape, untrained."""
    names = ["first", f"{GATES}expert_gate.weight", "second", f"{GATES}task_gate.weight"]
    nodes = [helper.make_node("MatMul", ["x", name], [f"y{i}"]) for i, name in enumerate(names)]
    given = [helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, 2])]
    made = [helper.make_tensor_value_info(f"y{i}", TensorProto.FLOAT, [1, 2]) for i in range(len(names))]
    zeros = [numpy_helper.from_array(np.zeros((2, 2), np.float32), name) for name in names]
    nodes.append(helper.make_node("Sum", [f"y{i}" for i in range(len(names))], ["z"]))
    result = [helper.make_tensor_value_info("z", TensorProto.FLOAT, [1, 2])]
    graph = helper.make_graph(nodes, "g", given, result, zeros, value_info=made)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    small = ir.to_proto(folded(ir.from_proto(model)))
    onnx.checker.check_model(small, full_check=True)
    assert [value.name for value in small.graph.initializer] == [names[0], names[1], names[3]]
    used = [node.input[1] for node in small.graph.node if node.op_type == "MatMul"]
    assert used == [names[0], names[1], names[3]]
