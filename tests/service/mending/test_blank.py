"""A blank backdrop moves to the far end if photographs contradict its depths; other black or white regions stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plane_scene import DEPTH
from plane_views import SIDE, in_another_world, plane_depths, plane_views

from gapmes.service.cameras.rotations import about_axis
from gapmes.service.matching.coarse_views import pixel_grid
from gapmes.service.matching.correspondence import views_with_parallax
from gapmes.service.mending import blank as module
from gapmes.service.mending.blank import BLANK, CONTRADICTED, EVEN, LEAST_SHARE, blank_held, blank_moved
from gapmes.service.photographs.from_border import from_border
from gapmes.service.photographs.images import FittedView

FAR = 2 * DEPTH
BEFORE = 0.75 * DEPTH  # where the network puts the black between poster and cameras


def points(view: FittedView) -> np.ndarray:
    """(H, W, 2) where rays meet the plane of the poster."""
    rays = view.camera.rays(pixel_grid((SIDE, SIDE)))
    met = view.camera.center + rays * ((DEPTH - view.camera.center[2]) / rays[:, 2])[:, None]
    return met[:, :2].reshape(SIDE, SIDE, 2)


def posters(count: int = 2, dark: float = 0.02) -> tuple[list[FittedView], np.ndarray]:
    """A textured poster before black with noise up to `dark`, and (V, H, W) which pixels are black."""
    rng, views, black = np.random.default_rng(3), [], []
    for view in plane_views()[:count]:
        outside = (np.abs(points(view) - (0.1, 0.1)) > (0.9, 0.6)).any(axis=-1)
        noise = rng.uniform(0, dark, view.image.shape).astype(np.float32)
        lit = np.maximum(view.image, np.float32(0.2))
        views.append(replace(view, image=np.where(outside, noise, lit)))
        black.append(outside)
    return views, np.stack(black)


def inverted(views: list[FittedView]) -> list[FittedView]:
    """The same in front of white."""
    return [replace(view, image=1 - view.image) for view in views]


@pytest.fixture(scope="module", params=[(2, False), (3, False), (2, True)], ids=["two", "three", "two, before white"])
def scene(request: pytest.FixtureRequest) -> tuple[list[FittedView], np.ndarray]:
    count, white = request.param
    views, black = posters(count)
    return inverted(views) if white else views, black


def with_black_at(views: list[FittedView], black: np.ndarray, depth: float) -> np.ndarray:
    return np.where(black, depth, plane_depths(views))


def test_black_that_covers_what_others_see_goes_to_the_far_end(scene: tuple[list[FittedView], np.ndarray]) -> None:
    views, black = scene
    depths = with_black_at(views, black, BEFORE)
    found = blank_moved(views, depths, FAR)
    assert (found[black] == FAR).all()
    assert (found[~black] == depths[~black]).all()
    assert (depths[black] == BEFORE).all()  # what was given is left


def test_black_at_its_own_depth_stays(scene: tuple[list[FittedView], np.ndarray]) -> None:
    views, black = scene
    for depth in (FAR, 0.9 * FAR):
        depths = with_black_at(views, black, depth)
        assert blank_moved(views, depths, FAR) is depths


def test_what_is_farther_than_far_stays_there() -> None:
    views, black = posters()
    depths = with_black_at(views, black, BEFORE)
    corner = np.zeros_like(black)
    corner[:, :4, :4] = True
    assert black[corner].all()
    depths[corner] = 3 * FAR
    found = blank_moved(views, depths, FAR)
    assert (found[corner] == 3 * FAR).all()
    assert (found[black & ~corner] == FAR).all()


def test_black_and_white_are_moved_apart() -> None:
    """What is blank in the left third is white: each goes to the far end by itself, while the other is there."""
    views, black = posters()
    left = np.zeros_like(black)
    left[:, :, : SIDE // 3] = True
    white = black & left
    both = [
        replace(view, image=np.where(of_view, np.float32(0.99), view.image))
        for view, of_view in zip(views, white, strict=True)
    ]
    depths = with_black_at(views, black & ~white, BEFORE)
    depths[white] = FAR
    found = blank_moved(both, depths, FAR)
    assert (found[black] == FAR).all()
    depths[white], depths[black & ~white] = BEFORE, FAR
    found = blank_moved(both, depths, FAR)
    assert (found[black] == FAR).all()


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e6])
def test_world_and_unit_change_nothing(unit: float) -> None:
    views, black = posters()
    turn = about_axis(np.array([0.3, 1.0, -0.2]), 1.1)
    moved = in_another_world(views, turn, unit * np.array([5.0, -3.0, 2.0]), unit)
    found = blank_moved(moved, unit * with_black_at(views, black, BEFORE), unit * FAR)
    assert (found[black] == unit * FAR).all()
    right = unit * with_black_at(views, black, FAR)
    assert blank_moved(moved, right, unit * FAR) is right


@pytest.mark.parametrize("white", [False, True])
def test_dark_and_bright_things_have_shades_and_stay(white: bool) -> None:
    """Evenly spread over levels to twice BLANK, a quarter is below half of it."""
    views, black = posters(dark=2 * BLANK)
    views = inverted(views) if white else views
    depths = with_black_at(views, black, BEFORE)
    assert blank_moved(views, depths, FAR) is depths


@pytest.mark.parametrize("white", [False, True])
@pytest.mark.parametrize("spread", [0.004, 0.02])
def test_a_lifted_or_noisy_backdrop_goes_as_well(white: bool, spread: float) -> None:
    """Most of it is above half of BLANK, but close to its own level."""
    rng, lifted = np.random.default_rng(5), []
    views, black = posters()
    for view, of_view in zip(views, black, strict=True):
        ground = rng.normal(0.6 * BLANK, spread / 3, view.image.shape).clip(0, None).astype(np.float32)
        lifted.append(replace(view, image=np.where(of_view, ground, view.image)))
    lifted = inverted(lifted) if white else lifted
    found = blank_moved(lifted, with_black_at(lifted, black, BEFORE), FAR)
    assert (found[black] == FAR).mean() > 0.95
    right = with_black_at(lifted, black, FAR)
    assert blank_moved(lifted, right, FAR) is right


@pytest.mark.parametrize(("then", "moves"), [(0.49, True), (0.51, False)])
def test_contradictions_must_fall_where_a_backdrop_is_even_above_its_level_alone(
    then: float, moves: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    views, black = posters()
    lifted = [
        replace(view, image=np.where(of_view, np.float32(0.6 * BLANK), view.image))
        for view, of_view in zip(views, black, strict=True)
    ]
    depths, shares = with_black_at(views, black, BEFORE), iter([0.02, 0.02 * then])
    monkeypatch.setattr(module, "_contradicted", lambda *_: next(shares))
    assert (blank_moved(lifted, depths, FAR) is not depths) == moves


def test_black_inside_the_picture_stays() -> None:
    """A frame of brighter pixels parts it from the border."""
    views, black = posters()
    framed = []
    for view in views:
        image = view.image.copy()
        image[:, [0, -1]] = image[:, :, [0, -1]] = 0.5
        framed.append(replace(view, image=image))
    depths = with_black_at(views, black, BEFORE)
    assert blank_moved(framed, depths, FAR) is depths


def test_masked_black_is_nobodys_and_stays() -> None:
    views, black = posters()
    masked = [replace(view, mask=~of_view) for view, of_view in zip(views, black, strict=True)]
    depths = with_black_at(views, black, BEFORE)
    assert blank_moved(masked, depths, FAR) is depths
    half = black[0].copy()
    half[:, SIDE // 2 :] = False
    views[0] = replace(views[0], mask=~half)
    found = blank_moved(views, depths, FAR)
    assert (found[0][half] == BEFORE).all()
    assert (found[0][black[0] & ~half] == FAR).all()


def test_little_black_stays() -> None:
    views, black = posters()
    rows = np.arange(SIDE)[:, None] < LEAST_SHARE * SIDE / 2
    little = [
        replace(view, image=np.where(of_view & ~rows, np.float32(0.3), view.image))
        for view, of_view in zip(views, black, strict=True)
    ]
    depths = with_black_at(views, black, BEFORE)
    assert blank_moved(little, depths, FAR) is depths


def test_views_from_one_place_tell_nothing() -> None:
    view, black = (one[0] for one in posters())
    depths = with_black_at([view, view], np.stack([black, black]), BEFORE)
    assert blank_moved([view, view], depths, FAR) is depths


@pytest.mark.parametrize(
    ("now", "then", "moves"),
    [
        (CONTRADICTED, 2 * CONTRADICTED, True),
        (0.99 * CONTRADICTED, 0.0, False),
        (0.05, 0.0, True),
        (0.05, 0.051 + CONTRADICTED, False),
    ],
)
def test_both_limits(now: float, then: float, moves: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    views, black = posters()
    depths, shares = with_black_at(views, black, BEFORE), iter([now, then])
    monkeypatch.setattr(module, "_contradicted", lambda *_: next(shares))
    assert (blank_moved(views, depths, FAR) is not depths) == moves


@pytest.mark.parametrize(("share", "moves"), [(EVEN + 0.05, True), (EVEN - 0.05, False)])
def test_so_much_of_the_dark_must_be_black(share: float, moves: bool) -> None:
    """Of the black pixels that share below half of BLANK, the others just below twice."""
    views, black = posters()
    rng, shaded = np.random.default_rng(4), []
    for view, of_view in zip(views, black, strict=True):
        image = view.image.copy()
        grey = of_view & (rng.uniform(size=of_view.shape) > share)
        image[:, of_view], image[:, grey] = BLANK / 2 - 0.001, 2 * BLANK - 0.001
        shaded.append(replace(view, image=image))
    depths = with_black_at(views, black, BEFORE)
    found = blank_moved(shaded, depths, FAR)
    assert (found != depths).any() == moves


def test_contradictions_are_what_the_definition_says() -> None:
    """Pixel by pixel through the cameras' own projections; what is within rounding of a limit is not compared. Of what
    lies out of the second view's picture, or on what its mask leaves out, it tells nothing."""
    views, black = posters(3)
    mask = np.ones((SIDE, SIDE), np.bool_)
    mask[20:50, 30:] = False
    views[1] = replace(views[1], mask=mask)
    rng = np.random.default_rng(9)
    depths = with_black_at(views, black, BEFORE) * rng.uniform(0.9, 1.1, black.shape)
    contradicted, untold = 0, 0
    for index, view in enumerate(views):
        found = module._contradictions(views, index, views_with_parallax(views, index, depths[index]), depths)
        for y, x in rng.integers(0, SIDE, (400, 2)):
            ray = view.camera.rays(np.array([[x + 0.5, y + 0.5]]))[0]
            point = view.camera.center + depths[index, y, x] * ray
            expected, margin = False, np.inf
            for other, second in enumerate(views):
                if other == index:
                    continue
                (place,), (z,) = second.camera.project(point[None])
                u, v = np.clip(place - 0.5, 0, SIDE - 1)
                i, j = int(u), int(v)
                k, n = min(i + 1, SIDE - 1), min(j + 1, SIDE - 1)
                weights = (1 - v + j) * (1 - u + i), (1 - v + j) * (u - i), (v - j) * (1 - u + i), (v - j) * (u - i)
                corners = (j, i), (j, k), (n, i), (n, k)
                colour = sum(w * second.image[:, a, b] for w, (a, b) in zip(weights, corners, strict=True))
                theirs = sum(w / depths[other, a, b] for w, (a, b) in zip(weights, corners, strict=True))
                way = np.linalg.norm(view.camera.center - second.camera.center) * second.camera.fx
                differs = np.abs(colour - view.image[:, y, x]).mean() - 0.1
                open_way = 1 - (theirs - 1 / z) * way
                inside = min(*place, *(SIDE - place))
                kept = all(second.kept[a, b] for a, b in corners)
                expected |= bool(inside > 0 and kept and differs > 0 and open_way > 0)
                untold += bool(not (inside > 0 and kept) and differs > 0 and open_way > 0)
                margin = min(margin, abs(differs), abs(open_way), abs(inside))
            if margin > 0.02:  # a lens whose pixels are not square moves what lies ahead a little less
                contradicted += expected
                assert found[y, x] == expected
    assert contradicted > 50
    assert untold > 10


