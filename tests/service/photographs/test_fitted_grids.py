"""Grids whose sides, focal lengths and masks differ: none of them stands in for another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.distortion import Lens, pinhole_window
from gapmes.service.photographs.fitting import FittedPhotos, fit_notices, fitted
from gapmes.service.photographs.images import PackedView, Photo, fit_view, match_photo
from gapmes.service.photographs.undistort import undistorted


def camera(width: int, height: int) -> Camera:
    side = (width + height) / 2
    return Camera.make(width, height, 0.9 * side, 0.8 * side, width / 2, height / 2, np.eye(4))


@pytest.mark.parametrize(
    ("size", "shape", "told"),
    [
        ((200, 300), (96, 64), None),
        ((100, 300), (96, 64), "the photograph has 100 px where a row of the scene with detail 2 has 128 px"),
        ((300, 150), (96, 64), "the photograph has 100 px where a row of the scene with detail 2 has 128 px"),
        ((300, 100), (64, 96), "the photograph has 150 px where a row of the scene with detail 2 has 192 px"),
        ((300, 150), (64, 96), None),
    ],
)
def test_a_photograph_is_small_by_the_crop_that_the_scene_has_of_it(size, shape, told):
    """Crops of 200, 100 and 100 px of 2:3, then of 150 and 225 px of 3:2."""
    notices = fit_notices(Photo(np.zeros((*size[::-1], 3), np.uint8)), camera(*size), None, 0, shape, detail=2)
    assert [notice["code"] for notice in notices] == ["detail_beyond_photograph"] * (told is not None)
    assert told is None or notices[0]["message"].startswith(told)


def test_the_finer_view_keeps_what_both_masks_keep():
    """A mask of single pixels: the coarser grid keeps where half of four are, the finer one each by itself."""
    rng = np.random.default_rng(4)
    kept = rng.random((128, 128)) < 0.6
    photo = Photo(rng.integers(0, 256, (128, 128, 3), dtype=np.uint8), kept, own_mask=True)
    view, fine, _ = fitted(photo, camera(128, 128), 0, (64, 64), finer=2)
    assert view.mask is not None
    assert not view.mask.all()
    coarse = view.mask.repeat(2, axis=0).repeat(2, axis=1)
    np.testing.assert_array_equal(fine.mask, kept & coarse)
    assert (kept & ~coarse).any() and (coarse & ~kept).any()  # noqa: PT018


def test_focal_lengths_change_each_by_its_own_share():
    photo = Photo(np.zeros((64, 96, 3), np.uint8))
    seen, shown = fit_view(photo, camera(96, 64), 32, 48), fit_view(photo, camera(96, 64), 64, 96)
    photos = FittedPhotos([seen], [shown], [PackedView.of(shown)], [])
    new = replace(seen.camera, fx=1.02 * seen.camera.fx, fy=0.99 * seen.camera.fy)
    changed = photos.with_cameras([new])
    for old, found in ((seen, changed.seen[0]), (shown, changed.shown[0]), (shown, changed.fine[0])):
        assert found.camera.fx == pytest.approx(1.02 * old.camera.fx)
        assert found.camera.fy == pytest.approx(0.99 * old.camera.fy)


@pytest.mark.parametrize(
    ("size", "seen"), [((2000, 101), (1000, 50)), ((1000, 50), (2000, 101)), ((101, 2000), (50, 1000))]
)
def test_a_pixel_of_the_short_side_may_be_many_of_the_long_one(size, seen):
    photo, found = match_photo(Photo(np.zeros((*size[::-1], 3), np.uint8)), camera(*seen))
    assert (found.width, found.height) == (photo.width, photo.height) == size


@pytest.mark.parametrize(
    ("size", "offered"), [((640, 640), 6), ((641, 640), 6), ((4000, 3990), 6), ((4000, 3900), 1), ((640, 480), 1)]
)
def test_an_orientation_is_offered_where_sizes_cannot_decide_on_it(size, offered):
    """A camera of 100 x 100 px fits 4000 x 3990 px as stored and turned."""
    photo = Photo(np.zeros((*size[::-1], 3), np.uint8), orientation=6)
    assert fit_view(photo, camera(*size), 64, 64).orientation == offered


@pytest.mark.parametrize("k1", [-0.2, 0.15])
def test_the_edge_of_a_mask_stays_where_it_is_through_a_lens(k1):
    """At column 60 of the photograph, within a twentieth of a pixel."""
    lens = Lens(320, 240, 250.0, 255.0, 163.0, 117.0, k1=k1)
    kept = np.zeros((240, 320), np.bool_)
    kept[:, :60] = True
    photo = undistorted(Photo(np.full((240, 320, 3), 200, np.uint8), kept), lens, index=0)
    window = pinhole_window(lens)
    x = (window.left + (np.arange(photo.width) + 0.5) * (window.width / photo.width) - lens.cx) / lens.fx
    y = (window.top + (np.arange(photo.height) + 0.5) * (window.height / photo.height) - lens.cy) / lens.fy
    column = lens.fx * lens.distorted(*np.meshgrid(x, y))[0] + lens.cx
    decided = np.abs(column - 60) > 0.05
    assert photo.mask is not None
    np.testing.assert_array_equal(photo.mask[decided], column[decided] < 60)
    assert ((column > 59.6) & (column < 59.9)).any()
