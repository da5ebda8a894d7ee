"""A given range that misses the scene is reported, with the estimate and the end where the photographs match best."""

import numpy as np
import pytest
from plane_scene import PlaneScene
from sample_photographs import FAR, NEAR, sample_views

from gapmes.service.cameras.depth_range import DepthRange, depth_range
from gapmes.service.matching.depth_sweep import narrowed
from gapmes.service.matching.photo_checks import check_photos
from gapmes.service.photographs.images import Photo, fit_view


@pytest.mark.parametrize("indices", [(1, 5), (0, 3, 7)])
@pytest.mark.parametrize(("near", "far", "end"), [(2, 2, "near"), (3, 3, "near"), (1, 0.6, "far"), (0.5, 0.5, "far")])
def test_a_range_that_misses_the_scene_is_told(indices, near, far, end):
    views = sample_views(indices)
    (notice,) = check_photos(views, DepthRange(near * NEAR, far * FAR, "given"))
    assert (notice["code"], notice["field"]) == ("depth_range_doubtful", "near")
    assert notice["score"] < 0.75
    found = narrowed(depth_range([view.camera for view in views]), views)
    assert f"from near = {near * NEAR:.4g} to far = {far * FAR:.4g}, and 0.8" in notice["message"]
    assert f"estimated: {found.near:.4g} to {found.far:.4g};" in notice["message"]
    assert f"match best at {end}: what they show may be {'nearer' if end == 'near' else 'farther'}" in notice["message"]


@pytest.mark.parametrize("indices", [(1, 5), (0, 3, 7), (0, 7), (6, 7)])
@pytest.mark.parametrize(("near", "far"), [(1, 1), (0.5, 1), (1, 2), (0.1, 10)])
def test_a_range_that_holds_the_scene_passes(indices, near, far):
    assert check_photos(sample_views(indices), DepthRange(near * NEAR, far * FAR, "given")) == []


def test_a_range_in_which_nothing_is_seen_twice_is_told():
    """At depths up to a tenth of the scene's the two share nothing."""
    (notice,) = check_photos(sample_views((1, 5)), DepthRange(0.1 * NEAR, 0.1 * FAR, "given"))
    assert notice["code"] == "depth_range_doubtful"
    assert "match with score 0.00 at" in notice["message"]


@pytest.mark.parametrize("bounds", [(0.3, 1.5), (20.0, 90.0)])
def test_the_poses_are_not_blamed_for_a_range(bounds):
    scene = PlaneScene.make(np.random.default_rng(7), count=2, turn=0)
    views = [fit_view(Photo(i), c, 72, 96) for i, c in zip(scene.images, scene.cameras, strict=True)]
    assert [notice["code"] for notice in check_photos(views, DepthRange(*bounds, "given"))] == ["depth_range_doubtful"]


def test_plain_photographs_blame_no_range():
    views = sample_views((1, 5))
    for view in views:
        view.image[:] = 0.5
    assert [n["code"] for n in check_photos(views, DepthRange(10 * NEAR, 10 * FAR, "given"))] == ["no_texture"]
