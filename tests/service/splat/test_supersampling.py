"""Several samples per pixel against the float64 reference, and the named sets of rules."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from splat_cases import bits, camera, scene

from gapmes.service.errors import InputError
from gapmes.service.splat import INRIA, Definition, render, render_reference, render_supersampled


def test_one_sample_is_the_plain_picture():
    gaussians = scene(200, 1, 2)
    once = render_supersampled(gaussians, camera(), 1, background=(0.2, 0.4, 0.6))
    plain = render(gaussians, camera(), background=(0.2, 0.4, 0.6))
    assert once.rgb.tobytes() == plain.rgb.tobytes()
    assert once.alpha.tobytes() == plain.alpha.tobytes()
    assert np.abs(once.depth - plain.depth).max() < 1e-6


@pytest.mark.parametrize("factor", [2, 3])
def test_samples_are_averaged_over_the_pixel(factor):
    gaussians, view = scene(150, 2), camera(24, 20, 22.0)
    ours = render_supersampled(gaussians, view, factor)
    rule = Definition(dilation=0.3 * factor**2)
    true = render_reference(gaussians, view.resized(factor * 24, factor * 20), definition=rule)
    squares = (20, factor, 24, factor)
    assert np.abs(ours.rgb - true.rgb.reshape(*squares, 3).mean(axis=(1, 3))).max() < 2e-6
    alpha = true.alpha.reshape(squares).mean(axis=(1, 3))
    assert np.abs(ours.alpha - alpha).max() < 2e-6
    depth = (true.alpha * true.depth).reshape(squares).mean(axis=(1, 3)) / np.maximum(alpha, 1e-12)
    assert (np.abs(ours.depth - depth) * alpha).max() < 5e-6


def test_more_samples_change_the_picture_little_and_less_and_less():
    """Measured over three scenes: 56 to 60 dB between 1 and 2 samples per side, 68 to 72 between 2 and 4."""
    gaussians, view = scene(300, 3), camera(64, 64, 60.0)
    pictures = [render_supersampled(gaussians, view, factor).rgb for factor in (1, 2, 4)]
    db = [-10 * np.log10(((a - b) ** 2).mean()) for a, b in pairwise(pictures)]
    assert db[0] > 50
    assert db[1] > db[0] + 10


def test_only_what_is_asked_for_is_there():
    gaussians, view = scene(50, 4), camera()
    for outputs in ((), ("alpha",), ("depth",)):
        image = render_supersampled(gaussians, view, 2, outputs=outputs)
        assert image.rgb.shape == (view.height, view.width, 3)
        for name in ("alpha", "depth"):
            assert (getattr(image, name).size > 0) == (name in outputs)
    with pytest.raises(InputError, match="'median' has no mean"):
        render_supersampled(gaussians, view, 2, outputs=("median",))
    for factor in (0, -1, 1.5, 58, 10**400):
        with pytest.raises(InputError, match="need a whole number from 1 to 57"):
            render_supersampled(gaussians, view, factor)


def test_a_renderer_is_named_for_its_rules():
    gaussians = scene(300, 5)
    assert bits(render(gaussians, camera(), compatibility="inria")) == bits(
        render(gaussians, camera(), definition=INRIA)
    )
    near = render(gaussians, camera(), compatibility="inria", near=1.5)
    assert bits(near) == bits(render(gaussians, camera(), definition=replace(INRIA, near=1.5)))
    twice = render_supersampled(gaussians, camera(), 2, compatibility="inria")
    rule = replace(INRIA, dilation=4 * INRIA.dilation)
    larger = render(gaussians, camera().resized(96, 80), definition=rule)
    assert np.abs(twice.rgb - larger.rgb.reshape(40, 2, 48, 2, 3).mean(axis=(1, 3))).max() < 1e-6
    with pytest.raises(InputError, match="need one of inria"):
        render(gaussians, camera(), compatibility="opengl")
    with pytest.raises(InputError, match="without a definition"):
        render(gaussians, camera(), compatibility="inria", definition=Definition())
