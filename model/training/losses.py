"""Losses of the recipe and the figures it reports (Eq. 21-25): colour, structure, depth in inverse depth."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from ..depth import DepthEstimate

_C1, _C2 = 0.01**2, 0.03**2  # SSIM constants for a range of 1 (Wang et al. 2004)


def box_ssim(a: Tensor, b: Tensor, window: int = 7) -> Tensor:
    """Mean SSIM of (n, 3, H, W) images in [0, 1] with a box window (quick; for the loss)."""

    def mean(x: Tensor) -> Tensor:
        return F.avg_pool2d(x, window, 1)

    return _ssim(a, b, mean).mean()


def gaussian_ssim(a: Tensor, b: Tensor) -> Tensor:
    """(n,) SSIM with the standard 11x11 window of sigma 1.5 (for reported figures)."""
    x = torch.arange(11, dtype=a.dtype, device=a.device) - 5
    kernel = torch.exp(-x.square() / (2 * 1.5**2))
    kernel = kernel / kernel.sum()
    weight = (kernel[:, None] * kernel[None])[None, None].repeat(3, 1, 1, 1)

    def mean(x: Tensor) -> Tensor:
        return F.conv2d(x, weight, groups=3)

    return _ssim(a, b, mean).mean((1, 2, 3))


def _ssim(a: Tensor, b: Tensor, mean) -> Tensor:
    mean_a, mean_b = mean(a), mean(b)
    var_a, var_b = mean(a * a) - mean_a**2, mean(b * b) - mean_b**2
    covariance = mean(a * b) - mean_a * mean_b
    top = (2 * mean_a * mean_b + _C1) * (2 * covariance + _C2)
    return top / ((mean_a**2 + mean_b**2 + _C1) * (var_a + var_b + _C2))


def psnr(a: Tensor, b: Tensor) -> Tensor:
    """(n,) PSNR in dB of (n, 3, H, W) images in [0, 1]."""
    return -10 * torch.log10((a - b).square().mean((1, 2, 3)).clamp(min=1e-10))


def normalised_inverse_depth(depth: Tensor, near_far: Tensor) -> Tensor:
    """(B, V, H, W) true z-depth to the network's 0 (far) .. 1 (near), clamped."""
    low, high = 1 / near_far[:, 1].reshape(-1, 1, 1, 1), 1 / near_far[:, 0].reshape(-1, 1, 1, 1)
    return ((1 / depth - low) / (high - low)).clamp(0, 1)


def depth_loss(estimate: DepthEstimate, final: Tensor, truth: Tensor) -> Tensor:
    """L1 loss at 1/4, 1/2 and full resolution; truth (B, V, K, H, W) normalised inverse depth, with K samples at equal
    distances from each pixel's centre.

    The centre of a coarse cell is a corner of four pixels. Their mean would be a depth of no surface at edges, and one
    of them would be off by half a pixel: the prediction is compared with the closest of the four.
    """
    truth = truth.flatten(0, 1)
    quarter = _closest(estimate.quarter, [truth[:, :, y::4, x::4] for y in (1, 2) for x in (1, 2)])
    samples = [truth[:, :, y::2, x::2] for y in (0, 1) for x in (0, 1)]
    half = 0.5 * _closest(estimate.refined, samples) + 0.5 * _closest(estimate.half, samples)
    return 0.5 * quarter + half + _closest(final, [truth])


def _closest(prediction: Tensor, samples: list[Tensor]) -> Tensor:
    """Mean over pixels of the smallest absolute difference; prediction (n, 1, h, w), samples (n, K, h, w)."""
    return (torch.cat(samples, dim=1) - prediction).abs().amin(1).mean()
