"""The choice of views from a capture: the score as documented, and its preferences."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from capture_scenes import arc

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.camera_fields import CameraFile, NamedView
from gapmes.service.cameras.depth_range import DepthRange
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.cameras.view_checks import check_views
from gapmes.service.captures import choose
from gapmes.service.captures.choose import Choice, chosen_views, scene_depths
from gapmes.service.captures.select import ViewSelection, checked_selection, named_views, several_named_views
from gapmes.service.errors import InputError, ViewCountError, ViewError


def around(angles: list[float], radius: float = 4.0) -> list[Camera]:
    """Cameras on a circle about the origin that look at it, at these angles in degrees."""
    cameras = []
    for angle in angles:
        pose = np.eye(4)
        pose[:3, :3] = about_axis(np.array([0.0, 1.0, 0.0]), np.radians(angle))
        pose[:3, 3] = pose[:3, :3] @ [0.0, 0.0, -radius]
        cameras.append(Camera.make(96, 72, 80.0, 80.0, 48.0, 36.0, pose))
    return cameras


def wandering(seed: int, count: int) -> list[Camera]:
    """Cameras at random places in a box that look roughly ahead."""
    rng, cameras = np.random.default_rng(seed), []
    for _ in range(count):
        pose = np.eye(4)
        turns = rng.normal(scale=0.3, size=2)
        pose[:3, :3] = about_axis(np.array([0.0, 1.0, 0.0]), turns[0]) @ about_axis(np.array([1.0, 0.0, 0.0]), turns[1])
        pose[:3, 3] = rng.uniform(-1, 1, 3)
        cameras.append(Camera.make(96, 72, 80.0, 80.0, 48.0, 36.0, pose))
    return cameras


def chosen(cameras: list[Camera], count: int) -> Choice:
    """The choice where no depth is known."""
    return chosen_views(cameras, count, [None] * len(cameras))


def score(cameras: list[Camera], places: tuple[int, ...], depth: float) -> float:
    """The definition, view by view and ray by ray."""

    def share(one: Camera, other: Camera) -> float:
        seen = 0
        for down in (np.arange(5) + 0.5) / 5:
            for across in (np.arange(5) + 0.5) / 5:
                pixel = np.array([[across * one.width, down * one.height]])
                (x, y), z = (
                    other.project(one.unproject(pixel, np.array([depth])))[0][0],
                    other.project(one.unproject(pixel, np.array([depth])))[1],
                )
                seen += bool(z[0] > 0 and 0 <= x < other.width and 0 <= y < other.height)
        return seen / 25

    def angle(one: Camera, other: Camera) -> float:
        point = one.center + depth * one.rotation[:, 2]
        a, b = one.center - point, other.center - point
        return float(np.degrees(np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1))))

    def pair(i: int, j: int) -> tuple[float, float]:
        one, other = cameras[i], cameras[j]
        overlap, turn = (0.5 * (way(one, other) + way(other, one)) for way in (share, angle))
        return overlap * min(1.0, turn / 5, 25 / turn), overlap * min(1.0, 10 / turn)

    quality = np.mean([max(pair(i, j)[0] for j in places if j != i) for i in places])
    covered = [1.0 if v in places else max(pair(v, i)[1] for i in places) for v in range(len(cameras))]
    return float(quality * np.mean(covered))


@pytest.mark.parametrize("seed", range(4))
def test_the_pair_has_the_highest_score_of_all(seed: int) -> None:
    cameras = wandering(seed, 7)
    depth = 2 / (1 / 2.0 + 1 / 10.0)
    scores = {places: score(cameras, places, depth) for places in combinations(range(7), 2)}
    choice = chosen_views(cameras, 2, [depth] * 7)
    assert scores[choice.places] == pytest.approx(max(scores.values()), rel=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_the_third_view_is_the_best_beside_the_pair(seed: int) -> None:
    cameras = wandering(seed, 7)
    depth = 2 / (1 / 2.0 + 1 / 10.0)
    pair, three = (chosen_views(cameras, count, [depth] * 7).places for count in (2, 3))
    scores = [score(cameras, (*pair, k), depth) for k in range(7) if k not in pair]
    assert set(pair) < set(three)
    assert score(cameras, three, depth) == pytest.approx(max(scores), rel=1e-9)


def test_the_choice_is_the_same_each_time_and_in_any_world() -> None:
    cameras = wandering(5, 12)
    first = chosen(cameras, 4)
    assert chosen(cameras, 4) == first
    turn = about_axis(np.array([0.6, 0.0, 0.8]), 1.1)
    moved = []
    for camera in cameras:
        pose = np.eye(4)
        pose[:3, :3] = turn @ camera.rotation
        pose[:3, 3] = 1000 * (turn @ camera.center) + [5e5, -3e5, 20.0]
        moved.append(camera.posed(pose))
    assert chosen(moved, 4).places == first.places


def test_parallax_is_neither_too_small_nor_too_large() -> None:
    """A frame of a video each degree around a thing."""
    choice = chosen(around([float(angle) for angle in range(0, 80)]), 3)
    first, second, third = choice.places
    assert 5 <= second - first <= 25
    assert 5 <= third - second <= 25
    assert 0.9 <= choice.said["overlap"] <= 1.0


def test_the_same_place_twice_is_never_chosen() -> None:
    cameras = around([0.0, 0.0, 0.0, 12.0, 12.0])
    assert chosen(cameras, 2).places == (0, 3)


def test_a_view_that_looks_elsewhere_is_left_out() -> None:
    cameras = around([0.0, 10.0, 20.0, 30.0])
    away = cameras[1].world_from_cam.copy()
    away[:3, :3] = away[:3, :3] @ np.diag([-1.0, 1.0, -1.0])
    cameras[1] = cameras[1].posed(away)
    assert 1 not in chosen(cameras, 3).places
    assert chosen(cameras, 9).places == (0, 1, 2, 3)


@pytest.mark.parametrize("count", [2, 3, 4, 6])
def test_what_is_chosen_passes_the_checks(count: int) -> None:
    cameras = arc(40)
    places = chosen(cameras, count).places
    assert len(places) == count
    check_views([cameras[place] for place in places], DepthRange(2.0, 9.0, "given"))


def test_of_thousands_some_hundred_are_compared() -> None:
    choice = chosen(around([0.05 * index for index in range(2000)]), 3)
    assert choice.said["compared"] == choose.MAX_SCORED == 400
    assert len(set(choice.places)) == 3
    assert max(choice.places) < 2000


def test_of_many_the_first_and_the_last_are_compared() -> None:
    """They alone see the same; all others look away from them and from each other."""
    cameras = around([0.0, *(180.0 + 0.01 * index for index in range(498)), 12.0])
    for index, camera in enumerate(cameras[1:-1]):
        camera.world_from_cam[1, 3] = 1000.0 * (index + 1)
    assert chosen_views(cameras, 2, [3.0] * 500).places == (0, 499)


def test_depths_are_where_axes_meet() -> None:
    """Exactly around a point; four baselines where all look the same way; the others' where one looks elsewhere."""
    np.testing.assert_allclose(scene_depths(around([0.0, 15.0, 40.0], 7.0)), 7.0)
    side_by_side = [camera.posed(np.eye(4)) for camera in around([0.0, 1.0, 2.0])]
    for index, camera in enumerate(side_by_side):
        camera.world_from_cam[0, 3] = 0.5 * index
    np.testing.assert_allclose(scene_depths(side_by_side), 4.0)
    np.testing.assert_allclose(scene_depths([side_by_side[0]] * 2), 1.0)
    cameras = around([0.0, 15.0, 40.0], 7.0)
    back = cameras[1].world_from_cam.copy()
    back[:3, :3] = back[:3, :3] @ np.diag([-1.0, 1.0, -1.0])
    np.testing.assert_allclose(scene_depths([*cameras, cameras[1].posed(back)]), 7.0)


