"""Camera geometry in torch, written so that it exports: rays, quaternions, other-view gathers."""

from __future__ import annotations

import torch
from torch import Tensor


def pixel_grid(height: int, width: int, device: torch.device) -> Tensor:
    """(2, H, W) normalised pixel centres (x, y) in (0, 1)."""
    y = (torch.arange(height, dtype=torch.get_default_dtype(), device=device) + 0.5) / height
    x = (torch.arange(width, dtype=torch.get_default_dtype(), device=device) + 0.5) / width
    return torch.stack([x[None, :].expand(height, width), y[:, None].expand(height, width)])


def camera_rays(positions: Tensor, intrinsics: Tensor) -> Tensor:
    """Directions (n, 3, ...) with z = 1 in the camera frame, of normalised positions (n, 2, ...) under K (n, 3, 3)."""
    shape = (-1,) + (1,) * (positions.dim() - 2)
    x = (positions[:, 0] - intrinsics[:, 0, 2].reshape(shape)) / intrinsics[:, 0, 0].reshape(shape)
    y = (positions[:, 1] - intrinsics[:, 1, 2].reshape(shape)) / intrinsics[:, 1, 1].reshape(shape)
    return torch.stack([x, y, torch.ones_like(x)], dim=1)


def rigid_inverse(matrix: Tensor) -> Tensor:
    """(..., 4, 4) inverse of rigid motions: [R^T | -R^T t]."""
    rotation = matrix[..., :3, :3].transpose(-1, -2)
    translation = -(rotation @ matrix[..., :3, 3:])
    return torch.cat([torch.cat([rotation, translation], dim=-1), matrix[..., 3:, :]], dim=-2)


def other_views(values: Tensor) -> Tensor:
    """(B, V, ...) -> (B, V, V-1, ...): for each view the values of all others, in order, for a symbolic V."""
    views = values.shape[1]
    slot = torch.arange(views - 1, device=values.device)[None]
    view = torch.arange(views, device=values.device)[:, None]
    index = (slot + (slot >= view).long()).reshape(-1)
    return values.index_select(1, index).reshape(values.shape[0], views, views - 1, *values.shape[2:])


def repeat_for_pairs(values: Tensor, pairs_per_view: int) -> Tensor:
    """(B, V, ...) -> (B, V, V-1, ...): each view's own values once for every other view."""
    return values.unsqueeze(2).expand(-1, -1, pairs_per_view, *values.shape[2:])


def quaternion_to_matrix(wxyz: Tensor) -> Tensor:
    """(..., 4) unit quaternions to (..., 3, 3) rotations."""
    w, x, y, z = wxyz[..., 0], wxyz[..., 1], wxyz[..., 2], wxyz[..., 3]
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], dim=-1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], dim=-1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], dim=-1),
    ]
    return torch.stack(rows, dim=-2)


def matrix_to_quaternion(rotation: Tensor) -> Tensor:
    """(n, 3, 3) rotations to (n, 4) wxyz quaternions with w >= 0, stable up to and at half turns.

    Each row of `candidates` is the quaternion times four times one of its own components; the row of the largest
    component is the accurate one (Shepperd 1978).
    """
    r = rotation
    trace = r[:, 0, 0] + r[:, 1, 1] + r[:, 2, 2]
    xy, xz, yz = r[:, 0, 1] + r[:, 1, 0], r[:, 0, 2] + r[:, 2, 0], r[:, 1, 2] + r[:, 2, 1]
    wx, wy, wz = r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]
    squares = torch.stack([1 + trace] + [1 + 2 * r[:, i, i] - trace for i in range(3)], dim=-1)
    candidates = torch.stack(
        [
            torch.stack([squares[:, 0], wx, wy, wz], dim=-1),
            torch.stack([wx, squares[:, 1], xy, xz], dim=-1),
            torch.stack([wy, xy, squares[:, 2], yz], dim=-1),
            torch.stack([wz, xz, yz, squares[:, 3]], dim=-1),
        ],
        dim=1,
    )
    best = squares.argmax(dim=-1).reshape(-1, 1, 1).expand(-1, 1, 4)
    chosen = candidates.gather(1, best).squeeze(1)
    unit = chosen / chosen.square().sum(-1, keepdim=True).sqrt()
    return torch.where(unit[:, :1] < 0, -unit, unit)


def quaternion_product(a: Tensor, b: Tensor) -> Tensor:
    """Hamilton product of wxyz quaternions: the rotation b followed by a."""
    aw, ax, ay, az = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bw, bx, by, bz = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    return torch.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        dim=-1,
    )
