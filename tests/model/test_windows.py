"""Window means: equal to pooling in float64, and the exported form equals the eager one."""

from __future__ import annotations

import pytest
import torch
import torch.nn.functional as F

from gapmes.model.windows import mean_inside, mean_with_repeated_border


@pytest.mark.parametrize("radius", [1, 2, 3, 4, 8, 32])
def test_equals_pooling_in_float64(radius: int) -> None:
    """Sums of up to 65 x 65 numbers in 0..1 in float32."""
    values = torch.rand(2, 3, 20, 33, generator=torch.Generator().manual_seed(radius))
    exact = values.double()
    repeated = F.pad(exact, (radius,) * 4, mode="replicate")
    expected = F.avg_pool2d(repeated, 2 * radius + 1, 1)
    assert (mean_with_repeated_border(values, radius) - expected).abs().max() < 3e-7
    expected = F.avg_pool2d(exact, 2 * radius + 1, 1, radius, count_include_pad=False)
    assert (mean_inside(values, radius) - expected).abs().max() < 3e-7


@pytest.mark.parametrize("mean", [mean_inside, mean_with_repeated_border])
@pytest.mark.parametrize("radius", [1, 4, 32])
def test_exported_form_is_two_products_with_the_same_values(mean, radius: int) -> None:
    class Means(torch.nn.Module):
        def forward(self, values: torch.Tensor) -> torch.Tensor:
            return mean(values, radius)

    values = torch.rand(1, 2, 16, 24, generator=torch.Generator().manual_seed(0))
    program = torch.export.export(Means(), (values,))
    names = [str(node.target) for node in program.graph.nodes]
    assert names.count("aten.matmul.default") == 2
    assert "aten.narrow.default" not in names
    assert (program.module()(values) - mean(values, radius)).abs().max() < 3e-7
