"""A mask that leaves out no pixel of a crop counts as none, and which pixels count as out of reach."""

from __future__ import annotations

import numpy as np
import pytest

from gapmes.service.cameras.camera import Camera
from gapmes.service.photographs.images import Photo, fit_view
from gapmes.service.photographs.resampling import _filter_support, resampled

BOXES = [
    ((64, 64), (32.0, 0.0, 96.0, 64.0)),  # as it is
    ((40, 24), (20.5, 10.25, 100.75, 58.0)),  # coarser
    ((90, 120), (40.0, 20.0, 70.5, 60.25)),  # finer
    ((16, 16), (0.0, 0.0, 128.0, 64.0)),
]


def noise(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


@pytest.mark.parametrize(("size", "box"), BOXES)
def test_what_lies_beyond_the_filter_changes_nothing(size: tuple[int, int], box: tuple) -> None:
    rgb, other = noise(0, 64, 128, 3), noise(1, 64, 128, 3)
    inside = np.zeros((64, 128), bool)
    inside[_filter_support(size, box)] = True
    expected, _ = resampled(rgb, None, size, box)
    found, mask = resampled(np.where(inside[..., None], rgb, other), inside, size, box)
    assert mask is None
    assert (found == expected).all()


@pytest.mark.parametrize(("side", "reached"), [(40, 27), (64, 29), (90, 29)])
def test_a_mask_beside_the_crop_is_none(side: int, reached: int) -> None:
    """Of 64 px from 32 on; three pixels of the coarser grid are reached beyond."""
    rgb = noise(2, 64, 128, 3)
    mask = np.ones((64, 128), bool)
    mask[:10, :reached] = False
    camera = Camera.make(128, 64, 64.0, 64.0, 64.0, 32.0, np.eye(4))
    masked, whole = (fit_view(Photo(rgb, kept), camera, side, side) for kept in (mask, None))
    assert masked.mask is None
    assert (masked.image == whole.image).all()
    mask[:10, 31:] = False
    assert fit_view(Photo(rgb, mask), camera, side, side).mask is not None


def test_a_pixel_that_is_averaged_away_leaves_no_mask_and_no_colour() -> None:
    rgb, mask = np.full((640, 640, 3), 200, np.uint8), np.ones((640, 640), bool)
    rgb[300, 300], mask[300, 300] = 0, False
    found, kept = resampled(rgb, mask, (64, 64), (0.0, 0.0, 640.0, 640.0))
    assert kept is None
    assert np.abs(found.astype(int) - 200).max() <= 1  # rounding of the weighted colours


@pytest.mark.parametrize("size", [(40, 20), (128, 64), (200, 100)])
def test_beside_a_mask_no_colour_is_darker_or_brighter_than_what_it_keeps(size: tuple[int, int]) -> None:
    """Negative weights would ring at the edges of the blocks, most where a mask leaves few pixels."""
    rng = np.random.default_rng(3)
    rgb = rng.choice(np.array([60, 200], np.uint8), (16, 32, 3)).repeat(4, axis=0).repeat(4, axis=1)
    mask = rng.random((64, 128)) < 0.7
    found, kept = resampled(np.where(mask[..., None], rgb, 0).astype(np.uint8), mask, size, (0.0, 0.0, 128.0, 64.0))
    colours = found if kept is None else found[kept]
    assert 58 <= colours.min() < 75
    assert 185 < colours.max() <= 202
