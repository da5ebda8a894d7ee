"""Which other views a view is compared with: all of up to three, else the two that stand nearest."""

from __future__ import annotations

import torch
from torch import Tensor

from ..geometry import other_views


def nearest_views(world_from_cam: Tensor, *, as_listed: bool) -> Tensor:
    """(B, V, 4, 4) -> (B, V, m) indices into the V views, m = 1 with two views and 2 with more; for a symbolic V.

    The nearest first; of equal distances the lowest index (equal to the bit: rounding
    decides between cameras that stand equally far). `as_listed` orders the others of up to three views by
    index instead, which only `tiled_mask` can tell apart.
    """
    centres = world_from_cam[..., :3, 3]
    count = centres.shape[1]
    pairs = torch.arange(count, device=centres.device).reshape(1, count, 1)
    index = other_views(pairs.reshape(1, count)).expand(centres.shape[0], -1, -1)  # (B, V, V-1)
    distance = (other_views(centres) - centres.unsqueeze(2)).square().sum(-1)
    if as_listed:
        few = torch.ones_like(pairs).sum() <= 3
        distance = torch.where(few, index.to(distance.dtype), distance)
    order = _stable_argsort(distance)
    return index.gather(2, order)[:, :, : 2 - 2 // count]


def _stable_argsort(values: Tensor) -> Tensor:
    """Ascending along the last axis, ties by index: the rank of each entry is a count, since sorts that say that they
    are stable do not export."""
    n = values.shape[-1]
    position = torch.arange(n, device=values.device)
    a, b = values.unsqueeze(-1), values.unsqueeze(-2)
    before = (b < a) | ((b == a) & (position.reshape(1, -1) < position.reshape(-1, 1)))
    rank = before.sum(-1)  # (..., n)
    slots = (rank.unsqueeze(-2) == position.reshape(-1, 1)).to(torch.int64)  # (..., place, entry)
    return (slots * position).sum(-1)


def neighbour_rows(neighbours: Tensor) -> Tensor:
    """(B, V, m) -> (B*V*m,) rows of a tensor of B*V views."""
    batch, count, _ = neighbours.shape
    offset = torch.arange(batch, device=neighbours.device).reshape(-1, 1, 1) * count
    return (neighbours + offset).reshape(-1)
