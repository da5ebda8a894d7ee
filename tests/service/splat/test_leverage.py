"""The derivative of a picture by an opacity, against finite differences of the float64 reference."""

from __future__ import annotations

import importlib
from dataclasses import fields
from itertools import combinations, pairwise
from typing import Any

import numpy as np
import pytest
from splat_cases import camera, dots, moved, scene

from gapmes.service.cameras.camera import Camera
from gapmes.service.errors import InputError
from gapmes.service.gaussians import Gaussians, joined
from gapmes.service.harmonics import C0
from gapmes.service.splat import Definition, Leverage, Render, leverage, render, render_reference
from gapmes.service.splat.leverage_parts import Part, Room, add_part, list_reaching
from gapmes.service.splat.sight import Sight, sight
from gapmes.service.splat.spans import unpacked_box

BEHIND = (0.2, 0.9, 0.4)
LEVERAGE = importlib.import_module("gapmes.service.splat.leverage")  # the package has the function by this name


def change_by_opacity(gaussians: Gaussians, view: Camera, i: int, step: float) -> np.ndarray:
    """(H, W, 3) dC/do of one Gaussian: a picture is linear in each opacity, apart from the cuts."""
    before = render_reference(gaussians, view, background=BEHIND).rgb
    opacities = gaussians.opacities.copy()
    opacities[i] -= np.float32(step)
    after = render_reference(moved(gaussians, opacities=opacities), view, background=BEHIND).rgb
    return (after - before) / (float(opacities[i]) - float(gaussians.opacities[i]))


def change_by_colour(gaussians: Gaussians, view: Camera, i: int) -> np.ndarray:
    """(H, W) the share of each pixel's colour that one Gaussian has: a picture in which it alone is not black."""
    harmonics = np.full((len(gaussians), 1, 3), np.float32(-0.5 / C0))
    harmonics[i] = 0.5 / C0
    return render_reference(moved(gaussians, harmonics=harmonics), view).rgb[..., 0]


