"""Knobs of the definition against the float64 reference, and exact skipping inside a tile."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from splat_cases import bits, camera, compare, dots, scene

from gapmes.service.errors import InputError
from gapmes.service.gaussians import Gaussians
from gapmes.service.scenes.gaussians_cache import size_of
from gapmes.service.splat import INRIA, Definition, render, render_views
from gapmes.service.splat.blend import PIECE, REACH_SLACK, measure_reach
from gapmes.service.splat.prepare import BLOCK, Workspace, prepared
from gapmes.service.splat.vectors import SIDE

SMOOTH = 2e-6  # as in test_render_accuracy.py
RULES = {
    "3 sigma": Definition(cut_radius=3.0),
    "1.5 sigma": Definition(cut_radius=1.5),
    "inria": INRIA,
    "stop before, early": Definition(inclusive_stop=False, stop=0.05),
    "early stop": Definition(stop=0.05),
    "high alpha cut": Definition(alpha_min=0.05),
    "low alpha cut": Definition(alpha_min=1e-4),
    "wide dilation": Definition(dilation=1.2),
    "opaque": Definition(alpha_max=1.0, stop=0.0),
}


@pytest.mark.parametrize("name", RULES)
def test_every_knob_means_the_same_in_the_reference(name):
    for seed in (1, 2):
        result = compare(scene(150, seed, 1), camera(), RULES[name])
        assert result.smooth < SMOOTH
        assert result.on_edge < 0.02


@pytest.mark.case("E5", "E6")
def test_knobs_change_the_image_by_no_more_than_their_bounds():
    gaussians, view = scene(300, 3), camera()
    exact = render(gaussians, view, definition=Definition(stop=0.0))
    top = float(exact.rgb.max())
    for stop in (1e-4, 1e-2, 0.1):
        inclusive = render(gaussians, view, definition=Definition(stop=stop))
        assert np.abs(inclusive.rgb - exact.rgb).max() <= stop * top + 1e-6
        exclusive = render(gaussians, view, definition=Definition(stop=stop, inclusive_stop=False))
        assert np.abs(exclusive.rgb - exact.rgb).max() <= stop / (1 - 0.99) * top + 1e-6
    assert not np.array_equal(exclusive.rgb, inclusive.rgb)


@pytest.mark.case("E6")
def test_a_pixel_whose_light_is_the_stop_itself_is_finished():
    layers = dots([[0, 0, 1.0], [0, 0, 1.1]], [0.3, 0.5], (1, 1, 1))
    view = camera(1, 1, 1.0)
    left = np.float32(1) - render(layers, view, outputs=("peaks",)).peaks[0]  # as the splatter rounds it
    first = bits(render(layers[:1], view, definition=Definition(stop=float(left))))
    assert bits(render(layers, view, definition=Definition(stop=float(left)))) == first
    below = float(np.nextafter(left, np.float32(0)))
    assert bits(render(layers, view, definition=Definition(stop=below))) != first


@pytest.mark.case("S2")
def test_planes_that_are_not_asked_for_change_nothing_and_are_not_there():
    gaussians, view = scene(400, 4, 2), camera(100, 70)
    whole = render(gaussians, view)
    for outputs in ((), ("alpha",), ("depth",)):
        image = render(gaussians, view, outputs=outputs)
        assert image.rgb.tobytes() == whole.rgb.tobytes()
        for name in ("alpha", "depth"):
            plane = getattr(image, name)
            assert plane.tobytes() == getattr(whole, name).tobytes() if name in outputs else plane.size == 0
    with pytest.raises(InputError, match="colour"):
        render(gaussians, view, outputs=("colour",))


def test_bytes_are_rounded_and_clipped_and_transparency_composites_to_the_same_picture():
    gaussians, view = scene(200, 6), camera()
    image = render(gaussians, view)
    expected = np.floor(np.clip(image.rgb, 0, 1).astype(np.float64) * 255 + 0.5)
    assert np.abs(image.rgb8() - expected).max() <= 1  # float32 rounds the product once more
    assert (image.rgb8() != expected).mean() < 1e-3
    pixels = image.rgba8().astype(float) / 255
    again = pixels[..., :3] * pixels[..., 3:]
    inside = (image.rgb <= image.alpha[..., None]).all(axis=2)  # straight colours above 1 do not fit 8 bits
    assert inside.mean() > 0.5
    assert np.abs(again - image.rgb)[inside].max() <= 1.01 / 255  # half a level of each factor
    with pytest.raises(InputError, match="alpha"):
        render(gaussians, view, outputs=()).rgba8()


@pytest.mark.case("S2")
def test_several_views_are_those_of_single_calls():
    gaussians = scene(200, 7, 1)
    views = [camera(), camera(30, 20), camera(focal=80.0)]
    for image, view in zip(render_views(gaussians, views, threads=2), views, strict=True):
        assert bits(image) == bits(render(gaussians, view))


@pytest.mark.case("E10")
@pytest.mark.parametrize("rule", [Definition(), Definition(inclusive_stop=False)])
def test_batches_give_the_same_bits_for_both_stopping_rules(rule):
    gaussians, view = scene(300, 5), camera(70, 50)
    split = Definition(max_entries=50, inclusive_stop=rule.inclusive_stop)
    assert bits(render(gaussians, view, definition=split)) == bits(render(gaussians, view, definition=rule))


@pytest.mark.case("E15", "S2")
@settings(max_examples=100)
@given(seed=st.integers(0, 2**32))
def test_the_test_of_a_block_leaves_out_nothing_that_a_pixel_would_show(seed):
    """Ellipses of sigma 0.55 to 1e5 px anywhere about a block; float64 at its 64 pixels says how far alpha reaches."""
    rng = np.random.default_rng(seed)
    count, half_log2e = PIECE, np.sqrt(0.5 / np.log(2))
    a = np.exp(rng.uniform(np.log(0.55), np.log(1e5), count))
    b = np.maximum(0.55, a * np.exp(-rng.uniform(0, 12, count)))
    turn = rng.uniform(0, np.pi, count)
    rows = np.stack([np.stack([a * np.cos(turn), -b * np.sin(turn)]), np.stack([a * np.sin(turn), b * np.cos(turn)])])
    l1 = np.hypot(*rows[0])
    k = (rows[0] * rows[1]).sum(axis=0) / l1**2
    l2 = a * b / l1
    step1, step2 = half_log2e / l1, half_log2e / l2
    # Centres up to 4 sigma along each axis away from a point near the block.
    along, across = rng.uniform(-4, 4, (2, count))
    x, y = rng.uniform(-20, 20, (2, count)) + np.einsum("ijn,jn->in", rows, np.stack([along, across]))
    fields = np.zeros((10, PIECE), np.float32)
    fields[0], fields[1], fields[2] = -x * step1, step1, (-y + k * x) * step2
    fields[3], fields[4], fields[5], fields[9] = k * step2, step2, 8.0, y
    fields[6], fields[7] = x, 1 / fields[4]
    fields[8] = 1 / (fields[1] ** 2 + fields[3] ** 2)
    x0, y0 = (np.float32(v) for v in rng.integers(-16, 9, 2) - 0.5)
    reach = np.empty(PIECE, np.float32)
    measure_reach(fields.ravel(), count, x0, y0, reach)
    px, py = np.meshgrid(np.arange(SIDE) + float(x0), np.arange(SIDE) + float(y0))
    dx, dy = px.ravel()[:, None] - x, py.ravel()[:, None] - y
    best = 8.0 - ((dx * step1) ** 2 + ((dy - k * dx) * step2) ** 2).min(axis=0)
    shown = best >= 0
    assert (reach[shown] >= -REACH_SLACK).all()
    # and it is not generous: between pixel centres the ellipse may come closer than at any of them, but not by much
    assert (reach[best < -40] < 0).all()
    # the same ones, each so opaque that its best pixel lies on the cut: what is left is rounding, a tenth of the slack
    fields[5] = np.where(shown, 8.0 - best, 8.0)
    measure_reach(fields.ravel(), count, x0, y0, reach)
    assert (reach[shown] >= -REACH_SLACK / 10).all()


@pytest.mark.parametrize("count", [1, 5 * BLOCK, 5 * BLOCK + 1])
def test_the_cache_of_sets_knows_what_drawing_keeps(count):
    gaussians = scene(count, 8, 2)
    bare = sum(getattr(gaussians, name).nbytes for name in Gaussians.__dataclass_fields__)
    render(gaussians, camera())
    kept = prepared(gaussians, 1)
    with kept.workspace() as space:
        arrays = [kept.geometry, kept.harmonics, *(getattr(space, name) for name in Workspace.__dataclass_fields__)]
    assert size_of(gaussians) - bare == sum(array.nbytes for array in arrays)
    assert len(kept.spare) == 1  # drawn twice, one after the other: one workspace
