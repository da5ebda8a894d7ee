"""Matching that needs no training: normalised correlation and colour on planes at half resolution, edge-aware.

The cost volume of classical stereo: small windows are compared on every plane, and a guided filter aggregates scores
within regions of similar colour. It is independent of the resolution that the network was trained at.
"""

from __future__ import annotations

import torch
from torch import Tensor

from .cost_volume import SWEEP_PIECES, Views
from .geometry import other_views, repeat_for_pairs
from .layers import sample_with_repeated_border
from .windows import mean_with_repeated_border

WINDOW_RADIUS = 2  # px at half resolution: correlation in windows of 5 x 5
GUIDE_RADIUS, GUIDE_EPSILON = 4, 1e-3  # px and variance of grey: weaker edges are smoothed across
COLOUR_LIMIT = 0.15  # truncation of the absolute colour difference
FLAT = 1e-3  # floor of the geometric mean of two variances: it damps the correlation of flat windows
UNSEEN = 0.6  # score, 0 to 1, outside of the source: less than a match, more than a clear mismatch


def matching_evidence(images: Tensor, views: Views, planes: int, *, sparse: bool = True) -> Tensor:
    """(B*V, D, h, w) scores of about 0..1 for the match with the other views on planes uniform in inverse depth.

    images (B*V, 3, h, w) in [0, 1], without gradient. Half of it is zero-mean normalised cross-correlation of all three
    channels, half the truncated difference of colours; mean over the other views, then filtered by the view's own grey
    picture (guided filter: He et al. 2010; on cost volumes: Hosni et al. 2011).
    Pairs of views without a common sample on a group of planes are skipped there, which does not change a bit of the
    result; with `sparse` False none are skipped.
    """
    n, _, h, w = images.shape
    others = views.count - 1
    warp = views.warp(h, w)
    bins = torch.linspace(0, 1, planes, device=images.device).reshape(1, planes, 1, 1)
    inverse = views.inverse_depth(bins)[:, :, 0, 0].reshape(-1, views.count, planes)
    inverse = repeat_for_pairs(inverse, others).reshape(-1, planes, 1)
    per_view = images.reshape(-1, views.count, 3, h, w)
    # variances are differences of mean squares: centring on the scene's mean, and scores on 0.5, reduces cancellation
    per_view = per_view - per_view.mean((1, 2, 3, 4), keepdim=True)
    own = _with_statistics(per_view.reshape(n, 3, h, w)).reshape(-1, views.count, 6, h, w)
    reference = repeat_for_pairs(own, others).reshape(-1, 6, h, w)
    source = other_views(per_view).reshape(-1, 3, h, w)
    guide = _Guide(per_view.mean(2).reshape(n, 1, h, w))
    pieces = []
    step = -(-planes // SWEEP_PIECES)
    for start in range(0, planes, step):
        some = inverse[:, start : start + step]
        grid, inside = warp.positions(some)
        count = some.shape[1]
        grid = grid.reshape(-1, count * h, w, 2)
        seen = inside.reshape(-1, count, h, w)
        if sparse:
            pairs = torch.nonzero(inside.flatten(1).any(dim=1)).squeeze(1)
            found = _compared(
                reference.index_select(0, pairs), source.index_select(0, pairs), grid.index_select(0, pairs)
            )
            score = torch.zeros_like(seen, dtype=images.dtype).index_add(0, pairs, found)
        else:
            score = _compared(reference, source, grid)
        score = torch.where(seen, score, torch.full_like(score, UNSEEN))
        pieces.append(guide.filter(score.reshape(n, others, count, h, w).mean(1) - 0.5))
    return torch.cat(pieces, dim=1) + 0.5


def _with_statistics(pictures: Tensor) -> Tensor:
    """(n, 6, h, w): colours (n, 3, h, w), their grey, and its mean and variance in windows."""
    grey = pictures.mean(1, keepdim=True)
    mean = mean_with_repeated_border(grey, WINDOW_RADIUS)
    return torch.cat([pictures, grey, mean, _variance(grey, mean)], dim=1)


def _variance(grey: Tensor, mean: Tensor) -> Tensor:
    return (mean_with_repeated_border(grey.square(), WINDOW_RADIUS) - mean.square()).clamp(min=0)


def _compared(reference: Tensor, source: Tensor, grid: Tensor) -> Tensor:
    """(m, D, h, w) similarity of references `_with_statistics` (m, 6, h, w) and sources (m, 3, h, w) sampled at the
    positions `grid` (m, D*h, w, 2) of each plane."""
    h, w = reference.shape[-2:]
    colours = sample_with_repeated_border(source, grid)
    return _similarity(reference, colours.reshape(colours.shape[0], 3, grid.shape[1] // h, h, w))


def _similarity(reference: Tensor, colours: Tensor) -> Tensor:
    """(m, D, h, w) in 0..1 of pictures `_with_statistics` (m, 6, h, w) and warped ones (m, 3, D, h, w)."""
    own, a, mean_a, var_a = reference.split([3, 1, 1, 1], dim=1)
    b = colours.mean(1)
    mean_b = mean_with_repeated_border(b, WINDOW_RADIUS)
    var_b = _variance(b, mean_b)
    covariance = mean_with_repeated_border(a * b, WINDOW_RADIUS) - mean_a * mean_b
    correlation = (covariance / (var_a * var_b).sqrt().clamp(min=FLAT)).clamp(-1, 1)
    difference = (colours - own.unsqueeze(2)).abs().mean(1).clamp(max=COLOUR_LIMIT) / COLOUR_LIMIT
    return 0.5 * (1 + correlation) / 2 + 0.5 * (1 - difference)


class _Guide:
    """Guided filter by one picture (n, 1, h, w)."""

    def __init__(self, picture: Tensor) -> None:
        self.picture = picture
        self.mean = mean_with_repeated_border(picture, GUIDE_RADIUS)
        self.variance = mean_with_repeated_border(picture.square(), GUIDE_RADIUS) - self.mean.square() + GUIDE_EPSILON

    def filter(self, scores: Tensor) -> Tensor:
        """(n, D, h, w) -> the same shape: within windows a linear function of the picture's grey."""
        mean = mean_with_repeated_border(scores, GUIDE_RADIUS)
        slope = (mean_with_repeated_border(self.picture * scores, GUIDE_RADIUS) - self.mean * mean) / self.variance
        level = mean - slope * self.mean
        smooth = mean_with_repeated_border(slope, GUIDE_RADIUS) * self.picture
        return smooth + mean_with_repeated_border(level, GUIDE_RADIUS)


def at_candidates(evidence: Tensor, candidates: Tensor) -> Tensor:
    """(n, K, h, w): evidence (n, D, h, w) interpolated linearly at normalised inverse depths (n, K, h, w)."""
    planes = evidence.shape[1]
    position = (candidates * (planes - 1)).clamp(0, planes - 1)
    below = position.floor().clamp(max=planes - 2)
    index = below.long()
    share = position - below
    return evidence.gather(1, index) * (1 - share) + evidence.gather(1, index + 1) * share
