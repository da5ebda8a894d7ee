"""The vision transformers: global semantics, and monocular depth cues with or without Depth-Anything-V2's own head."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .config import CELLS_PER_PATCH, PIXELS_PER_PATCH, VitConfig
from .depth_anything import DepthAnything
from .gradients import no_gradient
from .vit import Vit, normalised_for_vit

_FLAT = 1e-4  # of its greatest value: below this deviation a depth map says nothing but rounding


class VitFeatures(nn.Module):
    """Patch features of a Dinov2-type ViT on a grid of one token per 16 x 16 input pixels.

    Serves as F_dino with DINOv2 weights and as F_mono with the encoder of Depth-Anything-V2, which is the same class.
    """

    def __init__(self, config: VitConfig, *, frozen: bool) -> None:
        super().__init__()
        self.config = config
        self.frozen = frozen
        self.vit = Vit(config)
        if frozen:
            self.vit.requires_grad_(False)

    def forward(self, images: Tensor) -> Tensor:
        """(n, 3, H, W) in [0, 1] -> (n, hidden, H/16, W/16)."""
        height, width = images.shape[-2] // PIXELS_PER_PATCH, images.shape[-1] // PIXELS_PER_PATCH
        x = _seen_by_vit(normalised_for_vit(images), self.config.patch)
        with no_gradient(self.frozen):
            tokens = self.vit(x)[:, 1:]
        return tokens.transpose(1, 2).reshape(-1, self.config.hidden, height, width)


class DepthAnythingFeatures(nn.Module):
    """Depth-Anything-V2 whole: its encoder's patch features, and its inverse depth as a cue without scale and shift.

    Published weights are loaded by `pretrained.depth_anything.load_depth_anything`.
    """

    to_cells: Tensor

    def __init__(self, config: VitConfig, *, frozen: bool) -> None:
        """Random weights, with which the inverse depth is nearly constant. Raises `ValueError` below three layers."""
        super().__init__()
        self.config = config
        self.frozen = frozen
        self.model = DepthAnything(config)
        self.register_buffer("to_cells", _area_average(config.patch, CELLS_PER_PATCH), persistent=False)
        if frozen:
            self.model.requires_grad_(False)

    @property
    def vit(self) -> Vit:
        """The encoder, under the name that it has in `VitFeatures`."""
        return self.model.backbone

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """(n, 3, H, W) in [0, 1] -> features (n, hidden, H/16, W/16), the encoder's last, normed; and inverse depth
        (n, 1, H/4, W/4), greater is nearer, of mean 0 and deviation 1 over each image, or 0 where it is flat.
        """
        rows, columns = images.shape[-2] // PIXELS_PER_PATCH, images.shape[-1] // PIXELS_PER_PATCH
        x = _seen_by_vit(normalised_for_vit(images), self.config.patch)
        with no_gradient(self.frozen):
            tokens, inverse = self.model(x)
        features = tokens[:, 1:].transpose(1, 2).reshape(-1, self.config.hidden, rows, columns)
        return features, without_scale_and_shift(self._per_cell(inverse, rows, columns))

    def _per_cell(self, inverse: Tensor, rows: int, columns: int) -> Tensor:
        """Mean over the area of each cell: (n, 1, rows * patch, columns * patch) -> (n, 1, H/4, W/4).

        Two products with a small matrix, exact also where a cell is 3.5 px wide; bilinear sampling would skip pixels.
        """
        patch = self.config.patch
        x = inverse.reshape(-1, rows * patch, columns, patch) @ self.to_cells.T
        x = x.reshape(-1, rows, patch, columns * CELLS_PER_PATCH)
        return (self.to_cells @ x).reshape(-1, 1, rows * CELLS_PER_PATCH, columns * CELLS_PER_PATCH)


def without_scale_and_shift(inverse: Tensor) -> Tensor:
    """(n, 1, h, w), finite -> the same less its mean, by its deviation, image by image; exactly 0 where it is flat.

    The deviation has a floor relative to the greatest value, so that rounding is never blown up to a signal.
    """
    axes = (-2, -1)
    greatest = inverse.abs().amax(axes, keepdim=True).clamp_min(torch.finfo(inverse.dtype).tiny)
    # From the least value on, in parts of the greatest: no square below can overflow, and a constant is exactly 0.
    relative = inverse / greatest - (inverse / greatest).amin(axes, keepdim=True)
    centred = relative - relative.mean(axes, keepdim=True)
    deviation = centred.square().mean(axes, keepdim=True).sqrt()
    return centred / deviation.clamp_min(_FLAT)


def _seen_by_vit(x: Tensor, patch: int) -> Tensor:
    """(n, 3, H, W) -> (n, 3, H/16 * patch, W/16 * patch): one token per 16 x 16 input pixels."""
    if patch == PIXELS_PER_PATCH:
        return x
    size = (x.shape[-2] // PIXELS_PER_PATCH * patch, x.shape[-1] // PIXELS_PER_PATCH * patch)
    return F.interpolate(x, size=size, mode="bilinear", align_corners=False, antialias=False)


def _area_average(pixels: int, cells: int) -> Tensor:
    """(cells, pixels) weights that average `pixels` over `cells` equal intervals."""
    edges = torch.arange(cells + 1, dtype=torch.float64) * pixels / cells
    left, right = edges[:-1, None], edges[1:, None]
    start = torch.arange(pixels, dtype=torch.float64)[None]
    overlap = (torch.minimum(right, start + 1) - torch.maximum(left, start)).clamp_min(0)
    return (overlap * cells / pixels).to(torch.float32)
