"""Random camera motions of a training sample: sideways, forward or around the scene, targets in between."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .rotations import look_at, tilt

F64 = NDArray[np.float64]
Rng = np.random.Generator

WIDEST_ORBIT = math.radians(40.0)
STYLES = ("sideways", "forward", "orbit")
STYLE_SHARES = (0.45, 0.25, 0.30)


def camera_poses(
    rng: Rng, inputs: int, targets: int, baseline: float, depth: float, half_width: float, aside: float = 0.0
) -> F64:
    """(inputs + targets, 4, 4) world_from_cam, inputs first, around the origin and looking roughly along +z.

    `baseline` is the length of the path from the first to the last input and `depth` the median depth of the scene, in
    the same unit; `half_width` = tan(horizontal fov / 2). Targets lie on the path, up to 8 % beyond its ends; with
    `aside` each is displaced by a normal deviate whose standard deviation is uniform between 0 and `aside` baselines,
    so that depth errors at edges along the path become visible too.
    """
    style = STYLES[rng.choice(3, p=STYLE_SHARES)]
    along = np.concatenate([np.linspace(0, 1, inputs), rng.uniform(-0.08, 1.08, targets)]) - 0.5
    if inputs > 2:
        along[1 : inputs - 1] += rng.normal(0, 0.1 / (inputs - 1), inputs - 2)
    jitter = rng.normal(0, 0.06, (inputs + targets, 3)) * baseline
    if aside:
        jitter[inputs:] += rng.uniform(0, aside, (targets, 1)) * rng.normal(0, 1, (targets, 3)) * baseline
    if style == "orbit":
        centres, aim = _orbit(rng, along, baseline, depth)
    else:
        spread = (0.3, 0.15, 1.0) if style == "forward" else (1.0, 0.35, 0.3)
        direction = rng.normal(0, 1, 3) * spread
        direction /= np.linalg.norm(direction)
        centres = along[:, None] * direction * baseline
        # On wide baselines parallel axes would have no common field of view: there the cameras are turned inwards.
        closeness = rng.uniform(0.0, 1.0)
        sideways = baseline * math.hypot(direction[0], direction[1])
        needed = 1.0 - 0.7 * half_width * depth / max(sideways, 1e-9)
        aim = np.array([*(rng.normal(0, 0.06, 2) * depth), depth / max(closeness, needed, 0.05)])
    wobble = rng.uniform(0.0, 0.05)
    poses = np.tile(np.eye(4), (inputs + targets, 1, 1))
    for pose, centre in zip(poses, centres + jitter, strict=True):
        pose[:3, :3] = look_at(centre, aim, rng.normal(0, 0.5) * wobble) @ tilt(rng, wobble, wobble, 0.0)
        pose[:3, 3] = centre
    return poses


def _orbit(rng: Rng, along: F64, baseline: float, depth: float) -> tuple[F64, F64]:
    """Camera centres on a mostly level arc of at most 40 degrees about a point near the middle of the scene, and that
    point."""
    radius = depth * rng.uniform(0.85, 1.15)
    angles = along * min(2 * math.asin(min(1.0, baseline / (2 * radius))), WIDEST_ORBIT)
    rise = rng.normal(0, 0.3)
    centres = radius * np.stack([np.sin(angles), 0.5 * rise * angles, 1 - np.cos(angles)], axis=1)
    turn = tilt(rng, 0.0, 0.0, 0.3)
    return centres @ turn.T, np.array([*(rng.normal(0, 0.05, 2) * depth), radius])
