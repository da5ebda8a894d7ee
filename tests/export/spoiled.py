"""Wrong files for the verifier: with one wrong bias, or with ties that go to the highest index."""

from __future__ import annotations

import numpy as np
import onnx
from onnx import helper, numpy_helper


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
