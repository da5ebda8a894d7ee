"""The precisions of OpenVINO on this processor: bf16 is refused without AVX-512, as a test shows."""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec

import numpy as np


@cache
def precisions() -> tuple[str, ...]:
    """`fp32`, and `bf16` where OpenVINO takes it; none where it is not installed."""
    if find_spec("openvino") is None:
        return ()
    import openvino
    from openvino import opset13

    given = opset13.parameter([4, 4], np.float32)
    model = openvino.Model([opset13.relu(given)], [given])
    compiled = openvino.compile_model(model, "CPU", {"INFERENCE_PRECISION_HINT": "bf16"})
    taken = compiled.get_property("INFERENCE_PRECISION_HINT").get_type_name() == "bf16"
    return ("fp32", "bf16") if taken else ("fp32",)
