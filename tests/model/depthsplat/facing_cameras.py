"""Two cameras that face each other, and a point beside or behind the second."""

from __future__ import annotations

import torch
from torch import Tensor

LEAST = 1e-3  # what the authors clamp depths to


def facing_poses(k: Tensor, target_k: Tensor, at: tuple[float, float], depth: float, ahead: float) -> Tensor:
    """(1, 2, 4, 4) world_from_cam in float64. The point at z = `depth` that the first camera (K `k`) sees at `at` has
    z = `ahead` in the second and meets the middle of its picture (K `target_k`) if it is divided by `LEAST` at least.
    """
    point = torch.linalg.inv(k.double()) @ torch.tensor([*at, 1.0], dtype=torch.float64) * depth
    focal, centre = target_k.double().diagonal()[:2], target_k.double()[:2, 2]
    sideways = (0.5 * max(ahead, LEAST) - centre * ahead) / focal  # of the point, seen from the second
    poses = torch.eye(4, dtype=torch.float64).repeat(1, 2, 1, 1)
    poses[0, 1, :3, :3] = torch.diag(torch.tensor([-1.0, 1.0, -1.0]))
    poses[0, 1, :3, 3] = torch.stack([point[0] + sideways[0], point[1] - sideways[1], point[2] + ahead])
    return poses
