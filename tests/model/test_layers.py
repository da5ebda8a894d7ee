"""Shared layers against float64: means under a softmax of any size, their gradient, and samples beyond the border."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from gapmes.model.layers import sample_with_repeated_border, softmax_mean


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("scale", [0.0, 1.0, 1e2, 1e30])
def test_softmax_mean_equals_float64(scale: float) -> None:
    x, values = scale * random(2, 64, 5, 7), torch.linspace(0, 1, 64)
    exact = (x.double().softmax(1) * values.double().reshape(1, -1, 1, 1)).sum(1, keepdim=True)
    # sums of 64 rounded powers: measured 1.6e-7 of values up to 1
    assert (softmax_mean(x, values) - exact).abs().max() < 1e-6


def test_softmax_mean_has_the_gradient_of_what_it_says() -> None:
    x, values = random(1, 6, 2, 3).double().requires_grad_(), torch.linspace(0, 1, 6).double()
    assert torch.autograd.gradcheck(lambda x: softmax_mean(x, values), x)


@pytest.mark.parametrize(("height", "width"), [(128, 128), (9, 14), (1, 7), (6, 1)])
def test_beyond_the_border_its_pixels_repeat(height: int, width: int) -> None:
    """Against linear interpolation between the two nearest pixels of a row and a column, with clipped indices."""
    picture = random(2, 3, height, width)
    grid = 1.5 * random(2, 11, 5, 2, seed=1)
    grid[0, :3] = torch.tensor([[-1.0, 1.0], [4.0, -4.0], [1.0, 0.0], [0.0, -1.0], [-4.0, 4.0]])
    at = ((grid.double() + 1) / 2 * torch.tensor([width, height]) - 0.5).numpy()
    exact = np.zeros((2, 3, 11, 5))
    for dx in (0, 1):
        for dy in (0, 1):
            low = np.floor(at) + np.array([dx, dy])
            weight = (1 - np.abs(at - low)).prod(-1)
            x, y = low[..., 0].clip(0, width - 1).astype(int), low[..., 1].clip(0, height - 1).astype(int)
            for n in range(2):
                exact[n] += weight[n] * picture[n].double().numpy()[:, y[n], x[n]]
    sampled = sample_with_repeated_border(picture, grid)
    # positions of up to 128 px are rounded by 8e-6: measured 1.4e-5 of values up to 4.6
    assert np.abs(sampled.numpy() - exact).max() < 1e-4
    theirs = F.grid_sample(picture, grid, mode="bilinear", padding_mode="border", align_corners=False)
    assert (sampled - theirs).abs().max() < 1e-4
