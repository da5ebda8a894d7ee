"""Scenes for verification: random ones, and degenerate ones with ties, idle experts and ambiguous matching."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F

from gapmes.model.config import PIXELS_PER_PATCH

from .graph import SceneInputs

FLAT = ("black", "white", "grey")  # names of the hostile scenes whose images have one colour
# Names of those where no plane matches: noise, and a far range whose planes all miss the scene.
UNDETERMINED = ("noise", "far range")


def rotation_y(angle: float) -> torch.Tensor:
    """(3, 3) rotation about the y axis by `angle` in radians."""
    c, s = math.cos(angle), math.sin(angle)
    return torch.tensor([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def random_scene(views: int, height: int, width: int, *, seed: int) -> SceneInputs:
    """A textured wall seen by cameras on a gentle arc: smooth noise, the same in every view up to parallax."""
    generator = torch.Generator().manual_seed(seed)
    coarse = torch.rand(1, 3, height // 8 + 4, width // 8 + 4, generator=generator)
    wall = F.interpolate(coarse, size=(height + 32, width + 32), mode="bicubic", align_corners=False).clamp(0, 1)
    shifts = [min(32, 4 * v) for v in range(views)]
    images = torch.cat([wall[:, :, 8 : 8 + height, s : s + width] for s in shifts])
    images = (images + 0.02 * torch.rand(images.shape, generator=generator)).clamp(0, 1)
    intrinsics = torch.tensor([[0.9, 0, 0.5], [0, 0.9 * width / height, 0.5], [0, 0, 1]]).repeat(views, 1, 1)
    poses = torch.eye(4).repeat(views, 1, 1)
    for v in range(views):
        poses[v, :3, :3] = rotation_y(0.02 * v)
        poses[v, :3, 3] = torch.tensor([0.12 * v, 0.01 * v, -0.02 * v])
    return SceneInputs(images, intrinsics, poses, torch.tensor([1.0, 20.0]), all_patches(views, height, width))


def hostile_scenes(views: int, height: int, width: int) -> dict[str, SceneInputs]:
    """Degenerate inputs by name, for which outputs must be finite and agree between the two runtimes."""
    base = random_scene(views, height, width, seed=views)
    generator = torch.Generator().manual_seed(100 + views)

    def changed(**values: torch.Tensor) -> SceneInputs:
        return SceneInputs(**{**base.__dict__, **values})

    half = base.patch_mask.clone()
    half[:, ::2] = False
    still = base.world_from_cam.clone()
    still[:] = torch.eye(4)
    return {
        "black": changed(images=torch.zeros_like(base.images)),
        "white": changed(images=torch.ones_like(base.images)),
        "grey": changed(images=torch.full_like(base.images, 0.5)),
        "noise": changed(images=torch.rand(base.images.shape, generator=generator)),
        "no baseline": changed(world_from_cam=still),
        "far range": changed(near_far=torch.tensor([1e-2, 1e4])),
        "narrow range": changed(near_far=torch.tensor([3.0, 3.3])),
        "half masked": changed(patch_mask=half),
        "all masked": changed(patch_mask=torch.zeros_like(base.patch_mask)),
    }


def all_patches(views: int, height: int, width: int) -> torch.Tensor:
    """(V, P) a patch mask that keeps everything."""
    count = (height // PIXELS_PER_PATCH) * (width // PIXELS_PER_PATCH)
    return torch.ones(views, count, dtype=torch.bool)
