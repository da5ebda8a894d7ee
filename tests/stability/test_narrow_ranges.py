"""Depth ranges that are next to nothing: refused where float32 cannot tell near from far, else told apart by it."""

import numpy as np
import pytest

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.depth_range import depth_range
from gapmes.service.cameras.world_frame import WorldFrame
from gapmes.service.errors import DepthRangeError
from gapmes.service.reconstruct import Reconstructor


def pair() -> list[Camera]:
    cameras = []
    for x in (0.0, 0.2):
        pose = np.eye(4)
        pose[0, 3] = x
        cameras.append(Camera.make(64, 64, 64, 64, 32, 32, pose))
    return cameras


@pytest.mark.case("P3")
@pytest.mark.parametrize("near", [1e-30, 0.3, 1.0, 7.7e5, 1e30])
@pytest.mark.parametrize("excess", [1e-15, 1e-8, 6e-8, 9e-7])
def test_a_range_of_one_depth_is_refused(near: float, excess: float) -> None:
    """The network's depth in it would be 0 / 0."""
    far = near * (1 + excess)
    with pytest.raises(DepthRangeError, match="need far to exceed near by 1e-06 of it at least") as caught:
        depth_range(pair(), near, far)
    assert caught.value.field == "near"
    assert f"near = {near:.12g}, far = {far:.12g}" in str(caught.value)
    assert caught.value.cure == "the scene needs some depth"


@pytest.mark.case("P3")
def test_ends_that_are_swapped_are_told_apart() -> None:
    with pytest.raises(DepthRangeError, match=r"near = 1\.0000002, far = 1\.0000001, need near < far"):
        depth_range(pair(), 1.0000002, 1.0000001)


@pytest.mark.case("P3")
@pytest.mark.parametrize(
    ("near", "far"), [(0.1, 0.1000001), (1, 1.000001), (3, 3.000003), (7.5, 7.5000075), (1e3, 1000.001)]
)
def test_exactly_the_least_excess_is_enough(near: float, far: float) -> None:
    """As people write it; most of these are a little less in float64."""
    assert depth_range(pair(), near, far).far == far


@pytest.mark.case("P3")
@pytest.mark.parametrize("near", [1e-30, 0.3, 1.0, 7.7e5, 1e30])
def test_the_narrowest_range_has_two_ends_in_float32(near: float) -> None:
    depths = depth_range(pair(), near, near * (1 + 1.01e-6))
    ends = WorldFrame.of(pair(), depths).near_far(depths)
    inverse = np.float32(1) / ends
    assert inverse[0] > inverse[1]


@pytest.mark.case("P3")
def test_a_scene_in_the_narrowest_range_is_finite() -> None:
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 256, (64, 64, 3), dtype=np.uint8) for _ in range(2)]
    scene = Reconstructor(threads=1).reconstruct(images, pair(), near=1.0, far=1 + 1.01e-6, trust_poses=True)
    assert (scene.document["near"], scene.document["far"]) == (1.0, 1 + 1.01e-6)
    assert np.isfinite(scene.gaussians.means).all()
    assert scene.document["check"]["no_parallax_share"] == 1.0
