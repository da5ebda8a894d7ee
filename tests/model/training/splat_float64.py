"""Brute-force differentiable splatter in float64 torch: the definition, written as directly as possible."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

ALPHA_MAX = float(np.float32(0.99))  # two such layers leave less than 1e-4 in every precision


def splat_reference(
    means, factors, opacities, colours, world_from_cam, intrinsics, height, width,
    *, background=(0.0, 0.0, 0.0), near=0.01, dilation=0.3,
):  # fmt: skip
    """As `gapmes.model.training.splat.splat`, every Gaussian at every pixel; also returns the distance to a threshold.

    The third value (B, T, H, W) is the smallest relative distance of any alpha to 1/255 or of any transmittance to
    1e-4: where it is tiny, rounding may decide differently.
    """
    rgb, alpha, margin = [], [], []
    behind = torch.tensor(background, dtype=torch.float64)
    for b in range(means.shape[0]):
        for t in range(world_from_cam.shape[1]):
            args = (means[b], factors[b], opacities[b], colours[b], world_from_cam[b, t].double())
            image = _one(*args, intrinsics[b, t].double(), height, width, behind, near, dilation)
            for values, value in zip((rgb, alpha, margin), image, strict=True):
                values.append(value)
    views = (means.shape[0], world_from_cam.shape[1])
    return tuple(torch.stack(values).unflatten(0, views) for values in (rgb, alpha, margin))


def _one(
    mean, factor, opacity, colour, pose, k, height, width, behind, near, dilation
) -> tuple[Tensor, Tensor, Tensor]:
    cam = (mean - pose[:3, 3]) @ pose[:3, :3]
    keep = torch.nonzero(cam[:, 2] > near)[:, 0]
    keep = keep[torch.argsort(cam[keep, 2], stable=True)]
    x, y, z = cam[keep].unbind(-1)
    fx, fy = k[0, 0], k[1, 1]
    tan_x = (x / z).clamp(float((-0.15 * width - k[0, 2]) / fx), float((1.15 * width - k[0, 2]) / fx))
    tan_y = (y / z).clamp(float((-0.15 * height - k[1, 2]) / fy), float((1.15 * height - k[1, 2]) / fy))
    zero = torch.zeros_like(z)
    jacobian = torch.stack(
        [torch.stack([fx / z, zero, -fx * tan_x / z], -1), torch.stack([zero, fy / z, -fy * tan_y / z], -1)], -2
    )
    half = jacobian @ pose[:3, :3].T @ factor[keep]
    precision = torch.linalg.inv(half @ half.mT + dilation * torch.eye(2, dtype=torch.float64))
    centre = torch.stack([fx * x / z + k[0, 2], fy * y / z + k[1, 2]], -1)
    rows, columns = torch.meshgrid(
        torch.arange(height, dtype=torch.float64) + 0.5, torch.arange(width, dtype=torch.float64) + 0.5, indexing="ij"
    )
    offset = torch.stack([columns, rows], -1)[:, :, None] - centre
    raw = opacity[keep] * torch.exp(-0.5 * torch.einsum("hwni,nij,hwnj->hwn", offset, precision, offset))
    a = torch.where(raw >= 1 / 255, raw.clamp(max=ALPHA_MAX), torch.zeros_like(raw))
    before = torch.cumprod(torch.cat([torch.ones(height, width, 1, dtype=torch.float64), 1 - a], -1), -1)
    a = torch.where(before[..., :-1] > 1e-4, a, torch.zeros_like(a))  # the one that crosses is still added
    after = torch.cumprod(torch.cat([torch.ones(height, width, 1, dtype=torch.float64), 1 - a], -1), -1)
    weight = a * after[..., :-1]
    left = after[..., -1]
    rgb = torch.einsum("hwn,nc->chw", weight, colour[keep]) + left * behind[:, None, None]
    margin = torch.minimum((raw * 255 - 1).abs().amin(-1), (before * 1e4 - 1).abs().amin(-1)).detach()
    return rgb, (1 - left)[None], margin
