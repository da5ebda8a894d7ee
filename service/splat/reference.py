"""The reference renderer: the same definition by brute force in float64, every Gaussian at every pixel."""

from __future__ import annotations

from collections.abc import Sequence
from math import factorial, inf, pi, sqrt

import numpy as np
from numpy.polynomial import Legendre
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..gaussians import Gaussians
from .definition import Definition
from .options import check_types, checked_background, checked_definition, checked_degree
from .order import depth_order
from .render import Render

F64 = NDArray[np.float64]


def sh_basis(directions: F64, degree: int) -> F64:
    """(N, (degree+1)^2) real spherical harmonics of unit directions (N, 3), Condon-Shortley sign, m = -l..l."""
    x, y, z = directions.T
    columns = []
    for band in range(degree + 1):
        for m in range(-band, band + 1):
            a = abs(m)
            norm = sqrt((2 - (m == 0)) * (2 * band + 1) / (4 * pi) * factorial(band - a) / factorial(band + a))
            ring = (x + 1j * y) ** a
            azimuth = ring.imag if m < 0 else ring.real
            columns.append((-1) ** a * norm * Legendre.basis(band).deriv(a)(z) * azimuth)
    return np.stack(columns, axis=1)


def rotation_matrix(wxyz: F64) -> F64:
    """(3, 3) rotation of a quaternion (4,) of any length: I + 2 w [v] + 2 [v]^2 with [v] u = v x u (Rodrigues)."""
    w, *v = wxyz / np.linalg.norm(wxyz)
    cross = np.cross(v, np.eye(3)).T
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def render_reference(
    gaussians: Gaussians,
    camera: Camera,
    *,
    background: Sequence[float] | None = None,
    sh_degree: int | None = None,
    near: float | None = None,
    definition: Definition | None = None,
    compatibility: str | None = None,
    subset: NDArray[np.bool_] | None = None,
    faint: float = 0.0,
    beyond: float = inf,
) -> Render:
    """The exact image of `render` with all outputs, in float64; O(N H W).

    `removed` sums the weights of the Gaussians in the mask `subset` (N,) and of all layers with alpha below `faint` or
    farther than `beyond` standard deviations from their Gaussian's centre. The other arguments are those of `render`.
    Raises `InputError`.
    """
    check_types(gaussians, camera)
    rule, degree = checked_definition(definition, near, compatibility), checked_degree(sh_degree, gaussians)
    behind = checked_background(background)
    offset = gaussians.means - camera.center
    x, y, z = (offset @ camera.rotation).T
    drawn = (z > rule.near) & (z <= rule.far) & (gaussians.opacities.astype(np.float64) >= rule.alpha_min)
    half = 0.5 * rule.fov_margin * np.array([camera.width, camera.height])
    low = -(np.array([camera.cx, camera.cy]) + half) / (camera.fx, camera.fy)
    high = (np.array([camera.width - camera.cx, camera.height - camera.cy]) + half) / (camera.fx, camera.fy)
    columns, rows = np.arange(camera.width) + 0.5, np.arange(camera.height)[:, None] + 0.5
    finished = np.zeros((camera.height, camera.width), bool)
    light, mass = np.ones((camera.height, camera.width)), np.zeros((camera.height, camera.width))
    colour = np.zeros((camera.height, camera.width, 3))
    depth, median, removed = (np.zeros_like(light) for _ in range(3))
    peaks, pairs = np.zeros(len(gaussians)), 0
    chosen = np.zeros(len(gaussians), bool) if subset is None else np.asarray(subset, bool)
    for i in depth_order(z, np.flatnonzero(drawn).astype(np.int32), gaussians):
        tan = np.clip([x[i] / z[i], y[i] / z[i]], low, high)
        jacobian = np.array([[camera.fx, 0, -camera.fx * tan[0]], [0, camera.fy, -camera.fy * tan[1]]]) / z[i]
        own = rotation_matrix(gaussians.rotations_wxyz[i].astype(np.float64))
        a = np.hstack([jacobian @ camera.rotation.T @ own * gaussians.scales[i], sqrt(rule.dilation) * np.eye(2)])
        l1 = np.linalg.norm(a[0])
        k = a[0] @ a[1] / l1**2
        minors = np.outer(a[0], a[1]) - np.outer(a[1], a[0])  # each twice
        l2 = np.linalg.norm(minors) / sqrt(2) / l1  # Cauchy-Binet; |a1 - k a0| cancels for long needles
        dx, dy = columns - (camera.fx * x[i] / z[i] + camera.cx), rows - (camera.fy * y[i] / z[i] + camera.cy)
        distance2 = (dx / l1) ** 2 + ((dy - k * dx) / l2) ** 2
        alpha = np.minimum(gaussians.opacities[i].astype(np.float64) * np.exp(-0.5 * distance2), rule.alpha_max)
        seen = (alpha >= rule.alpha_min) & (distance2 <= rule.cut_radius * rule.cut_radius)
        if rule.inclusive_stop:
            added = seen & (light > rule.stop)
        else:
            finished |= seen & (light - alpha * light < rule.stop)
            added = seen & ~finished
        weight = np.where(added, alpha * light, 0.0)
        basis = sh_basis(offset[i : i + 1] / np.linalg.norm(offset[i]), degree)[0]
        colour += weight[..., None] * np.maximum(0.5 + basis @ gaussians.harmonics[i, : len(basis)], 0.0)
        median[added & (light > 0.5) & (light - weight <= 0.5)] = z[i]
        peaks[i], pairs = weight.max(initial=0.0), pairs + int(added.sum())
        removed += weight * (chosen[i] | (alpha < faint) | (distance2 > beyond * beyond))
        depth, mass, light = depth + weight * z[i], mass + weight, light - weight
    depth = np.divide(depth, mass, out=np.zeros_like(depth), where=mass > 0)
    colour += light[..., None] * behind
    stats = {"count": len(gaussians), "in_range": int(drawn.sum()), "pairs": pairs}
    return Render(colour, 1.0 - light, depth, stats, median, removed, peaks)
