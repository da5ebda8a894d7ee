"""What no other view confirms takes the depth of the surface behind its neighbours, as occluded pixels do."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

WINDOWS = (5, 9, 17, 33)  # px
ENOUGH = 0.03  # share of confirmed pixels from which on a window needs no larger one
FAR_PREFERENCE = 25.0  # weight e^-25 per unit of normalised inverse depth


def filled_from_behind(inverse: Tensor, confirmed: Tensor) -> Tensor:
    """(n, 1, h, w) of normalised inverse depth in 0..1: the less confirmed (0..1), the more of the far confirmed
    depths nearby.

    What is hidden in another view lies behind its neighbours. Smaller windows come first, larger ones take what they
    leave; where even the largest has nothing confirmed, the depth stays. Continuous in both arguments.
    """
    weight = confirmed * torch.exp(-FAR_PREFERENCE * inverse)
    left, filled = torch.ones_like(inverse), torch.zeros_like(inverse)
    for window in WINDOWS:
        held = (_mean(confirmed, window) / ENOUGH).clamp(max=1)
        behind = _mean(weight * inverse, window) / _mean(weight, window).clamp(min=1e-15)
        filled = filled + left * held * behind
        left = left * (1 - held)
    filled = filled + left * inverse
    return confirmed * inverse + (1 - confirmed) * filled


def _mean(values: Tensor, window: int) -> Tensor:
    """Over what a window of `window` px holds of (n, 1, h, w)."""
    rows = F.avg_pool2d(values, (1, window), 1, (0, window // 2), count_include_pad=False)
    return F.avg_pool2d(rows, (window, 1), 1, (window // 2, 0), count_include_pad=False)
