"""A camera for Gaussians that come without any: it looks along +z and holds most of what is there."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..cameras.pose import MAX_OFFSET
from ..errors import GaussiansError
from ..gaussians import Gaussians
from .scene_views import SceneViews

F64 = NDArray[np.float64]

SIDE = 512  # px, of the square picture
FIELD_OF_VIEW = math.radians(50)
SHARE = 0.8  # of all opacity that lies within the radius; what is beyond may be sky


def default_views(gaussians: Gaussians) -> SceneViews:
    """One camera in front of at least one Gaussian's scene, in OpenCV axes: x right, y down.

    The centre is the median of the means along each axis, weighed by opacity, and the radius that about it which holds
    80 % of the opacity. The camera looks along +z, as the first one of most reconstructions does, from as far away as
    lets a field of view of 50 degrees hold the sphere. `far` is the sphere's end and `near` such that an orbit turns
    about the centre. Without an extent the largest Gaussian, three standard deviations of it, stands in for the radius.
    Raises `GaussiansError` where that is too far away for a camera.
    """
    weights = gaussians.opacities.astype(np.float64)
    if not weights.any():
        weights = np.ones(len(gaussians))
    centre = np.array([_quantile(gaussians.means[:, axis], weights, 0.5) for axis in range(3)])
    with np.errstate(over="ignore"):  # what is too far is refused below
        radius = _quantile(np.linalg.norm(gaussians.means - centre, axis=1), weights, SHARE)
        if radius <= 0:
            radius = 3 * float(gaussians.scales.max()) or 1.0
        distance = radius / math.sin(FIELD_OF_VIEW / 2)
        away = float(np.linalg.norm(centre - [0, 0, distance]))
    if away > MAX_OFFSET:
        index = int(np.abs(gaussians.means).max(axis=1).argmax())
        raise GaussiansError(
            f"a camera that holds {SHARE:.0%} of them would be {away:.3g} units away, need at most {MAX_OFFSET:g}; the "
            f"farthest is at index {index}: {gaussians.means[index].tolist()}",
            field="means",
            index=index,
            cure="are all positions right? leave out the Gaussians that are not, or scale the scene",
        )
    focal = SIDE / 2 / math.tan(FIELD_OF_VIEW / 2)
    pose = np.eye(4)
    pose[:3, 3] = centre - [0, 0, distance]
    far = distance + radius
    return SceneViews([Camera.make(SIDE, SIDE, focal, focal, SIDE / 2, SIDE / 2, pose)], distance**2 / far, far)


def _quantile(values: F64, weights: F64, share: float) -> float:
    """The smallest value up to which that share of all weight lies."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order[min(np.searchsorted(total, share * total[-1]), len(order) - 1)]])
