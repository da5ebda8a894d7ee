"""A scene at a finer resolution than the network's: Gaussians subdivided and coloured by the photographs' own
pixels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..cameras.rotations import rotated
from ..cameras.world_frame import WorldFrame
from ..harmonics import C0
from ..network.engine import Arrays
from ..photographs.images import FittedView
from .depth_grid import finer_depths, pixel_steps

F64 = NDArray[np.float64]


def finer(outputs: Arrays, frame: WorldFrame, views: Sequence[FittedView], fine: Sequence[FittedView]) -> Arrays:
    """The network's outputs for `views` (V, H, W), upsampled to `fine`, the same crops with k times the pixels per
    axis.

    Every pixel's Gaussian is split into k x k, k times smaller, on the rays of the fine pixels and on the plane through
    its neighbours (`depth_grid.py`). Each adds to the base colour the difference of its fine pixel from the mean of the
    k x k, so that their mean colour stays. Gaussians that belong to no pixel are unchanged.
    """
    count, height, width = outputs["depth"].shape
    k = fine[0].camera.width // width
    pixels = count * height * width
    shape = (count, height, width)
    means = outputs["means"][:pixels].reshape(*shape, 3)
    poses = frame.poses([view.camera for view in views]).astype(np.float64)
    depth = np.empty((count, k * height, k * width))
    placed = np.empty((*depth.shape, 3))
    details = np.empty((*depth.shape, 3), np.float32)
    for index, (view, larger, pose) in enumerate(zip(views, fine, poses, strict=True)):
        depth[index], placed[index] = _on_rays(means[index], outputs["depth"][index], view.camera, pose, k)
        details[index] = _detail(larger, k)

    def repeated(name: str) -> NDArray:
        values = outputs[name][:pixels]
        return _enlarged(values.reshape(*shape, *values.shape[1:]), k).reshape(-1, *values.shape[1:])

    harmonics = repeated("harmonics")
    harmonics[:, 0] += details.reshape(-1, 3) / np.float32(C0)
    each = {
        "means": placed.reshape(-1, 3).astype(np.float32),
        "scales": repeated("scales") / np.float32(k),
        "rotations_wxyz": repeated("rotations_wxyz"),
        "opacities": repeated("opacities"),
        "harmonics": harmonics,
    }
    return {
        **outputs,
        **{name: np.concatenate([value, outputs[name][pixels:]]) for name, value in each.items()},
        "depth": depth.astype(np.float32),
        "confidence": _enlarged(outputs["confidence"], k),
    }


def _on_rays(means: NDArray, depth: NDArray, camera: Camera, pose: F64, k: int) -> tuple[F64, F64]:
    """(kH, kW) z-depths and (kH, kW, 3) means of the finer Gaussians, from `means` (H, W, 3) and `depth` (H, W) of a
    view; all in the network's frame, in which `pose` (4, 4) is the camera's. A Gaussian's offset from its pixel's ray,
    in px, and its depth relative to the pixel's are preserved."""
    rotation, center = pose[:3, :3], pose[:3, 3]
    height, width = depth.shape
    depths = finer_depths(depth, k)
    here = rotated(rotation.T, means.astype(np.float64) - center)
    places = np.empty((height, k, width, k, 3))
    for row, dy in enumerate(pixel_steps(k)):
        for column, dx in enumerate(pixel_steps(k)):
            ratio = (depths[row::k, column::k] / depth)[..., None]
            aside = here[..., 2:] * np.array([dx / camera.fx, dy / camera.fy, 0.0])
            places[:, row, :, column] = rotated(rotation, ratio * (here + aside)) + center
    return depths, places.reshape(k * height, k * width, 3)


def _detail(view: FittedView, k: int) -> NDArray[np.float32]:
    """(kH, kW, 3) difference of each kept pixel from the mean of the kept pixels in its square of k x k; 0 if
    masked."""
    image = view.image.transpose(1, 2, 0)
    kept = view.kept.astype(np.float32)
    squares = (image.shape[0] // k, k, image.shape[1] // k, k)
    total = (image * kept[..., None]).reshape(*squares, 3).sum(axis=(1, 3))
    mean = total / np.maximum(kept.reshape(squares).sum(axis=(1, 3)), 1)[..., None]
    return (image - _enlarged(mean[None], k)[0]) * kept[..., None]


def _enlarged(values: NDArray, k: int) -> NDArray:
    """(V, H, W, ...) -> (V, kH, kW, ...), each value repeated k x k times."""
    return values.repeat(k, axis=1).repeat(k, axis=2)
