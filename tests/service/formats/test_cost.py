"""The loss of a format is the PSNR of pictures on black, of cameras that see some of the Gaussians before or after."""

from __future__ import annotations

import numpy as np
import pytest
from format_cases import moderate

from gapmes.service.cameras.camera import Camera
from gapmes.service.formats.cost import picture_psnr
from gapmes.service.splat import render


def test_a_picture_of_which_nothing_is_left_loses_all_its_light() -> None:
    """Colours above 1 count as 1."""
    source, steps = moderate(200, 0, 0), []
    source.harmonics[::2] = 5.0
    ahead = Camera.make(32, 32, 32.0, 32.0, 16.0, 16.0, np.eye(4))
    cameras = [ahead, ahead.posed(np.diag([-1.0, 1.0, -1.0, 1.0]))]
    picture = render(source, ahead, threads=1).rgb
    assert picture.max() > 1.2
    expected = -10 * np.log10(np.square(np.clip(picture.astype(float), 0, 1)).mean())
    for before, after in ((source, source[:0]), (source[:0], source)):
        assert picture_psnr(before, after, cameras, {}, threads=1, step=steps.append) == [
            pytest.approx(expected, abs=1e-6),
            None,
        ]
    assert steps == [1, 2, 1, 2]
