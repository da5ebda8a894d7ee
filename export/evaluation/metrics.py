"""PSNR, SSIM and LPIPS of a picture against the truth, over all pixels or over those of a mask; in float64."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from .lpips import Lpips

F32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

WINDOW, SIGMA = 11, 1.5  # px, of SSIM (Wang et al. 2004)
_C1, _C2 = 0.01**2, 0.03**2
LEAST_ERROR = 1e-10  # mean squared; 100 dB, so that equal pictures have a number


@dataclass(frozen=True)
class Figures:
    """None where there is nothing to measure: no pixel in the mask, or no LPIPS weights."""

    psnr: float | None  # dB
    ssim: float | None
    lpips: float | None


def figures(picture: F32, truth: F32, mask: Mask, lpips: Lpips | None) -> Figures:
    """Compare (3, H, W) pictures in [0, 1] over the pixels of `mask` (H, W)."""
    if not mask.any():
        return Figures(None, None, None)
    return Figures(
        masked_psnr(picture, truth, mask),
        masked_ssim(picture, truth, mask),
        None if lpips is None else lpips.distance(picture, truth, mask),
    )


def mean_figures(several: Sequence[Figures]) -> Figures:
    """The mean of each figure over those that have it."""
    return Figures(*(mean_or_none([getattr(f, name) for f in several]) for name in ("psnr", "ssim", "lpips")))


def mean_or_none(values: Sequence[float | None]) -> float | None:
    """Mean of what is not None; None when nothing is left."""
    there = [value for value in values if value is not None]
    return sum(there) / len(there) if there else None


def masked_psnr(picture: F32, truth: F32, mask: Mask) -> float:
    """dB from the mean squared error over the pixels of the mask (at least one) and the three channels."""
    difference = picture.astype(np.float64) - truth
    return -10 * math.log10(max(LEAST_ERROR, float(np.square(difference[:, mask]).mean())))


def masked_ssim(picture: F32, truth: F32, mask: Mask) -> float | None:
    """Mean SSIM over the windows whose centre is in the mask; windows that leave the picture do not count.

    With a full mask it is the standard figure. A window at the edge of a mask still sees pixels beyond it.
    """
    values = ssim_map(torch.from_numpy(picture).double()[None], torch.from_numpy(truth).double()[None])[0]
    border = WINDOW // 2
    inner = mask[border:-border, border:-border]
    return float(values.mean(dim=0).numpy()[inner].mean()) if inner.any() else None


def ssim_map(a: Tensor, b: Tensor) -> Tensor:
    """(n, 3, H - 10, W - 10) SSIM of every window of (n, 3, H, W) pictures in [0, 1]."""
    offsets = torch.arange(WINDOW, dtype=a.dtype) - WINDOW // 2
    kernel = torch.exp(-offsets.square() / (2 * SIGMA**2))
    kernel = (kernel / kernel.sum()).repeat(3, 1)

    def mean(x: Tensor) -> Tensor:
        return F.conv2d(F.conv2d(x, kernel[:, None, None, :], groups=3), kernel[:, None, :, None], groups=3)

    mean_a, mean_b = mean(a), mean(b)
    var_a, var_b = mean(a * a) - mean_a**2, mean(b * b) - mean_b**2
    covariance = mean(a * b) - mean_a * mean_b
    top = (2 * mean_a * mean_b + _C1) * (2 * covariance + _C2)
    return top / ((mean_a**2 + mean_b**2 + _C1) * (var_a + var_b + _C2))
