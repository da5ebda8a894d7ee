"""Figures on generated scenes that training never sees: PSNR, SSIM, LPIPS, depth error, holes, expert shares."""

from __future__ import annotations

import torch

from ..network import GaPMeS
from .losses import gaussian_ssim, psnr
from .lpips import Lpips
from .scenes import SceneSampler
from .step import TensorBatch, predict_and_draw, to_tensors

VALIDATION_SEED = 900_001


def validation_batches(size: int, count: int, baseline: tuple[float, float]) -> list[TensorBatch]:
    """`count` scenes of fixed seeds with two inputs and two targets each."""
    sampler = SceneSampler(VALIDATION_SEED, "validation")
    return [to_tensors(sampler.batch(1, 2, 2, size, baseline=baseline), zoomed=False) for _ in range(count)]


@torch.no_grad()
def validate(model: GaPMeS, batches: list[TensorBatch], lpips: Lpips | None = None) -> dict[str, object]:
    """Means over all targets; `copy_psnr` is the PSNR of the nearer input itself, the baseline to exceed.

    `lpips` adds a score of that name.
    """
    was_training = model.training
    model.eval()
    scores, structure, perceived, depth, holes, copies, shares = [], [], [], [], [], [], []
    device = next(model.parameters()).device
    for batch in (batch.to(device) for batch in batches):
        prediction, rgb, alpha = predict_and_draw(model, batch)
        rgb, truth = rgb.clamp(0, 1).flatten(0, 1), batch.targets.flatten(0, 1)
        scores += psnr(rgb, truth).tolist()
        structure += gaussian_ssim(rgb, truth).tolist()
        if lpips is not None:
            pairs = zip(rgb.cpu().numpy(), truth.cpu().numpy(), strict=True)
            perceived += [lpips.distance(drawn, true) for drawn, true in pairs]
        holes.append(float((alpha < 0.5).float().mean()))
        truth_depth = batch.depth[:, :, 0]
        inverse = prediction.final_inverse.reshape(truth_depth.shape)
        depth.append(float((inverse - truth_depth).abs().mean()))
        distance = (batch.target_poses[:, :, None, :3, 3] - batch.poses[:, None, :, :3, 3]).norm(dim=-1)
        nearest = distance.argmin(-1)
        copied = torch.stack([batch.images[b, nearest[b]] for b in range(len(nearest))]).flatten(0, 1)
        copies += psnr(copied, truth).tolist()
        if prediction.routing is not None and prediction.routing.expert_index is not None:
            index = prediction.routing.expert_index.flatten()
            shares.append(torch.bincount(index, minlength=model.config.experts).float() / len(index))
    model.train(was_training)
    result: dict[str, object] = {
        "psnr": _mean(scores),
        "ssim": _mean(structure),
        "depth_error": _mean(depth),
        "holes": _mean(holes),
        "copy_psnr": _mean(copies),
    }
    if lpips is not None:
        result["lpips"] = _mean(perceived)
    if shares:
        result["expert_share"] = [round(float(x), 3) for x in torch.stack(shares).mean(0)]
    return result


def _mean(values: list[float]) -> float:
    return round(sum(values) / len(values), 4)
