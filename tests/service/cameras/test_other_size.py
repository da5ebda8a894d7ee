"""Intrinsics of pictures of another size are told by their principal points; those of real lenses and crops are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plane_scene import PlaneScene

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.depth_range import DepthRange
from gapmes.service.cameras.other_size import LEAST, other_size
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.cameras.view_checks import check_views
from gapmes.service.errors import ContradictionError, IntrinsicsError, OverlapError
from gapmes.service.network.engine import Engine
from gapmes.service.reconstruct import Reconstructor


def cameras(*middles: tuple[float, float], size: tuple[int, int] = (640, 480)) -> list[Camera]:
    """Side by side, with their principal points at these multiples of the middle."""
    made = []
    for index, (across, down) in enumerate(middles):
        pose = np.eye(4)
        pose[0, 3] = 0.1 * index
        width, height = size
        made.append(Camera.make(width, height, 600.0, 600.0, across * width / 2, down * height / 2, pose))
    return made


@pytest.mark.parametrize("factor", [0.25, 0.5, 2 / 3, 1.25, 1.5, 2.0, 3.9])
def test_photographs_that_were_scaled_alone_are_told_with_the_size_before(factor: float) -> None:
    right = cameras((1.03, 0.97), (1.0, 1.01))
    scaled = [replace(one, **{name: factor * getattr(one, name) for name in ("fx", "fy", "cx", "cy")}) for one in right]
    (notice,) = other_size(scaled)
    assert notice["code"] == "intrinsics_of_another_size"
    told = [int(word) for word in notice["message"].split("about ")[1].split(" px")[0].split(" x ")]
    assert told == pytest.approx([640 * factor, 480 * factor], rel=0.03)
    assert f"cx, cy = {scaled[0].cx:g}, {scaled[0].cy:g} px in a picture of 640 x 480 px" in notice["message"]
    assert notice in check_views(scaled, DepthRange(2.0, 8.0, "given"))
    assert ("begin at the upper left" if factor > 1 else "end at the lower right") in notice["message"]
    assert other_size(right) == []


@pytest.mark.parametrize(
    "middles",
    [
        [(1.0, 1.0), (1.0, 1.0)],
        [(1.1, 1.1), (0.9, 0.9)],
        [(1.5, 1.0), (1.5, 1.0)],  # cut off at the right
        [(2.0, 2.0), (0.0, 2.0)],  # the upper quarters of one photograph
        [(2.0, 2.0), (1.0, 1.0)],
        [(-0.5, -0.5), (-0.5, -0.5)],  # crops that do not have the middle
        [(LEAST - 0.01,) * 2] * 3,
    ],
)
def test_lenses_and_crops_are_not(middles: list[tuple[float, float]]) -> None:
    assert other_size(cameras(*middles)) == []


def test_where_the_views_then_share_nothing_it_comes_before_the_poses() -> None:
    """Of two cameras 35 degrees apart that are right with half of the focal length."""
    first, second = cameras((1.0, 1.0), (1.0, 1.0))
    pose = second.world_from_cam.copy()
    pose[:3, :3] = about_axis(np.array([0.0, 1.0, 0.0]), np.radians(35.0))
    pose[0, 3] = 0.5
    right = [replace(one, fx=500.0, fy=500.0) for one in (first, second.posed(pose))]
    assert other_size(right) == []
    check_views(right, DepthRange(2.0, 8.0, "given"))
    twice = [replace(one, fx=1000.0, fy=1000.0, cx=640.0, cy=480.0) for one in right]
    with pytest.raises(OverlapError) as caught:
        check_views(twice, DepthRange(2.0, 8.0, "given"))
    assert str(caught.value.cure).startswith("cx, cy = 640, 480 px in a picture of 640 x 480 px")
    assert "set trust_poses" in str(caught.value.cure)


def test_where_the_photographs_contradict_the_poses_it_comes_first_too(engine: Engine) -> None:
    """Upper left parts of two photographs, each with the other's pose; of one photograph twice it says nothing."""
    scene = PlaneScene.make(np.random.default_rng(5), count=2, turn=0)
    width, height = (5 * side // 8 for side in (scene.cameras[0].width, scene.cameras[0].height))
    images = [image[:height, :width] for image in scene.images]
    parts = [replace(camera, width=width, height=height) for camera in scene.cameras]
    reconstructor = Reconstructor(engine)
    with pytest.raises(ContradictionError) as caught:
        reconstructor.reconstruct(images, parts[::-1], near=scene.near, far=scene.far)
    hint, _, cure = str(caught.value.cure).partition("; else: ")
    assert hint == other_size(parts[::-1])[0]["message"]
    assert cure.startswith("these look like the cameras of the other photograph")
    with pytest.raises(ContradictionError) as caught:
        reconstructor.reconstruct([images[0]] * 2, parts, near=scene.near, far=scene.far)
    assert str(caught.value.cure).startswith("was one of them sent twice?")


def test_a_size_that_is_far_too_large_is_refused_with_that_cure() -> None:
    with pytest.raises(IntrinsicsError, match="lies far outside an image of 640 px") as caught:
        cameras((4.1, 4.1))
    assert "scale fx, fy, cx and cy" in str(caught.value.cure)
