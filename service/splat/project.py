"""Float64 projection of Gaussians into the image (Eq. 17-18): footprints, shades and depths, every culled one counted.

A footprint is the ellipse factor of EWA projection (Zwicker et al. 2001) and never a covariance, which float32 or an
inverse would ruin for thin splats. With A = [J W R S | sqrt(dilation) I] (2 x 5, rows a1 and a2), the lower triangle
    l1 = |a1|,  k = a1.a2 / l1^2,  l2 = |a2 - k a1| = sqrt(det(A A^T)) / l1
gives the squared Mahalanobis distance (dx / l1)^2 + ((dy - k dx) / l2)^2, which cannot be negative. The determinant is
the sum of squared 2 x 2 minors of A (Cauchy-Binet), so nothing cancels however long the needle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..camera import Camera
from ..gaussians import Gaussians
from .definition import Definition
from .kernel_cache import kernel
from .parallel import run_ranges
from .shade import shade

# The exponent is carried as a power of two: 2^-(u1^2 + u2^2) with u scaled by this is exp(-distance^2 / 2).
HALF_LOG2E = math.sqrt(0.5 / math.log(2.0))

# Added to the squared radius of the alpha cut, so that tile lists hold every pixel that float32 lets through: its
# error in the squared distance is below 1e-4.
RADIUS_SLACK = 1e-3

DRAWN, NEAR, FAR, FAINT, NOT_FINITE, OUTSIDE = range(6)
REASONS = {"near": NEAR, "far": FAR, "faint": FAINT, "not_finite": NOT_FINITE, "outside": OUTSIDE}


@dataclass(frozen=True, eq=False)
class Projection:
    """What one camera sees of N Gaussians; rows of culled ones are undefined."""

    footprints: NDArray[np.float64]  # (N, 8) x, y, HALF_LOG2E/l1, k, HALF_LOG2E/l2, half width, half height, shear; px
    shades: NDArray[np.float32]  # (N, 5) r, g, b, z-depth, log2 opacity
    depths: NDArray[np.float64]  # (N,) camera-frame z
    status: NDArray[np.uint8]  # (N,) DRAWN or why not
    crossing: int  # drawn Gaussians whose three-sigma extent reaches behind the near plane

    @property
    def culled(self) -> dict[str, int]:
        """How many were left out, by reason."""
        counts = np.bincount(self.status, minlength=len(REASONS) + 1)
        return {reason: int(counts[code]) for reason, code in REASONS.items()}


def project(gaussians: Gaussians, camera: Camera, definition: Definition, sh_degree: int, threads: int) -> Projection:
    """Project all Gaussians; positions are taken relative to the camera centre in float64 first."""
    count = len(gaussians)
    out = Projection(
        np.empty((count, 8)), np.empty((count, 5), np.float32), np.empty(count), np.empty(count, np.uint8), 0
    )
    view = np.concatenate([camera.rotation.T.ravel(), camera.center])
    margin_x = definition.fov_margin * 0.5 * camera.width
    margin_y = definition.fov_margin * 0.5 * camera.height
    lens = np.array(
        [
            camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height,
            -(camera.cx + margin_x) / camera.fx, (camera.width - camera.cx + margin_x) / camera.fx,
            -(camera.cy + margin_y) / camera.fy, (camera.height - camera.cy + margin_y) / camera.fy,
        ]
    )  # fmt: skip
    cuts = np.array([definition.near, definition.far, definition.dilation, definition.alpha_min])
    # One layout for every caller: numba would compile the kernel again for a strided or read-only array.
    arrays = (
        np.require(gaussians.means, np.float64, ["C", "W"]),
        *(
            np.require(getattr(gaussians, name), np.float32, ["C", "W"])
            for name in ("scales", "rotations_wxyz", "opacities", "harmonics")
        ),
    )
    results = (out.footprints, out.shades, out.depths, out.status)
    bounds = np.linspace(0, count, (4 * threads if threads > 1 else 1) + 1).astype(np.int64)
    crossings = run_ranges(
        lambda start, stop: project_range(start, stop, *arrays, sh_degree, view, lens, cuts, *results), bounds, threads
    )
    return Projection(*results, crossing=sum(crossings))


@kernel()
def project_range(
    start, stop, means, scales, rotations, opacities, harmonics, degree, view, lens, cuts, footprints, shades, depths,
    status,
):  # fmt: skip
    """Project Gaussians start..stop-1 into the output rows of the same index; returns how many cross the near plane."""
    fx, fy, cx, cy, width, height = lens[0], lens[1], lens[2], lens[3], lens[4], lens[5]
    near, far, dilation, alpha_min = cuts[0], cuts[1], cuts[2], cuts[3]
    w00, w01, w02 = view[0], view[1], view[2]
    w10, w11, w12 = view[3], view[4], view[5]
    w20, w21, w22 = view[6], view[7], view[8]
    log_alpha_min = math.log(alpha_min)
    crossing = 0
    for i in range(start, stop):
        # Position relative to the camera centre, still in world axes, then in camera axes.
        px, py, pz = means[i, 0] - view[9], means[i, 1] - view[10], means[i, 2] - view[11]
        x = w00 * px + w01 * py + w02 * pz
        y = w10 * px + w11 * py + w12 * pz
        z = w20 * px + w21 * py + w22 * pz
        depths[i] = z
        if not z > near:  # written so that NaN is culled too
            status[i] = NEAR
            continue
        if z > far:
            status[i] = FAR
            continue
        opacity = np.float64(opacities[i])
        if not opacity >= alpha_min:
            status[i] = FAINT
            continue
        inverse_z = 1.0 / z
        tan_x, tan_y = x * inverse_z, y * inverse_z
        mean_x, mean_y = fx * tan_x + cx, fy * tan_y + cy
        # Rows of J W: gradients of the pixel position in the world, at a point at most `fov_margin` out of view.
        tan_x, tan_y = min(max(tan_x, lens[6]), lens[7]), min(max(tan_y, lens[8]), lens[9])
        gx, gy = fx * inverse_z, fy * inverse_z
        u0, u1, u2 = gx * (w00 - tan_x * w20), gx * (w01 - tan_x * w21), gx * (w02 - tan_x * w22)
        v0, v1, v2 = gy * (w10 - tan_y * w20), gy * (w11 - tan_y * w21), gy * (w12 - tan_y * w22)
        # Their cross product in closed form: the minors of J are 1 : tan_x : tan_y.
        n0 = gx * gy * (w20 + tan_x * w00 + tan_y * w10)
        n1 = gx * gy * (w21 + tan_x * w01 + tan_y * w11)
        n2 = gx * gy * (w22 + tan_x * w02 + tan_y * w12)
        # Columns of R, from a quaternion whose float32 norm is not quite one.
        qw, qx = np.float64(rotations[i, 0]), np.float64(rotations[i, 1])
        qy, qz = np.float64(rotations[i, 2]), np.float64(rotations[i, 3])
        two = 2.0 / (qw * qw + qx * qx + qy * qy + qz * qz)
        r00, r01, r02 = 1.0 - two * (qy * qy + qz * qz), two * (qx * qy - qw * qz), two * (qx * qz + qw * qy)
        r10, r11, r12 = two * (qx * qy + qw * qz), 1.0 - two * (qx * qx + qz * qz), two * (qy * qz - qw * qx)
        r20, r21, r22 = two * (qx * qz - qw * qy), two * (qy * qz + qw * qx), 1.0 - two * (qx * qx + qy * qy)
        s0, s1, s2 = np.float64(scales[i, 0]), np.float64(scales[i, 1]), np.float64(scales[i, 2])
        # J W R S, row by row, and its three minors.
        a0, a1, a2 = (
            s0 * (u0 * r00 + u1 * r10 + u2 * r20),
            s1 * (u0 * r01 + u1 * r11 + u2 * r21),
            s2 * (u0 * r02 + u1 * r12 + u2 * r22),
        )
        b0, b1, b2 = (
            s0 * (v0 * r00 + v1 * r10 + v2 * r20),
            s1 * (v0 * r01 + v1 * r11 + v2 * r21),
            s2 * (v0 * r02 + v1 * r12 + v2 * r22),
        )
        m0 = s1 * s2 * (n0 * r00 + n1 * r10 + n2 * r20)
        m1 = s2 * s0 * (n0 * r01 + n1 * r11 + n2 * r21)
        m2 = s0 * s1 * (n0 * r02 + n1 * r12 + n2 * r22)
        aa, bb = a0 * a0 + a1 * a1 + a2 * a2, b0 * b0 + b1 * b1 + b2 * b2
        det = m0 * m0 + m1 * m1 + m2 * m2 + dilation * (aa + bb) + dilation * dilation
        l1, column = math.sqrt(aa + dilation), math.sqrt(bb + dilation)
        root = math.sqrt(det)
        k = (a0 * b0 + a1 * b1 + a2 * b2) / (l1 * l1)
        radius = math.sqrt(2.0 * (math.log(opacity) - log_alpha_min) + RADIUS_SLACK)
        half_width, half_height = radius * l1, radius * column
        # Infinities and NaN of any of the above end up in one of these sums.
        if not abs(root + l1 * column + k + mean_x + mean_y) < 1e150:
            status[i] = NOT_FINITE
            continue
        if (
            mean_x + half_width < 0.5
            or mean_x - half_width > width - 0.5
            or mean_y + half_height < 0.5
            or mean_y - half_height > height - 0.5
        ):
            status[i] = OUTSIDE
            continue
        status[i] = DRAWN
        footprints[i, 0], footprints[i, 1] = mean_x, mean_y
        footprints[i, 2], footprints[i, 3], footprints[i, 4] = HALF_LOG2E / l1, k, HALF_LOG2E * l1 / root
        footprints[i, 5], footprints[i, 6], footprints[i, 7] = half_width, half_height, root / (column * column)
        inverse_length = 1.0 / math.sqrt(px * px + py * py + pz * pz)
        px, py, pz = px * inverse_length, py * inverse_length, pz * inverse_length
        for channel in range(3):
            shades[i, channel] = shade(harmonics, i, channel, degree, px, py, pz)
        shades[i, 3], shades[i, 4] = z, math.log2(opacity)
        # Depth extent: |S R^T w| for the camera's z axis w.
        d0 = s0 * (w20 * r00 + w21 * r10 + w22 * r20)
        d1 = s1 * (w20 * r01 + w21 * r11 + w22 * r21)
        d2 = s2 * (w20 * r02 + w21 * r12 + w22 * r22)
        crossing += (z - near) * (z - near) < 9.0 * (d0 * d0 + d1 * d1 + d2 * d2)
    return crossing
