"""Gaussians of pixels resampled to a finer pixel grid: split, and placed on the rays of the finer pixels."""

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
from .depth_grid import FinerPixels, finer_depths

F64 = NDArray[np.float64]
PER_GAUSSIAN = ("scales", "rotations_wxyz", "opacities", "harmonics")


def on_finer_grid(
    outputs: Arrays,
    frame: WorldFrame,
    views: Sequence[FittedView],
    shape: tuple[int, int],
    details: Sequence[NDArray[np.float32]],
) -> Arrays:
    """The network's outputs for `views` (V, H, W), resampled to a grid of `shape` (H', W') over the same pictures, with
    at least as many rows and columns.

    Every finer pixel takes the Gaussian of the pixel that it lies in, at its own ray and on the plane through that
    pixel and its neighbours (`depth_grid.py`). The Gaussian becomes smaller by the root of the ratio of the pixels'
    areas, and `details`, V of (H', W', 3), are added to its base colour. Gaussians that belong to no pixel are
    unchanged.
    """
    count, height, width = outputs["depth"].shape
    rows, columns = FinerPixels.of(height, shape[0]), FinerPixels.of(width, shape[1])
    pixels = count * height * width

    def repeated(values: NDArray) -> NDArray:
        return values[:, rows.coarse[:, None], columns.coarse]

    def of_pixels(name: str) -> NDArray:
        return outputs[name][:pixels].reshape(count, height, width, *outputs[name].shape[1:])

    means = of_pixels("means")
    poses = frame.poses([view.camera for view in views]).astype(np.float64)
    depth = np.empty((count, *shape))
    placed = np.empty((*depth.shape, 3), np.float32)
    for index, (view, pose) in enumerate(zip(views, poses, strict=True)):
        depth[index], placed[index] = _on_rays(means[index], outputs["depth"][index], view.camera, pose, rows, columns)
    each = {name: repeated(of_pixels(name)) for name in PER_GAUSSIAN}
    each["means"] = placed
    each["scales"] = each["scales"] * np.float32(np.sqrt(height * width / np.prod(shape)))
    each["harmonics"][..., 0, :] += np.stack(details) / np.float32(C0)
    return {
        **outputs,
        **{
            name: np.concatenate([value.reshape(-1, *outputs[name].shape[1:]), outputs[name][pixels:]])
            for name, value in each.items()
        },
        "depth": depth.astype(np.float32),
        "confidence": np.ascontiguousarray(repeated(outputs["confidence"])),
    }


def unsqueezed(outputs: Arrays, frame: WorldFrame, seen: Sequence[FittedView], views: Sequence[FittedView]) -> Arrays:
    """The outputs for pictures as the network has `seen` them, on the grid of `views`, which they were reduced from
    (`squeezed`). What the network has changed of a pixel's colour is changed of each that takes its place."""
    shape = views[0].image.shape[1:]
    if seen[0].image.shape[1:] == shape:
        return outputs
    return on_finer_grid(outputs, frame, seen, shape, [_difference(*pair) for pair in zip(views, seen, strict=True)])


def _difference(view: FittedView, seen: FittedView) -> NDArray[np.float32]:
    """(H', W', 3) how far the colour of each pixel is from that of the pixel of `seen` that it lies in."""
    rows, columns = (FinerPixels.of(*counts) for counts in zip(seen.image.shape[1:], view.image.shape[1:], strict=True))
    return (view.image - seen.image[:, rows.coarse[:, None], columns.coarse]).transpose(1, 2, 0)


def _on_rays(
    means: NDArray, depth: NDArray, camera: Camera, pose: F64, rows: FinerPixels, columns: FinerPixels
) -> tuple[F64, F64]:
    """(H', W') z-depths and (H', W', 3) means of the finer Gaussians, from `means` (H, W, 3) and `depth` (H, W) of a
    view; all in the network's frame, in which `pose` (4, 4) is the camera's. A Gaussian's offset from its pixel's ray,
    in px of the coarse grid, and its depth relative to the pixel's are preserved."""
    rotation, center = pose[:3, :3], pose[:3, 3]
    depths = finer_depths(depth, len(rows.coarse), len(columns.coarse))
    places = np.ix_(rows.coarse, columns.coarse)
    here = rotated(rotation.T, means.astype(np.float64) - center)[places]
    ratio = (depths / depth[places])[..., None]
    steps = np.zeros((*depths.shape, 3))
    steps[..., 0], steps[..., 1] = columns.step / camera.fx, rows.step[:, None] / camera.fy
    return depths, rotated(rotation, ratio * (here + here[..., 2:] * steps)) + center
