"""The report of what was left out: where drawing begins, faint Gaussians beside pruned ones, and times of both sets."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from clouds import cloud, view

from gapmes.service.errors import ViewError
from gapmes.service.gaussians import Gaussians, joined
from gapmes.service.leaving_out import left_out
from gapmes.service.leaving_out.budget import Budget
from gapmes.service.leaving_out.certified import certified_views
from gapmes.service.leaving_out.left_out import leave_out
from gapmes.service.splat import Render, render
from gapmes.service.viewpoints.scene_views import SceneViews

CAMERAS = [view(-0.1), view(0.1)]


def white(means: Any, size: float, opacity: Any) -> Gaussians:
    count = len(means)
    turned, opacities = np.tile([1.0, 0, 0, 0], (count, 1)), np.broadcast_to(opacity, count)
    return Gaussians.make(means, np.full((count, 3), size), turned, opacities, np.full((count, 1, 3), 1.7))


def change(one: Gaussians, other: Gaussians) -> float:
    return max(float(np.abs(render(one, c, threads=1).rgb - render(other, c, threads=1).rgb).max()) for c in CAMERAS)


@pytest.mark.parametrize("max_error", [None, 0.0, 0.1])
def test_pictures_begin_where_those_of_the_scene_do(max_error: float | None) -> None:
    """What floats between the default plane and a tenth of near is in no picture of a scene."""
    at = CAMERAS[0].center + 0.05 * CAMERAS[0].rotation[:, 2]
    scene = joined(cloud(100, 4), white([at], 0.01, 0.9))
    lean, pictures, _ = leave_out(scene, np.zeros(101, bool), SceneViews(CAMERAS, 1.0, 10.0), Budget(max_error), 1)
    assert np.abs(render(lean, CAMERAS[0], threads=1).rgb - pictures[0].rgb).max() > 0.1
    for camera, picture in zip(CAMERAS, pictures, strict=True):
        np.testing.assert_array_equal(picture.rgb, render(lean, camera, near=0.1, threads=1).rgb)


def test_what_faint_ones_change_between_the_inputs_is_in_their_bound() -> None:
    """A wall hidden from both inputs by a screen each, seen from half way between them."""
    wall, inputs = np.array([0.0, 0.0, 6.0]), [view(-0.2), view(0.2)]
    screens = [camera.center + 0.35 * (wall - camera.center) for camera in inputs]
    scene = joined(white([wall], 0.03, 0.5), white(np.repeat(screens, 40, axis=0), 0.05, 0.95))
    may_go = np.arange(len(scene)) == 0
    lean, _, report = leave_out(scene, may_go, SceneViews(inputs), Budget(None, min_opacity=0.6), 1)
    middle = certified_views(inputs, 1)[-1]
    seen = float(np.abs(render(scene, middle, threads=1).rgb - render(lean, middle, threads=1).rgb).max())
    assert (report["faint"], seen > 0.1) == (1, True)
    assert seen <= report["faint_bound"]


def test_what_goes_for_either_reason_is_counted_and_measured_together() -> None:
    scene = cloud(300, 4, degree=1)
    lean, _, report = leave_out(scene, np.ones(300, bool), SceneViews(CAMERAS), Budget(0.2, min_opacity=0.3), 1)
    faint = int((scene.opacities < np.float32(0.3)).sum())
    assert faint == report["faint"] < report["dropped"] == 300 - len(lean)
    assert report["kept"] == len(lean)
    assert report["actual"] == change(scene, lean)
    assert report["actual"] > change(scene[scene.opacities >= np.float32(0.3)], lean)


def test_what_may_not_go_stays_also_after_faint_ones_have_gone() -> None:
    """Both others are out of sight; the mask belongs to the set before."""
    scene = white([[0, 0, 4.0], [0, 0, -4.0], [0, 0, -5.0], [0.1, 0, 3.0]], 0.05, [0.1, 0.9, 0.9, 0.9])
    may_go = np.array([True, False, True, True])
    lean, _, report = leave_out(scene, may_go, SceneViews(CAMERAS), Budget(0.0, min_opacity=0.2), 1)
    assert lean.means[:, 2].tolist() == [-4, 3]
    assert (report["faint"], report["unseen"]) == (1, 1)
    assert may_go.tolist() == [True, False, True, True]


def test_the_time_of_a_picture_is_the_least_of_two_of_each_set_without_what_is_done_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene, turns = cloud(300, 4), {300: [4.0, 3.0]}

    def timed(gaussians: Gaussians, *given: Any, outputs: Any, **options: Any) -> Render:
        image = render(gaussians, *given, outputs=outputs, **options)
        if outputs:
            return image
        seconds = turns.setdefault(len(gaussians), [2.0, 5.0]).pop(0)
        return replace(image, stats={**image.stats, "seconds": {"prepare": 100.0, "project": 0.5, "blend": seconds}})

    monkeypatch.setattr(left_out, "render", timed)
    report = leave_out(scene, np.ones(300, bool), SceneViews(CAMERAS), Budget(0.2), 1)[2]
    assert report["dropped"] > 0
    assert report["picture_seconds"] == [3.5, 2.5]  # before, after


def test_a_view_that_is_none_is_refused_by_the_name_of_the_option() -> None:
    with pytest.raises(ViewError, match="out of range") as caught:
        leave_out(cloud(3, 0), np.ones(3, bool), SceneViews(CAMERAS), Budget(asked=("7",)), 1)
    assert caught.value.field == "views"
