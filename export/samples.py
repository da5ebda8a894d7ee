"""Scenes for verification: random ones, one through other lenses, and degenerate ones with ties and idle experts."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F

from gapmes.model.config import PIXELS_PER_PATCH

from .graph import SceneInputs

FLAT = ("black", "white", "grey")  # names of the hostile scenes whose images have one colour
# Names of those where no plane matches: noise, and a far range whose planes all miss the scene.
UNDETERMINED = ("noise", "far range")
WALL_DEPTH = 4.0  # of `lenses_scene`, within its range of 1 to 20


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
    return SceneInputs(images, intrinsics, arc(views), torch.tensor([1.0, 20.0]), all_patches(views, height, width))


def arc(views: int) -> torch.Tensor:
    """(V, 4, 4) poses on a gentle arc."""
    poses = torch.eye(4).repeat(views, 1, 1)
    for v in range(views):
        poses[v, :3, :3] = rotation_y(0.02 * v)
        poses[v, :3, 3] = torch.tensor([0.12 * v, 0.01 * v, -0.02 * v])
    return poses


def lenses_scene(views: int, height: int, width: int, *, seed: int) -> SceneInputs:
    """A textured wall through another lens in each view, off the centre and with pixels that are not square; each view
    leaves other patches out.

    In the other scenes all views have one centred lens with square pixels and one mask: there a file that took those of
    another view, or half of a side for the principal point, would agree with torch.
    """
    generator = torch.Generator().manual_seed(seed)
    coarse = torch.rand(1, 3, height // 8 + 4, width // 8 + 4, generator=generator)
    wall = F.interpolate(coarse, size=(2 * height, 2 * width), mode="bicubic", align_corners=False).clamp(0, 1)
    intrinsics, poses, mask = torch.eye(3).repeat(views, 1, 1), arc(views), all_patches(views, height, width)
    x, y = ((torch.arange(side) + 0.5) / side for side in (width, height))
    images = []
    for v in range(views):
        fx, fy = 0.9 + 0.08 * v, (1.2 - 0.06 * v) * width / height
        cx, cy = 0.5 + 0.05 * (-1) ** v, 0.46 + 0.03 * v
        intrinsics[v, 0, 0], intrinsics[v, 1, 1], intrinsics[v, 0, 2], intrinsics[v, 1, 2] = fx, fy, cx, cy
        mask[v, v::7] = False
        rays = torch.stack(torch.broadcast_tensors((x - cx) / fx, ((y - cy) / fy)[:, None], torch.ones(())), dim=-1)
        rays = rays @ poses[v, :3, :3].T
        centre = poses[v, :3, 3]
        points = centre[:2] + rays[..., :2] * ((WALL_DEPTH - centre[2]) / rays[..., 2:])
        images.append(F.grid_sample(wall, points[None] / WALL_DEPTH, padding_mode="reflection", align_corners=False))
    return SceneInputs(torch.cat(images), intrinsics, poses, torch.tensor([1.0, 20.0]), mask)


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
