"""What was done to the poses, or had been before they came, that a caller should know: projection, and float32."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .camera import Camera

TOLD_MOVE = 0.01  # px; float32 and six decimals move less, and no match is as fine
TOLD_PX = 0.1  # of precision; the network finds matches to about that


def pose_notices(cameras: Sequence[Camera], near: float) -> list[dict[str, Any]]:
    """Warnings with code, field, index and message; `near` is the nearest depth in the cameras' units."""
    notices = [_projected(camera, index) for index, camera in enumerate(cameras) if _moved(camera) >= TOLD_MOVE]
    centers = np.stack([camera.center for camera in cameras])
    shift = float32_shift(centers, max(max(camera.fx, camera.fy) for camera in cameras), near)
    if shift > TOLD_PX:
        message = (
            f"all positions are float32 numbers and up to {np.abs(centers).max():.6g} units from the origin: if they "
            f"were rounded to float32, the precision of the input is {shift:.2g} px at near = {near:.4g}; subtract a "
            "common offset before rounding, or keep float64"
        )
        notices.append({"code": "float32_positions", "field": "cameras", "message": message})
    return notices


def float32_shift(positions: NDArray[np.floating], focal: float, depth: float) -> float:
    """How far, in px, rounding `positions` (N, 3) to float32 may have moved a point at `depth` under `focal` px: half a
    float32 step at the largest coordinate, times focal / depth. 0 where a coordinate is no float32 number, so that
    they were never rounded to it."""
    if not positions.size:
        return 0.0
    with np.errstate(over="ignore"):
        narrow = positions.astype(np.float32)
    if not (np.isfinite(narrow).all() and (narrow == positions).all()):
        return 0.0
    return float(np.spacing(np.abs(narrow).max())) / 2 * focal / depth


def _moved(camera: Camera) -> float:
    """Px by which projecting the pose moves the principal ray at most, each way. With R = Q S, Q the nearest rotation,
    S is I + (R^T R - I) / 2 to first order: components of its third column's change are at most half the drift."""
    return camera.drift / 2 * max(camera.fx, camera.fy)


def _projected(camera: Camera, index: int) -> dict[str, Any]:
    message = (
        f"max |R^T R - I| = {camera.drift:.3g}: the pose was projected onto the nearest rotation, which moves the "
        f"principal ray by up to {_moved(camera):.2g} px each way"
    )
    return {"code": "pose_projected", "field": "cameras.c2w", "index": index, "message": message}
