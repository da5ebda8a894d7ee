"""Differentiable Gaussian splatting on the CPU, with the same image definition as the service's renderer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from .splat_kernels import IMAGE_GRAD, RECORD, splat_backward_images, splat_backward_scenes, splat_forward


def splat(
    means: Tensor,
    factors: Tensor,
    opacities: Tensor,
    colours: Tensor,
    world_from_cam: Tensor,
    intrinsics: Tensor,
    height: int,
    width: int,
    *,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    near: float = 0.01,
    dilation: float = 0.3,
) -> tuple[Tensor, Tensor]:
    """Draw B scenes of N Gaussians into T views each.

    Args:
        means: (B, N, 3) world.
        factors: (B, N, 3, 3) world; the covariance is A A^T.
        opacities: (B, N) in [0, 1].
        colours: (B, N, 3).
        world_from_cam: (B, T, 4, 4), OpenCV axes.
        intrinsics: (B, T, 3, 3) in pixels of the target.
        background: colour behind everything.
        near: Gaussians with z <= near are left out.
        dilation: px^2 added to the diagonal of the image covariance.

    Returns:
        rgb (B, T, 3, H, W) over the background and alpha (B, T, 1, H, W), float32. Both are differentiable in means,
        factors, opacities and colours; cameras are constants. They lie on the device of `means`; the work is done on
        the CPU. Results do not depend on the number of threads.

    Raises:
        ValueError: shapes disagree, or a field holds NaN or infinity (named, counted).
    """
    batch, count = opacities.shape
    views = world_from_cam.shape[1]
    expected = {
        "means": (means, (batch, count, 3)),
        "factors": (factors, (batch, count, 3, 3)),
        "opacities": (opacities, (batch, count)),
        "colours": (colours, (batch, count, 3)),
        "world_from_cam": (world_from_cam, (batch, views, 4, 4)),
        "intrinsics": (intrinsics, (batch, views, 3, 3)),
    }
    for name, (value, shape) in expected.items():
        if tuple(value.shape) != shape:
            raise ValueError(f"{name}: shape is {tuple(value.shape)}, need {shape}")
        if not bool(torch.isfinite(value).all()):
            bad = int((~torch.isfinite(value)).sum())
            raise ValueError(f"{name}: {bad} of {value.numel()} numbers are NaN or infinite")
    cameras = _camera_rows(world_from_cam, intrinsics)
    size = (int(height), int(width))
    return _Splat.apply(
        means, factors, opacities, colours, cameras, size, np.asarray(background, np.float32), near, dilation
    )


def _camera_rows(world_from_cam: Tensor, intrinsics: Tensor) -> np.ndarray:
    """(B, T, 16) float64: rotation row-major, centre, fx, fy, cx, cy."""
    pose = world_from_cam.detach().cpu().double().numpy()
    k = intrinsics.detach().cpu().double().numpy()
    lens = np.stack([k[..., 0, 0], k[..., 1, 1], k[..., 0, 2], k[..., 1, 2]], axis=-1)
    return np.concatenate([pose[..., :3, :3].reshape(*pose.shape[:2], 9), pose[..., :3, 3], lens], axis=-1)


def _array(value: Tensor) -> np.ndarray:
    return value.detach().cpu().float().contiguous().numpy()


class _Splat(torch.autograd.Function):
    @staticmethod
    def forward(ctx, means, factors, opacities, colours, cameras, size, background, near, dilation):
        scene = (_array(means), _array(factors), _array(opacities), _array(colours))
        batch, views = cameras.shape[:2]
        images, count = batch * views, opacities.shape[1]
        rgb = np.empty((images, 3, *size), np.float32)
        transmittances = np.empty((images, *size), np.float32)
        records = np.empty((images, count, RECORD), np.float64)
        indices = np.empty((images, count), np.int32)
        visible = np.zeros(images, np.int64)
        last_used = np.zeros((images, *size), np.int32)
        splat_forward(
            *scene, cameras, background, near, dilation, rgb, transmittances, records, indices, visible, last_used
        )  # fmt: skip
        ctx.constants = (scene, cameras, size, background, dilation)
        ctx.images = (transmittances, records, indices, visible, last_used)
        ctx.dtypes = (means.dtype, factors.dtype, opacities.dtype, colours.dtype)
        ctx.device = means.device
        alpha = torch.from_numpy(1 - transmittances).view(batch, views, 1, *size)
        return torch.from_numpy(rgb).view(batch, views, 3, *size).to(means.device), alpha.to(means.device)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, rgb_grad, alpha_grad):
        (means, factors, opacities, colours), cameras, (height, width), background, dilation = ctx.constants
        transmittances, records, indices, visible, last_used = ctx.images
        images = len(transmittances)
        image_grads = np.empty((images, opacities.shape[1], IMAGE_GRAD), np.float64)
        splat_backward_images(
            background, transmittances, records, visible, last_used,
            _array(rgb_grad).reshape(images, 3, height, width), _array(alpha_grad).reshape(images, height, width),
            image_grads,
        )  # fmt: skip
        grads = [np.zeros(value.shape, np.float64) for value in (means, factors, opacities, colours)]
        splat_backward_scenes(
            means, factors, cameras, height, width, dilation, indices, visible, image_grads, *grads
        )  # fmt: skip
        typed = [torch.from_numpy(grad).to(ctx.device, dtype) for grad, dtype in zip(grads, ctx.dtypes, strict=True)]
        return *typed, None, None, None, None, None
