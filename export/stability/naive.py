"""Straightforward float32 implementations for comparison in the stability table; the product uses none of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gapmes.model.evidence import COLOUR_LIMIT, FLAT, GUIDE_EPSILON, GUIDE_RADIUS, WINDOW_RADIUS
from gapmes.service.cameras.camera import Camera
from gapmes.service.gaussians import Gaussians

F32 = np.float32
Array = NDArray[np.floating]


def picture(
    gaussians: Gaussians, camera: Camera, *, exclusive: bool = False, stop: float = 1e-4
) -> tuple[Array, Array]:
    """Colour (H, W, 3) and opacity by the 2-D covariance and its inverse, all in float32, in the order of float32
    depths; `exclusive` stops before the Gaussian that would finish a pixel."""
    rotation, centre = camera.rotation.astype(F32), camera.center.astype(F32)
    points = (gaussians.means.astype(F32) - centre) @ rotation
    columns = np.arange(camera.width, dtype=F32) + F32(0.5)
    rows = np.arange(camera.height, dtype=F32)[:, None] + F32(0.5)
    light, colour = np.ones((camera.height, camera.width), F32), np.zeros((camera.height, camera.width, 3), F32)
    done = np.zeros(light.shape, bool)
    for i in np.argsort(points[:, 2], kind="stable"):
        x, y, z = points[i]
        if not z > F32(0.01):
            continue
        limits = F32(0.65) * np.array([camera.width / camera.fx, camera.height / camera.fy], F32)
        tx, ty = np.clip(x / z, -limits[0], limits[0]), np.clip(y / z, -limits[1], limits[1])
        jacobian = np.array([[camera.fx / z, 0, -camera.fx * tx / z], [0, camera.fy / z, -camera.fy * ty / z]], F32)
        spread = _rotation(gaussians.rotations_wxyz[i]) * gaussians.scales[i]
        covariance = (spread @ spread.T).astype(F32)
        view = (jacobian @ rotation.T).astype(F32)
        flat = (view @ covariance @ view.T).astype(F32) + F32(0.3) * np.eye(2, dtype=F32)
        with np.errstate(all="ignore"):
            det = F32(flat[0, 0] * flat[1, 1] - flat[0, 1] * flat[0, 1])
            if det == 0 or not np.isfinite(det):
                continue
            a, b, c = flat[1, 1] / det, -flat[0, 1] / det, flat[0, 0] / det
            dx, dy = columns - F32(camera.fx * x / z + camera.cx), rows - F32(camera.fy * y / z + camera.cy)
            power = F32(-0.5) * (a * dx * dx + c * dy * dy) - b * dx * dy
            alpha = np.minimum(gaussians.opacities[i] * np.exp(power), F32(0.99))
        seen = (power <= 0) & (alpha >= F32(1 / 255)) & ~done
        after = light * (F32(1) - alpha)
        if exclusive:
            done |= seen & (after < F32(stop))
            seen &= ~done
        weight = np.where(seen, alpha * light, F32(0)).astype(F32)
        shade = np.maximum(F32(0.5) + F32(0.28209479) * gaussians.harmonics[i, 0], F32(0))
        colour += weight[..., None] * shade
        light = np.where(seen, after, light)
        if not exclusive:
            done |= light <= F32(stop)
    return colour, F32(1) - light


def _rotation(wxyz: Array) -> Array:
    w, x, y, z = wxyz.astype(F32)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ],
        F32,
    )


def unit_quaternion(raw: Array) -> Array:
    """q / (|q| + 1e-8)."""
    with np.errstate(all="ignore"):
        length = np.sqrt((raw.astype(F32) ** 2).sum(axis=-1, keepdims=True))
        return raw.astype(F32) / (length + F32(1e-8))


def softmax(logits: Array, temperature: float) -> Array:
    """exp of logits over temperature, divided by its sum."""
    with np.errstate(all="ignore"):
        values = np.exp(logits.astype(F32) / F32(temperature))
        return values / values.sum(axis=-1, keepdims=True)


def relative_pose(first: Array, second: Array) -> Array:
    """inverse(first) @ second with both stored in float32."""
    return np.linalg.inv(first.astype(F32)) @ second.astype(F32)


def band_rotation_by_angles(rotation: Array) -> Array:
    """(3, 3) rotation of band 1 (order y, z, x) by way of Euler angles in float32: acos and atan2, then products."""
    r = rotation.astype(F32)
    beta = np.arccos(np.clip(r[2, 2], F32(-1), F32(1)))
    alpha, gamma = np.arctan2(r[1, 2], r[0, 2]), np.arctan2(r[2, 1], -r[2, 0])

    def about_z(angle: Array) -> Array:
        c, s = np.cos(angle), np.sin(angle)
        return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]], F32)

    c, s = np.cos(beta), np.sin(beta)
    about_y = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]], F32)
    return about_z(alpha) @ about_y @ about_z(gamma)


def evidence(first: Array, second: Array) -> Array:
    """(h, w) matching evidence of two pictures (3, h, w) of the same camera, in their dtype, with variances and
    covariances as means of products less products of means (defined in `model/evidence.py`). In float64 it is the
    table's reference."""

    def mean(values: Array, radius: int) -> Array:
        padded = np.pad(values, radius, mode="edge")
        return np.lib.stride_tricks.sliding_window_view(padded, (2 * radius + 1, 2 * radius + 1)).mean((2, 3))

    def together(a: Array, b: Array, radius: int) -> Array:
        return mean(a * b, radius) - mean(a, radius) * mean(b, radius)

    a, b = first.mean(0), second.mean(0)
    spread = np.sqrt(np.maximum(together(a, a, WINDOW_RADIUS), 0) * np.maximum(together(b, b, WINDOW_RADIUS), 0))
    correlation = np.clip(together(a, b, WINDOW_RADIUS) / np.maximum(spread, FLAT), -1, 1)
    difference = np.minimum(np.abs(second - first).mean(0), COLOUR_LIMIT) / COLOUR_LIMIT
    score = (1 + correlation) / 4 + (1 - difference) / 2
    slope = together(a, score, GUIDE_RADIUS) / (together(a, a, GUIDE_RADIUS) + GUIDE_EPSILON)
    return mean(slope, GUIDE_RADIUS) * a + mean(mean(score, GUIDE_RADIUS) - slope * mean(a, GUIDE_RADIUS), GUIDE_RADIUS)
