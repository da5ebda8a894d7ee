"""The comparison at many depths against the one at a single depth per pixel, which samples in another way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from guarded import Guarded, beside_nan
from plane_views import SIDE, plane_depths, plane_views

from gapmes.service.cameras.rotations import about_axis
from gapmes.service.matching.correspondence import reprojected
from gapmes.service.matching.match_cost import LIMIT, difference, features
from gapmes.service.matching.reprojection_kernels import compare_level
from gapmes.service.mending.searched import _Sweep
from gapmes.service.photographs.images import FittedView

LEVELS = np.array([0.05, 0.15, 0.25, 0.3, 0.6, 2.0])


def swept(view: FittedView, other: FittedView) -> _Sweep:
    return _Sweep.of(view, features(view), other, features(other))


def test_every_level_is_the_comparison_at_its_depth() -> None:
    """Places in the other picture are up to 2e-13 px apart, which moves what lies on its border alone."""
    views, limits = plane_views(), []
    for view in views:
        for other in views:
            sweep, found = swept(view, other), []
            for level in LEVELS:
                found.append(sweep.cost(level))
                depth = np.full((SIDE, SIDE), 1 / level)
                expected = difference(view, features(view), depth, other, features(other))
                assert (np.abs(found[-1] - expected) < 1e-6).mean() > 0.999  # found: all; float32 holds the features
            limits.append(np.mean(np.array(found) == LIMIT))
    assert 0.1 < np.mean(limits) < 0.9


def test_what_a_mask_of_the_other_view_hides_is_not_seen() -> None:
    view, other, depth = *plane_views()[:2], plane_depths(plane_views())[0]
    half = np.arange(SIDE)[None] < np.full((SIDE, 1), SIDE // 2)
    level = float(1 / np.median(depth))
    masked = swept(view, replace(other, mask=half)).cost(level)
    place = reprojected(view, np.full_like(depth, 1 / level), other)
    shown, hidden = place.where & (place.column < SIDE // 2 - 2), place.column > SIDE // 2
    assert (masked[hidden] == LIMIT).all()
    assert (masked[shown] < LIMIT).mean() > 0.9
    anything = replace(other, mask=half, image=np.where(half, other.image, 0.9).astype(np.float32))
    assert (swept(view, anything).cost(level) == masked).all()


def test_what_lies_behind_the_other_view_is_not_seen() -> None:
    view, other = plane_views()[:2]
    pose = other.camera.world_from_cam.copy()
    pose[:3, :3] = pose[:3, :3] @ about_axis(np.array([0.0, 1.0, 0.0]), np.pi)
    away = replace(other, camera=other.camera.posed(pose))
    assert all((swept(view, away).cost(level) == LIMIT).all() for level in LEVELS)


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 37), (37, 1), (17, 33)])
def test_nothing_is_read_or_written_beside_the_arrays(height: int, width: int) -> None:
    """Rays that meet the very border of the other picture, its corners and what is beyond."""
    rng, guarded = np.random.default_rng(5), Guarded()
    own, others = (beside_nan(rng.random((height, width, 5)).astype(np.float32)) for _ in range(2))
    rays = rng.choice([-1.0, 0.0, 1e-9, 0.5, 1.0, 2.0, 1e30], (height, width, 3))
    rays[..., 2] = rng.choice([1.0, -1.0, 1e-300], (height, width))
    lens = beside_nan(np.array([width, height, 0.0, 0.0]))
    way = beside_nan(np.array([0.0, 0.0, 1e-6]))
    for level in (0.0, 1e-3):
        found = guarded.array((height, width), np.float64)
        compare_level(own, others, beside_nan(rays), way, lens, level, 0.4, found)
        guarded.check()
        assert np.isfinite(found).all()
        assert (found <= 0.4).all()
