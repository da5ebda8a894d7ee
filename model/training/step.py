"""One training step: scenes to tensors, prediction, pictures, loss."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import torch
import torch.nn.functional as F
from torch import Tensor

from .losses import box_ssim, depth_loss, normalised_inverse_depth
from .recipe import Recipe
from .rendering import draw
from .scenes import SceneBatch

if TYPE_CHECKING:  # processes that draw scenes have no network, which takes seconds to import
    from ..network import FullPrediction, GaPMeS


@dataclass(frozen=True)
class TensorBatch:
    """B scenes: V input views and T target views; poses relative to the first input of each scene."""

    images: Tensor  # (B, V, 3, H, W)
    intrinsics: Tensor  # (B, V, 3, 3) normalised
    poses: Tensor  # (B, V, 4, 4) float32
    depth: Tensor  # (B, V, K, H, W) true normalised inverse depth, K = 1, or the 2 x 2 finer samples when zoomed
    near_far: Tensor  # (B, 2)
    targets: Tensor  # (B, T, 3, h, w), h = H or 2 H
    target_intrinsics: Tensor  # (B, T, 3, 3) normalised
    target_poses: Tensor  # (B, T, 4, 4)

    def to(self, device: torch.device) -> TensorBatch:
        return TensorBatch(*(getattr(self, field.name).to(device) for field in fields(self)))


def to_tensors(batch: SceneBatch, *, zoomed: bool) -> TensorBatch:
    """Make poses relative to the first view in float64, then cast to float32; `zoomed` downsamples the inputs by 2 and
    keeps the targets."""
    world = torch.from_numpy(batch.world_from_cam)
    relative = (torch.linalg.inv(world[:, :1]) @ world).float()
    intrinsics = torch.from_numpy(batch.intrinsics).float()
    near_far = torch.from_numpy(batch.near_far).float()
    images, v = torch.from_numpy(batch.images), batch.inputs
    depth = normalised_inverse_depth(torch.from_numpy(batch.depths[:, :v]), near_far)
    inputs, samples = images[:, :v], [depth]
    if zoomed:
        inputs = F.avg_pool2d(inputs.flatten(0, 1), 2).reshape(*inputs.shape[:3], inputs.shape[-2] // 2, -1)
        samples = [depth[:, :, y::2, x::2] for y in (0, 1) for x in (0, 1)]
    return TensorBatch(
        inputs,
        intrinsics[:, :v],
        relative[:, :v],
        torch.stack(samples, dim=2),
        near_far,
        images[:, v:],
        intrinsics[:, v:],
        relative[:, v:],
    )


def predict_and_draw(model: GaPMeS, batch: TensorBatch) -> tuple[FullPrediction, Tensor, Tensor]:
    """Prediction, rgb (B, T, 3, h, w) and alpha (B, T, 1, h, w) at the targets."""
    prediction = model(batch.images, batch.intrinsics, batch.poses, batch.near_far)
    height, width = batch.targets.shape[-2:]
    near = 0.05 * float(batch.near_far[:, 0].min())
    rgb, alpha = draw(prediction.gaussians, batch.target_poses, batch.target_intrinsics, height, width, near=near)
    return prediction, rgb, alpha


def training_loss(model: GaPMeS, batch: TensorBatch, recipe: Recipe, step: int) -> tuple[Tensor, dict[str, float]]:
    """The loss of a step and its parts for the log."""
    prediction, rgb, _ = predict_and_draw(model, batch)
    squared = (rgb - batch.targets).square().mean()
    absolute = (rgb - batch.targets).abs().mean()
    structure = 1 - box_ssim(rgb.flatten(0, 1), batch.targets.flatten(0, 1))
    depth = depth_loss(prediction.estimate, prediction.final_inverse, batch.depth)
    loss = 4 * squared + 0.5 * absolute + recipe.ssim_weight * structure + recipe.depth_weight_at(step) * depth
    parts = {"mse": float(squared.detach()), "structure": float(structure.detach()), "depth": float(depth.detach())}
    if prediction.routing is not None:
        loss = loss + recipe.balance_weight * prediction.routing.balance_loss
        parts["balance"] = float(prediction.routing.balance_loss.detach())
    return loss, parts
