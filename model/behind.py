"""What no other view confirms takes the depth of the surface behind its neighbours, as occluded pixels do."""

from __future__ import annotations

import torch
from torch import Tensor

from .windows import mean_inside

WINDOWS = (5, 9, 17, 33)  # px
ENOUGH = 0.03  # share of confirmed pixels from which on a window needs no larger one
FAR_PREFERENCE = 25.0  # weight e^-25 per unit of normalised inverse depth


def filled_from_behind(inverse: Tensor, confirmed: Tensor) -> Tensor:
    """Normalised inverse depth (n, 1, h, w) in 0..1, with unconfirmed values replaced by far confirmed ones nearby.

    `confirmed` (n, 1, h, w) in 0..1 is the weight of the original value. Surfaces that are occluded in another view lie
    behind their neighbours. Small windows are used first, larger ones where these hold too few confirmed pixels; where
    the largest holds none, the value stays. Continuous in both arguments.
    """
    weight = confirmed * torch.exp(-FAR_PREFERENCE * inverse)
    left, filled = torch.ones_like(inverse), torch.zeros_like(inverse)
    for window in WINDOWS:
        held = (mean_inside(confirmed, window // 2) / ENOUGH).clamp(max=1)
        behind = mean_inside(weight * inverse, window // 2) / mean_inside(weight, window // 2).clamp(min=1e-15)
        filled = filled + left * held * behind
        left = left * (1 - held)
    filled = filled + left * inverse
    return confirmed * inverse + (1 - confirmed) * filled
