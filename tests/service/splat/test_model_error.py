"""The error of the affine projection itself, apart from rounding, is as docs/splatting.md says."""

import re
from pathlib import Path

import numpy as np
import pytest

from gapmes.service.cameras.camera import Camera
from gapmes.service.gaussians import Gaussians
from gapmes.service.splat import Definition, render

PAGE = (Path(__file__).parents[3] / "docs" / "splatting.md").read_text(encoding="utf-8")
ROWS = [
    [float(cell) for cell in row] for row in re.findall(r"^\| ([\d.e-]+) \| ([\d.e-]+) \| ([\d.e-]+) \|$", PAGE, re.M)
]
SIDE = 240  # px


def test_the_page_has_the_table():
    assert [row[0] for row in ROWS] == [0.001, 0.01, 0.1, 0.3, 1.0]


@pytest.mark.parametrize(("size", "on_axis", "off_axis"), ROWS)
def test_balls_differ_from_the_most_along_each_ray(size, on_axis, off_axis):
    """Next to no dilation, and a ball of some 24 px, so that only the projection differs from the closed form."""
    for degrees, told in ((0, on_axis), (40, off_axis)):
        angle = np.radians(degrees)
        middle, focal = np.array([np.sin(angle), 0.0, np.cos(angle)]), 24 / size * np.cos(angle)
        left = SIDE / 2 - focal * np.tan(angle)
        camera = Camera(SIDE, SIDE, focal, focal, left, SIDE / 2, np.eye(4))
        ball = Gaussians.make([middle], [[size] * 3], [[1.0, 0, 0, 0]], [1.0], np.zeros((1, 1, 3)))
        drawn = render(ball, camera, definition=Definition(dilation=1e-3, alpha_max=1.0, alpha_min=1e-6)).alpha
        x, y = np.meshgrid(np.arange(SIDE) + 0.5, np.arange(SIDE) + 0.5)
        rays = camera.rays(np.stack([x.ravel(), y.ravel()], axis=1))
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        nearest = np.maximum(rays @ middle, 0.0)[:, None] * rays
        exact = np.exp(-((middle - nearest) ** 2).sum(axis=1) / (2 * size**2)).reshape(SIDE, SIDE)
        assert np.abs(drawn - exact).max() == pytest.approx(told, rel=0.06)
