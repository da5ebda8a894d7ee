"""Warnings about poses that were projected onto rotations, and positions that may have been rounded to float32."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .camera import Camera
from .float32 import largest_shift
from .view_checks import Notice

LEAST_TURN_PX = 0.01  # below it no warning; rotations in float32 or with six decimals turn less
LEAST_SHIFT_PX = 0.1  # below it no warning


def pose_notices(cameras: Sequence[Camera], near: float, numbers: Sequence[int] | None = None) -> list[Notice]:
    """`near` is the nearest depth in the cameras' units, `numbers` what the caller calls the views, where these were
    chosen from more."""
    notices: list[Notice] = []
    for index, camera in zip(range(len(cameras)) if numbers is None else numbers, cameras, strict=True):
        focal = max(camera.fx, camera.fy)
        # With R = Q S, Q the nearest rotation, S is I + (R^T R - I) / 2 to first order: components of its third
        # column's change are at most half the drift.
        turned, moved = camera.given.drift / 2 * focal, camera.given.shift * focal / near
        if turned < LEAST_TURN_PX and moved < LEAST_SHIFT_PX:
            continue
        message = (
            f"max |R^T R - I| = {camera.given.drift:.3g}: the pose was projected onto the nearest rotation, which "
            f"moves the principal ray by up to {turned:.2g} px each way"
        )
        if camera.given.shift > 0:
            message += f" and the camera by {camera.given.shift:.3g} units, {moved:.2g} px at near = {near:.4g}"
        notices.append({"code": "pose_projected", "field": "cameras.c2w", "index": index, "message": message})
    steps, focal = [camera.given.step for camera in cameras], max(max(camera.fx, camera.fy) for camera in cameras)
    shift = largest_shift(max(steps), focal, near)
    if min(steps) > 0 and shift > LEAST_SHIFT_PX:
        far = max(float(np.abs(camera.center).max()) for camera in cameras)
        message = (
            f"all positions are float32 numbers and up to {far:.6g} units from the origin: if they were rounded to "
            f"float32, the precision of the input is {shift:.2g} px at near = {near:.4g}; subtract a common offset "
            "before rounding, or keep float64"
        )
        notices.append({"code": "float32_positions", "field": "cameras", "message": message})
    return notices
