"""The comparison: what is behind a pixel that is not covered, and the contribution of every view."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plane_views import SIDE, floaters, joined, on_the_plane

from gapmes.service.cameras.camera import Camera
from gapmes.service.gaussians import Gaussians
from gapmes.service.harmonics import C0
from gapmes.service.mending.targets import Targets
from gapmes.service.photographs.images import FittedView
from gapmes.service.splat import Leverage

COLOUR = np.array([0.2, 0.8, 0.5])
CAMERA = Camera.make(SIDE, SIDE, 60.0, 60.0, SIDE / 2, SIDE / 2, np.eye(4))
FLAT = FittedView(np.full((3, SIDE, SIDE), COLOUR[:, None, None], np.float32), None, CAMERA, 1.0)
NAMES = ("slope", "moved", "shown", "excess")


def splat(opacity: float, colour: np.ndarray = COLOUR) -> Gaussians:
    """A splat that covers the whole picture evenly."""
    return Gaussians.make([[0, 0, 2.0]], [[50.0] * 3], [[1.0, 0, 0, 0]], [opacity], ((colour - 0.5) / C0)[None, None])


def bits(sums: Leverage) -> list[bytes]:
    return [getattr(sums, name).tobytes() for name in NAMES]


@pytest.fixture(scope="module")
def scene(views: list[FittedView]) -> Gaussians:
    return joined(on_the_plane(views[0]), floaters(40))


def test_the_same_set_has_the_same_sums(views: list[FittedView], scene: Gaussians) -> None:
    compared = Targets(views)
    assert bits(compared.sums(scene, None, 1)) == bits(compared.sums(scene, None, 1))


@pytest.mark.parametrize("colour", [(0.2, 0.8, 0.5), (0.9, 0.9, 0.9), (0.1, 0.1, 0.1), (0.7, 0.2, 0.3)])
def test_what_lets_the_void_through_is_wrong_in_every_channel(colour: tuple[float, ...]) -> None:
    """Behind what is lost stands 1 where less than a half is wanted, else 0. One splat of opacity o covers o; of o0 at
    first, o0 - o is lost, and each channel differs by that share of the void's distance."""
    wanted = np.array(colour)
    view = replace(FLAT, image=np.full((3, SIDE, SIDE), wanted[:, None, None], np.float32))
    compared = Targets([view])
    first = compared.sums(splat(0.9, wanted), None, 1)
    assert first.slope == pytest.approx(0, abs=1e-2)  # of 4096 pixels; found: 2e-4
    faded = compared.sums(splat(0.6, wanted), None, 1)
    difference = 0.3 * ((wanted < 0.5) - wanted)
    weight = 1 / (1 + np.abs(difference).mean() / 0.05)
    shown = weight * 0.6 * SIDE**2
    assert faded.shown[0] == pytest.approx(shown, rel=2e-3)  # the splat falls off by a thousandth at the corners
    assert faded.excess[0] == pytest.approx(difference * shown, rel=5e-3)
    assert faded.slope[0] < -1  # more opacity would mend it
    other = Targets([view]).sums(splat(0.6, wanted), None, 1)  # never covered by more: nothing is lost
    assert other.slope == pytest.approx(0, abs=1e-2)
    assert other.excess == pytest.approx(0, abs=1e-2)


def test_covering_more_than_at_first_loses_nothing() -> None:
    compared = Targets([FLAT])
    compared.sums(splat(0.4), None, 1)
    assert compared.sums(splat(0.9), None, 1).excess == pytest.approx(0, abs=1e-2)


def test_masked_pixels_add_nothing_though_they_are_lost() -> None:
    compared = Targets([replace(FLAT, mask=np.zeros((SIDE, SIDE), bool))])
    compared.sums(splat(0.9), None, 1)
    sums = compared.sums(splat(0.5), None, 1)
    assert all((getattr(sums, name) == 0).all() for name in NAMES)


def test_every_view_remembers_its_own_cover(views: list[FittedView], scene: Gaussians) -> None:
    fainter = replace(scene, opacities=scene.opacities * np.float32(0.7))
    together, alone = Targets(views), [Targets([view]) for view in views]
    for number, one in enumerate((scene, fainter)):
        sums, parts = together.sums(one, None, 1), [compared.sums(one, None, 1) for compared in alone]
        for name in NAMES:
            expected = np.sum([getattr(part, name) for part in parts], axis=0)
            assert getattr(sums, name) == pytest.approx(expected, rel=1e-9, abs=1e-9), (number, name)
    assert (together.sums(fainter, None, 1).slope < 0).mean() > 0.5  # most are missed
