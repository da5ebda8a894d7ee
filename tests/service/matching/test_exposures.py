"""Photographs of different exposure: factors are found from matches, and colours scaled to the median."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from plane_scene import PlaneScene

from gapmes.service import Reconstructor
from gapmes.service.cameras.depth_range import DepthRange
from gapmes.service.captures.capture import load_scene_folder
from gapmes.service.matching.exposures import Exposures, equalised
from gapmes.service.matching.exposures import exposures as exposures_of
from gapmes.service.matching.pair_matches import PairMatches
from gapmes.service.photographs.fitting import FittedPhotos
from gapmes.service.photographs.images import FittedView, PackedView, Photo, decode_image, fit_view, match_photo
from gapmes.service.shipped import sample_folder

VIEWS = (1, 3, 5)
GROUPS = (0, 1, 4, 5)  # each view's nearest is of its own pair
EXACT = 0.015  # of a factor: measured 0.004 without clipping, 0.010 with it


@cache
def sample(which: tuple[int, ...] = VIEWS) -> tuple[tuple[Photo, ...], tuple, DepthRange]:
    scene = load_scene_folder(sample_folder())
    photos = tuple(decode_image(scene.image_paths[i].read_bytes(), index=i) for i in which)
    cameras = tuple(scene.file.views[i].camera for i in which)
    return photos, cameras, DepthRange(scene.file.near, scene.file.far, "given")


def exposed(photo: Photo, factors: tuple[float, ...]) -> Photo:
    pixels = np.clip(np.rint(photo.rgb * np.asarray(factors)), 0, 255).astype(np.uint8)
    return replace(photo, rgb=pixels)


def exposures(views: list[FittedView], depths: DepthRange) -> Exposures | None:
    return exposures_of(PairMatches(views, depths))


def fitted(photos: tuple[Photo, ...], size: int = 256, which: tuple[int, ...] = VIEWS) -> list[FittedView]:
    _, cameras, _ = sample(which)
    return [fit_view(*match_photo(p, c), size, size) for p, c in zip(photos, cameras, strict=False)]


@pytest.mark.parametrize(
    "factors",
    [
        ((0.5,) * 3, (1.0,) * 3),
        ((1.0,) * 3, (0.9,) * 3),
        ((1.2,) * 3, (1.0,) * 3),  # clipped where it is brightest
        ((0.8, 0.9, 1.0), (1.0, 0.9, 0.75)),  # another white balance
        ((0.7,) * 3, (1.0,) * 3, (0.85,) * 3),
    ],
)
def test_factors_are_found_and_the_middle_one_stays(factors: tuple[tuple[float, ...], ...]) -> None:
    photos, _, depths = sample()
    views = fitted(tuple(exposed(photo, f) for photo, f in zip(photos, factors, strict=False)))
    found = exposures(views, depths)
    assert found is not None
    assert found.parts == [list(range(len(views)))]
    logs = np.log(factors)
    np.testing.assert_allclose(found.gains, np.exp(np.median(logs, axis=0) - logs), rtol=EXACT)


@pytest.mark.parametrize(
    ("factors", "gains"),
    [
        ((0.6, 1, 1, 1), (1 / 0.6, 1, 1, 1)),  # three keep their colours
        ((0.6, 0.6, 1, 1), ((1 / 0.6) ** 0.5,) * 2 + (0.6**0.5,) * 2),
    ],
)
def test_pairs_of_nearest_views_are_joined(factors: tuple[float, ...], gains: tuple[float, ...]) -> None:
    photos, _, depths = sample(GROUPS)
    views = fitted(tuple(exposed(p, (f,) * 3) for p, f in zip(photos, factors, strict=True)), which=GROUPS)
    found = exposures(views, depths)
    assert found is not None
    assert found.parts == [[0, 1, 2, 3]]
    np.testing.assert_allclose(found.gains, np.repeat(np.array(gains)[:, None], 3, axis=1), rtol=EXACT)


@pytest.mark.parametrize("factor", [1 / 10, 1 / 16, 1 / 40])
@pytest.mark.parametrize("dark", [0, 1])
def test_a_photograph_that_is_nearly_black_is_brought_to_the_exposure_of_the_other(factor: float, dark: int) -> None:
    """As of a film that fades, or of 12 bits in a file for 16: all of it is darker than what is compared otherwise."""
    photos, _, depths = sample()
    factors = np.ones(2)
    factors[dark] = factor
    found = exposures(fitted(tuple(exposed(p, (f,) * 3) for p, f in zip(photos, factors, strict=False))), depths)
    assert found is not None
    np.testing.assert_allclose(found.gains, np.repeat((factor**0.5 / factors)[:, None], 3, axis=1), rtol=EXACT)


@pytest.mark.parametrize("factors", [(1 / 40, 1 / 40), (1 / 40, 1 / 60), (1 / 30, 1 / 40)])
def test_photographs_that_are_both_nearly_black_stay_without_a_large_factor(factors: tuple[float, float]) -> None:
    photos, _, depths = sample()
    views = fitted(tuple(exposed(p, (f,) * 3) for p, f in zip(photos, factors, strict=False)))
    assert exposures(views, depths) is None


def test_views_that_match_no_others_are_named_and_stay() -> None:
    """The last one shows something else."""
    photos, _, depths = sample()
    noise = np.random.default_rng(0).integers(0, 255, photos[2].rgb.shape, np.uint8)
    given = (exposed(photos[0], (0.64,) * 3), photos[1], replace(photos[2], rgb=noise))
    views = fitted(given)
    found = exposures(views, depths)
    assert found is not None
    assert found.parts == [[0, 1], [2]]
    np.testing.assert_allclose(found.gains, [[1.25] * 3, [0.8] * 3, [1] * 3], rtol=EXACT)
    _, (notice,) = equalised(
        FittedPhotos(views, views, [PackedView.of(v) for v in views], []), PairMatches(views, depths), (4, 7, 9)
    )
    assert "not enough matches to compare these groups of views with each other: 4, 7; 9" in notice["message"]


def test_one_exposure_and_small_differences_stay() -> None:
    photos, _, depths = sample()
    assert exposures(fitted(photos), depths) is None
    assert exposures(fitted((photos[0], exposed(photos[1], (1.04,) * 3))), depths) is None


def test_surfaces_that_shine_one_way_are_no_exposure() -> None:
    """Half of the second picture is brighter, the other half darker: no factor is that of the picture."""
    photos, _, depths = sample()
    pixels = photos[1].rgb.astype(float)
    middle = pixels.shape[1] // 2
    pixels[:, :middle] *= 1.25
    pixels[:, middle:] /= 1.25
    shaded = replace(photos[1], rgb=np.clip(np.rint(pixels), 0, 255).astype(np.uint8))
    assert exposures(fitted((photos[0], shaded)), depths) is None


def test_what_is_white_in_one_of_two_has_a_say() -> None:
    """Both overexposed alike: where one half is brighter and not white, the other half, white there, is darker."""
    photos, _, depths = sample()
    pixels = [photo.rgb.astype(float) for photo in photos[:2]]
    middle = pixels[0].shape[1] // 2
    for side, sign in ((slice(None, middle), 1), (slice(middle, None), -1)):
        level = 0.6 if sign > 0 else 4.0
        pixels[0][:, side] *= level * 1.3**-sign
        pixels[1][:, side] *= level * 1.3**sign
    shaded = [replace(photos[0], rgb=np.clip(np.rint(levels), 0, 255).astype(np.uint8)) for levels in pixels]
    assert exposures(fitted(tuple(shaded)), depths) is None


def test_what_does_not_match_has_no_say() -> None:
    flat = [np.full((256, 256, 3), level, np.uint8) for level in (60, 180)]
    noise = [np.random.default_rng(i).integers(0, 80 * (i + 1), (256, 256, 3), np.uint8) for i in range(2)]
    depths = sample()[2]
    for pixels in (flat, noise):
        assert exposures(fitted(tuple(Photo.from_array(p, index=0) for p in pixels)), depths) is None


@pytest.mark.parametrize("which", [0, 1])
def test_what_masks_leave_out_is_not_compared(which: int) -> None:
    """White where it is left out, which would be another exposure there."""
    photos, _, depths = sample()
    pixels, mask = photos[which].rgb.copy(), np.ones(photos[which].rgb.shape[:2], np.bool_)
    pixels[100:], mask[100:] = 255, False
    masked = [*photos[:2]]
    masked[which] = replace(photos[which], rgb=pixels, mask=mask)
    assert exposures(fitted(tuple(masked)), depths) is None
    masked[1 - which] = exposed(photos[1 - which], (0.7,) * 3)
    found = exposures(fitted(tuple(masked)), depths)
    assert found is not None
    np.testing.assert_allclose(found.gains[1 - which] / found.gains[which], 1 / 0.7, rtol=EXACT)


def fitted_photos(photos: tuple[Photo, ...], *, detail: int) -> FittedPhotos:
    seen, large = fitted(photos), fitted(photos, 512)
    return FittedPhotos(seen, large if detail == 2 else seen, [PackedView.of(view) for view in large], [])


@pytest.mark.parametrize("detail", [1, 2])
def test_every_crop_of_a_photograph_is_brought_to_it_and_it_is_told(detail: int) -> None:
    photos, _, depths = sample()
    given = fitted_photos((photos[0], exposed(photos[1], (0.64,) * 3)), detail=detail)
    found, (notice,) = equalised(given, PairMatches(given.seen, depths), (4, 7))
    assert notice["code"] == "exposures_differ"
    assert notice["index"] == 7
    assert "view 7 has 0.64 times as much " in notice["message"]
    assert " as view 4: " in notice["message"]
    assert "(4 times 0.8, 7 times 1.25)" in notice["message"]
    np.testing.assert_allclose(notice["gains"], [[0.8] * 3, [1.25] * 3], rtol=EXACT)
    for before, after in ((given.seen, found.seen), (given.shown, found.shown), (given.fine, found.fine)):
        for view, changed, gain in zip(before, after, notice["gains"], strict=True):
            wanted = np.minimum(view.image * np.asarray(gain)[:, None, None], 1)
            np.testing.assert_allclose(changed.image, wanted, atol=0.5 / 255 + 1e-3)
            assert changed.camera is view.camera
    assert (found.shown[0] is found.seen[0]) == (detail == 1)


def test_a_tint_is_told_by_its_channel() -> None:
    photos, _, depths = sample()
    given = fitted_photos((photos[0], exposed(photos[1], (1.1, 1.0, 0.75))), detail=1)
    _, (notice,) = equalised(given, PairMatches(given.seen, depths), (4, 7))
    assert "view 7 has 0.75 times as much blue as view 4" in notice["message"]


def test_of_one_exposure_nothing_is_copied() -> None:
    photos, _, depths = sample()
    given = fitted_photos(photos[:2], detail=1)
    found, told = equalised(given, PairMatches(given.seen, depths), (0, 1))
    assert found is given
    assert told == []


def test_a_plane_in_another_world_has_the_same_factors() -> None:
    scene = PlaneScene.make(np.random.default_rng(3), size=(256, 192), turn=0.5)
    images = [scene.images[0], np.rint(scene.images[1] * 0.8).astype(np.uint8), scene.images[2]]
    views = [fit_view(Photo(i), c, 192, 256) for i, c in zip(images, scene.cameras, strict=True)]
    found = exposures(views, DepthRange(scene.near, scene.far, "given"))
    assert found is not None
    np.testing.assert_allclose(found.gains, [[1] * 3, [1.25] * 3, [1] * 3], rtol=EXACT)


def test_a_scene_of_two_exposures_is_the_scene_of_one() -> None:
    """But for their mean brightness: from between the inputs it has 29.3 dB, as photographs of one exposure give."""
    photos, cameras, depths = sample()
    uneven = (photos[0], exposed(photos[2], (0.7,) * 3))
    one, two = (
        Reconstructor(threads=1).reconstruct(list(given), [cameras[0], cameras[2]], near=depths.near, far=depths.far)
        for given in ((photos[0], photos[2]), uneven)
    )
    truth = photos[1].rgb / 255.0
    errors = []
    for scene in (one, two):
        drawn = scene.render(cameras[1]).rgb
        gain = (drawn * truth).sum(axis=(0, 1)) / (drawn**2).sum(axis=(0, 1))
        errors.append(-10 * np.log10(((drawn * gain - truth) ** 2).mean()))
    assert "exposures_differ" in {notice["code"] for notice in two.document["warnings"]}
    assert "exposures_differ" not in {notice["code"] for notice in one.document["warnings"]}
    assert errors[1] > errors[0] - 0.3  # measured 0.0; 4.9 without


@pytest.mark.parametrize(
    ("factors", "differ"),
    [
        (((1 / 16,) * 3, (1 / 40,) * 3), True),  # beyond twofold
        (((1 / 16,) * 3, (1 / 40, 1 / 40, 1 / 20)), False),  # not in each channel
    ],
)
def test_of_two_dark_photographs_a_factor_counts_beyond_two_in_each_channel(
    factors: tuple[tuple[float, ...], ...], differ: bool
) -> None:
    photos, _, depths = sample()
    views = fitted(tuple(exposed(photo, f) for photo, f in zip(photos, factors, strict=False)))
    assert (exposures(views, depths) is not None) == differ
