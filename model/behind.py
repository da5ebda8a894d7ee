"""What no other view confirms takes the depth of the surface behind its neighbours, as occluded pixels do."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

WINDOWS = (5, 9, 17, 33)  # px; the smallest one that holds a confirmed pixel counts
NONE = 2.0  # nearer than any normalised inverse depth
CONFIRMED = 0.03  # of the depth range: views that differ by less show the same surface


def filled_from_behind(inverse: Tensor, confirmed: Tensor) -> Tensor:
    """(n, 1, h, w) of normalised inverse depth: where not confirmed (bool), the farthest confirmed one nearby.

    What is hidden in another view lies behind its neighbours. Without a confirmed pixel in the largest window it stays.
    """
    known = torch.where(confirmed, inverse, torch.full_like(inverse, NONE))
    result = known
    for window in WINDOWS:
        farthest = -F.max_pool2d(-known, window, stride=1, padding=window // 2)
        result = torch.where(result < NONE - 0.5, result, farthest)
    return torch.where(result < NONE - 0.5, result, inverse)
