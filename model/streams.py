"""Aligned streams, patches, experts and task maps (Eq. 1-2, 12-15): from backbone features to four task maps."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from .config import CELLS_PER_PATCH, ModelConfig
from .experts import ExpertGroup
from .layers import resize_to
from .routing import TASKS, Gates, Routing


@dataclass(frozen=True)
class TaskMaps:
    """One feature map (n, S*C_dim, H/4, W/4) for each of the four tasks, and the routing that made them."""

    maps: list[Tensor]
    routing: Routing | None  # None without experts and without tasks


def to_patches(grid: Tensor) -> Tensor:
    """(n, C, h, w) -> (n * P, C, 4, 4), patches row-major within an image."""
    n, c, h, w = grid.shape
    p = CELLS_PER_PATCH
    blocks = grid.reshape(n, c, h // p, p, w // p, p).permute(0, 2, 4, 1, 3, 5)
    return blocks.reshape(-1, c, p, p)


def from_patches(patches: Tensor, height: int, width: int) -> Tensor:
    """Inverse of `to_patches` for a grid of height x width cells (the Unpatch of Eq. 15)."""
    p, c = CELLS_PER_PATCH, patches.shape[1]
    blocks = patches.reshape(-1, height // p, width // p, c, p, p).permute(0, 3, 1, 4, 2, 5)
    return blocks.reshape(-1, c, height, width)


class PatchMixture(nn.Module):
    """The patch-level mixture of experts between the backbones and the heads."""

    def __init__(self, config: ModelConfig, channels: dict[str, int]) -> None:
        super().__init__()
        self.config = config
        width = config.stream_channels
        self.align = nn.ModuleDict({name: nn.Conv2d(channels[name], width, 1) for name in config.streams})  # Eq. 1
        self.channels = width * len(config.streams)
        self.gates = None
        if not (config.without_experts and config.without_tasks):
            query = self.channels * CELLS_PER_PATCH**2
            experts = 0 if config.without_experts else config.experts
            self.gates = Gates(query, experts, config.top_k, config.temperature, tasks=not config.without_tasks)
        self.experts = None if config.without_experts else ExpertGroup(config.experts, width)

    def forward(self, streams: dict[str, Tensor], like: Tensor, patch_keep: Tensor) -> TaskMaps:
        """streams: backbone features by name; `like` gives the aligned grid; patch_keep (n * P,) 1 or 0.

        A patch that is left out keeps its aligned features (its neighbours' convolutions need a value) but no expert
        runs on it and its weights are 0.
        """
        aligned = [resize_to(self.align[name](streams[name]), like) for name in self.config.streams]
        query = to_patches(torch.cat(aligned, dim=1))  # Eq. 2
        height, width = like.shape[-2:]
        routing = None
        if self.gates is not None:
            routing = self.gates(query.flatten(1)).kept(patch_keep)
        theta = query
        if self.experts is not None and routing is not None:
            theta = query + self.experts(query, routing)  # Eq. 12-14, residual
        maps = []
        for task in range(len(TASKS)):
            features = theta
            if routing is not None and routing.task_weight is not None:
                features = theta * (1 + routing.task_weight[:, task].reshape(-1, 1, 1, 1))  # Eq. 15, residual form
            maps.append(from_patches(features, height, width))
        return TaskMaps(maps, routing)
