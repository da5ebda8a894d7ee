"""Depth search and anchors where every view is wrong, masked, or looks past something near."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plane_views import SIDE, on_the_plane, plane_depths, plane_views, with_wrong_patch

from gapmes.service.cameras.camera import Camera, pixel_grid
from gapmes.service.gaussians import Gaussians, joined
from gapmes.service.mending.anchors import anchors
from gapmes.service.mending.refined import RANGE, refined
from gapmes.service.mending.searched import searched
from gapmes.service.mending.surfaces import Surface
from gapmes.service.photographs.images import FittedView


@pytest.mark.parametrize("masked", [0, 1])
def test_what_a_mask_hides_does_not_tell_any_depth(masked: int) -> None:
    """Neither of its own view nor of another one: whatever colours the hidden pixels have, to the bit."""
    views, rng = plane_views(), np.random.default_rng(0)
    depths, found = with_wrong_patch(views, 1.8), []
    kept = np.ones((SIDE, SIDE), np.bool_)
    kept[:, 36:] = False
    for fill in (np.full((3, SIDE, SIDE), 0.5), rng.random((3, SIDE, SIDE))):
        image = np.where(kept, views[masked].image, fill).astype(np.float32)
        changed = [replace(view, image=image, mask=kept) if at == masked else view for at, view in enumerate(views)]
        found.append(searched(changed, depths))
    shown = kept if masked == 0 else np.ones_like(kept)
    np.testing.assert_array_equal(found[0][0][shown], found[1][0][shown])


@pytest.mark.parametrize("count", [2, 3])
def test_views_that_are_all_wrong_find_each_other(count: int) -> None:
    """Half of each by a factor of 1.5; measured 83 and 90 % within 5 % of the truth, with the wrong depths of the
    others as what these must agree with 7 and 22 %."""
    views = plane_views()[:count]
    truth = plane_depths(views)
    wrong = truth.copy()
    wrong[:, :, :32] *= 1.5
    inner = np.s_[:, 8:-8, 4:26]
    assert (np.abs(searched(views, wrong) / truth - 1) < 0.05)[inner].mean() > 0.7


def test_a_surface_goes_no_farther_than_what_is_kept() -> None:
    surface = Surface(np.array([[5.0, 0.5, 3.0]]), np.ones((1, 3)))
    found = surface.within(np.array([[1.0, 2.0, 100.0]]), np.array([[True, True, False]]))
    np.testing.assert_array_equal(found, [[2.0, 1.0, 2.0]])


def test_nothing_before_the_near_plane_hides_what_anchors_show() -> None:
    """A white Gaussian between the cameras, half a unit ahead of them."""
    cameras = [view.camera for view in (plane_views()[at] for at in (0, 2))]
    scene = on_the_plane(plane_views()[0])
    near = (cameras[0].center + cameras[1].center) / 2 + np.array([0, 0, 0.5])
    white = Gaussians.make([near], [[2.0] * 3], [[1.0, 0, 0, 0]], [0.99], np.full((1, 1, 3), 1.7))
    both = joined(scene, white)
    every = np.ones(len(both), np.bool_)
    for picture in anchors(both, every, every, cameras, near=1.0).pictures:
        assert picture.image.mean() < 0.6  # measured 0.44 and 0.49; 0.97 where it is drawn


def test_no_depth_changes_by_more_than_its_range() -> None:
    """The photographs say 1.3 px of disparity, the depths 0.5: twice that is as far as one goes."""
    x, y = (axis.reshape(32, 32) for axis in pixel_grid((32, 32)).T)
    views = []
    for center, shift in ((0.0, 0.0), (0.1, 1.3)):
        grey = 0.5 + 0.25 * np.sin(0.6 * (x + shift)) + 0.15 * np.cos(0.4 * y + 0.35 * (x + shift))
        pose = np.eye(4)
        pose[0, 3] = center
        camera = Camera.make(32, 32, 60.0, 60.0, 16.0, 16.0, pose)
        views.append(FittedView(np.repeat(grey[None].astype(np.float32), 3, axis=0), None, camera, 1.0))
    depths = np.full((2, 32, 32), 60 * 0.1 / 0.5)
    moved = refined(views, depths) / depths
    assert moved.min() == pytest.approx(1 / RANGE)
    assert moved.max() <= RANGE
