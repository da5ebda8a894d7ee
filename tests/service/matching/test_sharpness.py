"""A photograph with less fine detail than another of the same surfaces is reported, and no other is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sample_matches import sample
from sample_photographs import FAR, NEAR, sample_cameras, sample_pixels
from wrong_cameras import turned

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.depth_range import DepthRange
from gapmes.service.matching.inexact_poses import doubted
from gapmes.service.matching.pair_matches import PairMatches
from gapmes.service.matching.sharpness import less_sharp, views_less_sharp
from gapmes.service.photographs.images import FittedView
from gapmes.service.reconstruct import Reconstructor

Picture = np.ndarray
RNG = np.random.default_rng(5)


def blurred(image: Picture, px: float) -> Picture:
    """(3, H, W) blurred by a Gaussian of that many px, periodically."""
    down, right = (np.fft.fftfreq(size) for size in image.shape[1:])
    response = np.exp(-2 * (np.pi * px) ** 2 * (down[:, None] ** 2 + right**2))
    return np.fft.ifft2(np.fft.fft2(image) * response).real.clip(0, 1)


def vignetted(image: Picture) -> Picture:
    down, right = (np.linspace(-0.5, 0.5, size) for size in image.shape[1:])
    return image * (1 - 1.2 * (down[:, None] ** 2 + right**2))


def with_one(pairs: PairMatches, which: int, change: Callable[[Picture], Picture]) -> PairMatches:
    views = list(pairs.views)
    views[which] = replace(views[which], image=change(views[which].image).astype(np.float32))
    return PairMatches(views, pairs.depths)


@pytest.mark.parametrize("which", [(1, 3), (0, 4), (2, 7), (0, 3, 6), (0, 2, 4, 6)])
def test_photographs_as_they_are_are_alike(which: Sequence[int]) -> None:
    assert less_sharp(sample(which), which) == []


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize(("px", "most"), [(0.7, 0.66), (1.0, 0.53), (2.0, 0.42)])
def test_one_that_is_blurred_is_named_with_what_is_left_of_its_detail(which: int, px: float, most: float) -> None:
    (notice,) = less_sharp(with_one(sample((1, 3)), which, lambda image: blurred(image, px)), (4, 9))
    assert (notice["code"], notice["field"], notice["index"]) == ("view_less_sharp", "images", (4, 9)[which])
    assert most - 0.16 < notice["detail"] < most
    assert (
        f"view {(4, 9)[which]} has {notice['detail']:.0%} of the fine detail of view {(9, 4)[which]}"
        in notice["message"]
    )


def test_so_is_one_that_was_enlarged() -> None:
    def enlarged(image: Picture) -> Picture:
        return image[:, ::4, ::4].repeat(4, 1).repeat(4, 2)

    smooth = with_one(sample((1, 3)), 1, lambda image: blurred(enlarged(blurred(image, 1.5)), 1.5))
    assert [notice["index"] for notice in less_sharp(smooth, (0, 1))] == [1]


@pytest.mark.parametrize(
    "change",
    [
        lambda image: image * 0.5,
        lambda image: (image * 1.5).clip(0, 1),
        lambda image: image**1.6,
        lambda image: image**0.6,
        lambda image: 0.1 + 0.8 * image,
        vignetted,
        lambda image: (image + RNG.normal(0, 10 / 255, image.shape)).clip(0, 1),
        lambda image: blurred(image, 0.4),
    ],
    ids=["darker", "overexposed", "gamma 1.6", "gamma 0.6", "flat", "vignette", "noise", "hardly blurred"],
)
@pytest.mark.parametrize("which", [0, 1])
def test_what_is_no_blur_is_not_told(which: int, change: Callable[[Picture], Picture]) -> None:
    assert less_sharp(with_one(sample((1, 3)), which, change), (0, 1)) == []


def test_photographs_that_are_blurred_alike_are_not_told() -> None:
    both = with_one(with_one(sample((1, 3)), 0, lambda image: blurred(image, 1)), 1, lambda image: blurred(image, 1))
    assert less_sharp(both, (0, 1)) == []


def test_of_several_each_is_told_once_beside_the_sharpest() -> None:
    pairs = sample((0, 2, 4, 6))
    for which, px in ((1, 2.0), (2, 0.9)):
        pairs = with_one(pairs, which, lambda image, px=px: blurred(image, px))
    notices = less_sharp(pairs, (10, 12, 14, 16))
    assert [notice["index"] for notice in notices] == [12, 14]
    assert "of view 10" in notices[0]["message"]  # not of 14, which is blurred itself
    assert "of view 16" in notices[1]["message"]


def test_what_masks_leave_out_has_no_say() -> None:
    def mostly_blurred(image: Picture) -> Picture:
        image = image.copy()
        image[:, :, :210] = blurred(image, 2)[:, :, :210]
        return image

    pairs = with_one(sample((1, 3)), 1, mostly_blurred)
    assert less_sharp(pairs, (0, 1)) != []
    mask = np.ones(pairs.views[1].image.shape[1:], np.bool_)
    mask[:, :210] = False
    masked: list[FittedView] = [pairs.views[0], replace(pairs.views[1], mask=mask)]
    assert less_sharp(PairMatches(masked, pairs.depths), (0, 1)) == []


def test_noise_is_that_of_the_surfaces_that_are_compared() -> None:
    """What is calm in one photograph alone, masked or out of sight in the other, takes no detail from either."""
    height, width, shift, focal, depth = 256, 256, 32, 256.0, 4.0
    waves = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width + shift))
    spectrum = np.where(waves > 0, np.maximum(waves, 1e-9) ** -1.45, 0)
    texture = np.fft.ifft2(np.fft.fft2(np.random.default_rng(4).normal(size=waves.shape)) * spectrum).real
    wall = np.full(waves.shape, 0.6)  # fronto-parallel, so that one view is the other, shifted
    wall[50:206, 70:220] = (0.5 + 0.15 * texture / texture.std()).clip(0, 1)[50:206, 70:220]
    views = []
    for left in (0, shift):
        pose = np.eye(4)
        pose[0, 3] = left * depth / focal
        image = np.repeat(wall[None, :, left : left + width], 3, axis=0).astype(np.float32)
        camera = Camera.make(width, height, focal, focal, width / 2, height / 2, pose)
        views.append(FittedView(image, None, camera, 1.0))
    mask = np.zeros((height, width), np.bool_)
    mask[54:202, 74 - shift : 216 - shift] = True
    for seen in (views, [views[0], replace(views[1], mask=mask)]):
        assert less_sharp(PairMatches(seen, DepthRange(2.0, 8.0, "given")), (0, 1)) == []


def test_where_there_is_nothing_to_compare_nothing_is_told() -> None:
    grey = with_one(sample((1, 3)), 0, lambda image: np.full_like(image, 0.5))
    assert less_sharp(grey, (0, 1)) == []


def test_a_reconstruction_tells_of_it(engine: Any) -> None:
    pixels = [sample_pixels(view) for view in (1, 5)]
    cameras = sample_cameras((1, 5))
    sharp = Reconstructor(engine).reconstruct(pixels, cameras, near=NEAR, far=FAR, fade=0)
    pixels[1] = np.rint(255 * blurred(pixels[1].transpose(2, 0, 1) / 255, 6)).astype(np.uint8).transpose(1, 2, 0)
    dull = Reconstructor(engine).reconstruct(pixels, cameras, near=NEAR, far=FAR, fade=0)
    codes = [[notice["code"] for notice in scene.document["warnings"]] for scene in (sharp, dull)]
    assert ["view_less_sharp" in each for each in codes] == [False, True]


@pytest.mark.parametrize("px", [6.0, 8.0, 12.0])
@pytest.mark.parametrize("which", [0, 1])
def test_blur_that_leaves_no_detail_at_all_is_told_and_is_no_wrong_pose(which: int, px: float) -> None:
    """Matches of a blurred photograph stand beside their lines by more than a pixel, which no turn explains."""
    pairs = with_one(sample((1, 3)), which, lambda image: blurred(image, px))
    (notice,) = less_sharp(pairs, (0, 1))
    assert notice["index"] == which
    assert notice["detail"] < 0.6
    assert doubted(pairs, {which}) == []


def test_a_wrong_pose_beside_blur_is_told_where_a_turn_explains_it() -> None:
    pairs = turned(with_one(sample((1, 3)), 1, lambda image: blurred(image, 2.0)), 1, (1.0, 0.0, 0.0), 0.7)
    assert views_less_sharp(pairs).keys() == {1}
    assert [residual.pair for residual in doubted(pairs, {1})] == [(0, 1)]