@pytest.mark.parametrize("degrees", [3.0, 5.0, 90.0])
def test_axes_that_meet_at_one_of_the_cameras_do_not_count(degrees: float) -> None:
    """A step forward and a turn: the depth there is plus or minus rounding as the world is turned."""
    first = around([0.0])[0]
    step = np.eye(4)
    step[:3, :3], step[2, 3] = about_axis(np.array([0.0, 1.0, 0.0]), np.radians(degrees)), 1.0
    rng = np.random.default_rng(0)
    for _ in range(100):
        axis, world = rng.normal(size=3), np.eye(4)
        world[:3, :3] = about_axis(axis / np.linalg.norm(axis), rng.uniform(0, 3))
        np.testing.assert_allclose(scene_depths([first.posed(world), first.posed(world @ step)]), 4.0)


NAMES = ("a/1.png", "a/2.png", "b/2.png", "7", "2020 trip.jpg")


@pytest.mark.parametrize(
    ("text", "indices"),
    [
        ("0,2", [0, 2]),
        ("b/2.png,1", [2, 1]),
        ("1.PNG", [0]),
        ("7", [3]),
        ("2020 trip.jpg , 0", [4, 0]),
    ],
)
def test_views_are_named_or_counted(text: str, indices: list[int]) -> None:
    assert named_views(text, NAMES, field="select") == indices


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("2.png", r"2 views are named '2\.png'"),
        ("9", "view 9 does not exist, the file has 5 views"),
        ("0,a/1.png", r"a/1\.png is given twice"),
        ("nothing.png", r"'nothing\.png' is not a view index, nor the name of a view"),
        ("0,,1", "'' is not a view index"),
        ("-1", "'-1' is not a view index"),
        ("9" * 5000, "does not exist"),
    ],
)
def test_views_that_are_none(text: str, words: str) -> None:
    with pytest.raises(ViewError, match=words) as caught:
        named_views(text, NAMES, field="select")
    assert caught.value.field == "select"
    assert text != "9" or caught.value.cure == "0 to 4"


