"""The backing layer: a coarse opaque sheet behind each view's far surface, so that gaps show colour, not a hole.

Nothing of it is learned: one flat Gaussian per 8 x 8 pixels (and two cells beyond the border) at the farthest depth of
its neighbourhood, pushed back by a few per cent, with the colour of the far pixels there. It adds 2 % Gaussians at
256 x 256 px.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from gapmes.service.harmonics import C0

from .adapter import GaussianBatch, footprint, per_scene, place
from .cost_volume import Views
from .geometry import matrix_to_quaternion
from .layers import replicate_pad

CELL = 8  # px
MARGIN = 2  # cells beyond the border
PUSH_BACK = 0.93  # on inverse-depth: 7 % farther, so that the sheet never hides the surface that it backs
SPREAD = 0.6  # standard deviation in cells
FLATNESS = 0.1  # thickness over spread
OPACITY = 0.9
FAR_PREFERENCE = 25.0  # weight e^-25 per unit of normalised inverse depth: colours come from the far surface


def backing_layer(images: Tensor, inverse: Tensor, views: Views, keep: Tensor, coefficients: int) -> GaussianBatch:
    """The sheet of n = B * V views; no gradient flows through it.

    images (n, 3, H, W), inverse (n, 1, H, W) normalised inverse depth, keep (n, 1, H, W).
    """
    images, inverse = images.detach(), inverse.detach()
    height, width = images.shape[-2:]
    cell_far = -F.max_pool2d(-inverse, CELL)
    weight = torch.exp(-(inverse - F.interpolate(cell_far, size=(height, width))) * FAR_PREFERENCE)  # 1 at its farthest
    colour = F.avg_pool2d(images * weight, CELL) / F.avg_pool2d(weight, CELL)
    far = -F.max_pool2d(-replicate_pad(cell_far, 1), 3, stride=1)
    colour, far = replicate_pad(colour, MARGIN), replicate_pad(far, MARGIN).clamp(min=0)
    kept = replicate_pad((F.avg_pool2d(keep, CELL) >= 0.5).to(images.dtype), MARGIN)
    depth = 1 / (views.inverse_depth(far) * PUSH_BACK)

    rows, columns = depth.shape[-2:]
    device = images.device
    y = (torch.arange(rows, dtype=torch.get_default_dtype(), device=device) - MARGIN + 0.5) * CELL / height
    x = (torch.arange(columns, dtype=torch.get_default_dtype(), device=device) - MARGIN + 0.5) * CELL / width
    positions = torch.stack([x[None, :].expand(rows, columns), y[:, None].expand(rows, columns)]).unsqueeze(0)
    intrinsics, poses = views.intrinsics.reshape(-1, 3, 3), views.world_from_cam.reshape(-1, 4, 4)
    positions = positions.expand(images.shape[0], -1, -1, -1)
    means = place(positions, depth, intrinsics, poses)
    size = footprint(depth, intrinsics, height, width) * CELL * SPREAD
    axes = torch.tensor([1.0, 1.0, FLATNESS], device=device).reshape(1, 3, 1, 1)
    scales = (size * axes).flatten(2).transpose(1, 2)
    rotations = matrix_to_quaternion(poses[:, :3, :3]).unsqueeze(1).expand(-1, means.shape[1], -1)
    dc = (colour.flatten(2).transpose(1, 2).unsqueeze(2) - 0.5) / C0
    harmonics = F.pad(dc, (0, 0, 0, coefficients - 1))
    v = views.count
    return GaussianBatch(
        per_scene(means, v),
        per_scene(scales, v),
        per_scene(rotations, v),
        per_scene((kept * OPACITY).flatten(1), v),
        per_scene(harmonics, v),
    )
