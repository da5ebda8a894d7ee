"""Pictures of another size: what is cropped, and that nothing is stretched or moved."""

import numpy as np
import pytest
from clouds import cloud

from gapmes.service.cameras.camera import Camera
from gapmes.service.splat import render
from gapmes.service.viewpoints.framing import even


def camera(width: int, height: int) -> Camera:
    return Camera.make(width, height, 80.0, 82.0, 0.45 * width, 0.52 * height, np.eye(4))


@pytest.mark.parametrize(("width", "height"), [(95, 63), (95, 64), (96, 63), (96, 64)])
def test_even_sides_cost_the_last_row_and_column_alone(width: int, height: int) -> None:
    """To the bit where all lies in the picture: outside it projections have a bound that the picture's size sets."""
    whole = camera(width, height)
    cut = even(whole)
    assert (cut.width, cut.height) == (width - width % 2, height - height % 2)
    np.testing.assert_array_equal(cut.intrinsics, whole.intrinsics)
    gaussians = cloud(600, 3)
    pixels, _ = cut.project(gaussians.means)
    gaussians = gaussians[((pixels >= 0) & (pixels < (cut.width, cut.height))).all(axis=1)]
    assert len(gaussians) > 150
    expected = render(gaussians, whole, threads=1).rgb[: cut.height, : cut.width]
    np.testing.assert_array_equal(render(gaussians, cut, threads=1).rgb, expected)


def test_a_single_column_stays() -> None:
    thin = Camera.make(1, 63, 1.0, 82.0, 0.5, 31.5, np.eye(4))
    assert (even(thin).width, even(thin).height) == (1, 62)
