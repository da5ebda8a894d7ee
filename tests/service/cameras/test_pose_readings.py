"""Other readings of the poses: all that match equally well are named, and so is rotating photographs as EXIF says."""

import math
import re
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from plane_scene import ROBOT, PlaneScene, photograph
from sample_photographs import sample_cameras, sample_pixels, sample_views

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.camera_fields import opencv_pose
from gapmes.service.cameras.camera_file import parse_camera_file
from gapmes.service.cameras.depth_range import DepthRange, depth_range, largest_baseline
from gapmes.service.cameras.pose_readings import apart_when_inverted, other_orders, other_readings, robot_readings
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.errors import BaselineError, ContradictionError
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
        "or world-to-camera matrices: invert each c2w; "
    )


SAID = [  # form, axes and pose as the file says, or as its format has them
    ("", "opencv", "c2w"),
    ("transforms.json", "opengl", "c2w"),
    ("COLMAP", "opencv", "w2c"),
    ("LLFF", "opencv", "c2w"),
    ("RealEstate10K", "opencv", "w2c"),
    *(("cameras.json", axes, pose) for axes in ("opencv", "opengl") for pose in ("c2w", "w2c")),
]
AXES = {"opencv": np.eye(4), "opengl": GL, "left": ROBOT, "right": ROBOT @ GL}
LOOKS = {
    "opencv": "OpenCV axes (x right, y down, z forward)",
    "opengl": "OpenGL axes (x right, y up, z backward)",
    "left": "a robot's axes (x forward, y left, z up)",
    "right": "a robot's axes (x forward, y right, z down)",
}
Said = tuple[str, str, str]


def written(poses: list[np.ndarray], axes: str, pose: str) -> list[np.ndarray]:
    turned = [matrix @ AXES[axes] for matrix in poses]
    return [inv(matrix) for matrix in turned] if pose == "w2c" else turned


def read(matrices: list[np.ndarray], said: Said, names: tuple[str, ...] | None = None) -> tuple[Camera, ...]:
    """As a file of this form is read; in a cameras.json under the first of the `names`, beside other matrices."""
    form, axes, pose = said
    if form == "cameras.json":
        view = {"width": 320, "height": 240, "fx": 250, "fy": 250, "cx": 160, "cy": 120}
        used, *others = names or (pose,)
        views = [{**view, used: m.tolist(), **{name: (m @ GL @ m).tolist() for name in others}} for m in matrices]
        return parse_camera_file({"axes": axes, "pose": pose, "views": views}).cameras
    poses = (opencv_pose(m, form=form, axes=axes, pose=pose, field="pose", index=None) for m in matrices)
    return tuple(Camera.make(320, 240, 250, 250, 160, 120, pose) for pose in poses)


def between(cameras: tuple[Camera, ...]) -> np.ndarray:
    one, other = (camera.world_from_cam for camera in cameras)
    return inv(one) @ other


def mended(
    cure: str, matrices: list[np.ndarray], said: Said, names: tuple[str, ...] | None = None
) -> tuple[Camera, ...]:
    """The cameras after doing what the cure says, word by word."""
    form, axes, pose = said
    if cure.startswith("say "):
        told = dict(re.findall(r'"(pose|axes)": "(\w+)"', cure))
        assert told.keys() <= {"pose", "axes"}
        assert told.items().isdisjoint({("pose", pose), ("axes", axes)})  # no word on what is said already
        if named := re.search(r", and name the matrices (\w+)$", cure):
            names = (named[1],)
        return read(matrices, (form, told.get("axes", axes), told.get("pose", pose)), names)
    if "invert each" in cure:
        matrices = [inv(matrix) for matrix in matrices]
    if found := re.search(r"negate (row|column)s 1 and 2", cure):
        matrices = [matrix @ GL if found[1] == "column" else GL @ matrix for matrix in matrices]
    if found := re.fullmatch(r"put (.+) for (row|column)s 0, 1, 2 of each \S.*", cure):
        moved = [re.fullmatch(rf"(-?){found[2]} ([012])", name).groups() for name in found[1].split(", ")]
        order, signs = [int(number) for _, number in moved], [-1 if sign else 1 for sign, _ in moved]
        if found[2] == "column":
            matrices = [matrix[:, [*order, 3]] * [*signs, 1] for matrix in matrices]
        else:
            matrices = [matrix[[*order, 3]] * np.array([*signs, 1])[:, None] for matrix in matrices]
    return read(matrices, said, names)


