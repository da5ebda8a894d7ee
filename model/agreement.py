"""Cross-view depth consistency at half resolution: cues of whether the other views' depths agree with this one's.

A surface point in front of the depth that a source view has there is wrong (a floater); one behind it is merely
occluded. The refinement reads this as feature channels.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from .cost_volume import Views
from .geometry import other_views, repeat_for_pairs
from .layers import sample_with_repeated_border

CUES = 4  # channels of `agreement_cues`
SHARPNESS = 16.0  # tanh(16 x) of a difference in normalised inverse depth: saturates at about a tenth of the range
CONFIRMED = 0.03  # of the depth range: views that differ by less show the same surface
SOFTNESS = 0.2  # of tanh: width of the passage from confirmed to not


def agreement_cues(inverse: Tensor, colours: Tensor, views: Views) -> Tensor:
    """(B*V, CUES, h, w) of normalised inverse depths (B*V, 1, h, w) and colours (B*V, 3, h, w); no gradient flows.

    Over the other views that have the point in frame: the mean signed difference to their depth (positive where the
    point is in front of it), the largest positive one, the mean absolute difference of colour; and their share.
    """
    inverse, colours = inverse.detach(), colours.detach()
    n, _, h, w = inverse.shape
    others = views.count - 1
    depths = views.inverse_depth(inverse).reshape(-1, views.count, 1, h * w)
    depths = repeat_for_pairs(depths, others).reshape(-1, 1, h * w)
    grid, inside, expected = views.warp(h, w).points(depths)

    maps = torch.cat([inverse, colours], dim=1)
    per_view = maps.reshape(-1, views.count, 4, h, w)
    source = other_views(per_view).reshape(-1, 4, h, w)
    sampled = sample_with_repeated_border(source, grid.reshape(-1, h, w, 2)).flatten(2)
    own = repeat_for_pairs(per_view, others).reshape(-1, 4, h * w)
    low = _per_pair(views.inverse_far, views)
    high = _per_pair(views.inverse_near, views)
    mine = (expected[:, 0] - low) / (high - low)
    mask = inside[:, 0].to(inverse.dtype)
    through = torch.tanh(SHARPNESS * (mine - sampled[:, 0])) * mask
    colour = (own[:, 1:] - sampled[:, 1:]).abs().mean(1) * mask

    through, colour, mask = (x.reshape(-1, others, h * w) for x in (through, colour, mask))
    seen = mask.sum(1)
    count = seen.clamp(min=1)
    cues = [through.sum(1) / count, through.clamp(min=0).amax(1), colour.sum(1) / count, seen / others]
    return torch.stack(cues, dim=1).reshape(n, CUES, h, w)


def confirmation(cues: Tensor) -> Tensor:
    """(n, 1, h, w) of `agreement_cues` (n, CUES, h, w): 1 where the views that have the point in frame agree, else 0.

    The transition is a ramp: a threshold would amplify rounding to whole windows of other depths. Unconfirmed points
    have a weight of exactly 0, since far depths outweigh near ones without limit.
    """
    limit = math.tanh(SHARPNESS * CONFIRMED)
    return (0.5 + (limit - cues[:, :1].abs()) / SOFTNESS).clamp(0, 1) * (cues[:, 3:] > 0).to(cues.dtype)


def _per_pair(values: Tensor, views: Views) -> Tensor:
    """(B, 1) -> (B*V*(V-1), 1)."""
    return values.unsqueeze(-1).expand(-1, views.count * (views.count - 1), -1).reshape(-1, 1)
