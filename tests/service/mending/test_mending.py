"""The steps after the network: which pixel each Gaussian belongs to, what replaces what, and what may fade."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from plane_views import SIDE, floaters, on_the_plane, plane_depths, plane_views

from gapmes.service.cameras.depth_range import DepthRange
from gapmes.service.cameras.world_frame import WorldFrame
from gapmes.service.gaussians import Gaussians, joined
from gapmes.service.kernels import warm_up
from gapmes.service.matching.confirmed import confirmed
from gapmes.service.matching.reprojection_kernels import reproject_pixels, sample_bilinear
from gapmes.service.mending import after_network as mending
from gapmes.service.mending.after_network import (
    SMOOTHING,
    Placed,
    at_finer_depths,
    at_mended_depths,
    matched_depths,
    mended,
    placed,
)
from gapmes.service.mending.anchors import anchors
from gapmes.service.mending.backdrop import OPACITY, backdrop
from gapmes.service.mending.choice.kernels import choose_rows
from gapmes.service.mending.choice.network import shipped_choice
from gapmes.service.mending.fading import BEHIND_KEEPS
from gapmes.service.photographs.images import FittedView
from gapmes.service.photographs.masks import MASKED, REPLACED, TRANSPARENT
from gapmes.service.viewpoints.scene_views import SceneViews

PIXELS = 3 * SIDE**2
NEAR, FAR = 2.0, 8.0


@pytest.fixture(scope="module")
def cameras(views: list[FittedView]) -> SceneViews:
    return SceneViews(tuple(view.camera for view in views), NEAR, FAR)


@pytest.fixture(scope="module")
def frame(views: list[FittedView]) -> WorldFrame:
    return WorldFrame.of([view.camera for view in views], DepthRange(NEAR, FAR, "given"))


def outputs(views: list[FittedView], frame: WorldFrame) -> dict[str, np.ndarray]:
    """A network's whose depths are right; 5 Gaussians stand behind the scene."""
    world = joined(*(on_the_plane(view) for view in views), floaters(5))
    return {
        "means": ((world.means - frame.origin) @ frame.rotation / frame.unit).astype(np.float32),
        "scales": world.scales / np.float32(frame.unit),
        "rotations_wxyz": world.rotations_wxyz,
        "opacities": world.opacities.copy(),
        "harmonics": world.harmonics,
        "depth": (plane_depths(views) / frame.unit).astype(np.float32),
    }


def test_where_nothing_moved_the_networks_own_stand(views: list[FittedView], frame: WorldFrame) -> None:
    found = placed(outputs(views, frame), frame, views, moved=False)
    assert len(found.gaussians) == PIXELS + 5
    assert (found.rows == np.arange(PIXELS + 5)).all()
    assert (found.around, found.added, found.dropped) == (PIXELS + 5, 0, {})
    assert (found.owner == np.repeat([0, 1, 2, 3], [SIDE**2] * 3 + [5])).all()


def test_the_backdrop_takes_the_place_of_the_networks(views: list[FittedView], frame: WorldFrame) -> None:
    given = outputs(views, frame)
    given["opacities"][[3, 7]] = 0
    found = placed(given, frame, views, moved=True)
    sheet, around = backdrop(views, found.depths, 1)
    assert (found.added, found.around) == (len(sheet), PIXELS + around)
    assert found.dropped == {TRANSPARENT: 2, REPLACED: 5}
    assert len(found.gaussians) == PIXELS - 2 + len(sheet)
    assert (found.gaussians.means[-len(sheet) :] == sheet.means.astype(np.float32)).all()  # as a .ply holds them
    assert (found.of_pixel == (np.arange(len(found.rows)) < PIXELS - 2)).all()
    assert set(found.rows[:8]) == {0, 1, 2, 4, 5, 6, 8, 9}


