"""PSNR and SSIM at their ends: nearly equal pictures, and flat ones in float32."""

from __future__ import annotations

import numpy as np
import pytest

from gapmes.service.pictures.picture_error import EQUAL_DB, psnr, ssim


@pytest.mark.parametrize("apart", [0.0, 1e-9, 9e-6])
def test_nothing_is_more_equal_than_equal_pictures(apart: float) -> None:
    """A difference of rounding alone would have up to 180 dB."""
    picture = np.full((3, 16, 16), 0.5)
    assert psnr(picture, picture + apart) == EQUAL_DB
    assert psnr(picture, picture + 1.1e-5) == pytest.approx(-20 * np.log10(1.1e-5))


@pytest.mark.parametrize("level", [0.1, 0.9])
def test_flat_pictures_have_their_similarity_in_float32(level: float) -> None:
    """Variances of 1e-4 squared are lost in the squares of 0.9 unless the mean is subtracted before."""
    rng = np.random.default_rng(5)
    truth, picture = ((level + 1e-4 * rng.normal(size=(3, 24, 24))).astype(np.float32) for _ in range(2))
    expected = ssim(picture.astype(np.float64), truth.astype(np.float64))
    assert ssim(picture, truth) == pytest.approx(expected, abs=3e-7)
