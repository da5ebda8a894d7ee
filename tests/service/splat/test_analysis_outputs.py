"""Median depth, peak weights, removed mass and counted pairs: against the reference, and their invariants."""

from dataclasses import replace

import numpy as np
import pytest
from splat_cases import bits, camera, dots, scene

from gapmes.service.errors import InputError
from gapmes.service.splat import INRIA, Definition, render, render_reference
from gapmes.service.splat.options import OUTPUTS


def halves(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).random(count) < 0.5


@pytest.mark.parametrize("rule", [Definition(), INRIA, Definition(stop=0.05)], ids=["own", "inria", "early stop"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_all_outputs_match_the_reference(rule, seed):
    """Measured: masses 5.7e-7, peaks 1.3e-7; medians and pairs are equal on these scenes, no pixel lies on an edge."""
    gaussians, view, subset = scene(250, seed, 1), camera(), halves(250, seed)
    ours = render(gaussians, view, definition=rule, outputs=OUTPUTS, subset=subset)
    true = render_reference(gaussians, view, definition=rule, subset=subset)
    off_edge = np.abs(ours.alpha - true.alpha) < 2e-6
    assert off_edge.mean() > 0.99
    assert np.abs(ours.removed - true.removed)[off_edge].max() < 2e-6
    same = np.abs(ours.median - true.median) <= 1e-6 * true.median
    assert same[off_edge].mean() > 0.999  # but where the transmittance passes 1/2 within a rounding
    # A Gaussian may peak on the edge of a cut: then it differs by what the cut lets through.
    assert np.quantile(np.abs(ours.peaks - true.peaks), 0.98) < 2e-6
    assert abs(ours.stats["pairs"] - true.stats["pairs"]) < 2e-4 * true.stats["pairs"]


@pytest.mark.case("S2")
def test_what_is_asked_for_changes_no_other_plane():
    gaussians, view, subset = scene(300, 4), camera(70, 50), halves(300, 4)
    plain = render(gaussians, view)
    for names in (("median",), ("peaks", "depth"), OUTPUTS):
        image = render(gaussians, view, outputs=names, subset=subset if "removed" in names else None)
        assert image.rgb.tobytes() == plain.rgb.tobytes()
        for name in ("alpha", "depth"):
            assert getattr(image, name).tobytes() == (getattr(plain, name).tobytes() if name in names else b"")
        for name in ("median", "removed", "peaks"):
            assert (getattr(image, name).size > 0) == (name in names)
        assert ("pairs" in image.stats) == ("pairs" in names)
    assert bits(render(gaussians, view)) == bits(plain)  # the marks of a subset are gone


@pytest.mark.case("E9")
@pytest.mark.parametrize("rule", [Definition(), INRIA])
def test_threads_and_batches_give_the_same_bits(rule):
    gaussians, view, subset = scene(300, 5), camera(100, 70), halves(300, 5)
    options = {"outputs": OUTPUTS, "subset": subset}
    one = render(gaussians, view, definition=rule, threads=1, **options)
    for threads, entries in ((2, 1 << 24), (5, 1 << 24), (2, 60)):
        other = render(gaussians, view, definition=replace(rule, max_entries=entries), threads=threads, **options)
        for name in ("rgb", "depth", "median", "removed", "peaks"):
            assert getattr(other, name).tobytes() == getattr(one, name).tobytes()
        assert other.stats["pairs"] == one.stats["pairs"]


@pytest.mark.case("S1")
def test_shares_of_a_partition_add_up_to_the_opacity():
    gaussians, view = scene(400, 6), camera()
    subset = halves(400, 6)
    shares = [render(gaussians, view, outputs=("removed",), subset=s).removed for s in (subset, ~subset)]
    alpha = render(gaussians, view).alpha
    assert np.abs(sum(shares) - alpha).max() < 2e-6
    nobody = render(gaussians, view, outputs=("removed",), subset=np.zeros(400, bool))
    assert not nobody.removed.any()


@pytest.mark.case("S1")
@pytest.mark.parametrize("seed", range(6))
def test_leaving_gaussians_out_moves_no_colour_by_more_than_their_mass(seed):
    """|C - C'| <= m R per channel, R the range of colours and background: the freed mass m reappears on what is kept.

    The early stop of either image adds at most its own share.
    """
    rng = np.random.default_rng(seed)
    gaussians, view = scene(300, seed), camera()
    subset = rng.random(300) < rng.choice([0.02, 0.2, 0.7])
    behind = rng.uniform(0, 1, 3)
    whole = render(gaussians, view, background=behind, outputs=("removed",), subset=subset)
    without = render(gaussians[~subset], view, background=behind)
    colours = np.maximum(0.5 + 0.28209479 * gaussians.harmonics[:, 0], 0.0)
    extent = np.maximum(colours.max(axis=0), behind) - np.minimum(colours.min(axis=0), behind)
    bound = (whole.removed[..., None] + 2 * Definition().stop) * extent + 2e-6
    difference = np.abs(whole.rgb - without.rgb)
    assert (difference <= bound).all()
    assert (difference > 0.01 * bound).mean() > 0.05  # and the bound says something


def test_peaks_are_those_of_single_dots():
    """Dots apart from each other have their opacity as peak; hidden, faint and out-of-view ones have none."""
    view = camera(32, 32, 32.0)
    at = [[(x + 0.5 - 16) / 32, (y + 0.5 - 16) / 32, 1.0] for x, y in ((4, 4), (20, 5), (9, 25))]
    means = [*at, [5.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.2, 0.2, 1.0], [*(2 * np.array(at[0]))]]
    opacities = [0.25, 0.5, 1.0, 0.9, 0.9, 1e-3, 0.5]
    image = render(dots(means, opacities, (1, 1, 1)), view, outputs=("peaks", "median", "pairs"))
    expected = [0.25, 0.5, Definition().alpha_max, 0, 0, 0, 0.5 * 0.75]
    assert np.abs(image.peaks - expected).max() < 1e-6
    assert image.median[5, 20] == np.float32(1.0)  # an opacity of exactly one half takes half of the light
    assert image.median[4, 4] == np.float32(2.0)
    assert image.median[0, 0] == 0.0


def test_a_subset_goes_with_its_output():
    gaussians, view = scene(10, 7), camera()
    with pytest.raises(InputError, match=r"subset.*give one"):
        render(gaussians, view, outputs=("removed",))
    with pytest.raises(InputError, match="ask for 'removed'"):
        render(gaussians, view, subset=np.ones(10, bool))
    with pytest.raises(InputError, match=r"\(9,\) of bool, need \(10,\)"):
        render(gaussians, view, outputs=("removed",), subset=np.ones(9, bool))
    with pytest.raises(InputError, match="int64"):
        render(gaussians, view, outputs=("removed",), subset=np.arange(10))


@pytest.mark.parametrize("seed", range(4))
def test_faint_layers_are_removed_mass_of_the_reference(seed):
    """What a cut between the two definitions takes away is at most the weights of those layers."""
    gaussians, view = scene(count=3, seed=seed), camera()
    fine, coarse = Definition(alpha_min=1e-6, stop=0.0), Definition(alpha_min=0.05, stop=0.0)
    whole = render_reference(gaussians, view, definition=fine, faint=0.05)
    cut = render_reference(gaussians, view, definition=coarse)
    some = (whole.removed > 0) & (whole.removed < 0.05)
    assert some.any()
    lost = whole.alpha - cut.alpha  # with one layer less what lies behind it gains light, so that less is lost
    assert (lost[some] > 0).all()
    assert (lost <= whole.removed + 1e-12).all()
    assert (whole.removed[whole.alpha == cut.alpha] == 0).all()
    both = render_reference(gaussians, view, definition=fine, faint=2.0)
    assert both.removed == pytest.approx(both.alpha, abs=1e-12)
