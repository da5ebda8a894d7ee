"""Targets at twice the size: the same views of the same scene, and a picture enlarged keeps its place."""

from __future__ import annotations

import numpy as np
from synthetic_scenes import SIZE, StepScene, camera_at, texture

from gapmes.export.evaluation.case import Case, generated_cases, photograph_case
from gapmes.export.evaluation.measure import enlarged
from gapmes.service.images import FittedView
from gapmes.service.picture_error import psnr
from gapmes.service.shipped import sample_folder


def assert_same_view(once: FittedView, twice: FittedView) -> None:
    one, two = once.camera, twice.camera
    assert (two.width, two.height) == (2 * one.width, 2 * one.height)
    np.testing.assert_allclose([two.fx, two.fy, two.cx, two.cy], 2 * np.array([one.fx, one.fy, one.cx, one.cy]))
    np.testing.assert_allclose(two.world_from_cam, one.world_from_cam)


def halved(view: FittedView) -> np.ndarray:
    c, height, width = view.image.shape
    return view.image.reshape(c, height // 2, 2, width // 2, 2).mean(axis=(2, 4))


def test_a_generated_scene_is_drawn_again_larger() -> None:
    """Rays differ between the sizes, so edges do; another scene is some 10 dB away."""
    cases = list(generated_cases(3, 2, 64, 64))
    for index, case in enumerate(cases):
        assert case.at_twice is not None
        truth = case.at_twice()
        assert truth.side_px == 128
        for once, twice in zip(case.targets, truth.views, strict=True):
            assert_same_view(once, twice)
            assert psnr(halved(twice), once.image) > 28
            assert psnr(halved(twice), cases[index - 1].targets[0].image) < 20


def test_a_photograph_is_resampled_from_its_own_pixels() -> None:
    case = photograph_case(sample_folder(), 2, 64, 64)
    assert case.at_twice is not None
    truth = case.at_twice()
    assert truth.side_px == 256
    for once, twice in zip(case.targets, truth.views, strict=True):
        assert_same_view(once, twice)
        assert psnr(halved(twice), once.image) > 30


def test_a_case_need_not_know_larger_targets() -> None:
    case: Case = StepScene(2.0).case()
    assert case.at_twice is None


def test_anenlarged_picture_stays_where_it_is() -> None:
    """61 dB; a shift by half a pixel of the small picture would leave 34."""

    def picture(size: int) -> np.ndarray:
        x = camera_at(0, size)
        rows, columns = np.mgrid[:size, :size] + 0.5
        return texture((columns - x.cx) / x.fx, (rows - x.cy) / x.fy, 0.0).astype(np.float32)

    large = enlarged(picture(SIZE))
    assert large.shape == (3, 2 * SIZE, 2 * SIZE)
    assert psnr(large, picture(2 * SIZE)) > 50
    assert psnr(np.roll(large, 1, axis=2), picture(2 * SIZE)) < 40
