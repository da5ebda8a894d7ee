"""Cameras of any numbers: a finite result or a refusal that names its field, never another error or a warning."""

from __future__ import annotations

import copy
import json
import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.camera_file import camera_document, parse_camera_file
from gapmes.service.cameras.depth_range import DepthRange, depth_range
from gapmes.service.cameras.pose import checked_pose, rigid_inverse
from gapmes.service.cameras.view_checks import check_views, range_notices
from gapmes.service.cameras.world_frame import WorldFrame
from gapmes.service.errors import CameraError, InputError

SIZES = ("width", "height")
GOOD = {"width": 64, "height": 48, "fx": 60.0, "fy": 62.0, "cx": 31.0, "cy": 25.0}

extremes = st.sampled_from(
    [0.0, -0.0, 5e-324, -5e-324, 1e-310, 1e-38, -1e-38, 1e-7, 1.0, -1.0, 2.0, 1e7, 1e38, -1e38, 1e150, -1e150]
)
finite = st.one_of(extremes, st.floats(-1e3, 1e3), st.floats(-1e150, 1e150))
absurd = st.sampled_from([math.nan, math.inf, -math.inf])
anything = st.one_of(finite, absurd, st.floats())
# Values for JSON, where integers have no upper limit and any type may stand.
huge = st.sampled_from([10**400, -(10**400)])
foreign = st.one_of(anything, huge, st.sampled_from([2**63, None, True, "1", [], {}, [[1.0]]]))


