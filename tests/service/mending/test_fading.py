"""Fading: Gaussians that the photographs contradict disappear, confirmed ones stay, and nothing else happens."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from plane_views import SIDE, error, floaters, in_another_world, joined, on_the_plane, plane_views

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.rotations import about_axis, quaternion_from_matrix, quaternion_product
from gapmes.service.commands.summary import fading_line
from gapmes.service.errors import InputError
from gapmes.service.gaussians import Gaussians
from gapmes.service.harmonics import C0
from gapmes.service.mending import fade_passes
from gapmes.service.mending.fading import BEHIND_KEEPS, faded
from gapmes.service.mending.targets import Targets
from gapmes.service.photographs.images import FittedView
from gapmes.service.splat import Leverage, render


@pytest.fixture(scope="module")
def views() -> list[FittedView]:
    """Three photographs of the plane; the one between the others is kept back by the tests."""
    return plane_views()


@pytest.fixture(scope="module")
def spoiled(views: list[FittedView]) -> Gaussians:
    """The plane from the first and the last photograph, then 40 floaters."""
    return joined(on_the_plane(views[0]), on_the_plane(views[2]), floaters(40))


def test_floaters_fade_and_the_surface_stays(views: list[FittedView], spoiled: Gaussians) -> None:
    given = [views[0], views[2]]
    result = faded(spoiled, given)
    kept = result.gaussians.opacities / spoiled.opacities
    assert np.median(kept[-40:]) < 0.1  # found: 0
    assert np.median(kept[:-40]) > 0.78  # found: 0.81; what blurs its neighbours' texture fades as well
    twice = faded(spoiled, given, 2).gaussians
    assert np.median((twice.opacities / spoiled.opacities)[:-40]) > 0.85  # found: 0.88
    for view in views:  # found: 4.9, 2.1 and 7.7 dB, the second for the photograph that was kept back
        assert error(result.gaussians, view) > error(spoiled, view) + 1.6
    assert result.halved >= 10
    assert result.mean_opacity[1] < result.mean_opacity[0]


def test_passes_settle(views: list[FittedView], spoiled: Gaussians, monkeypatch) -> None:
    """Many more than anyone asks for: surfaces do not go on fading, which would only let the void through."""
    monkeypatch.setattr(fade_passes, "MAX_PASSES", 32)
    given = [views[0], views[2]]
    some, more, most = (faded(spoiled, given, passes).gaussians for passes in (8, 16, 32))
    for view in views:  # found: 0.8 dB more to 0.2 less from 8 to 32; 7 to 15 less where the void counts nothing
        found = [error(scene, view) for scene in (spoiled, some, more, most)]
        assert min(found[1:]) > found[0] + 1.5
        assert max(found[1:]) - min(found[1:]) < 1.0
        assert render(most, view.camera).alpha.mean() > 0.94  # found: 0.955 or more


def test_opacities_and_colours_alone_change_and_no_opacity_rises(views: list[FittedView], spoiled: Gaussians) -> None:
    result = faded(spoiled, views, 4)
    assert (result.gaussians.opacities <= spoiled.opacities).all()
    assert (result.gaussians.opacities >= 0).all()
    for name in ("means", "scales", "rotations_wxyz"):
        assert getattr(result.gaussians, name) is getattr(spoiled, name)
    none = faded(spoiled, views, 0)
    assert none.gaussians is spoiled
    before = round(float(spoiled.opacities.mean(dtype=np.float64)), 6)
    assert none.document() == {"passes": 0, "halved": 0, "gone": 0, "mean_opacity": [before, before], "recoloured": 0.0}


def photographed(scene: Gaussians, views: list[FittedView]) -> list[FittedView]:
    """Pictures of the scene itself, whose colour goes on behind what it does not cover in full."""
    drawn = [render(scene, view.camera) for view in views]
    whole = [np.clip(image.rgb / np.maximum(image.alpha, 0.001)[..., None], 0, 1) for image in drawn]
    return [replace(view, image=one.transpose(2, 0, 1).copy()) for view, one in zip(views, whole, strict=True)]


def test_what_shows_its_photographs_already_stays(views: list[FittedView], spoiled: Gaussians) -> None:
    """Even floaters: the photographs are pictures of the very scene."""
    result = faded(spoiled, photographed(spoiled, views))
    assert np.abs(result.gaussians.opacities - spoiled.opacities).max() < 1e-6  # found: 0
    assert result.halved == 0
    assert C0 * np.abs(result.gaussians.harmonics - spoiled.harmonics).max() < 1e-6  # found: 0


@pytest.mark.parametrize("passes", [1, 2, 4, 8])
@pytest.mark.parametrize("behind", [1e-3, 1e-4])
def test_what_hardly_shines_through_moves_little(
    behind: float, passes: int, views: list[FittedView], spoiled: Gaussians
) -> None:
    """Pictures of the very scene over black, compared where at most this share of the light comes from behind."""
    drawn = [render(spoiled, view.camera) for view in views]
    seen = [
        replace(view, image=image.rgb.transpose(2, 0, 1).copy(), mask=image.alpha > 1 - behind)
        for view, image in zip(views, drawn, strict=True)
    ]
    assert sum(view.mask.sum() for view in seen) > 50  # found: 7,748 and 115
    result = faded(spoiled, seen, passes)
    # Found for 1, 2, 4, 8 passes: 2.2, 4.6, 4.1, 5.2 times that share at a thousandth, at most 2 times at a tenth of it
    assert np.abs(result.gaussians.opacities - spoiled.opacities).max() < 7 * behind
    assert result.halved == 0
    # Found: at most 3.3 and 1.6.
    assert C0 * np.abs(result.gaussians.harmonics - spoiled.harmonics).max() < 7 * behind


@pytest.mark.parametrize("passes", [4, 8])
def test_small_differences_do_not_add_up(passes: int, views: list[FittedView], spoiled: Gaussians) -> None:
    """Photographs of the very scene, rounded to 8 bits."""
    seen = photographed(spoiled, views)
    result = faded(
        spoiled, [replace(view, image=np.round(255 * view.image) / np.float32(255)) for view in seen], passes
    )
    assert result.halved == 0
    faint = np.abs(result.gaussians.opacities - spoiled.opacities)
    tint = C0 * np.abs(result.gaussians.harmonics - spoiled.harmonics)
    assert faint.max() < 0.04  # found: 0.017 after four passes, 0.019 after eight
    assert faint.mean() < 0.004  # found: 0.0013, 0.0019
    assert tint.max() < 0.02  # found: 0.006, 0.009
    assert tint.mean() < 0.003  # found: 0.0010, 0.0014


def test_masked_pixels_count_nothing(views: list[FittedView], spoiled: Gaussians) -> None:
    masked = [replace(view, mask=np.zeros((SIDE, SIDE), bool)) for view in views]
    unchanged = faded(spoiled, masked).gaussians
    assert (unchanged.opacities == spoiled.opacities).all()
    assert (unchanged.harmonics == spoiled.harmonics).all()
    # A floater fades by the photographs whose masks keep it.
    half = np.arange(SIDE)[:, None] < np.full(SIDE, SIDE // 2)
    some = faded(spoiled, [replace(view, mask=half) for view in views]).gaussians.opacities
    fewer = (spoiled.opacities - some)[-40:] > 0.05
    assert 5 < fewer.sum() < ((spoiled.opacities - faded(spoiled, views).gaussians.opacities)[-40:] > 0.05).sum()


def test_a_lone_splat_is_not_measured_against_the_void() -> None:
    """Its photograph has its colour everywhere; over black or over white most of its pixels would be wrong."""
    camera = Camera.make(SIDE, SIDE, 60.0, 60.0, SIDE / 2, SIDE / 2, np.eye(4))
    colour = np.array([0.8, 0.3, 0.6])
    one = Gaussians.make([[0, 0, 2.0]], [[0.3] * 3], [[1.0, 0, 0, 0]], [0.7], ((colour - 0.5) / C0)[None, None])
    photograph = np.broadcast_to(colour.astype(np.float32)[:, None, None], (3, SIDE, SIDE)).copy()
    result = faded(one, [FittedView(photograph, None, camera, 1.0)] * 2, 4)
    assert result.gaussians.opacities[0] == pytest.approx(0.7, abs=1e-6)


def test_the_bits_do_not_depend_on_threads(views: list[FittedView], spoiled: Gaussians) -> None:
    one, three = (faded(spoiled, views, threads=threads).gaussians for threads in (1, 3))
    assert one.opacities.tobytes() == three.opacities.tobytes()
    assert one.harmonics.tobytes() == three.harmonics.tobytes()


@pytest.mark.parametrize(("unit", "offset"), [(1e-3, 0.0), (1.0, 1e6), (300.0, -5e4)])
def test_the_world_and_its_unit_do_not_matter(unit: float, offset: float, views: list[FittedView]) -> None:
    """x -> unit R x + offset for scene and cameras. The plane is made uneven: of surfaces that lie exactly side by side
    rounding would decide which one is in front."""
    rng = np.random.default_rng(3)
    flat = joined(on_the_plane(views[0]), on_the_plane(views[2]), floaters(40))
    scene = replace(flat, means=flat.means + rng.normal(0, 0.02, flat.means.shape))
    turn, shift = about_axis(np.array([0.48, -0.6, 0.64]), 2.3), np.array([offset, -offset, 0.5 * offset])
    poses = in_another_world(views, turn, shift, unit)
    moved = Gaussians.make(
        unit * scene.means @ turn.T + shift,
        unit * scene.scales,
        quaternion_product(quaternion_from_matrix(turn), scene.rotations_wxyz),
        scene.opacities,
        scene.harmonics,
    )
    here, there = faded(scene, views, near=0.1).gaussians, faded(moved, poses, near=0.1 * unit).gaussians
    assert np.abs(here.opacities - there.opacities).max() < 1e-4  # found: 2e-6
    assert np.abs(here.harmonics - there.harmonics).max() < 1e-4  # found: 7e-7


def test_colours_beyond_white_are_compared_as_they_are_seen(views: list[FittedView]) -> None:
    """Pictures end at 1, and so do photographs: a Gaussian is not wrong for being brighter than both."""
    bright = on_the_plane(views[0])
    bright = replace(bright, harmonics=1.5 * bright.harmonics + np.float32(0.5))
    seen = render(bright, views[0].camera)
    assert (seen.rgb > 1.2).mean() > 0.05
    photograph = np.clip(seen.rgb, 0, 1).transpose(2, 0, 1).copy()
    result = faded(bright, [FittedView(photograph, seen.alpha > 0.9999, views[0].camera, 1.0)])
    assert (bright.opacities - result.gaussians.opacities).max() < 1e-3
    assert (0.5 + C0 * bright.harmonics).max() > 1.2
    assert C0 * np.abs(bright.harmonics - result.gaussians.harmonics).max() < 1e-3


def test_colours_at_the_end_of_float32_leave_numbers() -> None:
    """The wide one behind makes sums of the opacities infinite, of which no step can be told."""
    camera = Camera.make(SIDE, SIDE, 60.0, 60.0, SIDE / 2, SIDE / 2, np.eye(4))
    scales, harmonics = [[0.05] * 3, [2.0] * 3, [0.05] * 3], np.zeros((3, 1, 3))
    harmonics[1] = 1e38
    means, turns = [[0, 0, 2.0], [0, 0, 4.0], [0.4, 0, 2.0]], [[1.0, 0, 0, 0]] * 3
    scene = Gaussians.make(means, scales, turns, [0.985, 0.5, 0.5], harmonics)
    photograph = np.full((3, SIDE, SIDE), 0.5, np.float32)
    result = faded(scene, [FittedView(photograph, None, camera, 1.0)] * 2)
    assert np.isfinite(result.gaussians.opacities).all()
    assert (result.gaussians.opacities <= scene.opacities).all()
    assert np.isfinite(result.gaussians.harmonics).all()


def test_what_stands_behind_keeps_more_than_half_of_its_opacity(views: list[FittedView], spoiled: Gaussians) -> None:
    heard: list[int] = []
    behind = np.arange(len(spoiled)) >= len(spoiled) - 40  # the floaters
    found = faded(spoiled, views, 8, behind=behind, done=heard.append).gaussians
    assert (found.harmonics[behind] != spoiled.harmonics[behind]).any()  # colours of both kinds follow
    kept = found.opacities / spoiled.opacities
    assert kept[behind].min() == pytest.approx(BEHIND_KEEPS)
    assert BEHIND_KEEPS * 0.97 > 0.5  # a sheet alone is no hole
    assert kept[~behind].min() < 0.5
    assert faded(spoiled, views, 8).gaussians.opacities[behind].min() < 0.1
    assert heard == list(range(1, 10))


def test_what_is_too_faint_to_be_drawn_is_gone(views: list[FittedView], spoiled: Gaussians) -> None:
    result = faded(spoiled, views, 8)
    assert 0 < result.gone.sum() == result.document()["gone"]
    assert (result.gaussians.opacities[result.gone] < 1 / 255).all()
    for view in views:
        whole, without = (render(one, view.camera).rgb for one in (result.gaussians, result.gaussians[~result.gone]))
        assert (whole == without).all()


def test_nothing_to_fade(views: list[FittedView], spoiled: Gaussians) -> None:
    result = faded(spoiled[:0], views)
    assert len(result.gaussians) == 0
    assert result.document() == {"passes": 4, "halved": 0, "gone": 0, "mean_opacity": [0.0, 0.0], "recoloured": 0.0}


def test_colours_come_to_what_the_photographs_show(views: list[FittedView]) -> None:
    """The plane from two photographs, its colours off by a shade: the first pass takes most of it, the rest settles."""
    scene = joined(on_the_plane(views[0]), on_the_plane(views[2]))
    shade = np.array([0.10, -0.06, 0.04], np.float32)
    tinted = replace(scene, harmonics=scene.harmonics + shade / np.float32(C0))
    given = [views[0], views[2]]
    # found: 0.009, 0.024, 0.007, 0.006; the second goes too far by the momentum
    off = [np.abs(_shade(faded(tinted, given, n).gaussians, tinted) + shade).max() for n in (1, 2, 4, 8)]
    assert max(off) < 0.3 * np.abs(shade).max()
    assert off[3] < off[2] < off[1]
    assert off[2] < 0.1 * np.abs(shade).max()
    for view in views:  # found: 6.2, 2.6 and 7.8 dB, the second for the photograph that was kept back
        assert error(faded(tinted, given).gaussians, view) > error(tinted, view) + 1.0


def test_colours_follow_one_pass_behind(views: list[FittedView], spoiled: Gaussians, monkeypatch) -> None:
    """Each round is drawn with the colours of the one before; the first only lowers opacities."""
    drawn: list[Gaussians] = []

    def recorded(targets: Targets, now: Gaussians, *rest: object) -> Leverage:
        drawn.append(now)
        return real(targets, now, *rest)

    real = Targets.sums
    monkeypatch.setattr(Targets, "sums", recorded)
    last = faded(spoiled, views, 2).gaussians
    assert len(drawn) == 3
    steps = list(pairwise([*drawn, last]))
    assert [bool((a.opacities != b.opacities).any()) for a, b in steps] == [True, True, False]
    assert [bool((a.harmonics != b.harmonics).any()) for a, b in steps] == [False, True, True]


def _shade(found: Gaussians, before: Gaussians) -> np.ndarray:
    return C0 * (found.harmonics - before.harmonics)[:, 0].mean(axis=0)


def test_colours_stay_within_what_can_be_seen(views: list[FittedView], spoiled: Gaussians) -> None:
    """Photographs of nothing but black, and of white: base colours end at 0 and 1, and beyond only where they were."""
    for value in (0.0, 1.0):
        flat = [replace(view, image=np.full_like(view.image, value)) for view in views]
        before, after = (0.5 + C0 * one.harmonics[:, 0] for one in (spoiled, faded(spoiled, flat, 8).gaussians))
        assert (after >= np.minimum(before, 0) - 1e-6).all()
        assert (after <= np.maximum(before, 1) + 1e-6).all()
        assert np.abs(after - value).mean() < 0.01 * np.abs(before - value).mean()  # found: 0.001 of it


def test_what_depends_on_the_direction_stays(views: list[FittedView], spoiled: Gaussians) -> None:
    more = np.random.default_rng(2).normal(0, 0.1, (len(spoiled), 3, 3)).astype(np.float32)
    scene = replace(spoiled, harmonics=np.concatenate([spoiled.harmonics, more], axis=1))
    found = faded(scene, views).gaussians.harmonics
    assert (found[:, 1:] == more).all()
    assert np.abs(found[:, 0] - scene.harmonics[:, 0]).mean() > 0.01


@pytest.mark.parametrize("passes", [-1, 9, True, 1.5])
def test_a_number_of_passes_that_makes_no_sense_is_refused(passes, views: list[FittedView], spoiled: Gaussians) -> None:
    with pytest.raises(InputError, match="need a whole number from 0 to 8") as caught:
        faded(spoiled, views, passes)
    assert caught.value.field == "fade"


def test_a_line_says_what_faded(views: list[FittedView], spoiled: Gaussians) -> None:
    result = faded(spoiled, views)
    line = fading_line({"fading": result.document()})
    assert line.startswith("fading in 4 passes: ")
    lost = f"{result.halved:,} Gaussians lost half of their opacity or more, {result.gone.sum():,} are no longer drawn"
    assert lost in line
    assert line.endswith(f"and colours moved by {255 * result.recoloured:.1f} of 255 on average")
    assert "in 1 pass:" in fading_line({"fading": faded(spoiled, views, 1).document()})
    assert fading_line({"fading": faded(spoiled, views, 0).document()}) == "fading: off"