@pytest.mark.parametrize("pose", ["c2w", "w2c"])
@pytest.mark.parametrize("axes", AXES)
@pytest.mark.parametrize("said", SAID, ids=" ".join)
def test_done_word_by_word_the_cure_makes_a_file_right(said: Said, axes: str, pose: str) -> None:
    """Whatever the file is and says, and whatever its matrices are, but for inverse ones of a robot."""
    poses = [camera.world_from_cam for camera in sample_cameras((1, 5))]
    right, matrices = inv(poses[0]) @ poses[1], written(poses, axes, pose)
    cameras = read(matrices, said)
    readings = (*other_readings(cameras), *robot_readings(cameras))
    fitting = [reading for reading in readings if np.allclose(between(reading.cameras), right, rtol=0, atol=1e-12)]
    if (axes, pose) == said[1:] or (axes in ("left", "right") and pose != said[2]):
        assert fitting == []
        return
    (reading,) = fitting
    np.testing.assert_allclose(between(mended(reading.cure, matrices, said)), right, rtol=0, atol=1e-12)
    direction = {"c2w": "camera-to-world matrices", "w2c": "world-to-camera matrices"}[pose]
    if pose == said[2]:
        assert reading.looks_like == LOOKS[axes]
    else:
        assert reading.looks_like == direction + ("" if axes == said[1] else f" in {LOOKS[axes][:11]}")
    things = {
        "": "c2w",
        "cameras.json": "matrix",
        "transforms.json": "transform_matrix",
        "COLMAP": "[R | t] of quaternion and translation",
        "LLFF": "[right | down | -back | centre]",
        "RealEstate10K": "[R | t]",
    }
    assert reading.cure.startswith("say ") or f" each {things[said[0]]}" in reading.cure


@pytest.mark.parametrize("names", [("c2w",), ("w2c",), ("w2c", "c2w")], ids="+".join)
@pytest.mark.parametrize("axes", ["opencv", "opengl", "left"])
def test_so_it_does_whatever_the_matrices_are_called(axes: str, names: tuple[str, ...]) -> None:
    """Those that are said to be world-to-camera; a view may have both, of which the right one is read."""
    poses = [camera.world_from_cam for camera in sample_cameras((1, 5))]
    said, right = ("cameras.json", "opencv", "w2c"), inv(poses[0]) @ poses[1]
    matrices = written(poses, axes, "w2c" if axes == "left" else "c2w")
    cameras = read(matrices, said, names)
    readings = (*other_readings(cameras), *robot_readings(cameras))
    (reading,) = (r for r in readings if np.allclose(between(r.cameras), right, rtol=0, atol=1e-12))
    found = between(mended(reading.cure, matrices, said, names))
    np.testing.assert_allclose(found, right, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("said", "words"),
    [
        (("", "opencv", "c2w"), "world-to-camera matrices, invert each c2w"),
        (("transforms.json", "opengl", "c2w"), "world-to-camera matrices, invert each transform_matrix"),
        (("COLMAP", "opencv", "w2c"), "camera-to-world matrices, invert each [R | t] of quaternion and translation"),
        (
            ("cameras.json", "opencv", "c2w"),
            'world-to-camera matrices, say "pose": "w2c", and name the matrices w2c',
        ),
        (
            ("cameras.json", "opengl", "w2c"),
            'camera-to-world matrices, say "pose": "c2w", and name the matrices c2w',
        ),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_a_ring_that_is_read_inverted_is_told_in_the_same_words(said: Said, words: str) -> None:
    ring = [about_axis(np.array([0.0, 1.0, 0.0]), turn) for turn in (0.0, 0.4, 0.8)]
    poses = [np.block([[turn, turn @ [[0.0], [0.0], [-3.0]]], [np.zeros((1, 3)), np.ones((1, 1))]]) for turn in ring]
    inverse = {"c2w": "w2c", "w2c": "c2w"}[said[2]]
    with pytest.raises(BaselineError) as caught:
        largest_baseline(read(written(poses, said[1], inverse), said))
    apart = 2 * 3 * np.sin(0.4)
    assert caught.value.cure.endswith(f"; if these are {words}: the cameras then stand {apart:.4g} apart")


def test_of_matrices_that_were_written_differently_the_cure_is_for_those_as_they_were_read():
    poses = [camera.world_from_cam for camera in sample_cameras((1, 5))]
    one, other = read(poses, ("cameras.json", "opencv", "c2w")), read(poses, ("cameras.json", "opengl", "c2w"))
    assert other_readings((one[0], other[1]))[0].cure == "invert each c2w"
    assert other_readings(one)[0].cure == 'say "pose": "w2c", and name the matrices w2c'


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


def two(apart: float, turn: float) -> list[Camera]:
    """Ten units ahead of the origin, so many apart, the second turned; about the origin that turn moves its inverse."""
    poses = [np.eye(4), np.eye(4)]
    poses[1][:3, :3] = about_axis(np.array([0.0, 1.0, 0.0]), turn)
    for pose, x in zip(poses, (0.0, apart), strict=True):
        pose[:3, 3] = [x, 0.0, 10.0]
    return [Camera.make(320, 240, 250, 250, 160, 120, pose) for pose in poses]


@pytest.mark.parametrize(("times", "told"), [(0.5, False), (9.5, False), (10.5, True), (400.0, True)])
def test_inverting_is_told_where_it_brings_cameras_ten_times_as_far_apart(times: float, told: bool) -> None:
    cameras = two(0.02, -math.asin(0.02 * (times - 1) / 10))
    centers = [np.linalg.inv(camera.world_from_cam)[:3, 3] for camera in cameras]
    ratio = np.linalg.norm(centers[0] - centers[1]) / 0.02
    assert (ratio > 10) == told
    assert bool(apart_when_inverted(cameras)) == told


def test_inverses_that_rounding_alone_moves_apart_are_not_told() -> None:
    """By a ten-millionth of a unit in ten; by a thousandth they are."""
    assert apart_when_inverted(two(0.0, 1e-8)) == ""
    assert "then stand 0.001 apart" in apart_when_inverted(two(0.0, 1e-4))