@pytest.mark.parametrize(
    ("colour", "blank"),
    [
        ((0.0594, 0.0594, 0.0594), True),
        ((0.0606, 0.0606, 0.0606), False),
        ((0.0, 0.0, 0.15), False),
        ((0.941, 0.941, 0.941), True),
        ((0.939, 0.939, 0.939), False),
        ((1.0, 1.0, 0.85), False),
    ],
)
def test_what_is_blank(colour: tuple[float, ...], blank: bool) -> None:
    """Every channel counts. Three tenths of the ground have the colour, the others are black, or white."""
    views, black = posters()
    image = np.full(views[0].image.shape, round(np.mean(colour)), np.float32)
    drawn = np.random.default_rng(6).uniform(size=black.shape) < 0.3
    drawn &= black
    given = []
    for view, ground, dots in zip(views, black, drawn, strict=True):
        picture = np.where(ground, image, np.clip(view.image, 0.2, 0.8))
        picture[:, dots] = np.array(colour, np.float32)[:, None]
        given.append(replace(view, image=picture))
    depths = with_black_at(given, black, BEFORE)
    found = blank_moved(given, depths, FAR)
    joined = np.stack([from_border(ground & ~dots) for ground, dots in zip(black, drawn, strict=True)])
    assert joined.sum() > 0.6 * black.sum()
    assert (found == (np.where(black if blank else joined, FAR, depths))).all()


