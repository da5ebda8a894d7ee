"""UniMatch's multi-view transformer: attention in shifted windows, within a view and to its neighbours."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from .config import FEATURES, WINDOWS

BLOCKED = -100.0  # added to the scores of cells that a shift has brought together
TEMPERATURE = 10_000.0  # of the sine embedding


def window_positions(channels: int, height: int, width: int) -> Tensor:
    """(1, channels, height, width) sine embedding of positions within a window (Carion et al. 2020, normalised)."""
    half = channels // 2
    index = torch.arange(half, dtype=torch.float32)
    period = TEMPERATURE ** (2 * torch.div(index, 2, rounding_mode="floor") / half)
    axes = []
    for size in (height, width):
        steps = torch.arange(1, size + 1, dtype=torch.float32)
        angles = (steps / (size + 1e-6) * 2 * math.pi).unsqueeze(1) / period
        axes.append(torch.stack([angles[:, 0::2].sin(), angles[:, 1::2].cos()], dim=2).flatten(1))
    y = axes[0].unsqueeze(1).expand(height, width, half)
    x = axes[1].unsqueeze(0).expand(height, width, half)
    return torch.cat([y, x], dim=2).permute(2, 0, 1).unsqueeze(0)


def with_positions(features: Tensor) -> Tensor:
    """(n, C, h, w) with each window's embedding added."""
    _, channels, height, width = features.shape
    position = window_positions(channels, height // WINDOWS, width // WINDOWS)
    return features + position.repeat(1, 1, WINDOWS, WINDOWS).to(features.device)


def to_windows(grid: Tensor) -> Tensor:
    """(n, h, w, c) -> (n, windows, cells of a window, c)."""
    n, h, w, c = grid.shape
    k = WINDOWS
    blocks = grid.reshape(n, k, h // k, k, w // k, c).permute(0, 1, 3, 2, 4, 5)
    return blocks.reshape(n, k * k, (h // k) * (w // k), c)


def from_windows(blocks: Tensor, height: int, width: int) -> Tensor:
    """Inverse of `to_windows`."""
    k, c = WINDOWS, blocks.shape[-1]
    grid = blocks.reshape(-1, k, k, height // k, width // k, c).permute(0, 1, 3, 2, 4, 5)
    return grid.reshape(-1, height, width, c)


def shift_mask(height: int, width: int) -> Tensor:
    """(windows, L, L): 0 between cells that lie together without the shift, `BLOCKED` between others (Liu et al.
    2021)."""
    k = WINDOWS
    regions = torch.zeros(1, height, width, 1)
    number = 0
    for rows in _regions(height // k):
        for columns in _regions(width // k):
            regions[:, rows, columns] = number
            number += 1
    flat = to_windows(regions)[0, :, :, 0]
    return torch.where(flat.unsqueeze(1) == flat.unsqueeze(2), 0.0, BLOCKED)


def _regions(window: int) -> tuple[slice, slice, slice]:
    return slice(0, -window), slice(-window, -(window // 2)), slice(-(window // 2), None)


def mask_for_views(mask: Tensor, neighbours: int, *, tiled: bool) -> Tensor:
    """(windows, L, L) -> (windows, L, m * L) for keys that list one view after the other.

    `tiled` gives each key the column that the authors' code gives it, whose keys list the views of a cell together
    under a mask that lists them one after the other: see `Compatibility.tiled_mask`.
    """
    if not tiled:
        return mask.repeat(1, 1, neighbours)
    cells = mask.shape[-1]
    place = torch.arange(cells, device=mask.device).reshape(1, -1) * neighbours
    column = (place + torch.arange(neighbours, device=mask.device).reshape(-1, 1)) % cells
    return mask.index_select(2, column.reshape(-1))


class AttentionLayer(nn.Module):
    """Single-head attention in windows, merged, and for the second of a block a feed-forward layer."""

    def __init__(self, *, feed_forward: bool) -> None:
        super().__init__()
        c = FEATURES
        self.q_proj = nn.Linear(c, c, bias=False)
        self.k_proj = nn.Linear(c, c, bias=False)
        self.v_proj = nn.Linear(c, c, bias=False)
        self.merge = nn.Linear(c, c, bias=False)
        self.norm1 = nn.LayerNorm(c)
        self.mlp = None
        if feed_forward:
            self.mlp = nn.Sequential(nn.Linear(2 * c, 8 * c, bias=False), nn.GELU(), nn.Linear(8 * c, c, bias=False))
            self.norm2 = nn.LayerNorm(c)

    def forward(self, source: Tensor, target: Tensor, rows: Tensor | None, shift: bool, mask: Tensor | None) -> Tensor:
        """source, target (n, h, w, c); rows (n * m,) of `target` that each source attends to, None for its own; mask
        (windows, L, m * L) or None."""
        n, h, w, c = source.shape
        query, key, value = self.q_proj(source), self.k_proj(target), self.v_proj(target)
        by = (h // WINDOWS // 2, w // WINDOWS // 2)
        if shift:
            query, key, value = (torch.roll(x, (-by[0], -by[1]), dims=(1, 2)) for x in (query, key, value))
        q, k, v = (to_windows(x) for x in (query, key, value))
        if rows is not None:
            k, v = (self._of_neighbours(x, rows, n) for x in (k, v))
        scores = q @ k.transpose(-1, -2) / c**0.5
        if mask is not None:
            scores = scores + mask
        out = from_windows(scores.softmax(-1) @ v, h, w)
        if shift:
            out = torch.roll(out, by, dims=(1, 2))
        message = self.norm1(self.merge(out))
        if self.mlp is not None:
            message = self.norm2(self.mlp(torch.cat([source, message], dim=-1)))
        return source + message

    @staticmethod
    def _of_neighbours(windows: Tensor, rows: Tensor, n: int) -> Tensor:
        """(n, windows, L, c) -> (n, windows, m * L, c)."""
        _, count, cells, c = windows.shape
        chosen = windows.index_select(0, rows).reshape(n, -1, count, cells, c)
        return chosen.transpose(1, 2).reshape(n, count, -1, c)


class TransformerBlock(nn.Module):
    """Attention within the view, then to its neighbours."""

    def __init__(self) -> None:
        super().__init__()
        self.self_attn = AttentionLayer(feed_forward=False)
        self.cross_attn_ffn = AttentionLayer(feed_forward=True)


class MultiViewTransformer(nn.Module):
    """Makes the features of every view aware of its neighbours."""

    def __init__(self, layers: int = 6) -> None:
        super().__init__()
        self.layers = nn.ModuleList([TransformerBlock() for _ in range(layers)])

    def forward(self, features: Tensor, rows: Tensor, *, tiled_mask: bool = False) -> Tensor:
        """features (n, C, h, w) of n = B * V views, positions added; rows (n * m,), see `neighbour_rows`."""
        n, _, height, width = features.shape
        x = features.permute(0, 2, 3, 1)
        own = shift_mask(height, width).to(x.device)
        across = mask_for_views(own, rows.shape[0] // n, tiled=tiled_mask)
        for number, block in enumerate(self.layers):
            assert isinstance(block, TransformerBlock)
            shift = number % 2 == 1
            # neighbours are read as they were before this block, not after its self-attention
            before = x
            x = block.self_attn(x, x, None, shift, own if shift else None)
            x = block.cross_attn_ffn(x, before, rows, shift, across if shift else None)
        return x.permute(0, 3, 1, 2)
