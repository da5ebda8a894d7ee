"""PSNR and SSIM of pictures with colours in [0, 1] (PSNR also of 8-bit ones), over all pixels or those of a mask."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

WINDOW, SIGMA = 11, 1.5  # px, of SSIM (Wang et al. 2004)
C1, C2 = 0.01**2, 0.03**2
EQUAL_DB = 100.0  # of equal pictures, whose PSNR would be infinite


def psnr(picture: NDArray, truth: NDArray, mask: NDArray[np.bool_] | None = None) -> float:
    """PSNR in dB, at most 100. A mask (H, W), True keeps, needs pictures (3, H, W); NaN if it keeps no pixel."""
    difference = _unit(picture) - _unit(truth)
    chosen = difference if mask is None else difference[:, mask]
    if not chosen.size:
        return math.nan
    error = float(np.square(chosen).mean())
    return EQUAL_DB if error == 0 else min(-10 * math.log10(error), EQUAL_DB)


def ssim(picture: NDArray, truth: NDArray, mask: NDArray[np.bool_] | None = None) -> float:
    """Mean SSIM of (3, H, W) pictures over all windows inside, or those with centres in the mask; NaN if there is none.

    Computed in the pictures' precision: float32 is accurate to 1e-6 (measured 1e-7) in two thirds of the time. Moments
    are taken about the mean of `truth`, so that variances of flat pictures are not lost to rounding.
    """
    middle = truth.dtype.type(truth.mean(dtype=np.float64)) if truth.size else truth.dtype.type(0)
    a, b = picture - middle, truth - middle
    mean_a, mean_b = _gaussian_means(a), _gaussian_means(b)
    var_a, var_b = _gaussian_means(a * a) - mean_a**2, _gaussian_means(b * b) - mean_b**2
    covariance = _gaussian_means(a * b) - mean_a * mean_b
    mean_a, mean_b = mean_a + middle, mean_b + middle
    top = (2 * mean_a * mean_b + C1) * (2 * covariance + C2)
    values = (top / ((mean_a**2 + mean_b**2 + C1) * (var_a + var_b + C2))).mean(axis=0)
    border = WINDOW // 2
    chosen = values if mask is None else values[mask[border:-border, border:-border]]
    return float(chosen.mean(dtype=np.float64)) if chosen.size else math.nan


def _unit(picture: NDArray) -> NDArray[np.float64]:
    return picture / 255.0 if picture.dtype == np.uint8 else picture.astype(np.float64)


def _gaussian_means(x: NDArray) -> NDArray:
    """(3, H - 10, W - 10) Gaussian-weighted means of all windows inside `x` (3, H, W)."""
    offsets = np.arange(WINDOW) - WINDOW // 2
    weights = np.exp(-(offsets**2) / (2 * SIGMA**2))
    weights = (weights / weights.sum()).astype(x.dtype)
    for axis in (1, 2):
        length = max(x.shape[axis] - WINDOW + 1, 0)
        total = np.zeros_like(np.take(x, range(length), axis=axis))
        for start, weight in enumerate(weights):
            total += weight * np.take(x, range(start, start + length), axis=axis)
        x = total
    return x
