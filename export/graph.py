"""The network for one scene of V views with plain tensors in and out, as it is exported."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from gapmes.model.architectures import Network
from gapmes.model.backbones import DepthAnythingFeatures, VitFeatures
from gapmes.model.config import PIXELS_PER_PATCH
from gapmes.model.depthsplat.vit import IntermediateVit
from gapmes.service.network.contract import EXPERT_OUTPUTS, MARGIN_OUTPUTS, REQUIRED_OUTPUTS, TASK_OUTPUTS


@dataclass(frozen=True)
class SceneInputs:
    """The five inputs of the contract for V views of H x W pixels."""

    images: Tensor  # (V, 3, H, W) in [0, 1]
    intrinsics: Tensor  # (V, 3, 3) normalised
    world_from_cam: Tensor  # (V, 4, 4) relative to camera 0
    near_far: Tensor  # (2,)
    patch_mask: Tensor  # (V, P) bool

    def tensors(self) -> tuple[Tensor, ...]:
        return self.images, self.intrinsics, self.world_from_cam, self.near_far, self.patch_mask


class SceneGraph(nn.Module):
    """Wraps a network for one scene; returns the outputs in the order of `output_names`."""

    def __init__(self, network: Network) -> None:
        super().__init__()
        self.network = network

    @property
    def output_names(self) -> tuple[str, ...]:
        """The contract's outputs that this network has."""
        gates = self.network.gates
        experts = EXPERT_OUTPUTS if gates is not None and gates.expert_gate is not None else ()
        tasks = TASK_OUTPUTS if gates is not None and gates.task_gate is not None else ()
        return REQUIRED_OUTPUTS + experts + tasks + (MARGIN_OUTPUTS if gates is not None else ())

    def forward(
        self, images: Tensor, intrinsics: Tensor, world_from_cam: Tensor, near_far: Tensor, patch_mask: Tensor
    ) -> tuple[Tensor, ...]:
        prediction = self.network(
            images.unsqueeze(0),
            intrinsics.unsqueeze(0),
            world_from_cam.unsqueeze(0),
            near_far.unsqueeze(0),
            patch_mask.unsqueeze(0),
        )
        g = prediction.gaussians
        values = [g.means, g.scales, g.rotations_wxyz, g.opacities, g.harmonics]
        outputs = [v.squeeze(0) for v in values] + [prediction.depth.squeeze(0), prediction.confidence.squeeze(0)]
        routing = prediction.routing
        if routing is not None:
            patches = (images.shape[-2] // PIXELS_PER_PATCH) * (images.shape[-1] // PIXELS_PER_PATCH)
            for value in (routing.expert_index, routing.expert_weight, routing.task_weight):
                if value is not None:
                    outputs.append(value.reshape(-1, patches, value.shape[-1]))
            if routing.margin is not None:
                outputs.append(routing.margin.reshape(-1, patches))
        return tuple(outputs)


def evaluated(network: Network, inputs: SceneInputs, dtype: torch.dtype) -> dict[str, NDArray[np.generic]]:
    """Every output by name, computed in `dtype` throughout. The network is converted to `dtype` and stays so."""
    graph, usual = SceneGraph(network.to(dtype)).eval(), torch.get_default_dtype()
    given = [value.to(dtype) if value.is_floating_point() else value for value in inputs.tensors()]
    torch.set_default_dtype(dtype)
    try:
        with torch.no_grad():
            return dict(zip(graph.output_names, [value.numpy() for value in graph(*given)], strict=True))
    finally:
        torch.set_default_dtype(usual)


@contextmanager
def folded_position_embeddings(network: Network, height: int, width: int) -> Iterator[None]:
    """Replace each ViT's position embedding by its constant for this size within the context: `Vit.fixed_grid`."""
    with ExitStack() as fixed:
        for module in network.modules():
            if isinstance(module, IntermediateVit):
                rows, columns = module.grid(height, width)
            elif isinstance(module, VitFeatures | DepthAnythingFeatures):
                rows, columns = height // PIXELS_PER_PATCH, width // PIXELS_PER_PATCH
            else:
                continue
            fixed.enter_context(module.vit.fixed_grid(rows, columns))
        yield
