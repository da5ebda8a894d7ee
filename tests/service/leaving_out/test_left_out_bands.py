"""Bands of harmonics that are 0 are left out: the pictures stay the same to the bit, and no other band is left out."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from clouds import cloud, view

from gapmes.service.formats.ply_write import ply_size
from gapmes.service.gaussians import Gaussians, without_zero_bands
from gapmes.service.leaving_out.budget import Budget, parse_max_error
from gapmes.service.leaving_out.left_out import leave_out, table
from gapmes.service.splat import render
from gapmes.service.viewpoints.scene_views import SceneViews

CAMERAS = [view(turn) for turn in (-0.4, -0.1, 0.2, 0.5)]


def banded(degree: int) -> Gaussians:
    """Gaussians with harmonics of degree 3, of which the bands above `degree` are 0."""
    gaussians = cloud(200, 5, 3)
    gaussians.harmonics[:, (degree + 1) ** 2 :] = 0
    return gaussians


def left(gaussians: Gaussians, max_error: str) -> tuple[Gaussians, dict[str, Any]]:
    """What stays where no Gaussian may go, and the report."""
    scene, budget = SceneViews(CAMERAS[:2], 1.0, 10.0), Budget(parse_max_error(max_error))
    lean, _, report = leave_out(gaussians, np.zeros(len(gaussians), np.bool_), scene, budget, 1)
    return lean, report


@pytest.mark.parametrize("max_error", ["0", "1/255"])
@pytest.mark.parametrize("degree", [0, 1, 2])
def test_zero_bands_go_and_no_picture_changes(degree: int, max_error: str) -> None:
    gaussians = banded(degree)
    lean, report = left(gaussians, max_error)
    assert (lean.sh_degree, len(lean), report["bands"]) == (degree, len(gaussians), [3, degree])
    assert (report["dropped"], report["bound"], len(report["picture_seconds"])) == (0, 0.0, 2)
    assert report["bytes_saved"] == ply_size(gaussians) - ply_size(lean) > 0
    for camera in CAMERAS:
        one, two = render(gaussians, camera, threads=1), render(lean, camera, threads=1)
        assert one.rgb.max() > 0.1
        for plane in ("rgb", "alpha", "depth"):
            np.testing.assert_array_equal(getattr(one, plane), getattr(two, plane))
    outputs, mask = {"opacities": gaussians.opacities}, np.ones((2, 4), np.bool_)
    unpruned: Any = SimpleNamespace(outputs=outputs, patch_mask=mask, dropped={}, placed=SimpleNamespace(added=0))
    info: Any = SimpleNamespace(experts=None, keep_all=False)
    rows = table(unpruned, info, report)
    assert rows == [{"what": "bands of harmonics that are 0", "count": 3 - degree, "of": 3, "error": 0.0}]


@pytest.mark.parametrize("coefficient", range(16))
def test_a_single_coefficient_keeps_its_band(coefficient: int) -> None:
    """Of one Gaussian and one channel, also the last of a band, at -0 and where it is the smallest number that is."""
    gaussians = banded(0)
    gaussians.harmonics[-1, coefficient, 2] = np.finfo(np.float32).smallest_subnormal
    gaussians.harmonics[0, coefficient + 1 :, 0] = -0.0
    kept = without_zero_bands(gaussians)
    assert kept.sh_degree == math.isqrt(coefficient)
    np.testing.assert_array_equal(kept.harmonics, gaussians.harmonics[:, : (kept.sh_degree + 1) ** 2])
    assert kept.harmonics.flags.c_contiguous


def test_a_set_without_zero_bands_stays_the_same_object() -> None:
    for degree in range(4):
        gaussians = cloud(20, 5, degree)
        assert without_zero_bands(gaussians) is gaussians
    black = cloud(20, 5, 2)
    black.harmonics[:] = 0
    assert without_zero_bands(black).sh_degree == 0
    assert without_zero_bands(cloud(20, 5, 2)[:0]).sh_degree == 0


def test_off_keeps_all_bands() -> None:
    gaussians = banded(1)
    lean, report = left(gaussians, "off")
    assert lean is gaussians
    assert (report["bands"], report["bytes_saved"], report["certified"]) == ([3, 3], 0, None)
    assert report["picture_seconds"] is None