def test_what_is_brighter_than_twice_the_limit_is_no_shade() -> None:
    """With 45 % of the ground at 2.1 times BLANK the rest goes, with as much at 1.9 times it stays."""
    views, black = posters()
    rng, moved = np.random.default_rng(8), []
    dots = black & (rng.uniform(size=black.shape) < 0.45)
    for level in (1.9 * BLANK, 2.1 * BLANK):
        given = []
        for view, of_view in zip(views, dots, strict=True):
            image = view.image.copy()
            image[:, of_view] = level
            given.append(replace(view, image=image))
        depths = with_black_at(given, black, BEFORE)
        moved.append((blank_moved(given, depths, FAR) != depths).any())
    assert moved == [False, True]


def test_limits_are_those_of_the_documentation() -> None:
    assert (BLANK, LEAST_SHARE, CONTRADICTED) == (0.06, 0.02, 0.015)
    assert pytest.approx(2 / 3) == EVEN


def test_what_stood_at_the_far_end_is_held() -> None:
    """As float32 has it, and only what is blank up to the border."""
    views, black = posters()
    before = with_black_at(views, black, np.float64(np.float32(FAR)) * (1 - 5e-8))
    before[:, :2, :2] = BEFORE
    before[0, SIDE // 2, SIDE // 2] = FAR
    after = before * 0.9
    held = black.copy()
    held[:, :2, :2] = False
    assert (blank_held(views, before, after, FAR) == np.where(held, before, after)).all()
