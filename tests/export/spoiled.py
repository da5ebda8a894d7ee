"""A wrong file for the verifier: one bias is off."""

from __future__ import annotations

import numpy as np
import onnx
from onnx import numpy_helper


def spoil(model: onnx.ModelProto, by: float = 0.05) -> None:
    """Change one bias of the opacity head: finite, plausible, wrong; or not finite."""
    (target,) = [i for i in model.graph.initializer if i.name == "network.heads.alpha.out.bias"]
    target.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(target) + np.float32(by), target.name))
