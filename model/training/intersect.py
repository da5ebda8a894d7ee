"""Numba ray-primitive intersection in the primitive's own axes, and the nearest hit among all primitives of a scene."""

from __future__ import annotations

import math

import numba as nb

from .primitives import BOX, CYLINDER, ELLIPSOID, ROOM
from .splat_projection import FASTMATH

FARTHEST = 1e18  # a ray that hits nothing
NEAREST = 1e-4  # closer hits are those of the surface that the ray starts on


@nb.njit(fastmath=FASTMATH, error_model="numpy", cache=True)
def _nonzero(value):
    return value if abs(value) > 1e-12 else 1e-12


@nb.njit(fastmath=FASTMATH, error_model="numpy", cache=True)
def intersect(kind, half, o0, o1, o2, d0, d1, d2):
    """(t, face) of the first hit of origin o and direction d with one primitive; t is FARTHEST for a miss."""
    if kind == ELLIPSOID:
        i0, i1, i2 = 1.0 / half[0], 1.0 / half[1], 1.0 / half[2]
        e0, e1, e2, p0, p1, p2 = d0 * i0, d1 * i1, d2 * i2, o0 * i0, o1 * i1, o2 * i2
        a, b = e0 * e0 + e1 * e1 + e2 * e2, e0 * p0 + e1 * p1 + e2 * p2
        c = p0 * p0 + p1 * p1 + p2 * p2 - 1.0
        discriminant = b * b - a * c
        if discriminant <= 0.0:
            return FARTHEST, 0
        t = (-b - math.sqrt(discriminant)) / a
        return (t, 0) if t > NEAREST else (FARTHEST, 0)
    i1 = 1.0 / _nonzero(d1)
    middle1, reach1 = -o1 * i1, abs(i1) * half[1]
    if kind == CYLINDER:
        i0, i2 = 1.0 / half[0], 1.0 / half[2]
        e0, e2, p0, p2 = d0 * i0, d2 * i2, o0 * i0, o2 * i2
        a, b, c = e0 * e0 + e2 * e2, e0 * p0 + e2 * p2, p0 * p0 + p2 * p2 - 1.0
        discriminant = b * b - a * c
        if discriminant <= 0.0 or a < 1e-18:
            return FARTHEST, 0
        root = math.sqrt(discriminant)
        enter, leave, face = (-b - root) / a, (-b + root) / a, 0
        if middle1 - reach1 > enter:
            enter, face = middle1 - reach1, 1
        leave = min(leave, middle1 + reach1)
        return (enter, face) if NEAREST < enter < leave else (FARTHEST, 0)
    i0, i2 = 1.0 / _nonzero(d0), 1.0 / _nonzero(d2)
    middle0, reach0, middle2, reach2 = -o0 * i0, abs(i0) * half[0], -o2 * i2, abs(i2) * half[2]
    if kind == BOX:
        enter, face = middle0 - reach0, 0
        if middle1 - reach1 > enter:
            enter, face = middle1 - reach1, 1
        if middle2 - reach2 > enter:
            enter, face = middle2 - reach2, 2
        leave = min(middle0 + reach0, middle1 + reach1, middle2 + reach2)
        return (enter, face) if NEAREST < enter < leave else (FARTHEST, 0)
    leave, face = middle0 + reach0, 0
    if middle1 + reach1 < leave:
        leave, face = middle1 + reach1, 1
    if middle2 + reach2 < leave:
        leave, face = middle2 + reach2, 2
    return (leave, face) if leave > NEAREST else (FARTHEST, 0)


@nb.njit(fastmath=FASTMATH, error_model="numpy", cache=True)
def to_local(rotation, v0, v1, v2):
    """R^T v: a world direction in own axes."""
    return (
        rotation[0, 0] * v0 + rotation[1, 0] * v1 + rotation[2, 0] * v2,
        rotation[0, 1] * v0 + rotation[1, 1] * v1 + rotation[2, 1] * v2,
        rotation[0, 2] * v0 + rotation[1, 2] * v1 + rotation[2, 2] * v2,
    )


@nb.njit(fastmath=FASTMATH, error_model="numpy", cache=True)
def image_bounds(kind, centre, rotation, half, camera, bounds):
    """Fill `bounds` (4,) with left, right, top, bottom of the pixels that can show the primitive."""
    bounds[0], bounds[1], bounds[2], bounds[3] = FARTHEST, -FARTHEST, FARTHEST, -FARTHEST
    everywhere = kind == ROOM
    for corner in range(8):
        s0 = half[0] if corner & 1 else -half[0]
        s1 = half[1] if corner & 2 else -half[1]
        s2 = half[2] if corner & 4 else -half[2]
        e0 = centre[0] + rotation[0, 0] * s0 + rotation[0, 1] * s1 + rotation[0, 2] * s2 - camera[9]
        e1 = centre[1] + rotation[1, 0] * s0 + rotation[1, 1] * s1 + rotation[1, 2] * s2 - camera[10]
        e2 = centre[2] + rotation[2, 0] * s0 + rotation[2, 1] * s1 + rotation[2, 2] * s2 - camera[11]
        z = camera[2] * e0 + camera[5] * e1 + camera[8] * e2
        if z <= NEAREST:
            everywhere = True
            break
        u = camera[12] * (camera[0] * e0 + camera[3] * e1 + camera[6] * e2) / z + camera[14]
        v = camera[13] * (camera[1] * e0 + camera[4] * e1 + camera[7] * e2) / z + camera[15]
        bounds[0], bounds[1] = min(bounds[0], u), max(bounds[1], u)
        bounds[2], bounds[3] = min(bounds[2], v), max(bounds[3], v)
    if everywhere:
        bounds[0], bounds[1], bounds[2], bounds[3] = -FARTHEST, FARTHEST, -FARTHEST, FARTHEST


@nb.njit(fastmath=FASTMATH, error_model="numpy", cache=True)
def nearest_hit(active, count, bounds, px, kinds, rotations, halves, origins, d0, d1, d2):
    """(t, primitive, face) of the ray through image column `px`; primitive -1 means none.

    Only `active[:count]` are looked at, and of those only the ones whose `bounds` hold `px`. `origins` (P, 3) is the
    camera centre in the axes of each primitive.
    """
    best, which, best_face = FARTHEST, -1, 0
    for n in range(count):
        p = active[n]
        if px < bounds[p, 0] or px > bounds[p, 1]:
            continue
        l0, l1, l2 = to_local(rotations[p], d0, d1, d2)
        t, face = intersect(kinds[p], halves[p], origins[p, 0], origins[p, 1], origins[p, 2], l0, l1, l2)
        if t < best:
            best, which, best_face = t, p, face
    return best, which, best_face


@nb.njit(fastmath=FASTMATH, error_model="numpy", cache=True)
def occluded(count, kinds, centres, rotations, halves, x0, x1, x2, d0, d1, d2):
    """Whether a solid lies between the point x and the light at x + d. Rooms cast no shadow: it may be outside them."""
    for p in range(count):
        if kinds[p] == ROOM:
            continue
        rotation = rotations[p]
        o0, o1, o2 = to_local(rotation, x0 - centres[p, 0], x1 - centres[p, 1], x2 - centres[p, 2])
        l0, l1, l2 = to_local(rotation, d0, d1, d2)
        t, _ = intersect(kinds[p], halves[p], o0, o1, o2, l0, l1, l2)
        if t < 1.0:
            return True
    return False