def test_a_single_view_is_too_few_for_a_reconstruction_alone() -> None:
    assert named_views("1", NAMES, field="views") == [1]
    assert several_named_views("1,0", NAMES, field="views") == [1, 0]
    with pytest.raises(ViewCountError, match="1 view, need 2 to 6") as caught:
        several_named_views("1", NAMES, field="views")
    assert caught.value.field == "views"
    with pytest.raises(ViewError, match="nor the name of a view"):
        several_named_views("neither", NAMES, field="views")


def test_selections_that_cannot_be() -> None:
    for wanted in (
        ViewSelection("0,1"),
        ViewSelection("0,1,2,3,4,5"),
        ViewSelection(context=2),
        ViewSelection(context=6),
    ):
        assert checked_selection(wanted) is wanted
    with pytest.raises(ViewCountError, match="7 views, need 2 to 6"):
        checked_selection(ViewSelection("0,1,2,3,4,5,6"))
    for count, said in ((0, "0 views"), (1, "1 view"), (7, "7 views")):
        with pytest.raises(ViewCountError, match=f"{said}, need 2 to 6"):
            checked_selection(ViewSelection(context=count))
    with pytest.raises(ViewCountError, match="100001 views, need 2 to 6"):
        checked_selection(ViewSelection("," * 100_000))
    with pytest.raises(InputError, match="is given beside select"):
        checked_selection(ViewSelection("0,1", 2))


def test_a_view_is_compared_at_its_own_depth() -> None:
    """Of three views that look one way, the middle one sees what is near, where only the view beside it sees the same;
    at the depth of the others all three share nearly all."""
    cameras = around([0.0, 0.0, 0.0])
    for camera, across in zip(cameras, (0.0, 1.0, 10.0), strict=True):
        camera.world_from_cam[0, 3] = across
    assert chosen_views(cameras, 2, [5.0, 5.0, 5.0]).places == (0, 1)
    assert chosen_views(cameras, 2, [100.0, 100.0, 100.0]).places == (0, 2)
    assert chosen_views(cameras, 2, [100.0, None, 100.0]).places == (0, 2)
    assert chosen_views(cameras, 2, [5.0, 5.0, 100.0]).places == (0, 1)


def test_depths_of_views_are_the_users_else_their_own_else_the_files() -> None:
    cameras = around([0.0, 10.0, 20.0])
    bounds = [(2.0, 6.0), None, (1.0, 3.0)]
    views = tuple(NamedView(None, camera, bounds=each) for camera, each in zip(cameras, bounds, strict=True))
    file = CameraFile(views, 1.0, None)
    assert file.middles(None, None) == pytest.approx([3.0, None, 1.5])
    assert file.middles(4.0, 12.0) == pytest.approx([6.0] * 3)
    assert file.middles(None, 3.0) == pytest.approx([1.5] * 3)
    assert file.middles(4.0, None) == [None] * 3
    for near, far in ((6.0, 2.0), (0.0, 2.0), (-1.0, 2.0)):  # refused later
        assert np.isnan(file.middles(near, far)).all()


def test_views_without_bounds_take_no_range_from_others() -> None:
    """Among views with bounds, one without is compared at the median of theirs; if none of the chosen has bounds,
    their range is estimated."""
    cameras = around([0.0, 10.0, 20.0, 30.0])
    bounds = [(2.0, 6.0), None, None, (1.0, 3.0)]
    file = CameraFile.bounded(
        [NamedView(None, camera, bounds=each) for camera, each in zip(cameras, bounds, strict=True)]
    )
    assert (file.near, file.far) == (1.0, 6.0)
    assert file.middles(None, None) == [pytest.approx(3.0), None, None, pytest.approx(1.5)]
    chosen = [file.chosen(places) for places in ([1, 2], [0, 1], [3, 0])]
    assert [(each.near, each.far) for each in chosen] == [(None, None), (2.0, 6.0), (1.0, 6.0)]
    whole = CameraFile(tuple(NamedView(None, camera) for camera in cameras), 2.0, 6.0)
    assert whole.middles(None, None) == pytest.approx([3.0] * 4)
    assert (whole.chosen([1, 2]).near, whole.chosen([1, 2]).far) == (2.0, 6.0)
