"""A picture's effort: outputs that are not requested are not drawn, and every setting is the splatter's own."""

import numpy as np
import pytest
from clouds import cloud, view

from gapmes.service.errors import InputError
from gapmes.service.pictures.effort import ALPHA_MIN, LIMITS, STOP, Effort, draw
from gapmes.service.splat import Definition, render, render_supersampled


@pytest.mark.case("S2")
@pytest.mark.parametrize(("channel", "planes"), [("rgb", ()), ("alpha", ("alpha",)), ("depth", ("alpha", "depth"))])
def test_only_the_planes_of_the_channel_are_drawn_and_they_have_the_same_bits(channel, planes):
    gaussians = cloud(200, 1, degree=2)
    drawn, whole = draw(gaussians, view(), channel), render(gaussians, view())
    assert drawn.rgb.tobytes() == whole.rgb.tobytes()
    for name in ("alpha", "depth"):
        expected = getattr(whole, name) if name in planes else np.empty((0, 0), np.float32)
        assert getattr(drawn, name).tobytes() == expected.tobytes()


def test_settings_are_those_of_the_splatter():
    assert (Definition().alpha_min, Definition().stop) == (ALPHA_MIN, STOP)
    assert Effort().definition() == Definition()
    gaussians = cloud(200, 1, degree=2)
    rule = Definition(alpha_min=0.02, stop=0.1, cut_radius=1.5)
    expected = render_supersampled(gaussians, view(), 2, definition=rule, sh_degree=1, near=0.5, outputs=())
    drawn = draw(gaussians, view(), "rgb", Effort(0.02, 0.1, 1, 2, 1.5), near=0.5)
    assert drawn.rgb.tobytes() == expected.rgb.tobytes()


BEYOND = [("alpha_min", 0.0), ("alpha_min", 2.0), ("stop", -1.0), ("samples", 5)]
BEYOND += [("cut_radius", value) for value in (0.9, 6.1, float("nan"), float("inf"))]


@pytest.mark.parametrize(("name", "value"), BEYOND)
def test_an_effort_beyond_its_limits_is_refused_by_name(name, value):
    with pytest.raises(InputError, match=name):
        Effort(**{name: value})


def test_the_largest_radius_leaves_out_nothing_at_the_least_cut():
    gaussians, finest = cloud(200, 1, degree=0), LIMITS["alpha_min"][0]
    whole = draw(gaussians, view(), "rgb", Effort(finest))
    for radius, same in ((LIMITS["cut_radius"][1], True), (3.0, False)):
        drawn = draw(gaussians, view(), "rgb", Effort(finest, cut_radius=radius))
        assert (drawn.rgb.tobytes() == whole.rgb.tobytes()) == same
