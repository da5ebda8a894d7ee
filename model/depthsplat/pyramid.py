"""Features at the coarse scale and at twice its resolution, from those of the coarse scale."""

from __future__ import annotations

from torch import Tensor, nn


class FeaturePyramid(nn.Module):
    """The coarse scale as it is; the fine one with half of the channels, by a transposed convolution."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        half = channels // 2
        self.stages = nn.ModuleList(
            [
                nn.Sequential(),
                nn.Sequential(
                    nn.ConvTranspose2d(channels, half, 2, stride=2), nn.GELU(), nn.Conv2d(half, half, 3, padding=1)
                ),
            ]
        )

    def forward(self, x: Tensor) -> list[Tensor]:
        """(n, C, h, w) -> [(n, C, h, w), (n, C/2, 2h, 2w)]."""
        return [stage(x) for stage in self.stages]
