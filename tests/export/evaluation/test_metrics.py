"""PSNR and SSIM under masks, against brute force in float64."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from gapmes.export.evaluation.metrics import Figures, figures, mean_figures
from gapmes.model.training import losses
from gapmes.service.pictures.picture_error import psnr, ssim

RNG = np.random.default_rng(5)


def pictures(height: int = 40, width: int = 36) -> tuple[np.ndarray, np.ndarray]:
    """A smooth picture and a noisy copy, (3, H, W) float32."""
    a = F.interpolate(torch.from_numpy(RNG.random((1, 3, 6, 6))), size=(height, width), mode="bicubic")[0].clamp(0, 1)
    b = (a + 0.1 * torch.from_numpy(RNG.standard_normal(a.shape))).clamp(0, 1)
    return a.float().numpy(), b.float().numpy()


def some_pixels(shape: tuple[int, int]) -> np.ndarray:
    mask = RNG.random(shape) < 0.4
    mask[: shape[0] // 3] = False
    return mask


def test_masked_psnr_is_the_error_of_the_kept_pixels() -> None:
    a, b = pictures()
    mask = some_pixels(a.shape[1:])
    total, count = 0.0, 0
    for row, column in zip(*np.nonzero(mask), strict=True):
        for channel in range(3):
            total += (float(a[channel, row, column]) - float(b[channel, row, column])) ** 2
            count += 1
    assert psnr(a, b, mask) == pytest.approx(-10 * math.log10(total / count), abs=1e-9)


def test_masked_ssim_is_the_mean_of_windows_centred_in_the_mask() -> None:
    a, b = pictures(24, 22)
    mask = some_pixels((24, 22))
    offsets = np.arange(11) - 5
    kernel = np.exp(-(offsets[:, None] ** 2 + offsets[None] ** 2) / (2 * 1.5**2))
    kernel /= kernel.sum()
    values = []
    for row in range(5, 19):
        for column in range(5, 17):
            if not mask[row, column]:
                continue
            for channel in range(3):
                x, y = (p[channel, row - 5 : row + 6, column - 5 : column + 6].astype(np.float64) for p in (a, b))
                mx, my = (kernel * x).sum(), (kernel * y).sum()
                vx, vy = (kernel * x * x).sum() - mx**2, (kernel * y * y).sum() - my**2
                c = (kernel * x * y).sum() - mx * my
                top = (2 * mx * my + 1e-4) * (2 * c + 9e-4)
                values.append(top / ((mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4)))
    assert ssim(a.astype(np.float64), b.astype(np.float64), mask) == pytest.approx(np.mean(values), abs=1e-9)


def test_with_a_full_mask_both_are_the_figures_of_training() -> None:
    a, b = pictures()
    full = np.ones(a.shape[1:], dtype=bool)
    one, other = torch.from_numpy(a)[None], torch.from_numpy(b)[None]
    assert psnr(a, b, full) == pytest.approx(float(losses.psnr(one, other)), abs=1e-4)  # float32 there
    assert ssim(a.astype(np.float64), b.astype(np.float64), full) == pytest.approx(
        float(losses.gaussian_ssim(one, other)), abs=1e-5
    )


def test_equal_pictures_and_empty_masks() -> None:
    a, b = pictures()
    full, none = np.ones(a.shape[1:], dtype=bool), np.zeros(a.shape[1:], dtype=bool)
    equal = figures(a, a, full, None)
    assert equal.psnr == pytest.approx(100)
    assert equal.ssim == pytest.approx(1)
    assert equal.lpips is None
    assert figures(a, b, none, None) == Figures(None, None, None)
    assert mean_figures([Figures(10, 0.5, None), Figures(None, None, None), Figures(20, 0.7, None)]) == Figures(
        15, pytest.approx(0.6), None
    )
