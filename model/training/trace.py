"""Numba ray caster: textured solids under one light, supersampled colour and exact z-depth at the pixel centres."""

from __future__ import annotations

import math

import numba as nb
import numpy as np

from .intersect import image_bounds, nearest_hit, occluded, to_local
from .patterns import SIZE
from .primitives import CYLINDER, ELLIPSOID, PackedWorlds
from .splat_projection import FASTMATH
from .textures import LEVEL_OFFSETS, LEVELS, TextureAtlas

BANDS = 4  # an image is traced in this many parts, so that small batches use all threads
GLOSS_EXPONENT = 24
TO_UNIT = 1.0 / 255.0


@nb.njit(fastmath=FASTMATH, error_model="numpy", cache=True)
def _mirrored(i, size):
    i = i & (2 * size - 1)  # sizes are powers of two
    return i if i < size else 2 * size - 1 - i


@nb.njit(fastmath=FASTMATH, error_model="numpy", cache=True)
def _add_level(texels, level, u, v, weight, colour):
    """Bilinear lookup of one mip level, mirrored at the borders, times `weight`, added to `colour`."""
    size, start = SIZE >> level, LEVEL_OFFSETS[level]
    x, y = u * size - 0.5, v * size - 0.5
    left, top = math.floor(x), math.floor(y)
    fx, fy = x - left, y - top
    xa, xb = _mirrored(left, size), _mirrored(left + 1, size)
    ya, yb = _mirrored(top, size), _mirrored(top + 1, size)
    a, b = start + (ya * size + xa) * 3, start + (ya * size + xb) * 3
    c, d = start + (yb * size + xa) * 3, start + (yb * size + xb) * 3
    weight = weight * TO_UNIT
    wa, wb, wc, wd = (1 - fx) * (1 - fy) * weight, fx * (1 - fy) * weight, (1 - fx) * fy * weight, fx * fy * weight
    for k in range(3):
        colour[k] += texels[a + k] * wa + texels[b + k] * wb + texels[c + k] * wc + texels[d + k] * wd


@nb.njit(fastmath=FASTMATH, error_model="numpy", cache=True)
def _add_texture(texels, u, v, footprint, colour):
    """Trilinear lookup; `footprint` is the width of a sample in finest texels."""
    level = min(LEVELS - 1.01, max(0.0, math.log2(max(footprint, 1e-6))))
    fine = int(level)
    rest = level - fine
    _add_level(texels, fine, u, v, 1.0 - rest, colour)
    if rest > 0.02:
        _add_level(texels, fine + 1, u, v, rest, colour)


@nb.njit(fastmath=FASTMATH, error_model="numpy", cache=True)
def _surface(kind, face, half, q0, q1, q2, l0, l1, l2):
    """(u, v, normal in own axes, texture slot) where a ray of direction l meets a primitive at q."""
    if kind == ELLIPSOID:
        n0, n1, n2 = q0 / (half[0] * half[0]), q1 / (half[1] * half[1]), q2 / (half[2] * half[2])
        inverse = 1.0 / math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        radius = max(half[0], half[1], half[2])
        u = math.atan2(q0 / half[0], q2 / half[2]) * radius
        v = math.asin(min(1.0, max(-1.0, q1 / half[1]))) * radius
        return u, v, n0 * inverse, n1 * inverse, n2 * inverse, 0
    if kind == CYLINDER:
        if face == 1:
            return q0, q2, 0.0, (-1.0 if l1 > 0 else 1.0), 0.0, 1
        n0, n2 = q0 / (half[0] * half[0]), q2 / (half[2] * half[2])
        inverse = 1.0 / math.sqrt(n0 * n0 + n2 * n2)
        u = math.atan2(q0 / half[0], q2 / half[2]) * max(half[0], half[2])
        return u, q1, n0 * inverse, 0.0, n2 * inverse, 0
    if face == 0:
        return q1, q2, (-1.0 if l0 > 0 else 1.0), 0.0, 0.0, (0 if l0 > 0 else 3)
    if face == 1:
        return q0, q2, 0.0, (-1.0 if l1 > 0 else 1.0), 0.0, (1 if l1 > 0 else 4)
    return q0, q1, 0.0, 0.0, (-1.0 if l2 > 0 else 1.0), (2 if l2 > 0 else 5)


