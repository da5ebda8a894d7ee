"""Extreme gate settings for torch and an exported graph alike: all logits tied, one expert for all, two for all."""

from __future__ import annotations

from typing import Literal

import numpy as np
import onnx
import torch
from onnx import numpy_helper

from gapmes.model.architectures import Network

from .fold import GATES
from .quantise import TRANSPOSED

GateSetting = Literal["as trained", "all tied", "one expert", "two experts"]
_GATES = GATES.removeprefix("network.")
# exp(-200 / tau) underflows to exactly 0 in float32, so that the second choice has no weight and does not run
DECISIVE = 200.0


def gate_values(network: Network, setting: GateSetting) -> dict[str, torch.Tensor]:
    """The state-dict entries of the gates under a setting. Except as trained, weights are 0 and the biases decide."""
    state = {
        name: value
        for name, value in network.state_dict().items()
        if name.startswith(_GATES) and name.endswith((".weight", ".bias"))
    }
    if setting == "as trained":
        return {name: value.clone() for name, value in state.items()}
    values = {name: torch.zeros_like(value) for name, value in state.items()}
    bias = values.get(f"{_GATES}expert_gate.bias")
    if bias is not None and setting != "all tied":
        bias[-1] = DECISIVE
        if setting == "two experts":
            bias[1 if len(bias) > 2 else 0] = DECISIVE
    return values


def with_gates(model: onnx.ModelProto, values: dict[str, torch.Tensor]) -> onnx.ModelProto:
    """A copy of the graph with the gates' constants replaced. Raises `ValueError` when one is not in the graph."""
    changed = onnx.ModelProto()
    changed.CopyFrom(model)
    pending = {f"network.{name}": value for name, value in values.items()}
    for initializer in changed.graph.initializer:
        value = pending.pop(initializer.name.removesuffix(TRANSPOSED), None)
        if value is None:
            continue
        array = value.numpy()
        if list(array.shape) != list(initializer.dims):
            array = array.T  # the quantiser stores it transposed
        initializer.CopyFrom(numpy_helper.from_array(np.ascontiguousarray(array), initializer.name))
    if pending:
        raise ValueError(f"the graph has no constants named {sorted(pending)}; were the gates quantised or folded?")
    return changed
