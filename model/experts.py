"""Feature-learning experts on routed patches (Eq. 12-14): only the patches that chose an expert run through it."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from .config import CELLS_PER_PATCH
from .routing import Routing


class Expert(nn.Module):
    """Three 3x3 convolutions within a patch, zero-padded, so that a patch's result does not depend on its batch."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Conv2d(channels, channels, 3, padding=1),
            nn.GELU(),
            nn.Conv2d(channels, channels, 3, padding=1),
            nn.GELU(),
            nn.Conv2d(channels, channels, 3, padding=1),
        )

    def forward(self, patches: Tensor) -> Tensor:
        """(m, C, 4, 4) -> (m, C, 4, 4)."""
        return self.layers(patches)


class ExpertGroup(nn.Module):
    """N_e experts shared by the streams: one gather and one batch per expert, and one gather of all results."""

    def __init__(self, experts: int, channels: int) -> None:
        super().__init__()
        self.channels = channels
        self.sparse = True  # False: every expert on every patch, which gives the same up to rounding
        self.experts = nn.ModuleList([Expert(channels) for _ in range(experts)])

    def forward(self, patches: Tensor, routing: Routing) -> Tensor:
        """patches (M, S*C, 4, 4) -> sum over selected experts of weight * expert, same shape.

        A patch whose weight for an expert is exactly 0 (not selected, lambda = 1, masked) is not computed for it.
        """
        if not self.sparse:
            return self.dense(patches, routing)
        index, weight = chosen_experts(routing)
        runs = (dense_weights(routing, len(self.experts)) != 0).t()  # (N_e, M)
        p = CELLS_PER_PATCH
        outputs = [patches.new_zeros(1, *patches.shape[1:])]
        for expert, run in zip(self.experts, runs.unbind(), strict=True):
            streams = patches.index_select(0, torch.nonzero(run).squeeze(1)).reshape(-1, self.channels, p, p)
            outputs.append(expert(streams).reshape(-1, patches.shape[1], p, p))
        found = torch.cat(outputs)  # zeros, then expert after expert
        # row of `found` for every choice; 0, the zeros, where its weight is 0
        rows = (runs.reshape(-1).cumsum(0).reshape(runs.shape) * runs).t().gather(1, index)  # (M, k)
        taken = found.flatten(1).index_select(0, rows.reshape(-1)).reshape(*rows.shape, patches.shape[1] * p * p)
        return (weight.unsqueeze(1) @ taken).reshape(patches.shape)

    def dense(self, patches: Tensor, routing: Routing) -> Tensor:
        """The same sum with every expert run on every patch: the reference for tests."""
        weights = dense_weights(routing, len(self.experts))
        p = CELLS_PER_PATCH
        streams = patches.reshape(-1, self.channels, p, p)
        outputs = torch.stack([expert(streams).reshape(patches.shape) for expert in self.experts], dim=1)
        return (outputs * weights[:, :, None, None, None]).sum(1)


def chosen_experts(routing: Routing) -> tuple[Tensor, Tensor]:
    """(M, k) indices and weights. Raises `ValueError` without experts."""
    index, weight = routing.expert_index, routing.expert_weight
    if index is None or weight is None:
        raise ValueError("the routing has no experts: the gates were built without them")
    return index, weight


def dense_weights(routing: Routing, experts: int) -> Tensor:
    """(M, N_e) weight of every expert for every patch, 0 where it was not selected."""
    index, weight = chosen_experts(routing)
    return weight.new_zeros(weight.shape[0], experts).scatter(-1, index, weight)
