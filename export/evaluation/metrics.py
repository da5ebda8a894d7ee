"""PSNR, SSIM and LPIPS of a picture against the truth, over all pixels or over those of a mask; in float64."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gapmes.model.training.lpips import Lpips
from gapmes.service.pictures.picture_error import psnr, ssim

F32 = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Figures:
    """Scores of one picture; None for an empty mask, for SSIM without a whole window and for LPIPS without weights."""

    psnr: float | None  # dB
    ssim: float | None
    lpips: float | None


def figures(picture: F32, truth: F32, mask: Mask, lpips: Lpips | None) -> Figures:
    """Compare (3, H, W) pictures in [0, 1] over the pixels of `mask` (H, W).

    SSIM is averaged over windows centred in the mask, which extend beyond it at its edge.
    """
    if not mask.any():
        return Figures(None, None, None)
    similarity = ssim(picture.astype(np.float64), truth.astype(np.float64), mask)
    return Figures(
        psnr(picture, truth, mask),
        None if math.isnan(similarity) else similarity,
        None if lpips is None else lpips.distance(picture, truth, mask),
    )


def mean_figures(several: Sequence[Figures]) -> Figures:
    """The mean of each figure over those that have it."""
    return Figures(*(mean_or_none([getattr(f, name) for f in several]) for name in ("psnr", "ssim", "lpips")))


def mean_or_none(values: Sequence[float | None]) -> float | None:
    """Mean of what is not None; None when nothing is left."""
    there = [value for value in values if value is not None]
    return sum(there) / len(there) if there else None