@contextmanager
def named_or_finite(*fields: str) -> Iterator[None]:
    """Turns warnings of arithmetic into errors, and lets refusals pass that name one of the fields or a part of it."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        refused = None
        try:
            yield
        except InputError as refusal:
            refused = refusal
    if refused is not None:
        assert isinstance(refused.field, str)
        assert not fields or refused.field.startswith(fields), refused.field
        assert str(refused).startswith(refused.field)


def small(size: object) -> bool:
    """Whether it is no finite number above 1e15, which has tests of its own."""
    return not isinstance(size, int | float) or abs(size) in (math.inf, 10**400) or not abs(size) > 1e15


def assert_plausible(camera: Camera) -> None:
    for matrix in (camera.intrinsics, camera.normalized_intrinsics, camera.world_from_cam):
        assert np.isfinite(matrix).all()
    assert np.abs(camera.rotation.T @ camera.rotation - np.eye(3)).max() < 1e-13
    assert 0.1 <= camera.fx / camera.width <= 20
    assert -1 <= camera.cy / camera.height <= 2


@pytest.mark.case("P5", "E14")
@settings(max_examples=150)
@given(st.dictionaries(st.sampled_from([*GOOD]), anything, min_size=1, max_size=3))
def test_a_camera_of_any_numbers_is_made_or_refused_by_name(changes):
    """Sizes that are not finite or above 1e15 have tests of their own."""
    if not all(math.isfinite(changes.get(name, 1.0)) and small(changes.get(name, 1.0)) for name in SIZES):
        return
    with named_or_finite(*(f"views.{name}" for name in GOOD)):
        camera = Camera.make(**{**GOOD, **changes}, world_from_cam=np.eye(4), index=2, field="views")
        assert_plausible(camera)


@pytest.mark.parametrize("name", SIZES)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 10**400])
def test_a_size_that_is_no_finite_number_is_refused_by_name(name, value):
    with pytest.raises(CameraError) as caught:
        Camera.make(**{**GOOD, name: value}, world_from_cam=np.eye(4), index=2, field="views")
    assert (caught.value.field, caught.value.index) == (f"views.{name}", 2)


@pytest.mark.case("P5")
@settings(max_examples=200)
@given(
    st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3), st.one_of(finite, absurd)), min_size=1, max_size=16),
    st.sampled_from([3, 4]),
)
def test_a_pose_of_any_numbers_is_a_rigid_motion_or_refused_by_name(changes, rows):
    """Denormals and huge numbers included; beyond 1e150, whose square float64 no longer holds, see below."""
    matrix = np.eye(4)
    for row, column, value in changes:
        matrix[row, column] = value
    with named_or_finite("views.c2w"):
        pose = checked_pose(matrix[:rows], field="views.c2w", index=1).matrix
        assert np.isfinite(pose).all()
        assert np.abs(pose[:3, :3].T @ pose[:3, :3] - np.eye(3)).max() < 1e-13
        assert (pose[:3, 3] == matrix[:3, 3]).all()
        assert np.isfinite(rigid_inverse(pose)).all()


@pytest.mark.parametrize("value", [1e155, 1e200, -1e308])
@pytest.mark.parametrize("place", [(0, 0), (0, 1), (2, 2)])
def test_a_pose_beyond_the_square_root_of_float64_is_refused_without_a_warning(value, place):
    matrix = np.eye(4)
    matrix[place] = value
    with named_or_finite("views.c2w"):
        checked_pose(matrix, field="views.c2w")
        raise AssertionError("this is no rotation")


OURS = {
    "near": 1.0,
    "far": 9.0,
    "views": [camera_document(Camera.make(**GOOD, world_from_cam=np.eye(4)), f"{i}.png") for i in range(2)],
}
THEIRS = {
    "w": 640, "h": 480, "fl_x": 500.0, "fl_y": 510.0, "cx": 322.0, "cy": 236.5, "k1": 0.0, "near": 1.0, "far": 9.0,
    "frames": [{"file_path": "0.png", "transform_matrix": np.eye(4).tolist()}],
}  # fmt: skip


@pytest.mark.case("P5")
@settings(max_examples=200)
@given(
    st.dictionaries(st.sampled_from([*GOOD, "near", "far"]), foreign, max_size=3),
    st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3), foreign), max_size=3),
)
def test_a_camera_file_of_any_numbers_is_read_or_refused_by_name(numbers, cells):
    document = copy.deepcopy(OURS)
    for name, value in numbers.items():
        (document if name in ("near", "far") else document["views"][1])[name] = value
    for row, column, value in cells:
        document["views"][1]["c2w"][row][column] = value
    if any(isinstance(v, float) and math.isfinite(v) and abs(v) > 1e150 for *_, v in cells):
        return
    if not all(small(numbers.get(name)) for name in SIZES):
        return
    with named_or_finite("views", "cameras."):
        file = parse_camera_file(json.loads(json.dumps(document)))
        for camera in file.cameras:
            assert_plausible(camera)
        assert all(value is None or math.isfinite(value) for value in (file.near, file.far))


@pytest.mark.case("P5")
@settings(max_examples=200)
@given(
    st.dictionaries(
        st.sampled_from([*(set(THEIRS) - {"frames"}), "camera_angle_x", "camera_angle_y", "k4", "k5", "p1"]),
        foreign,
        max_size=4,
    ),
    st.booleans(),
)
def test_a_transforms_file_of_any_numbers_is_read_or_refused_by_name(numbers, angles):
    """Sizes above 1e15 px and the smallest denormal angle have tests of their own."""
    document = copy.deepcopy(THEIRS)
    if angles:
        del document["fl_x"], document["fl_y"]
        document |= {"camera_angle_x": 0.7}
    document |= numbers
    if not all(small(document[name]) for name in ("w", "h")):
        return
    if any(document.get(f"camera_angle_{axis}") == 5e-324 for axis in "xy"):
        return
    with named_or_finite("frames", "cameras."):
        for camera in parse_camera_file(json.loads(json.dumps(document))).cameras:
            assert_plausible(camera)


def test_the_smallest_field_of_view_is_refused_by_name():
    document = {key: value for key, value in THEIRS.items() if key not in ("fl_x", "fl_y")}
    with pytest.raises(CameraError) as caught:
        parse_camera_file({**document, "camera_angle_x": 5e-324})
    assert caught.value.field.startswith("frames")


@pytest.mark.parametrize(("size", "focal"), [(1e25, "camera_angle_x"), (1e300, "camera_angle_x"), (1e308, "fl_x")])
def test_a_huge_picture_in_a_transforms_file_is_read_or_refused_by_name(size, focal):
    document = {key: value for key, value in THEIRS.items() if key not in ("fl_x", "fl_y", "cx", "cy")}
    with named_or_finite("frames"):
        parse_camera_file({**document, "w": size, "h": size, focal: 0.7})


@pytest.mark.parametrize("size", [2.0**64, 1e38])
def test_a_camera_of_a_huge_size_is_refused_by_name_or_has_numbers(size):
    with named_or_finite("camera.width", "camera.height"):
        assert_plausible(Camera.make(size, size, size, size, size / 2, size / 2, np.eye(4)))


pixel = st.one_of(st.floats(-1e4, 1e4), st.sampled_from([0.0, -0.0, 1e-38, 1e38, -1e38]))
depth = st.one_of(st.floats(1e-38, 1e38), st.sampled_from([1e-38, 1.0, 1e38]))
place = st.one_of(st.floats(-1e6, 1e6), st.sampled_from([0.0, 5e-324, 1e-38, -1e38, 1e38]))


@pytest.mark.case("P4", "E19")
@settings(max_examples=200)
@given(
    st.lists(st.tuples(pixel, pixel, depth), min_size=1, max_size=5),
    st.tuples(place, place, place),
    st.sampled_from([0.1, 1.0, 20.0]),
)
def test_unprojecting_any_pixels_gives_finite_points(rows, center, focal):
    pose = np.eye(4)
    pose[:3, 3] = center
    camera = Camera.make(64, 48, focal * 64, focal * 48, 32, 24, checked_pose(pose))
    table = np.array(rows)
    with named_or_finite():
        points = camera.unproject(table[:, :2], table[:, 2])
        assert np.isfinite(points).all()
        back, z = camera.project(points)
        assert np.isfinite(z).all()
        assert (np.isfinite(back).all(axis=1) == (z > 0)).all()  # where the offset swallows the depth, z is 0
        if not any(center):
            near = np.abs(table[:, :2]).max(axis=1) <= 1e4
            assert np.abs(back - table[:, :2])[near].max(initial=0.0) < 1e-9


@pytest.mark.case("P4")
@settings(max_examples=200)
@given(st.lists(st.tuples(place, place, st.one_of(place, depth)), min_size=1, max_size=5))
def test_projecting_any_points_gives_pixels_in_front_and_none_behind(rows):
    """Depths are 0, negative or at least 1e-38; below it see the next test."""
    points = np.array([row for row in rows if not 0 < row[2] < 1e-38]).reshape(-1, 3)
    camera = Camera.make(64, 48, 60, 62, 32, 24, np.eye(4))
    with named_or_finite():
        pixels, z = camera.project(points)
    assert (z == points[:, 2]).all()
    assert np.isfinite(pixels[z > 0]).all()
    assert np.isnan(pixels[z <= 0]).all()


@pytest.mark.parametrize("z", [5e-324, 1e-310])
def test_points_a_denormal_in_front_of_the_camera_are_projected_without_a_warning(z):
    camera = Camera.make(64, 48, 60, 62, 32, 24, np.eye(4))
    with named_or_finite():
        camera.project(np.array([[0.1, 0.2, z]]))


def pair(baseline: float) -> list[Camera]:
    cameras = []
    for x in (0.0, baseline):
        pose = np.eye(4)
        pose[0, 3] = x
        cameras.append(Camera.make(64, 48, 60, 60, 32, 24, pose))
    return cameras


@pytest.mark.case("P3", "P2")
@settings(max_examples=150)
@given(
    st.one_of(st.sampled_from([0.0, 1e-150, 1e-38, 0.1, 1e38, 1e150]), st.floats(1e-100, 1e100)),
    st.one_of(st.none(), st.floats(-1.0, 1e300), st.sampled_from([math.nan, math.inf, -math.inf, 0.0, 1e-38])),
    st.one_of(st.none(), st.floats(-1.0, 1e300), st.sampled_from([math.nan, math.inf, -math.inf, 0.0, 1e38])),
)
def test_any_depth_range_is_checked_or_refused_by_name(baseline, near, far):
    """Nears above 1e-300; a smaller one has no inverse and a test of its own."""
    if near is not None and 0 < near < 1e-300:
        return
    with named_or_finite("near", "far", "camera"):
        cameras = pair(baseline)
        depths = depth_range(cameras, near, far)
        check_views(cameras, depths)
        notices = range_notices(depths)
        assert 0 < depths.near < depths.far < math.inf
        wide = depths.far / depths.near > 1000
        assert ("depth_range_wide" in [notice["code"] for notice in notices]) == wide


@pytest.mark.parametrize(("near", "far"), [(5e-324, 1.0), (1e-310, 1.0), (1.0, 1e308)])
def test_a_depth_range_beyond_float64_is_refused_by_name(near, far):
    with named_or_finite("near", "far"):
        cameras = pair(0.5)
        check_views(cameras, depth_range(cameras, near, far))


@pytest.mark.parametrize("baseline", [1e160, 1e300])
def test_cameras_too_far_apart_are_checked_or_refused_by_name(baseline):
    with named_or_finite("camera"):
        cameras = pair(baseline)
        check_views(cameras, depth_range(cameras))


def test_a_depth_range_that_float32_cannot_hold_is_refused_by_name():
    """Near is the network's unit, so that far / near must stay below 3.4e38."""
    with named_or_finite("near", "far"):
        cameras = pair(0.5e-20)
        depths = depth_range(cameras, 1e-20, 1e20)
        check_views(cameras, depths)
        assert np.isfinite(WorldFrame.of(cameras, depths).near_far(depths)).all()


@pytest.mark.case("P3")
@pytest.mark.parametrize("ratio", [1e6, 1e30, 1e38])
def test_ratios_that_float32_holds_reach_the_network_finite(ratio):
    cameras, depths = pair(0.5), DepthRange(1.0, ratio, "given")
    assert [notice["code"] for notice in range_notices(depths)] == ["depth_range_wide"]
    assert np.isfinite(WorldFrame.of(cameras, depths).near_far(depths)).all()
