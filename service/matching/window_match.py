"""Zero-mean normalised cross-correlation (ZNCC) of a picture with warped pictures, in small windows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
WindowMean = Callable[[F64], F64]  # (..., h, w) of the same

RADIUS = 3  # windows of 7 x 7 px
MIN_SEEN = 0.6  # share of a window that must be seen
NOT_SEEN = -1.0  # the correlation of a window of which less is seen
_ROUNDED = (1 / 255) ** 2 / 12  # variance of the rounding to 8 bits, which correlates with nothing
_NOISE = 1e-8  # variance below which a window has no texture; (0.03 of an 8-bit level)^2


def window_mean(values: F64, radius: int = RADIUS) -> F64:
    """(..., h, w) means over square windows of 2 * radius + 1 px, clipped at the border; by running sums.

    `plane_means` is 20 times as fast, but its compiled loops take 60 MB: photographs are checked before the network
    runs, and those would be in memory beside it.
    """
    for axis in (-2, -1):
        count = values.shape[axis]
        low = np.maximum(np.arange(count) - radius, 0)
        high = np.minimum(np.arange(count) + radius + 1, count)
        sums = np.cumsum(values, axis=axis)
        sums = np.concatenate([np.zeros_like(np.take(sums, [0], axis=axis)), sums], axis=axis)
        size = (high - low).reshape((-1, 1) if axis == -2 else (-1,))
        values = (np.take(sums, high, axis=axis) - np.take(sums, low, axis=axis)) / size
    return values


def correlations(picture: F64, warped: F64, seen: NDArray[np.bool_], mean: WindowMean = window_mean) -> F64:
    """(D, h, w) ZNCC in -1..1 of windows of `picture` (h, w) and of each `warped` picture (D, h, w), over the pixels
    `seen` (D, h, w); NOT_SEEN for windows of which less than MIN_SEEN is. `mean` is `window_mean` or an equivalent.

    Invariant to gain and offset as long as the contrast is above the rounding to 8 bits: a window of variance v
    correlates with itself by v / (v + 1.3e-6).
    """
    mask = seen.astype(np.float64)
    amount = mean(mask)
    safe = np.maximum(amount, 1e-9)
    mean_a, mean_b = mean(picture * mask) / safe, mean(warped * mask) / safe
    var_a = mean(picture**2 * mask) / safe - mean_a**2
    var_b = mean(warped**2 * mask) / safe - mean_b**2
    covariance = mean(picture * warped * mask) / safe - mean_a * mean_b
    correlation = covariance / np.sqrt((np.maximum(var_a, 0.0) + _ROUNDED) * (np.maximum(var_b, 0.0) + _ROUNDED))
    return np.where(amount >= MIN_SEEN, correlation, NOT_SEEN)


def contrast(picture: F64, kept: NDArray[np.bool_], mean: WindowMean = window_mean) -> F64:
    """(h, w) standard deviation over the `kept` (h, w) pixels of each window; 0 where it is noise. `mean` as for
    `correlations`."""
    weight = kept.astype(np.float64)
    share = np.maximum(mean(weight), 1e-9)
    middle = mean(picture * weight) / share
    return np.sqrt(np.maximum(mean(picture**2 * weight) / share - middle**2 - _NOISE, 0.0))


def match_weights(picture: F64, best: F64, kept: NDArray[np.bool_]) -> F64:
    """(h, w) contrast at the `kept` (h, w) pixels; 0 where the window is seen in no warped picture, that is, where the
    `best` correlation (h, w) is NOT_SEEN."""
    return np.where(kept & (best > NOT_SEEN), contrast(picture, kept), 0.0)


def match_score(picture: F64, best: F64, kept: NDArray[np.bool_]) -> tuple[float, float]:
    """Mean, in [0, 1], of the `best` correlations (h, w), weighted by `match_weights`, and the sum of the weights;
    (0, 0) where that is 0."""
    weights = match_weights(picture, best, kept)
    total = float(weights.sum())
    return (float((np.clip(best, 0.0, 1.0) * weights).sum() / total), total) if total > 0 else (0.0, 0.0)
