"""Mixed precision in training: convolutions in bfloat16, geometry in float32."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn

from ..heads import TaskHead
from ..network import GaPMeS
from ..trunk import LightTrunk


def bfloat16_modules(model: GaPMeS) -> list[nn.Module]:
    """The modules that take most of a step's time; none of them handles positions or depths."""
    depth, trunk = model.depth, model.trunk
    parts: list[nn.Module] = []
    if isinstance(trunk, LightTrunk):  # the full one is frozen, and computes as its weights were trained
        parts += [trunk.to_half, trunk.at_half, trunk.to_quarter, trunk.at_quarter, trunk.to_eighth]
    parts += [depth.volume_net, depth.volume_up, depth.refine_net, depth.second_net, depth.up_mask]
    if model.mixture.experts is not None:
        parts += list(model.mixture.experts.experts)
    return parts + [part for part in model.heads.children() if isinstance(part, TaskHead)]


def bfloat16_is_fast(device: torch.device | str) -> bool:
    """Whether the device computes in bfloat16 with its own instructions.

    A processor without AVX-512 falls back to scalar loops: a step took 34 s, and 3 s in float32.
    """
    if torch.device(device).type == "cuda":
        with torch.cuda.device(device):
            return torch.cuda.is_bf16_supported(including_emulation=False)
    return torch.backends.mkldnn.is_available() and bool(torch.ops.mkldnn._is_mkldnn_bf16_supported())


def use_bfloat16(model: GaPMeS) -> None:
    """Make `bfloat16_modules` compute under bfloat16 autocast from now on; they return float32, weights stay float32.

    This cannot be undone: a copy that is made before stays in float32.
    """
    for module in bfloat16_modules(model):
        module.forward = _in_bfloat16(module.forward)


def _in_bfloat16(forward: Callable[..., Tensor]) -> Callable[..., Tensor]:
    def run(*inputs: Tensor) -> Tensor:
        with torch.autocast(inputs[0].device.type, dtype=torch.bfloat16):
            return forward(*inputs).float()

    return run
