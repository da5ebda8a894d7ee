"""Matching between views: plane sweep by correlation at 1/4 resolution, local candidates at 1/2 resolution."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .geometry import camera_rays, other_views, pixel_grid, repeat_for_pairs, rigid_inverse
from .gradients import no_gradient
from .layers import replicate_pad
from .warp import Warp

# The correlation map of one pair has (h*w)^2 entries: 67 MB at 64 x 64. It is computed in this many pieces of rows of
# the reference, which divides the peak memory and changes no result.
SWEEP_PIECES = 8


@dataclass(frozen=True)
class Views:
    """Cameras of B scenes with V views: K (B, V, 3, 3) normalised, poses (B, V, 4, 4), inverse-depth range (B, 1)."""

    intrinsics: Tensor
    world_from_cam: Tensor
    inverse_far: Tensor
    inverse_near: Tensor
    _warps: dict[tuple[int, int], Warp] = field(default_factory=dict, init=False, repr=False, compare=False)

    @staticmethod
    def make(intrinsics: Tensor, world_from_cam: Tensor, near_far: Tensor) -> Views:
        """near_far (B, 2)."""
        return Views(intrinsics, world_from_cam, 1 / near_far[:, 1:], 1 / near_far[:, :1])

    @property
    def count(self) -> int:
        return self.intrinsics.shape[1]

    def per_view(self, values: Tensor) -> Tensor:
        """(B, 1) -> (B*V, 1, 1, 1)."""
        return values.expand(-1, self.count).reshape(-1, 1, 1, 1)

    def inverse_depth(self, normalised: Tensor) -> Tensor:
        """Normalised inverse depth (B*V, c, h, w), 0 at far and 1 at near, to 1 / z."""
        low, high = self.per_view(self.inverse_far), self.per_view(self.inverse_near)
        return low + (high - low) * normalised

    def warp(self, height: int, width: int) -> Warp:
        """The warp of a height x width grid, rays (m, 1, height * width), between all m = B*V*(V-1) ordered pairs of
        views; cached by size. No gradient flows to the cameras."""
        if (height, width) not in self._warps:
            with no_gradient():
                self._warps[height, width] = self._warp(height, width)
        return self._warps[height, width]

    def _warp(self, height: int, width: int) -> Warp:
        others = self.count - 1
        reference_pose = repeat_for_pairs(self.world_from_cam, others).reshape(-1, 4, 4)
        source_pose = other_views(self.world_from_cam).reshape(-1, 4, 4)
        reference_k = repeat_for_pairs(self.intrinsics, others).reshape(-1, 3, 3)
        source_k = other_views(self.intrinsics).reshape(-1, 3, 3)
        grid = pixel_grid(height, width, reference_k.device).expand(reference_k.shape[0], -1, -1, -1)
        rays = camera_rays(grid, reference_k).flatten(2).unsqueeze(2)
        return Warp.make(rays, source_k, rigid_inverse(source_pose) @ reference_pose)


class PatchDescriptor(nn.Module):
    """Zero-mean normalised 4x4 grey patches with stride 2: correlating them is ZNCC, which needs no training."""

    taps: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("taps", torch.eye(16).reshape(16, 1, 4, 4), persistent=False)

    def forward(self, grey: Tensor) -> Tensor:
        """(n, 1, h, w) -> (n, 16, h/2, w/2), unit length up to a floor for flat patches."""
        patch = F.conv2d(replicate_pad(grey, 1), self.taps, stride=2)
        patch = patch - patch.mean(1, keepdim=True)
        return patch / (patch.square().sum(1, keepdim=True) + 16e-3).sqrt()


def sweep(features: list[Tensor], views: Views, planes: int) -> tuple[list[Tensor], Tensor]:
    """Mean correlation with the other views on `planes` depths uniform in inverse depth.

    features: tensors (B*V, C_i, h, w). Correlate first (one matrix product per pair), then sample the correlation map
    along the epipolar line: bilinear sampling is linear, so this equals sampling the features and is far cheaper.
    Returns one (B*V, D, h, w) per feature tensor, averaged over the views that see the point, and the share of them.
    """
    n, _, h, w = features[0].shape
    warp = views.warp(h, w).turned()
    bins = torch.linspace(0, 1, planes, device=features[0].device).reshape(1, planes, 1, 1)
    inverse = views.inverse_depth(bins)[:, :, 0, 0]  # (B*V, D)
    others = views.count - 1
    inverse = inverse.reshape(-1, views.count, planes).unsqueeze(2).expand(-1, -1, others, -1).reshape(-1, 1, planes)
    reference = [
        repeat_for_pairs(f.reshape(-1, views.count, *f.shape[1:]), others).reshape(-1, *f.shape[1:]) for f in features
    ]
    source = [other_views(f.reshape(-1, views.count, *f.shape[1:])).reshape(-1, *f.shape[1:]) for f in features]
    pieces: list[list[Tensor]] = [[] for _ in features]
    insides: list[Tensor] = []
    for start in range(0, h, -(-h // SWEEP_PIECES)):
        stop = min(h, start + -(-h // SWEEP_PIECES))
        grid, inside = warp.part(start * w, stop * w).positions(inverse)
        insides.append(inside.to(grid.dtype))
        for number, (ref, src) in enumerate(zip(reference, source, strict=True)):
            correlation = ref[:, :, start:stop].flatten(2).transpose(1, 2) @ src.flatten(2)
            sampled = F.grid_sample(
                correlation.reshape(-1, 1, h, w),
                grid.reshape(-1, planes, 1, 2),
                mode="bilinear",
                padding_mode="zeros",
                align_corners=False,
            )
            pieces[number].append(sampled.reshape(-1, (stop - start) * w, planes) * insides[-1])
    seen = torch.cat(insides, dim=1).reshape(-1, others, h * w, planes).sum(1)
    volumes = []
    for parts in pieces:
        total = torch.cat(parts, dim=1).reshape(-1, others, h * w, planes).sum(1)
        volumes.append((total / seen.clamp(min=1)).transpose(1, 2).reshape(n, planes, h, w))
    return volumes, (seen / others).transpose(1, 2).reshape(n, planes, h, w)


def local_matching(features: list[Tensor], candidates: Tensor, views: Views) -> tuple[list[Tensor], Tensor]:
    """Mean correlation at per-pixel candidates (B*V, K, h, w) of normalised inverse depth.

    features: tensors (B*V, C_i, h, w), each correlated on its own. Returns one (B*V, K, h, w) per feature tensor and
    the share of other views that see the point.
    """
    n, count, h, w = candidates.shape
    others = views.count - 1
    inverse = views.inverse_depth(candidates).reshape(-1, views.count, count, h * w)
    inverse = repeat_for_pairs(inverse, others).reshape(-1, count, h * w)
    grid, inside = views.warp(h, w).positions(inverse)
    mask = inside.to(candidates.dtype)
    seen = mask.reshape(-1, others, count, h * w).sum(1)
    widths = [feature.shape[1] for feature in features]
    channels = sum(widths)
    # all feature maps at once: computing sample positions costs more than reading samples
    per_view = torch.cat(features, dim=1).reshape(-1, views.count, channels, h, w)
    source = other_views(per_view).reshape(-1, channels, h, w)
    reference = repeat_for_pairs(per_view, others).reshape(-1, channels, 1, h * w)
    each: list[list[Tensor]] = [[] for _ in features]
    # candidate by candidate: all at once would take K times the memory of the feature maps
    for at in grid.split(1, dim=1):
        products = reference * F.grid_sample(source, at, mode="bilinear", padding_mode="zeros", align_corners=False)
        for scores, part in zip(each, products.split(widths, dim=1), strict=True):
            scores.append(part.sum(1))
    volumes = []
    for scores in each:
        total = (torch.cat(scores, dim=1) * mask).reshape(-1, others, count, h * w).sum(1)
        volumes.append((total / seen.clamp(min=1)).reshape(n, count, h, w))
    return volumes, (seen / others).reshape(n, count, h, w)
