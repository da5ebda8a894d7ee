"""Photographs that show next to nothing: named, and kept from refuting the poses of the others."""

from dataclasses import replace

import numpy as np
import pytest
from test_photo_checks import DEPTHS, fitted

from gapmes.service.cameras.depth_range import DepthRange
from gapmes.service.matching.depth_sweep import narrowed
from gapmes.service.matching.photo_checks import check_photos


def changed(scene, place, change):
    return replace(scene, images=tuple(change(i) if p == place else i for p, i in enumerate(scene.images)))


def plain(image):
    """One level with the noise of a sensor."""
    noise = np.random.default_rng(5).integers(-1, 2, image.shape)
    return (90 + noise).astype(image.dtype)


@pytest.mark.parametrize("place", range(3))
def test_a_plain_photograph_is_named_and_the_poses_of_the_others_pass(plane_scene, place):
    """The one in the middle is the nearest neighbour of both others."""
    (notice,) = check_photos(fitted(changed(plane_scene, place, plain)), DEPTHS, numbers=(4, 7, 9))
    assert notice["code"] == "photo_plain"
    assert notice["field"] == "images"
    assert notice["index"] == (4, 7, 9)[place]
    assert f"photograph {notice['index']} shows next to nothing" in notice["message"]


def test_of_two_photographs_the_plain_one_is_named(plane_scene):
    views = fitted(changed(plane_scene, 1, plain))[:2]
    assert [(notice["code"], notice["index"]) for notice in check_photos(views, DEPTHS)] == [("photo_plain", 1)]


def test_wrong_poses_of_the_others_are_noticed_beside_a_plain_one(plane_scene):
    views = fitted(changed(plane_scene, 1, plain), change=lambda pose: pose @ np.diag([1.0, -1.0, -1.0, 1.0]))
    plain_one, doubt = check_photos(views, DEPTHS, trust_poses=True, numbers=(4, 7, 9))
    assert plain_one["index"] == 7
    assert doubt["code"] == "poses_doubtful"
    assert "OpenGL axes" in doubt["message"]


def test_a_dark_photograph_is_not_plain(plane_scene):
    """Of several that are all as dark none is plain, however dark."""
    assert check_photos(fitted(changed(plane_scene, 1, lambda image: image // 8)), DEPTHS) == []
    dark = replace(
        plane_scene, images=tuple((image.astype(float) / 50).round().astype(np.uint8) for image in plane_scene.images)
    )
    assert "photo_plain" not in [notice["code"] for notice in check_photos(fitted(dark), DEPTHS)]


def test_a_masked_rest_that_is_plain_is_named(plane_scene):
    """What the mask leaves out has contrast, but no say."""
    views = fitted(plane_scene)
    height, width = views[1].image.shape[1:]
    mask = np.zeros((height, width), bool)
    mask[:, : width // 2] = True
    image = np.where(mask, np.float32(0.4), views[1].image)
    (notice,) = check_photos([views[0], replace(views[1], image=image, mask=mask), views[2]], DEPTHS)
    assert (notice["code"], notice["index"]) == ("photo_plain", 1)


def test_the_depth_range_is_narrowed_as_without_the_plain_photograph(plane_scene):
    wide = DepthRange(0.3, 300.0, "estimated")
    views = fitted(changed(plane_scene, 1, plain))
    found = narrowed(wide, views)
    assert found == narrowed(wide, views[::2])
    assert found.near > 0.5
