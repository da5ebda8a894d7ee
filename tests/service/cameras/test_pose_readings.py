"""Other readings of the poses: all that match equally well are named, and so is rotating photographs as EXIF says."""

import re
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from plane_scene import ROBOT, PlaneScene, photograph
from sample_photographs import sample_cameras, sample_pixels, sample_views

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.camera_file import parse_camera_file
from gapmes.service.cameras.depth_range import DepthRange, depth_range
from gapmes.service.cameras.pose_readings import other_orders, other_readings, robot_readings
from gapmes.service.errors import ContradictionError
from gapmes.service.matching.photo_checks import check_photos
from gapmes.service.photographs.images import Photo, fit_view
from gapmes.service.photographs.upright import upright

GL = np.diag([1.0, -1.0, -1.0, 1.0])
inv = np.linalg.inv
DEPTHS = DepthRange(2.0, 8.0, "given")


def test_readings_that_match_alike_are_all_named():
    """Of two that look the same way through one lens: exchanged and inverted are one relative pose."""
    rng, cameras, lens = np.random.default_rng(5), [], PlaneScene.make(np.random.default_rng(5)).cameras[0]
    for place in ([-0.5, 0.0, 0.0], [0.1, 0.15, 0.1]):
        pose = np.eye(4)
        pose[:3, 3] = place
        cameras.append(lens.posed(pose))
    waves, phases = rng.normal(size=(3, 24, 2)) * 7, rng.uniform(0, 2 * np.pi, (3, 24))
    views = [fit_view(Photo(photograph(camera, waves, phases)), camera, 72, 96) for camera in cameras]
    assert check_photos(views, DEPTHS) == []
    swapped = [replace(v, camera=o.camera) for v, o in zip(views, reversed(views), strict=True)]
    with pytest.raises(ContradictionError) as caught:
        check_photos(swapped, DEPTHS)
    assert caught.value.cure.startswith(
        "these look like the cameras of the other photograph: swap the two cameras or images; "
        "or world-to-camera matrices: invert them,"
    )


def transforms(matrices: list[np.ndarray]) -> tuple[Camera, ...]:
    frames = [{"file_path": str(i), "transform_matrix": matrix.tolist()} for i, matrix in enumerate(matrices)]
    return parse_camera_file({"w": 320, "h": 240, "fl_x": 250, "frames": frames}).cameras


def between(cameras: tuple[Camera, ...]) -> np.ndarray:
    one, other = (camera.world_from_cam for camera in cameras)
    return inv(one) @ other


@pytest.mark.parametrize(
    ("written", "place", "told", "mended"),
    [
        (lambda c2w: c2w, 1, "in a transforms.json OpenCV axes: negate columns 1 and 2 of each", lambda m: m @ GL),
        (inv, 0, "invert them, .*of a transforms.json negate columns 1 and 2 then", lambda m: inv(m) @ GL),
        (lambda c2w: inv(c2w @ GL), 2, "of a transforms.json invert them", inv),
        (
            lambda c2w: c2w @ ROBOT,
            4,
            r"json a robot's axes \(x forward, y left, z up\): .*json -column 1, column 2, -column 0",
            lambda m: m[:, [1, 2, 0, 3]] * [-1, 1, -1, 1],
        ),
        (
            lambda c2w: c2w @ ROBOT @ GL,
            3,
            r"json a robot's axes \(x forward, y right, z down\): .*json column 1, -column 2, -column 0",
            lambda m: m[:, [1, 2, 0, 3]] * [1, -1, -1, 1],
        ),
    ],
)
def test_cures_are_those_of_a_transforms_json_too(written, place, told, mended):
    """It has OpenGL axes, and takes no word for others."""
    poses = [camera.world_from_cam for camera in sample_cameras((1, 5))]
    matrices = [written(pose) for pose in poses]
    cameras = transforms(matrices)
    reading = (*other_readings(cameras), *robot_readings(cameras))[place]
    np.testing.assert_allclose(between(reading.cameras), inv(poses[0]) @ poses[1], atol=1e-12)
    assert re.search(told, f"{reading.looks_like}: {reading.cure}")
    np.testing.assert_allclose(
        between(transforms([mended(matrix) for matrix in matrices])), inv(poses[0]) @ poses[1], atol=1e-12
    )


