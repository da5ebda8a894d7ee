"""Wrong files for the verifier: with one wrong bias, with ties that go to the highest index, with other lenses."""

from __future__ import annotations

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper


def spoil(model: onnx.ModelProto, by: float = 0.05) -> None:
    """Change one bias of the opacity head: finite, plausible, wrong; or not finite."""
    (target,) = [i for i in model.graph.initializer if i.name == "network.heads.alpha.out.bias"]
    target.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(target) + np.float32(by), target.name))


def spoil_ties(model: onnx.ModelProto) -> None:
    """Every ArgMax takes the last maximum instead of the first: other routes where logits tie, the same elsewhere."""
    nodes = [node for node in model.graph.node if node.op_type == "ArgMax"]
    assert nodes
    for node in nodes:
        others = [attribute for attribute in node.attribute if attribute.name != "select_last_index"]
        del node.attribute[:]
        node.attribute.extend([*others, helper.make_attribute("select_last_index", 1)])


def spoil_lens(model: onnx.ModelProto, entry: int, taken_from: int, share: float) -> None:
    """Entry number `entry` of every flattened intrinsic matrix becomes `share` times that of number `taken_from`."""
    change = np.eye(9, dtype=np.float32)
    change[:, entry] = 0
    change[taken_from, entry] = share
    initializers = {"nine": np.array([-1, 9]), "three": np.array([-1, 3, 3]), "change": change}
    model.graph.initializer.extend(numpy_helper.from_array(value, name) for name, value in initializers.items())
    _in_place_of(
        model,
        "intrinsics",
        [
            helper.make_node("Reshape", ["intrinsics", "nine"], ["flat"]),
            helper.make_node("MatMul", ["flat", "change"], ["changed"]),
            helper.make_node("Reshape", ["changed", "three"], ["spoiled"]),
        ],
    )


def spoil_views(model: onnx.ModelProto, name: str) -> None:
    """Every view gets the first one's part of an input."""
    model.graph.initializer.append(helper.make_tensor("first", TensorProto.INT64, [1], [0]))
    _in_place_of(
        model,
        name,
        [
            helper.make_node("Gather", [name, "first"], ["alone"], axis=0),
            helper.make_node("Shape", [name], ["shape"]),
            helper.make_node("Expand", ["alone", "shape"], ["spoiled"]),
        ],
    )


def _in_place_of(model: onnx.ModelProto, name: str, nodes: list[onnx.NodeProto]) -> None:
    """All nodes read what `nodes` call "spoiled" in place of the input `name`."""
    own = list(model.graph.node)
    for node in own:
        node.input[:] = ["spoiled" if value == name else value for value in node.input]
    del model.graph.node[:]
    model.graph.node.extend([*nodes, *own])
