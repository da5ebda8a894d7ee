"""Evaluation at twice the size: the same views with finer detail in the truth, an enlarged picture instead, and the
table."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic_scenes import SIZE, StepScene, camera_at, texture
from test_floors import scene

from gapmes.export.evaluation import measure as measuring
from gapmes.export.evaluation.case import LargerTargets, generated_cases, photograph_case
from gapmes.export.evaluation.measure import enlarged, lost_to_detail
from gapmes.export.evaluation.scores import Group, ModelScore, SceneScore, Twice
from gapmes.export.evaluation.tables import SCENES_SHOWN, group_section
from gapmes.export.size import Size
from gapmes.service.photographs.images import FittedView
from gapmes.service.pictures.picture_error import psnr
from gapmes.service.shipped import sample_folder


def assert_same_view_with_more_detail(once: FittedView, twice: FittedView) -> None:
    """Measured: 32 to 45 dB when averaged back; the enlarged small picture has 27 to 32 dB against the large one."""
    one, two = once.camera, twice.camera
    assert (two.width, two.height) == (2 * one.width, 2 * one.height)
    np.testing.assert_allclose([two.fx, two.fy, two.cx, two.cy], 2 * np.array([one.fx, one.fy, one.cx, one.cy]))
    np.testing.assert_allclose(two.world_from_cam, one.world_from_cam)
    assert psnr(halved(twice.image), once.image) > 28
    assert psnr(enlarged(once.image), twice.image) < psnr(halved(twice.image), once.image) - 3


def halved(image: np.ndarray) -> np.ndarray:
    channels, height, width = image.shape
    return image.reshape(channels, height // 2, 2, width // 2, 2).mean(axis=(2, 4))


def test_a_generated_scene_is_drawn_again_larger() -> None:
    """Rays differ between the sizes, so edges do; another scene is some 10 dB away."""
    cases = list(generated_cases(3, 2, 48, 64))
    for index, case in enumerate(cases):
        assert case.at_twice is not None
        truth = case.at_twice()
        assert truth.side_px == 96
        for once, twice in zip(case.targets, truth.views, strict=True):
            assert_same_view_with_more_detail(once, twice)
            assert psnr(halved(twice.image), cases[index - 1].targets[0].image) < 20


def test_a_photograph_is_resampled_from_its_own_pixels() -> None:
    case = photograph_case(sample_folder(), 2, 64, 64)
    assert case.at_twice is not None
    truth = case.at_twice()
    assert truth.side_px == 256
    for once, twice in zip(case.targets, truth.views, strict=True):
        assert_same_view_with_more_detail(once, twice)


def wall(size: int) -> np.ndarray:
    """The texture in a camera of `size` pixels, one unit in front of it."""
    camera = camera_at(0, size)
    rows, columns = np.mgrid[:size, :size] + 0.5
    return texture((columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, 0.0).astype(np.float32)


def test_an_enlarged_picture_stays_where_it_is() -> None:
    """61 dB; a shift by half a pixel of the small picture would leave 34."""
    large = enlarged(wall(SIZE))
    assert large.shape == (3, 2 * SIZE, 2 * SIZE)
    assert psnr(large, wall(2 * SIZE)) > 50
    assert psnr(np.roll(large, 1, axis=2), wall(2 * SIZE)) < 40
    assert enlarged(wall(SIZE)[:, :48]).shape == (3, 96, 2 * SIZE)


def test_detail_costs_a_good_picture_more_than_a_bad_one() -> None:
    """Errors that are unrelated to the detail add to it: within 0.01 dB (measured 0.0014)."""
    chance = np.random.default_rng(3)
    truth = wall(2 * SIZE) + 0.05 * chance.standard_normal((3, 2 * SIZE, 2 * SIZE)).astype(np.float32)
    target = halved(truth)
    changes = []
    for size in (0.05, 0.2):
        wrong = size * chance.standard_normal((3, SIZE // 8, SIZE // 8)).astype(np.float32)
        for _ in range(3):  # smooth, so that enlarging keeps it
            wrong = enlarged(wrong + 0.5) - 0.5
        picture = target + wrong
        large = enlarged(target) + enlarged(wrong + 0.5) - 0.5
        found = lost_to_detail([picture], [target], [truth])
        assert found == pytest.approx(psnr(large, truth) - psnr(picture, target), abs=0.01)
        changes.append(found)
    assert changes[0] < changes[1] < 0
    flat = np.full((3, SIZE, SIZE), 0.4, np.float32)
    assert lost_to_detail([flat + 0.1], [flat], [enlarged(flat)]) == pytest.approx(0, abs=1e-6)


def test_changes_are_against_the_score_at_the_size_itself() -> None:
    """Pictures are one grey: off by 0.02 at the size itself (34 dB), by 0.01 and 0.1 at twice the size."""
    grey = np.full((3, SIZE, SIZE), 0.5, np.float32)
    view = StepScene(2.0).view(camera_at(0, 2 * SIZE))
    truth = LargerTargets((FittedView(np.full((3, 2 * SIZE, 2 * SIZE), 0.6, np.float32), None, view.camera, 1.0),), 99)
    target = grey + 0.02
    seen = np.zeros((SIZE, SIZE), bool)
    seen[:16, :16] = True  # co-visible pixels, where the error is another, do not count
    targets = [FittedView(target, None, camera_at(0), 1.0)]
    score = measuring._score([grey], targets, [seen], None)
    score = replace(score, covisible=replace(score.covisible, psnr=99.0))

    class Half:
        """Draws one colour, transparent in a quarter of the picture."""

        def draw(self, camera, threads):
            alpha = np.ones((camera.height, camera.width), np.float32)
            alpha[: camera.height // 4] = 0.2
            return type("Drawn", (), {"rgb": np.full((*alpha.shape, 3), 0.61, np.float32), "alpha": alpha})

    found = measuring._at_twice(truth, Half(), [grey], targets, score, None)  # type: ignore[arg-type]
    assert found.psnr == pytest.approx(40, abs=0.01)
    assert found.change == pytest.approx(6.02, abs=0.01)
    assert found.enlarged == pytest.approx(20 - 33.98, abs=0.01)
    assert found.detail == pytest.approx(-10 * np.log10(1 + 0.08**2 / 0.02**2), abs=0.01)
    assert (found.holes, found.side_px) == (0.25, 99)


def test_a_long_table_has_the_means_and_all_models_of_the_scenes_that_change_most() -> None:
    def entry(number: int) -> SceneScore:
        one = scene(f"s{number:02d}", 25, 20, Twice(20.0, -0.1 * number, -0.5, -0.4, 0.0, 300))
        other = ModelScore(one.models["ours"].score, 0.0, 0.0, 0.1, Twice(10.0, -9.0, -0.5, -0.4, 0.0, 90))
        one.models["other"] = other
        return one

    count = SCENES_SHOWN + 5
    group = Group(
        "generated",
        2,
        Size.square(128),
        "true depth",
        [entry(i) for i in range(count)],
        dict.fromkeys(("ours", "other")),
    )
    lines = group_section(group, lpips=False)
    assert f"The {SCENES_SHOWN} scenes that change most of {count}; all are in report.json." in lines
    start = next(i for i, line in enumerate(lines) if line.startswith("| at 256 px"))
    shown = lines[start + 2 : lines.index("", start)]
    mean = -0.1 * (count - 1) / 2
    assert shown[0] == f"| mean | ours | 20.00 | {mean:+.2f} | -0.50 | -0.40 | 0.000% |  |"
    names = [line.split(" | ")[0].strip("| ") for line in shown[2:]]
    assert names == [f"s{i:02d}" for i in range(count - 1, 4, -1) for _ in range(2)]
    assert shown[3].endswith("photograph has 90 px on its shorter side, enlarged |")
