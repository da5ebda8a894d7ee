"""Photographs of two scenes are told as such: not silently, nor as another convention of poses or a turn of one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import skimage.data
from PIL import Image
from sample_photographs import sample_views

from gapmes.service.cameras.depth_range import depth_range
from gapmes.service.matching import photo_checks
from gapmes.service.matching.inexact_poses import EpipolarResidual
from gapmes.service.matching.photo_checks import check_photos
from gapmes.service.photographs.images import FittedView


def unrelated(one: str, other: str, pair: tuple[int, int] = (3, 7)) -> list[FittedView]:
    """Two photographs of scikit-image under cameras of the sample."""
    views = []
    for name, view in zip((one, other), sample_views(pair), strict=True):
        whole = getattr(skimage.data, name)()
        side = min(whole.shape[:2])
        top, left = ((length - side) // 2 for length in whole.shape[:2])
        square = Image.fromarray(whole[top : top + side, left : left + side]).resize((256, 256))
        views.append(replace(view, image=np.asarray(square, np.float32).transpose(2, 0, 1) / 255))
    return views


@pytest.mark.parametrize(
    ("one", "other"),
    [("chelsea", "astronaut"), ("chelsea", "coffee"), ("astronaut", "coffee"), ("astronaut", "rocket")],
)
def test_photographs_of_two_scenes_hardly_match(one: str, other: str) -> None:
    """Smooth ones match by up to 0.59, so much is alike somewhere."""
    views = unrelated(one, other)
    (notice,) = check_photos(views, depth_range([view.camera for view in views]))
    assert notice["code"] == "photos_hardly_match"
    assert notice["score"] < 0.6
    assert "do all show one scene" in notice["message"]


@pytest.mark.parametrize(("score", "code"), [(0.6, "photos_hardly_match"), (0.66, "poses_doubtful")])
def test_another_reading_that_hardly_matches_itself_is_no_advice(
    monkeypatch: pytest.MonkeyPatch, score: float, code: str
) -> None:
    views = unrelated("rocket", "astronaut")
    monkeypatch.setattr(photo_checks, "consistency", lambda *_: score)
    (notice,) = check_photos(views, depth_range([view.camera for view in views]))
    assert notice["code"] == code


@pytest.mark.parametrize(("turned", "zoomed", "told"), [(1.63, 1.6, "no turn"), (0.7, 0.69, "turned by 0.29 degrees")])
def test_a_change_that_explains_less_than_half_is_no_cause(turned: float, zoomed: float, told: str) -> None:
    residual = EpipolarResidual((0, 1), 1.5, turned, 0.005, zoomed, 0.01)
    assert told in residual.cause(0, 1)
