"""A plain renderer, as one would write it first: tiles of 16 x 16, float32 covariances, one pixel after the other.

For a central principal point it draws the same image as the product except for rounding: dilation 0.3, alpha cut 1/255,
clamp 0.99, inclusive stop at 1e-4. It runs threads in the same way as the product, since numba's own threads poll while
idle and slow down whatever runs next.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from gapmes.service.cameras.camera import Camera
from gapmes.service.gaussians import Gaussians
from gapmes.service.harmonics import evaluate_basis
from gapmes.service.splat.parallel import run_ranges

TILE = 16
F32 = np.float32


class PlainRenderer:
    """Draws one set of Gaussians; what does not depend on the camera is computed once."""

    def __init__(self, gaussians: Gaussians, threads: int) -> None:
        self.gaussians = gaussians
        self.threads = threads
        self.covariances = covariances(gaussians.rotations_wxyz, gaussians.scales)
        self.means = gaussians.means.astype(F32)

    def __call__(self, camera: Camera) -> NDArray[np.float32]:
        """The picture (H, W, 3) over black."""
        g = self.gaussians
        if g.sh_degree > 0:
            directions = g.means - camera.center
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)
            basis = evaluate_basis(directions, g.sh_degree)
            colours = np.maximum(0.5 + np.einsum("nk,nkc->nc", basis, g.harmonics), 0).astype(F32)
        else:
            colours = np.maximum(0.5 + 0.28209479177387814 * g.harmonics[:, 0], 0).astype(F32)
        pose = camera.cam_from_world.astype(F32)
        lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height], F32)
        splats, depths = np.empty((len(g), 7), F32), np.zeros(len(g), F32)
        run_ranges(
            lambda first, last: project(
                first, last, self.means, self.covariances, g.opacities, pose, lens, splats, depths
            ),
            self._parts(len(g)),
            self.threads,
        )
        drawn = np.flatnonzero(depths > 0)
        order = drawn[np.argsort(depths[drawn], kind="stable")]
        offsets, members = bin_tiles(splats, order, camera.width, camera.height)
        image = np.zeros((camera.height, camera.width, 3), F32)
        run_ranges(
            lambda first, last: blend(first, last, splats, colours, g.opacities, offsets, members, image),
            self._parts(len(offsets) - 1),
            self.threads,
        )
        return image

    def _parts(self, count: int) -> NDArray[np.int64]:
        return np.linspace(0, count, 16 * self.threads + 1).astype(np.int64)


@numba.njit(cache=True)
def covariances(rotations, scales):
    out = np.empty((rotations.shape[0], 6), np.float32)
    for i in range(rotations.shape[0]):
        w, x, y, z = rotations[i]
        r = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        m = r * scales[i]
        c = m @ m.T
        out[i] = np.array([c[0, 0], c[0, 1], c[0, 2], c[1, 1], c[1, 2], c[2, 2]])
    return out


@numba.njit(cache=True, nogil=True)
def project(first, last, means, covariance, opacities, pose, lens, splats, depths):
    """splats (N, 7): x, y, conic a, b, c, half width, half height; depths (N,) stays 0 where nothing is drawn."""
    fx, fy, cx, cy, width, height = lens
    limit_x, limit_y = F32(0.65) * width / fx, F32(0.65) * height / fy
    for i in range(first, last):
        p = pose[:3, 0] * means[i, 0] + pose[:3, 1] * means[i, 1] + pose[:3, 2] * means[i, 2] + pose[:3, 3]
        z = p[2]
        if z <= F32(0.01) or opacities[i] < F32(1 / 255):
            continue
        tx, ty = min(max(p[0] / z, -limit_x), limit_x), min(max(p[1] / z, -limit_y), limit_y)
        j0, j2, k1, k2 = fx / z, -fx * tx / z, fy / z, -fy * ty / z
        u = j0 * pose[0, :3] + j2 * pose[2, :3]
        v = k1 * pose[1, :3] + k2 * pose[2, :3]
        c = covariance[i]
        cu0, cu1, cu2 = (
            c[0] * u[0] + c[1] * u[1] + c[2] * u[2],
            c[1] * u[0] + c[3] * u[1] + c[4] * u[2],
            c[2] * u[0] + c[4] * u[1] + c[5] * u[2],
        )
        cv0, cv1, cv2 = (
            c[0] * v[0] + c[1] * v[1] + c[2] * v[2],
            c[1] * v[0] + c[3] * v[1] + c[4] * v[2],
            c[2] * v[0] + c[4] * v[1] + c[5] * v[2],
        )
        a = u[0] * cu0 + u[1] * cu1 + u[2] * cu2 + F32(0.3)
        b = v[0] * cu0 + v[1] * cu1 + v[2] * cu2
        d = v[0] * cv0 + v[1] * cv1 + v[2] * cv2 + F32(0.3)
        det = a * d - b * b
        if det <= 0:
            continue
        radius = math.sqrt(2 * math.log(F32(255) * opacities[i]))
        x, y = fx * p[0] / z + cx, fy * p[1] / z + cy
        half_width, half_height = radius * math.sqrt(a), radius * math.sqrt(d)
        if x + half_width < 0 or x - half_width > width or y + half_height < 0 or y - half_height > height:
            continue
        splats[i] = np.array([x, y, d / det, -b / det, a / det, half_width, half_height], np.float32)
        depths[i] = z


@numba.njit(cache=True)
def bin_tiles(splats, order, width, height):
    columns, rows = (width + TILE - 1) // TILE, (height + TILE - 1) // TILE
    offsets = np.zeros(columns * rows + 1, np.int64)
    for turn in range(2):
        if turn == 1:
            offsets = np.cumsum(offsets)
            members, cursors = np.empty(offsets[-1], np.int32), offsets.copy()
        for i in order:
            x, y, half_width, half_height = splats[i, 0], splats[i, 1], splats[i, 5], splats[i, 6]
            for row in range(max(0, int((y - half_height) // TILE)), min(rows - 1, int((y + half_height) // TILE)) + 1):
                first, last = max(0, int((x - half_width) // TILE)), min(columns - 1, int((x + half_width) // TILE))
                for column in range(first, last + 1):
                    tile = row * columns + column
                    if turn == 0:
                        offsets[tile + 1] += 1
                    else:
                        members[cursors[tile]] = i
                        cursors[tile] += 1
    return offsets, members


@numba.njit(cache=True, nogil=True)
def blend(first, last, splats, colours, opacities, offsets, members, image):
    height, width = image.shape[:2]
    columns = (width + TILE - 1) // TILE
    for tile in range(first, last):
        left, top = (tile % columns) * TILE, (tile // columns) * TILE
        for y in range(top, min(top + TILE, height)):
            for x in range(left, min(left + TILE, width)):
                light, red, green, blue = F32(1), F32(0), F32(0), F32(0)
                for entry in range(offsets[tile], offsets[tile + 1]):
                    i = members[entry]
                    dx, dy = F32(x) + F32(0.5) - splats[i, 0], F32(y) + F32(0.5) - splats[i, 1]
                    power = -F32(0.5) * (splats[i, 2] * dx * dx + splats[i, 4] * dy * dy) - splats[i, 3] * dx * dy
                    alpha = min(F32(0.99), opacities[i] * math.exp(power))
                    if alpha < F32(1 / 255):
                        continue
                    weight = alpha * light
                    red += weight * colours[i, 0]
                    green += weight * colours[i, 1]
                    blue += weight * colours[i, 2]
                    light -= weight
                    if light <= F32(1e-4):
                        break
                image[y, x, 0], image[y, x, 1], image[y, x, 2] = red, green, blue