@nb.njit(parallel=True, fastmath=FASTMATH, error_model="numpy", cache=True)
def _trace(
    texels, counts, kinds, centres, rotations, halves, textures, texture_maps, albedos, glosses, lights, backgrounds,
    cameras, supersample, images, depths,
):  # fmt: skip
    views, height, width = cameras.shape[1], images.shape[3], images.shape[4]
    for part in nb.prange(cameras.shape[0] * views * BANDS):
        band, image = part % BANDS, part // BANDS
        b, view = image // views, image % views
        camera, light, sky = cameras[b, view], lights[b], backgrounds[b]
        count, kind, rotation, half = counts[b], kinds[b], rotations[b], halves[b]
        origins, bounds, active = np.empty((count, 3)), np.empty((count, 4)), np.empty(count, np.int64)
        for p in range(count):
            centre = centres[b, p]
            origins[p, 0], origins[p, 1], origins[p, 2] = to_local(
                rotation[p], camera[9] - centre[0], camera[10] - centre[1], camera[11] - centre[2]
            )
            image_bounds(kind[p], centre, rotation[p], half[p], camera, bounds[p])
        colour, total = np.empty(3), np.empty(3)
        samples = supersample * supersample
        for y in range(band * height // BANDS, (band + 1) * height // BANDS):
            actives = 0
            for p in range(count):
                if bounds[p, 2] <= y + 1 and bounds[p, 3] >= y:
                    active[actives] = p
                    actives += 1
            for x in range(width):
                total[:] = 0.0
                for sample in range(samples + 1):
                    if sample < samples:
                        px = x + (sample % supersample + 0.5) / supersample
                        py = y + (sample // supersample + 0.5) / supersample
                    else:  # the last ray goes through the pixel's centre and gives the depth
                        px, py = x + 0.5, y + 0.5
                    cx, cy = (px - camera[14]) / camera[12], (py - camera[15]) / camera[13]
                    d0 = camera[0] * cx + camera[1] * cy + camera[2]
                    d1 = camera[3] * cx + camera[4] * cy + camera[5]
                    d2 = camera[6] * cx + camera[7] * cy + camera[8]
                    t, p, face = nearest_hit(active, actives, bounds, px, kind, rotation, half, origins, d0, d1, d2)
                    if sample == samples:
                        depths[b, view, y, x] = t if p >= 0 else np.inf
                        continue
                    length = math.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
                    if p < 0:
                        mix = 0.5 + 0.5 * (d0 * sky[6] + d1 * sky[7] + d2 * sky[8]) / length
                        for k in range(3):
                            total[k] += sky[k] + (sky[3 + k] - sky[k]) * mix
                        continue
                    l0, l1, l2 = to_local(rotation[p], d0, d1, d2)
                    q0, q1, q2 = origins[p, 0] + t * l0, origins[p, 1] + t * l1, origins[p, 2] + t * l2
                    u, v, m0, m1, m2, slot = _surface(kind[p], face, half[p], q0, q1, q2, l0, l1, l2)
                    n0 = rotation[p, 0, 0] * m0 + rotation[p, 0, 1] * m1 + rotation[p, 0, 2] * m2
                    n1 = rotation[p, 1, 0] * m0 + rotation[p, 1, 1] * m1 + rotation[p, 1, 2] * m2
                    n2 = rotation[p, 2, 0] * m0 + rotation[p, 2, 1] * m1 + rotation[p, 2, 2] * m2
                    facing = abs(d0 * n0 + d1 * n1 + d2 * n2) / length
                    repeats = texture_maps[b, p, 2]
                    footprint = t / (camera[12] * supersample) * repeats * SIZE / math.sqrt(max(facing, 0.1))
                    colour[:] = 0.0
                    _add_texture(
                        texels[textures[b, p, slot]], u * repeats + texture_maps[b, p, 0],
                        v * repeats + texture_maps[b, p, 1], footprint, colour,
                    )  # fmt: skip
                    x0, x1, x2 = camera[9] + t * d0, camera[10] + t * d1, camera[11] + t * d2
                    e0, e1, e2 = light[0] - x0, light[1] - x1, light[2] - x2
                    distance = math.sqrt(e0 * e0 + e1 * e1 + e2 * e2) + 1e-9
                    lit = max(0.0, e0 * n0 + e1 * n1 + e2 * n2) / distance
                    if lit > 0.0 and light[10] > 0.0:
                        lift = 1e-3 * t  # offset along the normal, against self-shadowing
                        if occluded(
                            count, kind, centres[b], rotation, half,
                            x0 + lift * n0, x1 + lift * n1, x2 + lift * n2, e0, e1, e2,
                        ):  # fmt: skip
                            lit = 0.0
                    highlight = 0.0
                    if glosses[b, p] > 0.0 and lit > 0.0:
                        h0 = e0 / distance - d0 / length
                        h1 = e1 / distance - d1 / length
                        h2 = e2 / distance - d2 / length
                        norm = math.sqrt(h0 * h0 + h1 * h1 + h2 * h2) + 1e-9
                        highlight = glosses[b, p] * max(0.0, (h0 * n0 + h1 * n1 + h2 * n2) / norm) ** GLOSS_EXPONENT
                    lit /= 1.0 + light[6] * distance * distance
                    for k in range(3):
                        shade = colour[k] * albedos[b, p, k] * (light[7 + k] + light[3 + k] * lit)
                        total[k] += min(1.0, shade + highlight)
                for k in range(3):
                    images[b, view, k, y, x] = total[k] / samples


def trace(
    atlas: TextureAtlas, worlds: PackedWorlds, cameras: np.ndarray, height: int, width: int, supersample: int
) -> tuple[np.ndarray, np.ndarray]:
    """Images (B, V, 3, H, W) float32 in [0, 1] and z-depths (B, V, H, W) float32, infinite where nothing is hit.

    `cameras` is (B, V, 16) float64: world_from_cam rotation row-major, centre, fx, fy, cx, cy in pixels. A pixel is the
    mean of `supersample`^2 rays; the depth is that of the ray through the pixel's centre.
    """
    batch, views = cameras.shape[:2]
    images = np.empty((batch, views, 3, height, width), np.float32)
    depths = np.empty((batch, views, height, width), np.float32)
    _trace(atlas.texels, *worlds.arrays(), cameras, supersample, images, depths)
    return images, depths
