"""Camera paths by their axioms: closed, through the inputs, uniform, smooth, and covariant with the world."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from camera_sets import PIVOT, UP, arc, camera, moves_with_the_world
from hypothesis import given
from hypothesis import strategies as st

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.rotations import about_axis, rotation_angle, rotation_vector, slerp
from gapmes.service.errors import ViewError
from gapmes.service.viewpoints.camera_path import (
    LEAST_SWING,
    MOST_SWING,
    PATHS,
    camera_path,
    loop,
    seen_swing,
)
from gapmes.service.viewpoints.input_path import TURN_SHARE, InputPath, distance
from gapmes.service.viewpoints.views import between, mean_camera


def scattered(seed: int, count: int = 4) -> list[Camera]:
    """Cameras about 1 apart that look about the same way, none of them level."""
    rng = np.random.default_rng(seed)
    turns = [rng.normal(0, 0.25, 3) for _ in range(count)]
    rotations = [about_axis(turn / np.linalg.norm(turn), float(np.linalg.norm(turn))) for turn in turns]
    return [camera(rotation, rng.normal(0, 1, 3), 60 + 5 * i) for i, rotation in enumerate(rotations)]


def steps(cameras: list[Camera]) -> np.ndarray:
    """Distances between neighbours, the last and the first included."""
    return np.array([distance(a, b, PIVOT) for a, b in zip(cameras, [*cameras[1:], cameras[0]], strict=True)])


@pytest.mark.parametrize("name", PATHS)
@pytest.mark.parametrize("frames", [2, 7, 48])
def test_a_loop_is_closed_and_has_no_frame_twice(name, frames):
    path = camera_path(name, scattered(1), pivot_depth=PIVOT)
    shots = loop(path, frames)
    assert len(shots) == frames
    for pose in (path(1.0).world_from_cam, path(1 - 1e-12).world_from_cam):
        np.testing.assert_allclose(pose, shots[0].world_from_cam, atol=1e-9)
    if name == "orbit":  # the others come back the way that they went
        assert steps(shots).min() > 0.5 * steps(shots).max()
    assert steps(shots)[-1] <= steps(shots).max()


@given(seed=st.integers(0, 2**20), time=st.floats(0, 1), name=st.sampled_from(PATHS))
def test_every_camera_is_one(seed, time, name):
    shot = camera_path(name, scattered(seed), pivot_depth=PIVOT)(time)
    np.testing.assert_allclose(shot.rotation @ shot.rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(shot.rotation) == pytest.approx(1)
    assert (shot.width, shot.height) == (64, 48)
    assert 60 <= shot.fx <= 75  # between the shortest and the longest lens


def meetings(path: InputPath) -> list[float]:
    """The times at which the path reaches each camera on the way there: the first is 0, the last 1/2."""
    ends = np.cumsum([0.0, *(lengths[-1] for lengths in path.arc_lengths)])
    return [time_of(end / ends[-1]) / 2 for end in ends]


def time_of(share: float) -> float:
    """The share of the time after which a `share` of the arc length is behind."""
    e = TURN_SHARE
    if share > 0.5:
        return 1 - time_of(1 - share)
    return float(np.sqrt(2 * e * (1 - e) * share)) if share < e / (2 * (1 - e)) else share * (1 - e) + e / 2


@given(seed=st.integers(0, 2**20), count=st.integers(2, 6))
def test_the_inputs_are_met_there_and_back(seed, count):
    cameras = scattered(seed, count)
    path = InputPath.through(cameras, PIVOT)
    assert (meetings(path)[0], meetings(path)[-1]) == (0, 0.5)
    for time, given_camera in zip(meetings(path), cameras, strict=True):
        for when in (time, 1 - time):
            met = path.at(when)
            np.testing.assert_allclose(met.world_from_cam, given_camera.world_from_cam, atol=1e-9)
            assert met.fx == pytest.approx(given_camera.fx)


@pytest.mark.parametrize("name", PATHS)
def test_pixels_stay_square_where_the_inputs_have_other_shapes(name):
    """What one of them shows is cropped to the shape of the first, whose picture is as it was."""
    cameras = [replace(camera(np.eye(3), [x, 0.0, 0.0]), fy=60.0) for x in (0.0, 1.0)]
    cameras[1] = replace(cameras[1], width=48, height=64)
    path = camera_path(name, cameras, pivot_depth=PIVOT)
    for time in np.linspace(0, 1, 9):
        assert path(time).fx == pytest.approx(path(time).fy, rel=1e-14)
        assert (path(time).width, path(time).height) == (64, 48)
    if name == "inputs":
        assert (path(0.0).fx, path(0.5).fx) == (60, pytest.approx(80))


@pytest.mark.parametrize("seed", range(12))
def test_speed_is_even_and_bounded(seed):
    """Between the turns within 5 % of constant (worst over 200 seeds: 1.9 %, where the way bends sharply)."""
    path = InputPath.through(scattered(seed), PIVOT)
    top = 2 * sum(way[-1] for way in path.arc_lengths) / (1 - TURN_SHARE)
    h = 1e-5
    for begin in (0.0, 0.5):  # there, and back
        for time in begin + np.linspace(TURN_SHARE / 2, 0.5 - TURN_SHARE / 2 - h, 40):
            assert distance(path.at(time), path.at(time + h), PIVOT) / h == pytest.approx(top, rel=0.05)
        stop = distance(path.at(begin), path.at(begin + h), PIVOT) / h
        assert stop < 0.01 * top  # it stands where it turns
    frames = 100
    assert steps(loop(path.at, frames)).max() <= 1.02 * top / frames  # 1.010 at worst: no frame jumps


@pytest.mark.parametrize("seed", range(5))
def test_no_kink_in_place_or_direction(seed):
    """Velocities just before and just after an input differ by what the curve bends in between, which goes with h."""
    path = InputPath.through(scattered(seed), PIVOT)

    def kink(h: float) -> float:
        worst = 0.0
        for time in meetings(path)[1:-1]:
            before, at, after = path.at(time - h), path.at(time), path.at(time + h)
            speeds = [(at.center - before.center) / h, (after.center - at.center) / h]
            turns = [
                at.rotation @ rotation_vector(a.rotation.T @ b.rotation) / h for a, b in ((before, at), (at, after))
            ]
            for first, last in (speeds, turns):
                unit = np.linalg.norm(first), np.linalg.norm(last)
                worst = max(worst, float(np.linalg.norm(first / unit[0] - last / unit[1])))
        return worst

    assert kink(1e-5) < 0.01  # a polyline through the same cameras turns by 0.5 and more, whatever h


@pytest.mark.parametrize("seed", range(3))
def test_the_check_for_kinks_finds_one(seed):
    cameras = scattered(seed)
    straight = [b.center - a.center for a, b in pairwise(cameras)]
    units = [step / np.linalg.norm(step) for step in straight]
    assert max(np.linalg.norm(a - b) for a, b in pairwise(units)) > 0.5


def test_a_way_back_turns_on_the_spot():
    """To one camera and back: the same places on both sides of it, at the speed of everywhere else."""
    start, end = scattered(3, 2)
    path = InputPath.through([start, end, start], PIVOT)
    [time] = meetings(path)[1:-1]
    for step in (1e-4, 1e-3):
        before, at, after = path.at(time - step), path.at(time), path.at(time + step)
        np.testing.assert_allclose(before.world_from_cam, after.world_from_cam, atol=1e-9)
        np.testing.assert_allclose(at.world_from_cam, end.world_from_cam, atol=1e-12)
        elsewhere = distance(path.at(0.15), path.at(0.15 + step), PIVOT)
        assert distance(before, at, PIVOT) == pytest.approx(elsewhere, rel=0.02)


def test_two_cameras_are_a_line_and_a_slerp():
    start, end = scattered(3, 2)
    path = InputPath.through([start, end], PIVOT)
    for time in (0.1, 0.2, 0.25, 0.4):
        shot = path.at(time)
        share = np.linalg.norm(shot.center - start.center) / np.linalg.norm(end.center - start.center)
        expected = between(start, end, float(share))
        np.testing.assert_allclose(shot.world_from_cam, expected.world_from_cam, atol=1e-3)
    np.testing.assert_allclose(path.at(0.25).world_from_cam, between(start, end, 0.5).world_from_cam, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_centres_lie_on_the_centripetal_catmull_rom_spline(seed):
    """Drawn by the pyramid of Barry and Goldman (1988), with knots whose squares are the distances between poses."""
    cameras = scattered(seed)
    path = InputPath.through(cameras, PIVOT)
    steps_between = [np.sqrt(distance(one, other, PIVOT)) for one, other in pairwise(cameras)]
    assert max(steps_between) > 1.05 * min(steps_between)
    knots, places = np.concatenate([[0.0], np.cumsum(steps_between)]), [one.center for one in cameras]
    for u in (0.1, 0.5, 0.7):
        at = knots[1] + u * (knots[2] - knots[1])
        level = places
        for width in (1, 2):
            level = [
                ((knots[i + width] - at) * level[i] + (at - knots[i]) * level[i + 1]) / (knots[i + width] - knots[i])
                for i in range(len(level) - 1)
            ]
        expected = ((knots[2] - at) * level[0] + (at - knots[1]) * level[1]) / (knots[2] - knots[1])
        np.testing.assert_allclose(path.pieces[1].camera(u).center, expected, atol=1e-12)


def test_cameras_that_turn_evenly_are_a_slerp():
    cameras = arc(40)
    path = InputPath.through(cameras, PIVOT)
    for index, piece in enumerate(path.pieces):
        for u in (0.25, 0.5, 0.8):
            expected = slerp(cameras[index].rotation, cameras[index + 1].rotation, u)
            np.testing.assert_allclose(piece.camera(u).rotation, expected, atol=1e-12)


@given(seed=st.integers(0, 2**20), scale=st.sampled_from([1e-3, 1.0, 1e3]), name=st.sampled_from(PATHS))
def test_paths_move_with_the_world(seed, scale, name):
    moves_with_the_world(scattered(seed), scale, name)


@pytest.mark.parametrize("name", ["turntable", "orbit"])
def test_what_is_looked_at_stays_in_its_place_and_distance(name):
    cameras = scattered(2)
    middle = mean_camera(cameras, PIVOT)
    pivot = middle.center + PIVOT * middle.rotation[:, 2]
    for shot in loop(camera_path(name, cameras, pivot_depth=PIVOT), 12):
        pixels, z = shot.project(pivot[None])
        np.testing.assert_allclose(pixels, [[middle.cx, middle.cy]], atol=1e-9)
        assert z[0] == pytest.approx(PIVOT)


def test_a_turntable_goes_as_far_as_it_is_told_to_both_sides_and_an_orbit_round():
    cameras = arc(10)
    shots = loop(camera_path("turntable", cameras, pivot_depth=PIVOT, swing=30), 8)
    middle = mean_camera(cameras, PIVOT)
    angles = [math.degrees(rotation_angle(middle.rotation.T @ shot.rotation)) for shot in shots]
    np.testing.assert_allclose(angles, [0, 21.2132, 30, 21.2132, 0, 21.2132, 30, 21.2132], atol=1e-4)
    assert (shots[2].center - middle.center) @ middle.rotation[:, 0] > 0  # to the right first
    assert (shots[6].center - middle.center) @ middle.rotation[:, 0] < 0
    behind = loop(camera_path("orbit", cameras, pivot_depth=PIVOT), 4)[2]
    np.testing.assert_allclose(behind.rotation[:, 2], -middle.rotation[:, 2], atol=1e-9)


@pytest.mark.parametrize("swing", [1e-3, 0.5, 180.0])
def test_a_swing_may_be_as_small_as_any_and_half_a_turn(swing):
    cameras = arc(10)
    shot, middle = camera_path("turntable", cameras, pivot_depth=PIVOT, swing=swing)(0.25), mean_camera(cameras, PIVOT)
    assert math.degrees(rotation_angle(middle.rotation.T @ shot.rotation)) == pytest.approx(swing)


@pytest.mark.parametrize("degrees", [12.0, 30.0, 80.0])
def test_the_swing_is_what_the_inputs_span(degrees):
    cameras = arc(degrees)
    assert seen_swing(cameras, PIVOT) == pytest.approx(degrees)
    leaning = [camera(c.rotation @ about_axis(np.array([1.0, 0, 0]), 0.5), c.center) for c in cameras]
    assert seen_swing(leaning, PIVOT) < degrees  # heights do not count


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_farthest_input_on_either_side_counts(side):
    """Seen from their common pivot; the mean of three equal directions and one at 40 degrees lies at about 10."""
    cameras = [camera(c.rotation, c.center) for a in (0.0, 0.0, 0.0, 40.0 * side) for c in arc(a, 2)[1:]]
    assert 29 < seen_swing(cameras, PIVOT) < 31


def test_an_input_behind_the_pivot_swings_as_far_as_any():
    """From 150 degrees round; the mean of it and of three in front stands at 13."""
    assert seen_swing([*arc(0.0, 1) * 3, arc(150.0, 2)[1]], PIVOT) == MOST_SWING


def test_a_swing_has_bounds():
    assert seen_swing(arc(0.5), PIVOT) == LEAST_SWING
    assert seen_swing(arc(0.0, 1), PIVOT) == LEAST_SWING
    around = [camera(about_axis(UP, a), -5 * about_axis(UP, a)[:, 2]) for a in (0.0, 0.1, -0.1, 3.0)]
    assert LEAST_SWING <= seen_swing(around, 1.0) <= MOST_SWING


def test_cameras_at_one_place_are_passed_once():
    cameras = scattered(4, 3)
    doubled = [cameras[0], cameras[0], cameras[1], cameras[2], replace(cameras[2], fx=61.0)]
    assert len(InputPath.through(doubled, PIVOT).pieces) == 2
    turned = camera(cameras[0].rotation @ about_axis(UP, 0.3), cameras[0].center)  # the same place, another direction
    assert len(InputPath.through([cameras[0], turned], PIVOT).pieces) == 1


@pytest.mark.parametrize(
    ("name", "count", "options", "words"),
    [
        ("inputs", 1, {}, "1 place of a camera is no path, need 2"),
        ("spiral", 3, {}, "'spiral' is no path"),
        ("orbit", 3, {"swing": 10}, "goes with the path turntable"),
        ("turntable", 3, {"swing": 0}, "is 0 degrees"),
        ("turntable", 3, {"swing": 181}, "is 181 degrees"),
        ("turntable", 3, {"swing": math.nan}, "is nan degrees"),
    ],
)
def test_what_is_no_path_is_refused(name, count, options, words):
    with pytest.raises(ViewError, match=words):
        camera_path(name, scattered(0, count), pivot_depth=PIVOT, **options)