def _weights(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """A fifth of the pixels counts nothing."""
    return np.where(rng.uniform(size=shape) < 0.8, rng.uniform(0.1, 2.0, shape), 0.0)


def case(count: int, seed: int, degree: int = 0) -> tuple[Gaussians, Camera, np.ndarray, np.ndarray, np.ndarray]:
    """Gaussians, camera, their picture, a residual and weights, in more than one tile each way."""
    rng = np.random.default_rng(seed)
    view = camera(44, 37)
    gaussians = scene(count, seed, degree)
    gaussians = moved(gaussians, opacities=np.maximum(gaussians.opacities, np.float32(0.02)))
    picture = render(gaussians, view, background=BEHIND).rgb
    return gaussians, view, picture, rng.normal(size=picture.shape), _weights(rng, picture.shape[:2])


def weighed(
    gaussians: Gaussians, view: Camera, picture: np.ndarray, residual: np.ndarray, weight: np.ndarray, **options: Any
) -> Leverage:
    """Whatever is drawn."""
    return leverage(gaussians, view, lambda _: (picture, residual, weight), **options)


def assert_same(one: Leverage, other: Leverage) -> None:
    for field in fields(Leverage):
        assert (getattr(one, field.name) == getattr(other, field.name)).all(), field.name


@pytest.mark.parametrize(("count", "seed", "degree"), [(12, 1, 0), (60, 2, 2), (90, 3, 0)])
def test_slopes_and_moves_are_those_of_the_reference(count: int, seed: int, degree: int) -> None:
    gaussians, view, picture, residual, weight = case(count, seed, degree)
    found = weighed(gaussians, view, picture, residual, weight)
    each = weight[..., None]
    compared = 0
    for i in range(count):
        change, closer = (change_by_opacity(gaussians, view, i, step) for step in (2.0**-11, 2.0**-13))
        if np.abs(change - closer).max() > 1e-9:
            continue  # a pixel went over a cut
        compared += 1
        # Found: at most 4e-7 of the largest slope and move of the scene; float32 adds up some hundred pixels.
        assert found.slope[i] == pytest.approx((each * residual * change).sum(), rel=1e-5, abs=1e-4)
        assert found.moved[i] == pytest.approx((each * change**2).sum(), rel=1e-5, abs=1e-5)
    assert compared >= 0.9 * count
    for i in range(count):
        share = change_by_colour(gaussians, view, i)
        # Found: at most 3e-7 of the largest.
        assert found.shown[i] == pytest.approx((weight * share).sum(), rel=1e-5, abs=1e-5)
        assert found.excess[i] == pytest.approx((each * residual * share[..., None]).sum((0, 1)), rel=1e-5, abs=1e-4)
    assert (found.moved > 0).sum() >= 0.6 * count


def test_a_held_alpha_moves_nothing() -> None:
    """An opacity of 1 is held at 0.99 where the Gaussian is at its height, and moves the pixels around."""
    view = camera(17, 17)
    one = dots([[0.0, 0.0, 2.0]], [1.0], [0.9, 0.5, 0.1], scale=0.6)
    picture = render(one, view).rgb
    everywhere = np.ones((17, 17))
    height = picture[..., 0] / np.float32(0.9)
    assert (height >= 0.9899).any()
    free = height < 0.9899
    found = weighed(one, view, picture, picture, everywhere)
    assert found.slope[0] == pytest.approx((picture[free] ** 2).sum(), rel=1e-5)
    held = weighed(one, view, picture, picture, 1.0 * ~free)
    assert held.moved[0] == 0.0
    assert held.shown[0] == pytest.approx(height[~free].sum(), rel=1e-5)  # its colour does
    assert held.excess[0] == pytest.approx((height[~free, None] * picture[~free]).sum(0), rel=1e-5)


def test_what_is_not_drawn_has_no_weighed() -> None:
    view = camera(24, 24)
    gaussians = dots([[0, 0, 2], [0, 0, -2], [0, 0, 3], [9, 0, 2]], [0.5, 0.5, 0.003, 0.5], 0.7, scale=0.1)
    picture = render(gaussians, view).rgb
    found = weighed(gaussians, view, picture, np.ones_like(picture), np.ones((24, 24)))
    assert found.moved[0] > 0
    assert not found.moved[1:].any()
    assert not found.slope[1:].any()
    assert not found.shown[1:].any()
    assert not found.excess[1:].any()
    none = weighed(gaussians, view, picture, np.ones_like(picture), np.zeros((24, 24)))
    assert not none.moved.any()
    assert not none.shown.any()
    empty = gaussians[np.zeros(4, bool)]
    assert weighed(empty, view, picture, picture, np.ones((24, 24))).slope.shape == (0,)


def test_lists_in_several_batches_go_on_where_the_one_before_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    gaussians, *given = case(90, 3)
    whole = weighed(gaussians, *given)
    monkeypatch.setattr(LEVERAGE, "checked_definition", lambda *_: Definition(max_entries=7))
    parts = weighed(gaussians, *given)
    assert_same(parts, whole)


@pytest.mark.parametrize("several", [False, True])
@pytest.mark.parametrize("wall", [False, True])
def test_what_is_judged_is_drawn_from_the_same_projection(
    monkeypatch: pytest.MonkeyPatch, several: bool, wall: bool
) -> None:
    """Of lists in one batch these are shared too; a wall in front ends drawing before the last of several batches."""
    gaussians, view, _, residual, weight = case(90, 3)
    if wall:
        near = dots([[0.0, 0.0, 0.5]] * 30, [0.99] * 30, (0.3, 0.6, 0.9), 3.0)
        gaussians = joined(near, gaussians)
    expected = render(gaussians, view, outputs=("alpha",))
    whole = weighed(gaussians, view, expected.rgb, residual, weight)
    calls: list[str] = []
    for module, name in (("sight", "project"), ("sight", "depth_order"), ("binning", "_fill")):
        _count(monkeypatch, f"gapmes.service.splat.{module}", name, calls)
    monkeypatch.setattr(LEVERAGE, "checked_definition", lambda *_: Definition(max_entries=7 if several else 10**6))
    drawn: list[Render] = []

    def judge(image: Render) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        drawn.append(image)
        return image.rgb, residual, weight

    assert_same(leverage(gaussians, view, judge), whole)
    assert (drawn[0].rgb == expected.rgb).all()
    assert (drawn[0].alpha == expected.alpha).all()
    assert (calls.count("project"), calls.count("depth_order")) == (1, 1)
    assert calls.count("_fill") > 2 if several else calls.count("_fill") == 1


def _count(monkeypatch: pytest.MonkeyPatch, module: str, name: str, calls: list[str]) -> None:
    """Note each call of a module's function in `calls`."""
    real = getattr(importlib.import_module(module), name)

    def counted(*given: Any, **options: Any) -> Any:
        calls.append(name)
        return real(*given, **options)

    monkeypatch.setattr(f"{module}.{name}", counted)


@pytest.mark.parametrize("several", [False, True])
def test_the_number_of_threads_does_not_matter(monkeypatch: pytest.MonkeyPatch, several: bool) -> None:
    gaussians, *given = case(90, 6)
    if several:
        monkeypatch.setattr(LEVERAGE, "checked_definition", lambda *_: Definition(max_entries=7))
    one, *others = (weighed(gaussians, *given, threads=threads) for threads in (1, 2, 3, 5))
    for other in others:
        assert_same(one, other)


@pytest.mark.parametrize(("width", "height"), [(44, 37), (300, 20), (20, 300), (200, 170)])
def test_a_part_has_sums_for_whoever_its_tiles_list(width: int, height: int) -> None:
    """Those of others are not even cleared: who is listed is among its members, and hardly anybody else."""
    gaussians, view = scene(400, 7, 0, (1e-3, 1.0)), camera(width, height)
    with sight(gaussians, view, Definition(), 0, 1) as seen:
        (lists,) = seen.lists()
        listed = [lists.members[start:end] for start, end in pairwise(lists.offsets)]
        for first, last in combinations(range(seen.grid.tiles + 1), 2):
            part = part_of(seen, first, last)
            assert set(part.members) >= set(np.concatenate(listed[first:last]))
            assert len(set(part.members)) == len(part.members)
            assert (part.sums[part.members] == 0).all()
            assert np.isnan(np.delete(part.sums, part.members, axis=0)).all()
        rows = [part_of(seen, row, row + seen.grid.columns) for row in range(0, seen.grid.tiles, seen.grid.columns)]
        boxed = [[unpacked_box(box)[2:] for box in seen.projection.space.boxes[row.members]] for row in rows]
        assert all(top <= number <= bottom for number, row in enumerate(boxed) for top, bottom in row)


def part_of(seen: Sight, first: int, last: int) -> Part:
    """In a room of NaN."""
    room = Room.of(seen)
    room.sums[:] = np.nan
    return Part.of(seen, room, first, last)


@pytest.mark.parametrize(("width", "height"), [(44, 37), (300, 20), (20, 300), (200, 170)])
def test_all_parts_at_once_write_to_little_more_than_the_whole(width: int, height: int) -> None:
    """Of Gaussians of a pixel or a few: only those at the edges of the parts are in more than one."""
    with sight(scene(400, 7, 0, (1e-3, 0.05)), camera(width, height), Definition(), 0, 1) as seen:
        edges = [seen.grid.tiles * part // LEVERAGE.PARTS for part in range(LEVERAGE.PARTS + 1)]
        written = sum(len(part_of(seen, *ends).members) for ends in pairwise(edges))
        assert len(seen.order) <= written < 1.3 * len(seen.order)  # found: 1.04 to 1.15


def test_the_order_of_the_gaussians_does_not_matter() -> None:
    gaussians, *given = case(90, 4)
    order = np.random.default_rng(0).permutation(90)
    found, other = weighed(gaussians, *given), weighed(gaussians[order], *given)
    assert_same(other, Leverage(*(getattr(found, field.name)[order] for field in fields(Leverage))))


def test_pixels_without_weight_may_hold_anything() -> None:
    gaussians, view, picture, residual, weight = case(60, 5)
    expected = weighed(gaussians, view, picture, residual, weight)
    picture, left_out = picture.astype(np.float64), weight == 0
    picture[left_out], residual[left_out] = (np.nan, 1e300, -1e300), (np.inf, np.nan, 1e300)
    found = weighed(gaussians, view, picture, residual, weight)
    assert_same(found, expected)


@pytest.mark.parametrize("name", ["picture", "residual", "weight"])
def test_planes_of_another_size_are_refused(name: str) -> None:
    gaussians, view, *planes = case(3, 0)
    given = dict(zip(("picture", "residual", "weight"), planes, strict=True))
    given[name] = given[name][:1]
    with pytest.raises(InputError, match=r"\(1, 44.*need \(37, 44"):
        weighed(gaussians, view, **given)


def test_sums_of_another_set_are_refused() -> None:
    gaussians, *given = case(3, 0)
    with pytest.raises(InputError, match="onto: is of 2 Gaussians, need 3"):
        weighed(gaussians, *given, onto=Leverage.of(2))


def test_strided_and_read_only_planes_are_weighed_alike_by_the_same_kernels() -> None:
    gaussians, view, *planes = case(40, 2)
    expected = weighed(gaussians, view, *planes)
    spread = [np.repeat(plane, 2, axis=1)[:, ::2] for plane in planes]
    for plane in spread:
        plane.flags.writeable = False
    opacities = np.repeat(gaussians.opacities, 2)[::2]
    opacities.flags.writeable = False
    assert_same(weighed(moved(gaussians, opacities=opacities), view, *spread), expected)
    for kernel in (LEVERAGE.fill_tiles, list_reaching, add_part, LEVERAGE.leverage_tiles):
        assert len(kernel.signatures) == 1  # nothing is compiled while a request waits


def test_a_near_plane_that_makes_no_sense_is_refused() -> None:
    gaussians, *given = case(3, 0)
    with pytest.raises(InputError, match="near"):
        weighed(gaussians, *given, near=-1.0)


def test_sums_go_on_over_several_pictures() -> None:
    gaussians, view, picture, residual, weight = case(40, 5, 0)
    one, two = (
        weighed(gaussians, view, picture, residual, weight),
        weighed(gaussians, view, picture, -residual, weight),
    )
    both = weighed(gaussians, view, picture, residual, weight)
    assert weighed(gaussians, view, picture, -residual, weight, onto=both) is both
    for field in fields(Leverage):
        parts = getattr(one, field.name), getattr(two, field.name)
        rounding = 1e-13 * max(np.abs(part).max() for part in parts)  # eight float64 numbers in another order
        np.testing.assert_allclose(getattr(both, field.name), sum(parts), rtol=1e-13, atol=rounding)
    assert both.moved.any()


def test_sums_that_go_on_do_not_depend_on_the_number_of_threads() -> None:
    gaussians, view, picture, residual, weight = case(40, 5, 0)
    found = []
    for threads in (1, 2, 5):
        both = weighed(gaussians, view, picture, residual, weight, threads=threads)
        found.append(weighed(gaussians, view, picture, -residual, weight, threads=threads, onto=both))
    for other in found[1:]:
        assert_same(found[0], other)
