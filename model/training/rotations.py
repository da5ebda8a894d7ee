"""Rotation matrices for placing things: small tilts, look-at poses and uniformly random rotations, float64."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]


def euler(pitch: float, yaw: float, roll: float) -> F64:
    """(3, 3) R_y(yaw) R_x(pitch) R_z(roll); angles in radians."""
    ca, sa, cb, sb = math.cos(pitch), math.sin(pitch), math.cos(yaw), math.sin(yaw)
    cc, sc = math.cos(roll), math.sin(roll)
    about_x = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
    about_y = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    about_z = np.array([[cc, -sc, 0], [sc, cc, 0], [0, 0, 1]])
    return about_y @ about_x @ about_z


def tilt(rng: np.random.Generator, pitch: float, yaw: float, roll: float) -> F64:
    """`euler` of normal angles with mean 0 and these standard deviations, in radians."""
    return euler(*(rng.normal(0, 1, 3) * (pitch, yaw, roll)))


def uniform_rotation(rng: np.random.Generator) -> F64:
    """A rotation uniform over SO(3), from a normalised normal quaternion."""
    w, x, y, z = (q := rng.normal(size=4)) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def look_at(centre: F64, target: F64, roll: float = 0.0) -> F64:
    """(3, 3) world_from_cam rotation in OpenCV axes that looks from `centre` at `target`, world y pointing down."""
    forward = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward], axis=1) @ euler(0.0, 0.0, roll)
