"""Parts of the bound of leaving out that random scenes hardly need: the early stop, and the edges of footprints."""

import math

import numpy as np
import pytest
from clouds import cloud, view

from gapmes.service.cameras.camera import Camera
from gapmes.service.gaussians import Gaussians
from gapmes.service.leaving_out.pruning import colour_range, largest_change, prune, reaches, removal_bound
from gapmes.service.splat import Definition, render, render_reference

SH_C0 = 0.28209479177387814
PIXEL = Camera.make(1, 1, 1.0, 1.0, 0.5, 0.5, np.eye(4))


def behind_each_other(opacities: list[float], greys: list[float]) -> Gaussians:
    """Round ones in the middle of the pixel."""
    count = len(opacities)
    constants = np.repeat((np.array(greys) - 0.5)[:, None, None] / SH_C0, 3, axis=2)
    turned = np.tile([1.0, 0, 0, 0], (count, 1))
    return Gaussians.make(
        np.outer(np.linspace(1, 2, count), [0, 0, 1]), np.full((count, 3), 0.01), turned, opacities, constants
    )


@pytest.mark.case("S1")
@pytest.mark.parametrize("stop", [1e-3, 0.05])
def test_what_the_stop_hides_is_in_the_bound(stop: float) -> None:
    """With a faint black layer the pixel just ends before a white one, without it it just does not: that shows what is
    stop times as bright, whatever the faint layer weighs."""
    faint, rule = 0.004, Definition(stop=stop, alpha_max=1.0)
    dark = 1 - stop / (1 - faint / 2)
    scene, gone = behind_each_other([faint, dark, 1.0], [0.0, 0.0, 1.0]), np.array([True, False, False])
    before, after = (render(some, PIXEL, definition=rule) for some in (scene, scene[~gone]))
    change = largest_change([after], [before])
    assert stop < change < 1.01 * stop
    mass = float(render(scene, PIXEL, outputs=("removed",), subset=gone, definition=rule).removed.max())
    assert change <= removal_bound(scene, gone, [PIXEL], definition=rule) < mass + 1.01 * stop
    found = prune(scene, [PIXEL], 10 * (mass + stop), may_go=gone, worth=0, pictures=1, definition=rule)
    assert found.dropped == 1
    assert found.actual == change <= found.bound


@pytest.mark.parametrize("down", [slice(0, 12), slice(12, 22), slice(22, 30)])
@pytest.mark.parametrize("across", [slice(0, 16), slice(16, 26), slice(26, 40)])
def test_marks_beside_a_gaussian_neither_reach_it_nor_hide_one_that_does(down: slice, across: slice) -> None:
    """It is drawn within 3 px of (20.5, 16.5)."""
    camera = Camera.make(40, 30, 40.0, 40.0, 20.5, 16.5, np.eye(4))
    one = Gaussians.make([[0.0, 0, 4.0]], [[0.03] * 3], [[1.0, 0, 0, 0]], [0.9], np.zeros((1, 1, 3)))
    beside, drawn = np.zeros((30, 40), bool), render(one, camera, threads=1).alpha > 0
    beside[down, across] = True
    beside[11:23, 15:27] = False
    assert np.argwhere(drawn).min(axis=0).tolist() >= [13, 17]
    assert np.argwhere(drawn).max(axis=0).tolist() <= [19, 23]
    assert not reaches(one, camera, beside, Definition()).any()
    for row, column in np.argwhere(drawn):
        marked = beside.copy()
        marked[row, column] = True
        assert reaches(one, camera, marked, Definition()).all()


def test_a_removal_is_bounded_by_its_weight_with_what_is_rounded_and_what_the_stop_hides() -> None:
    """Behind a half, 0.4 weighs 0.2; four roundings and one for each layer, twice. What is not there costs nothing."""
    gaussians, each = behind_each_other([0.5, 0.4, 0.3], [0.2, 0.5, 0.9]), 2.0**-24 * (3 + 4)
    expected = 0.2 * (1 + 2 * each) + (1 + each) * 1e-4 + 2 * each
    bound = removal_bound(gaussians, np.array([False, True, False]), [PIXEL], definition=Definition(stop=1e-4))
    assert bound == pytest.approx(expected, rel=2e-7)
    assert removal_bound(gaussians, np.zeros(3, bool), [PIXEL]) == 0.0


