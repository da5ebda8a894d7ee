"""The vision transformer of DINOv2 (Oquab et al. 2023), with the published tensor names."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .config import VitConfig

IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)
NORM_EPSILON = 1e-6
DEVIATION = 0.02  # of random weights


class Vit(nn.Module):
    """`VitConfig` gives the shape. Weights are random until others are loaded.

    `offset` is added to the number of rows and columns, in cells, when the position embedding is resampled: 0, or what
    the code that the weights were trained with adds.
    """

    def __init__(self, config: VitConfig, *, offset: float = 0.0) -> None:
        super().__init__()
        self.config = config
        self.embeddings = VitEmbeddings(config, offset)
        self.encoder = VitEncoder(config)
        self.layernorm = nn.LayerNorm(config.hidden, eps=NORM_EPSILON)
        self.apply(_randomise)

    def forward(self, images: Tensor) -> Tensor:
        """Images (n, 3, H, W), normalised, of whole patches -> tokens (n, 1 + patches, hidden) of the last layer,
        normed; the first is the class token."""
        (tokens,) = self.tokens(images, [self.config.layers])
        normed: Tensor = self.layernorm(tokens)
        return normed

    def tokens(self, images: Tensor, layers: Collection[int]) -> list[Tensor]:
        """Tokens (n, 1 + patches, hidden) of these layers in ascending order, not normed; 1 is the first, 0 the patch
        embedding."""
        found: list[Tensor] = self.encoder(self.embeddings(images), layers)
        return found

    @contextmanager
    def fixed_grid(self, rows: int, columns: int) -> Iterator[None]:
        """Within the context the position embedding is a constant, that of a grid of so many patches.

        Otherwise an exported graph would hold the bicubic resampling, which backends compute differently.
        """
        before = self.embeddings.constant
        with torch.no_grad():
            self.embeddings.constant = self.embeddings.positions(rows, columns).clone()
        try:
            yield
        finally:
            self.embeddings.constant = before


class VitEmbeddings(nn.Module):
    """The class token and a linear embedding of each patch, with their positions."""

    def __init__(self, config: VitConfig, offset: float) -> None:
        super().__init__()
        self.patch, self.offset = config.patch, offset
        self.constant: Tensor | None = None  # positions of a fixed grid
        side = config.image_size // config.patch
        self.cls_token = nn.Parameter(torch.zeros(1, 1, config.hidden))
        # published files have it, but only masked pretraining reads it
        self.mask_token = nn.Parameter(torch.zeros(1, config.hidden), requires_grad=False)
        projection = nn.Conv2d(3, config.hidden, config.patch, stride=config.patch)
        self.patch_embeddings = nn.ModuleDict({"projection": projection})
        self.position_embeddings = nn.Parameter(torch.zeros(1, side * side + 1, config.hidden))

    def forward(self, images: Tensor) -> Tensor:
        """(n, 3, H, W) -> (n, 1 + patches, hidden)."""
        grid = self.patch_embeddings["projection"](images)
        tokens = torch.cat([self.cls_token.expand(grid.shape[0], -1, -1), grid.flatten(2).transpose(1, 2)], dim=1)
        return tokens + (self.positions(*grid.shape[-2:]) if self.constant is None else self.constant)

    def positions(self, rows: int, columns: int) -> Tensor:
        """(1, 1 + rows * columns, hidden)."""
        return resampled_positions(self.position_embeddings, rows, columns, self.offset)


def resampled_positions(table: Tensor, rows: int, columns: int, offset: float = 0.0) -> Tensor:
    """A position embedding (1, 1 + M * M, C) for rows x columns patches: (1, 1 + rows * columns, C), bicubic.

    The scale is that of rows + offset and columns + offset, which moves samples by up to `offset` cells; M x M patches
    have the table itself. Computed in float32 or better.
    """
    side = round((table.shape[1] - 1) ** 0.5)
    if (rows, columns) == (side, side):
        return table
    grid = table[:, 1:].reshape(1, side, side, -1).permute(0, 3, 1, 2)
    grid = grid.to(torch.promote_types(table.dtype, torch.float32))
    if offset:
        scale = ((rows + offset) / side, (columns + offset) / side)
        resampled = F.interpolate(grid, scale_factor=scale, mode="bicubic", align_corners=False)
    else:
        resampled = F.interpolate(grid, size=(rows, columns), mode="bicubic", align_corners=False)
    patches = resampled.to(table.dtype).permute(0, 2, 3, 1).reshape(1, rows * columns, -1)
    return torch.cat([table[:, :1], patches], dim=1)


class VitEncoder(nn.Module):
    """The layers."""

    def __init__(self, config: VitConfig) -> None:
        super().__init__()
        self.layer = nn.ModuleList([VitLayer(config) for _ in range(config.layers)])

    def forward(self, tokens: Tensor, wanted: Collection[int]) -> list[Tensor]:
        """(n, t, hidden) -> the same of each layer that is `wanted`, where 0 is the input; others are not kept."""
        found = [tokens] if 0 in wanted else []
        for number, layer in enumerate(self.layer, start=1):
            tokens = layer(tokens)
            if number in wanted:
                found.append(tokens)
        return found


class VitLayer(nn.Module):
    """Attention and feed-forward layer, each normed before, scaled after, and added to its input."""

    def __init__(self, config: VitConfig) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(config.hidden, eps=NORM_EPSILON)
        self.attention = VitAttention(config)
        self.layer_scale1 = LayerScale(config.hidden)
        self.norm2 = nn.LayerNorm(config.hidden, eps=NORM_EPSILON)
        self.mlp = VitMlp(config)
        self.layer_scale2 = LayerScale(config.hidden)

    def forward(self, tokens: Tensor) -> Tensor:
        """(n, t, hidden) -> the same shape."""
        tokens = self.layer_scale1(self.attention(self.norm1(tokens))) + tokens
        return self.layer_scale2(self.mlp(self.norm2(tokens))) + tokens


class VitAttention(nn.Module):
    """Every token attends to every token. The queries are scaled, which are fewer than the scores."""

    def __init__(self, config: VitConfig) -> None:
        super().__init__()
        self.heads, width = config.heads, config.hidden
        self.q_proj, self.k_proj, self.v_proj, self.o_proj = (nn.Linear(width, width) for _ in range(4))

    def forward(self, tokens: Tensor) -> Tensor:
        """(n, t, hidden) -> the same shape."""
        n, count, hidden = tokens.shape
        heads = (n, count, self.heads, hidden // self.heads)
        query, key, value = (
            project(tokens).view(heads).transpose(1, 2) for project in (self.q_proj, self.k_proj, self.v_proj)
        )
        weights = ((query * heads[-1] ** -0.5) @ key.transpose(-1, -2)).softmax(-1)
        joined: Tensor = self.o_proj((weights @ value).transpose(1, 2).reshape(n, count, hidden))
        return joined


class VitMlp(nn.Module):
    """Two layers, GELU between them."""

    def __init__(self, config: VitConfig) -> None:
        super().__init__()
        self.fc1 = nn.Linear(config.hidden, config.hidden * config.mlp_ratio)
        self.fc2 = nn.Linear(config.hidden * config.mlp_ratio, config.hidden)

    def forward(self, tokens: Tensor) -> Tensor:
        """(n, t, hidden) -> the same shape."""
        wide: Tensor = self.fc2(F.gelu(self.fc1(tokens)))
        return wide


class LayerScale(nn.Module):
    """A factor for each channel (Touvron et al. 2021)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.lambda1 = nn.Parameter(torch.ones(channels))

    def forward(self, x: Tensor) -> Tensor:
        return x * self.lambda1


def _randomise(module: nn.Module) -> None:
    if isinstance(module, nn.Linear | nn.Conv2d):
        nn.init.trunc_normal_(module.weight, std=DEVIATION)
        assert module.bias is not None
        nn.init.zeros_(module.bias)
    elif isinstance(module, VitEmbeddings):
        nn.init.trunc_normal_(module.position_embeddings, std=DEVIATION)
        nn.init.trunc_normal_(module.cls_token, std=DEVIATION)


def normalised_for_vit(images: Tensor) -> Tensor:
    """(n, 3, H, W) in [0, 1] to zero mean and unit deviation over ImageNet."""
    mean, std = (torch.tensor(x, device=images.device).reshape(1, 3, 1, 1) for x in (IMAGENET_MEAN, IMAGENET_STD))
    return (images - mean) / std