def test_a_stride_and_a_mask_leave_the_backdrop(views: list[FittedView], frame: WorldFrame) -> None:
    thin = placed(outputs(views, frame), frame, views, stride=4, moved=True)
    assert thin.of_pixel.sum() == PIXELS // 16
    left = np.arange(SIDE)[None] < np.full((SIDE, 1), SIDE // 2)
    masked = [replace(views[0], mask=left), *views[1:]]
    found = placed(outputs(views, frame), frame, masked, moved=True)
    assert found.dropped[MASKED] == SIDE**2 // 2
    assert (found.owner == 0).sum() == SIDE**2 // 2
    assert found.added == len(backdrop(masked, found.depths, 1)[0]) < thin.added


def test_what_stands_behind_keeps_more_than_half_and_what_stands_around_may_go(
    views: list[FittedView], frame: WorldFrame, cameras: SceneViews
) -> None:
    """Without the pixels' own Gaussians and in a wrong colour, all of it contradicts the photographs."""
    whole = placed(outputs(views, frame), frame, views, moved=True)
    behind = ~whole.of_pixel
    wrong = whole.gaussians[behind]
    wrong.harmonics[:] = 5.0
    alone = Placed(wrong, whole.rows[behind], whole.around, whole.depths, {}, whole.added)
    found = mended(alone, views, cameras, 8, 1).gaussians.opacities
    sheet = alone.rows < alone.around
    assert found[sheet].min() == pytest.approx(BEHIND_KEEPS * OPACITY)
    assert found[~sheet].min() < 0.1


def test_what_is_confirmed_anchors_the_rest(
    views: list[FittedView], frame: WorldFrame, cameras: SceneViews, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = outputs(views, frame)
    given["depth"][0, 24:40, 24:40] *= 1.2
    given["opacities"][[3, 7]] = 0
    found, heard = placed(given, frame, views, moved=True), []

    def listening(gaussians: Gaussians, sure: np.ndarray, may_fade: np.ndarray, *rest: object, **options: Any) -> Any:
        heard.append((sure, may_fade))
        return anchors(gaussians, sure, may_fade, *rest, **options)

    monkeypatch.setattr("gapmes.service.mending.after_network.anchors", listening)
    mended(found, views, cameras, 1, 1)
    ((sure, may_fade),) = heard
    expected = np.delete(confirmed(views, found.depths).ravel(), [3, 7])
    assert 0.3 < expected.mean() < 0.95
    assert (sure[: len(expected)] == expected).all()
    assert not sure[len(expected) :].any()
    assert (may_fade == (found.of_pixel & ~sure)).all()


def test_of_four_views_nothing_is_an_anchor(
    views: list[FittedView], frame: WorldFrame, monkeypatch: pytest.MonkeyPatch
) -> None:
    four, heard = [*views, replace(views[1])], []
    given = joined(*(on_the_plane(view) for view in four))
    depths = np.concatenate([plane_depths(views), plane_depths(views)[1:2]])
    found = Placed(given, np.arange(len(given)), len(given), depths, {}, 0)
    monkeypatch.setattr(
        "gapmes.service.mending.after_network.anchors", lambda _, sure, *rest, **options: heard.append(sure)
    )
    mended(found, four, SceneViews(tuple(view.camera for view in four), NEAR, FAR), 1, 1)
    assert [sure.any() for sure in heard] == [False]
    assert confirmed(four, depths).any()


def test_without_a_pass_nothing_changes(views: list[FittedView], frame: WorldFrame, cameras: SceneViews) -> None:
    found = placed(outputs(views, frame), frame, views, moved=False)
    after = mended(found, views, cameras, 0, 1)
    assert after.gaussians is found.gaussians
    assert after.halved == 0


@pytest.mark.parametrize(
    ("count", "steps"),
    [
        (2, ["continued", "refined", "searched", "refined", "continued_finely", "chosen", "blank_moved"]),
        (3, ["refined", "searched", "refined", "continued", "blank_moved"]),
        (4, ["refined", "searched", "refined", "blank_moved"]),
    ],
)
def test_which_steps_depths_take(count: int, steps: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    views = [*plane_views(), plane_views()[0]][:count]
    frame = WorldFrame.of([view.camera for view in views], DepthRange(NEAR, FAR, "given"))
    taken: list[str] = []

    def recorded(name: str) -> None:
        def step(_: object, depths: np.ndarray, *others: object) -> np.ndarray:
            taken.append(name)
            assert name != "blank_moved" or others == (FAR,)
            return depths * 1.01

        monkeypatch.setattr(mending, name, step)

    for name in ("continued", "refined", "searched", "continued_finely", "chosen", "blank_moved"):
        recorded(name)
    before = outputs(views, frame)
    after = at_mended_depths(before, frame, views, FAR, 1)
    assert taken == steps
    assert frame.depths(after) == pytest.approx(frame.depths(before) * 1.01 ** len(steps), rel=1e-6)
    taken.clear()
    at_finer_depths(before, frame, views, FAR)
    assert taken == (["continued", "refined"] if count == 2 else ["refined"])


def test_a_finer_grid_leaves_a_blank_backdrop_at_the_far_end(monkeypatch: pytest.MonkeyPatch) -> None:
    views = plane_views()[:2]
    frame = WorldFrame.of([view.camera for view in views], DepthRange(NEAR, FAR, "given"))
    left = np.s_[:, :, : SIDE // 4]
    black = []
    for view in views:
        image = np.maximum(view.image, np.float32(0.3))
        image[left] = 0
        black.append(replace(view, image=image))
    depths = plane_depths(views)
    depths[left] = FAR
    given = frame.at_depths(outputs(views, frame), [view.camera for view in views], depths)
    monkeypatch.setattr(mending, "refined", lambda _, found: 0.9 * found)
    after = frame.depths(at_finer_depths(given, frame, black, FAR))
    assert after[left] == pytest.approx(FAR, rel=1e-6)
    assert (after[:, :, SIDE // 4 :] < 0.95 * FAR).all()


def test_the_choice_is_between_what_is_found_the_networks_own_and_that_before_planes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In the order in which its weights were trained."""
    views = plane_views()[:2]
    frame = WorldFrame.of([view.camera for view in views], DepthRange(NEAR, FAR, "given"))
    heard: list[tuple[np.ndarray, ...]] = []

    def listening(_: object, depths: np.ndarray, others: tuple[np.ndarray, ...], network: object) -> np.ndarray:
        heard.append((depths, *others))
        assert network is shipped_choice()
        return depths

    monkeypatch.setattr(mending, "chosen", listening)
    given = outputs(views, frame)
    given["depth"] *= 1.07
    at_mended_depths(given, frame, views, FAR, 1)
    matched, planed = matched_depths(views, frame.depths(given), 1)
    assert not (matched == planed).all()
    ((first, second, third),) = heard
    assert (first == planed).all()
    assert (second == frame.depths(given)).all()
    assert (third == matched).all()


def test_nothing_is_compiled_while_depths_are_mended(frame: WorldFrame) -> None:
    warm_up()
    views = plane_views()[:2]
    at_mended_depths(outputs(views, frame), frame, views, FAR, 1)
    loops = (
        (reproject_pixels, 1),
        (sample_bilinear, 2),
        (choose_rows, 1),
    )  # float32 pictures, float64 depths
    assert [len(loop.signatures) for loop, _ in loops] == [count for _, count in loops]


@pytest.mark.parametrize("count", [2, 3])
def test_wrong_depths_move_towards_the_truth(count: int) -> None:
    """All off by half a pixel of parallax; a patch that is a fifth too far comes back as well."""
    views = plane_views()[:count]
    cameras, truth = [view.camera for view in views], plane_depths(views)
    frame = WorldFrame.of(cameras, DepthRange(NEAR, FAR, "given"))
    wrong = truth * 1.04
    wrong[0, 24:40, 24:40] *= 1.2
    before = frame.at_depths(outputs(views, frame), cameras, wrong)
    after = at_mended_depths(before, frame, views, FAR)
    errors = [np.median(np.abs(frame.depths(one) / truth - 1)) for one in (before, after)]
    assert errors[1] < 0.05 * errors[0]  # found: 0.024 and 0.023
    patch = np.median(np.abs(frame.depths(after) / truth - 1)[0, 24:40, 24:40])
    assert patch < 0.005  # found: 0.0006
    points = frame.origin + after["means"][: truth.size].astype(np.float64) @ frame.rotation.T * frame.unit
    z = np.concatenate([c.project(p)[1] for c, p in zip(cameras, points.reshape(count, -1, 3), strict=True)])
    assert z == pytest.approx(frame.depths(after).ravel(), rel=1e-5)


@pytest.mark.parametrize("stride", [1, 2])
def test_gaussians_of_pixels_are_wider_by_a_share_of_their_pixel(
    stride: int, views: list[FittedView], frame: WorldFrame
) -> None:
    given = outputs(views, frame)
    given["opacities"][[3, 7]] = 0
    before = placed(given, frame, views, stride=stride, moved=False)
    after = placed(given, frame, views, stride=stride, moved=True)
    count = int(before.of_pixel.sum())
    assert (before.rows[:count] == after.rows[:count]).all()
    focal = np.repeat([np.sqrt(view.camera.fx * view.camera.fy) for view in views], SIDE**2)[before.rows[:count]]
    pixel = stride * before.depths.ravel()[before.rows[:count]] / focal
    grown = np.sqrt(before.gaussians.scales[:count] ** 2 + SMOOTHING * pixel[:, None] ** 2)
    assert after.gaussians.scales[:count] == pytest.approx(grown, rel=1e-6)
    assert (after.gaussians.means[:count] == before.gaussians.means[:count]).all()