@pytest.mark.parametrize("coefficient", range(16))
def test_the_range_is_that_of_the_brightest_colour_by_its_bands(coefficient: int) -> None:
    """Of one coefficient of 4 in one channel: its band's norm times 4 above a half; unclamped below 1."""
    band = math.isqrt(coefficient)
    for value in (4.0, -4.0, 0.01):
        harmonics = np.zeros((3, 16, 3))
        harmonics[1, coefficient, 2] = value
        gaussians = Gaussians.make(np.ones((3, 3)), np.ones((3, 3)), [[1.0, 0, 0, 0]] * 3, np.ones(3), harmonics)
        change = value if band == 0 else abs(value)
        expected = max(1.0, 0.5 + math.sqrt((2 * band + 1) / (4 * math.pi)) * change)
        assert colour_range(gaussians) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("focal", [12.0, 400.0])
@pytest.mark.parametrize("middle", [20.0, 6.0, 34.0])
@pytest.mark.parametrize("seed", range(40))
def test_the_outermost_pixels_that_a_ball_marks_count_as_reached(focal: float, middle: float, seed: int) -> None:
    """Through a long lens its outline is as wide as the bounding square; through a wide one the affine projection
    stretches it away from the principal point, also that of a ball beside the picture."""
    rng = np.random.default_rng(seed)
    focals = focal * np.array([(1.0, 1.0), (0.5, 1.0), (1.0, 0.5)][seed % 3])
    camera = Camera.make(40, 40, *focals, middle, middle, np.eye(4))
    at = (rng.uniform(*((2, 38) if seed % 2 else (-8, 48)), 2) - middle) / focals
    size = rng.uniform(1.0, 4.0) / focal
    ball = Gaussians.make([[*at, 1.0]], [[size] * 3], [[1.0, 0, 0, 0]], [0.9], np.zeros((1, 1, 3)))
    rule = Definition()
    marked = np.argwhere(render_reference(ball, camera, definition=rule).alpha > 0)
    ends = ((axis, end) for axis in (0, 1) for end in (np.argmin, np.argmax)) if len(marked) else ()
    for row, column in {tuple(marked[end(marked[:, axis])]) for axis, end in ends}:
        pixel = np.zeros((40, 40), bool)
        pixel[row, column] = True
        assert reaches(ball, camera, pixel, rule).all()


@pytest.mark.case("S1")
def test_a_removal_changes_no_colour_by_more_than_their_range() -> None:
    """What covers a pixel alone has all of its weight: no rounding beyond."""
    gaussians, rule = behind_each_other([1.0], [0.9]), Definition(alpha_max=1.0)
    assert removal_bound(gaussians, np.ones(1, bool), [PIXEL], definition=rule) == colour_range(gaussians) == 1.0


def test_where_nothing_may_go_nothing_changes_and_the_mask_stays_the_callers() -> None:
    gaussians, cameras = cloud(60, 3), [view(-0.1), view(0.1)]
    none = prune(gaussians, cameras, 0.3, may_go=np.zeros(60, bool), worth=0, pictures=2)
    assert (none.dropped, none.bound, none.actual) == (0, 0.0, 0.0)
    may_go = np.arange(60) % 3 > 0
    before = may_go.copy()
    found = prune(gaussians, cameras, 0.3, may_go=may_go, worth=0)
    assert 0 < found.dropped < before.sum()
    assert not (~found.keep & ~before).any()
    np.testing.assert_array_equal(may_go, before)


def test_what_is_left_to_go_after_the_second_look_may_be_too_little() -> None:
    """Two hundred faint layers in one place, of which each alone could go, and one out of sight: all stay. With more of
    those, they go."""
    for hidden, dropped in ((1, 0), (9, 9)):
        z = np.concatenate([2 + 0.001 * np.arange(200), np.full(hidden, -3.0)])
        means, count = np.outer(z, [0, 0, 1]), 200 + hidden
        turned = np.tile([1.0, 0, 0, 0], (count, 1))
        scene = Gaussians.make(means, np.full((count, 3), 0.1), turned, np.full(count, 0.0045), np.zeros((count, 1, 3)))
        result = prune(scene, [view()], 0.05)
        assert (result.dropped, result.unseen, result.bound) == (dropped, dropped, 0.0)