@pytest.mark.parametrize(
    ("written", "place", "mended"),
    [
        (lambda c2w: c2w @ ROBOT, 0, lambda m: m[:, [1, 2, 0, 3]] * [-1, -1, 1, 1]),
        (lambda c2w: c2w @ ROBOT @ GL, 1, lambda m: m[:, [1, 2, 0, 3]]),
    ],
)
def test_the_cure_of_a_robots_axes_gives_the_right_poses(written, place, mended):
    """The columns of the cure, as it counts and signs them."""
    cameras = sample_cameras((1, 5))
    wrong = [camera.posed(written(camera.world_from_cam)) for camera in cameras]
    reading = robot_readings(wrong)[place]
    signs = "-column 1, -column 2, column 0" if place == 0 else "column 1, column 2, column 0"
    assert reading.cure.startswith(f"put {signs} for columns 0, 1, 2 of each c2w")
    for camera, read, bad in zip(cameras, reading.cameras, wrong, strict=True):
        np.testing.assert_array_equal(mended(bad.world_from_cam), read.world_from_cam)
        np.testing.assert_allclose(read.world_from_cam, camera.world_from_cam, atol=1e-15)


STORED = {2: 2, 3: 3, 4: 4, 5: 5, 6: 8, 7: 7, 8: 6}  # the orientation that undoes another; both turned by 90 degrees


@pytest.mark.parametrize("orientation", STORED)
@pytest.mark.parametrize("indices", [(1, 5), (0, 3, 6)])
def test_photographs_that_exif_turns_are_named(indices, orientation):
    """Stored mirrored, upside down, on their side, or two of these, while the cameras are those of what is seen: the
    photographs are square, and their sizes tell nothing."""
    views = sample_views(indices)
    photos = [Photo(upright(sample_pixels(index), STORED[orientation]), orientation=orientation) for index in indices]
    stored = [fit_view(p, c, 256, 256) for p, c in zip(photos, sample_cameras(indices), strict=True)]
    depths = depth_range([view.camera for view in views])
    (notice,) = check_photos(stored, depths, trust_poses=True, numbers=range(4, 4 + len(views)))
    assert notice["code"] == "poses_doubtful"
    which = "4, 5" if len(views) == 2 else "4, 5, 6"
    cure = f"cameras of photographs that are turned as EXIF says: save photographs {which} turned so, without the tag"
    assert f"(these look like {cure}" in notice["message"]
    as_stored = [replace(view, orientation=orientation) for view in views]  # under cameras of what is stored
    assert check_photos(as_stored, depths) == []


@pytest.mark.parametrize(("size", "orientation", "left"), [((96, 72), 6, 1), ((96, 72), 3, 3), ((96, 97), 6, 6)])
def test_photographs_whose_size_tells_that_they_are_not_turned_have_no_other_reading(size, orientation, left):
    """The camera has the stored size, and turned by 90 degrees the photograph has another."""
    width, height = size
    photo = Photo(np.zeros((height, width, 3), np.uint8), orientation=orientation)
    camera = Camera.make(width, height, 80, 80, width / 2, height / 2, np.eye(4))
    assert fit_view(photo, camera, 64, 64).orientation == left


def test_pictures_that_are_not_square_are_not_turned_by_90_degrees():
    """Of a network whose crop of a square photograph on its side shows other parts of it."""
    pixels = [upright(sample_pixels(index), 8) for index in (1, 5)]
    cameras = sample_cameras((1, 5))
    stored = [fit_view(Photo(p, orientation=6), c, 192, 256) for p, c in zip(pixels, cameras, strict=True)]
    notices = check_photos(stored, depth_range(cameras), trust_poses=True)
    assert all("EXIF" not in notice["message"] for notice in notices)


@pytest.mark.parametrize("count", [2, 3, 4, 6])
def test_other_orders_are_every_swap_and_of_three_every_order(count):
    cameras, numbers = [sample_cameras((1,))[0] for _ in range(count)], range(10, 10 + count)
    found = {}
    for reading in other_orders(cameras, numbers):
        order = tuple(next(own for own in range(count) if cameras[own] is one) for one in reading.cameras)
        found[order] = reading.cure
    moved = {order: sum(k != own for k, own in enumerate(order)) for order in permutations(range(count))}
    assert set(found) == {order for order in moved if moved[order] == 2 or (count == 3 and moved[order])}
    for order, cure in found.items() if count > 2 else ():
        said = {(k, own) for k in range(count) for own in range(count) if f"{10 + k} fits that of {10 + own}" in cure}
        assert said == {(k, own) for k, own in enumerate(order) if k != own}
