"""Depth-Anything-V2 (Yang et al. 2024): a ViT and a DPT head (Ranftl et al. 2021), with the published tensor names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch.nn.functional as F
from torch import Tensor, nn

from .config import VitConfig
from .vit import DEVIATION, Vit

HEAD_CHANNELS = 32
FACTORS = (4.0, 2.0, 1.0, 0.5)  # of the levels' sizes, from the finest to the coarsest, in patches


@dataclass(frozen=True)
class DptShape:
    """Shape of Depth-Anything-V2's head on a ViT."""

    layers: tuple[int, int, int, int]  # of the ViT whose tokens it reads, 1 is the first; 0 is the patch embedding
    levels: tuple[int, int, int, int]  # channels, from the finest level to the coarsest
    fusion: int  # channels of the fused map

    @staticmethod
    def of(vit: VitConfig) -> DptShape:
        """The published shape for ViT-S, B and L, and the same proportions for others, of three layers or more."""
        if (vit.hidden, vit.layers) == (1024, 24):
            return DptShape((5, 12, 18, 24), (256, 512, 1024, 1024), 256)
        first, second, third, last = (vit.layers * i // 4 for i in (1, 2, 3, 4))
        if second == third:
            raise ValueError(f"a depth head reads four layers of a ViT, this one has {vit.layers}; give it at least 3")
        h = vit.hidden
        return DptShape((first, second, third, last), (h // 8, h // 4, h // 2, h), h // 6)


class DepthAnything(nn.Module):
    """Inverse depth without scale; random weights, with which it is nearly constant, until others are loaded. Raises
    `ValueError` below three layers."""

    def __init__(self, config: VitConfig) -> None:
        super().__init__()
        self.config, self.shape = config, DptShape.of(config)
        self.backbone = Vit(config)
        self.neck = Neck(config.hidden, self.shape)
        self.head = DepthHead(self.shape.fusion, config.patch)
        self.neck.apply(_randomise)
        self.head.apply(_randomise)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Images (n, 3, H, W), normalised, of whole patches -> tokens (n, 1 + patches, hidden) of the last layer,
        normed, and inverse depth (n, 1, H, W), greater is nearer."""
        rows, columns = images.shape[-2] // self.config.patch, images.shape[-1] // self.config.patch
        read = [self.backbone.layernorm(tokens) for tokens in self.backbone.tokens(images, self.shape.layers)]
        return read[-1], self.head(self.neck(read, rows, columns), rows, columns)


class Neck(nn.Module):
    """Four layers' tokens as maps of four sizes, which are fused from the coarsest to the finest."""

    def __init__(self, hidden: int, shape: DptShape) -> None:
        super().__init__()
        stage = [Reassembled(hidden, *level) for level in zip(shape.levels, FACTORS, strict=True)]
        self.reassemble_stage = Stage(stage)
        self.convs = nn.ModuleList([nn.Conv2d(c, shape.fusion, 3, padding=1, bias=False) for c in shape.levels])
        self.fusion_stage = Stage([Fusion(shape.fusion) for _ in shape.levels])

    def forward(self, tokens: list[Tensor], rows: int, columns: int) -> Tensor:
        """Four times (n, 1 + rows * columns, hidden) -> (n, fusion, 8 rows, 8 columns)."""
        stage, fusions = self.reassemble_stage.layers, self.fusion_stage.layers
        maps = [
            conv(level(x[:, 1:].transpose(1, 2).unflatten(2, (rows, columns))))
            for x, level, conv in zip(tokens, stage, self.convs, strict=True)
        ]
        fused: Tensor | None = None
        for fusion, here, finer in zip(fusions, maps[::-1], [*maps[-2::-1], None], strict=True):
            size = None if finer is None else (finer.shape[-2], finer.shape[-1])
            fused = fusion(here, None, size) if fused is None else fusion(fused, here, size)
        assert fused is not None
        return fused


class Stage(nn.Module):
    """A list under the name that published files have."""

    def __init__(self, layers: Sequence[nn.Module]) -> None:
        super().__init__()
        self.layers = nn.ModuleList(layers)


class Reassembled(nn.Module):
    """A map of one size with its own number of channels."""

    def __init__(self, hidden: int, channels: int, factor: float) -> None:
        super().__init__()
        self.projection = nn.Conv2d(hidden, channels, 1)
        self.resize: nn.Module = nn.Identity()
        if factor > 1:
            self.resize = nn.ConvTranspose2d(channels, channels, int(factor), stride=int(factor))
        elif factor < 1:
            self.resize = nn.Conv2d(channels, channels, 3, stride=int(1 / factor), padding=1)

    def forward(self, x: Tensor) -> Tensor:
        resized: Tensor = self.resize(self.projection(x))
        return resized


class ResidualUnit(nn.Module):
    """ReLU and convolution twice; the input added."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.convolution1, self.convolution2 = (nn.Conv2d(channels, channels, 3, padding=1) for _ in range(2))

    def forward(self, x: Tensor) -> Tensor:
        changed: Tensor = self.convolution2(F.relu(self.convolution1(F.relu(x))))
        return changed + x


class Fusion(nn.Module):
    """Adds a level to what comes from the coarser ones, and enlarges the sum. The coarsest level adds nothing: its
    first unit, which published files have, is never run."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.projection = nn.Conv2d(channels, channels, 1)
        self.residual_layer1, self.residual_layer2 = ResidualUnit(channels), ResidualUnit(channels)

    def forward(self, coarse: Tensor, level: Tensor | None, size: tuple[int, int] | None) -> Tensor:
        """Both (n, c, h, w) -> (n, c, *size), twice the size without one."""
        if level is not None:
            coarse = coarse + self.residual_layer1(level)
        size = size or (2 * coarse.shape[-2], 2 * coarse.shape[-1])
        enlarged = F.interpolate(self.residual_layer2(coarse), size=size, mode="bilinear", align_corners=True)
        projected: Tensor = self.projection(enlarged)
        return projected


class DepthHead(nn.Module):
    """Inverse depth at the size of the picture."""

    def __init__(self, fusion: int, patch: int) -> None:
        super().__init__()
        self.patch = patch
        self.conv1 = nn.Conv2d(fusion, fusion // 2, 3, padding=1)
        self.conv2 = nn.Conv2d(fusion // 2, HEAD_CHANNELS, 3, padding=1)
        self.conv3 = nn.Conv2d(HEAD_CHANNELS, 1, 1)

    def forward(self, fused: Tensor, rows: int, columns: int) -> Tensor:
        """(n, fusion, h, w) -> (n, 1, rows * patch, columns * patch)."""
        size = (rows * self.patch, columns * self.patch)
        x = F.interpolate(self.conv1(fused), size=size, mode="bilinear", align_corners=True)
        return F.relu(self.conv3(F.relu(self.conv2(x))))


def _randomise(module: nn.Module) -> None:
    if isinstance(module, nn.Conv2d | nn.ConvTranspose2d):
        nn.init.normal_(module.weight, std=DEVIATION)
        if module.bias is not None:
            nn.init.zeros_(module.bias)
