"""Scenes as pixel-aligned networks make them: small flat Gaussians on surfaces with relief, in random order."""

from __future__ import annotations

import numpy as np

from gapmes.service.cameras.camera import Camera
from gapmes.service.gaussians import Gaussians

FIELD_OF_VIEW = np.radians(60.0)
SPACING_SHARE = 0.65  # standard deviation over the distance between neighbours
PLANES = (  # centre, two half axes
    ((0.0, 0.0, 3.5), (2.4, 0.0, 0.0), (0.0, 2.4, 0.0)),
    ((0.0, 1.3, 2.3), (2.2, 0.0, 0.0), (0.0, 0.0, 1.3)),
    ((-1.7, 0.0, 2.3), (0.0, 1.6, 0.0), (0.0, 0.0, 1.3)),
)
BALLS = (((-0.5, 0.3, 2.0), 0.45), ((0.6, 0.1, 2.5), 0.5), ((0.1, -0.6, 3.0), 0.4), ((0.9, 0.7, 1.8), 0.35))


def camera(size: int) -> Camera:
    """A square image of 60 degrees at the origin."""
    focal = 0.5 * size / np.tan(0.5 * FIELD_OF_VIEW)
    return Camera.make(size, size, focal, focal, 0.5 * size, 0.5 * size, np.eye(4))


def surface_scene(count: int, degree: int, seed: int = 0) -> Gaussians:
    """Three planes and four balls; 4 % of the Gaussians are three to eight times larger, and opacities vary."""
    rng = np.random.default_rng(seed)
    shares = np.diff(np.linspace(0, count, len(PLANES) + len(BALLS) + 1).astype(int))
    points, normals = [], []
    for share, (centre, first, second) in zip(shares, PLANES, strict=False):
        a, b = rng.uniform(-1, 1, (2, share, 1))
        normal = np.cross(first, second)
        points.append(np.array(centre) + a * np.array(first) + b * np.array(second))
        normals.append(np.tile(normal / np.linalg.norm(normal), (share, 1)))
    for share, (centre, radius) in zip(shares[len(PLANES) :], BALLS, strict=True):
        direction = rng.standard_normal((share, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        points.append(np.array(centre) + radius * direction)
        normals.append(direction)
    position, normal = np.concatenate(points), np.concatenate(normals)
    relief = 0.02 * np.sin(9 * position).sum(axis=1, keepdims=True) + rng.normal(0, 0.002, (count, 1))
    position = position + relief * normal
    spacing = 2 * position[:, 2] * np.tan(0.5 * FIELD_OF_VIEW) / np.sqrt(count)
    size = SPACING_SHARE * spacing * np.exp(rng.normal(0, 0.3, count))
    large = rng.random(count) < 0.04
    size[large] *= rng.uniform(3, 8, large.sum())
    scales = size[:, None] * np.exp(rng.normal(0, 0.2, (count, 3))) * [1.0, 1.0, 0.1]
    # The rotation that takes z to the normal, after a random rotation about z.
    half_way = np.column_stack([1 + normal[:, 2], -normal[:, 1], normal[:, 0], np.zeros(count)])
    half_way[np.abs(half_way).max(axis=1) < 1e-9] = (0.0, 1.0, 0.0, 0.0)
    half_way /= np.linalg.norm(half_way, axis=1, keepdims=True)
    angle = rng.uniform(0, np.pi, count)
    w, x, y, _ = half_way.T
    cos, sin = np.cos(angle), np.sin(angle)
    turned = np.column_stack([w * cos, x * cos + y * sin, y * cos - x * sin, w * sin])
    harmonics = rng.normal(0, 0.1, (count, (degree + 1) ** 2, 3))
    harmonics[:, 0] = rng.uniform(-1.5, 1.5, (count, 3))
    opacities = np.where(rng.random(count) < 0.6, rng.uniform(0.7, 1, count), rng.uniform(0.05, 0.7, count))
    shuffled = rng.permutation(count)
    return Gaussians.make(position, scales, turned, opacities, harmonics)[shuffled]
