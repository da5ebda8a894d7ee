"""A default camera for Gaussians without cameras, which looks along +z and frames most of the scene."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..cameras.pose import MAX_OFFSET, rigid_motion
from ..errors import GaussiansError
from ..gaussians import Gaussians
from .scene_views import SceneViews

F64 = NDArray[np.float64]

SIDE = 512  # px, of the square picture
FIELD_OF_VIEW = math.radians(50)
SHARE = 0.8  # of all opacity that lies within the radius; what is beyond may be sky


def default_views(gaussians: Gaussians) -> SceneViews:
    """The view of one camera in front of the scene, in OpenCV axes: x right, y down.

    The centre is the opacity-weighted median of the means along each axis; the sphere about it that holds 80 % of the
    opacity is framed. The camera looks along +z, as the first one of most reconstructions does, from where the sphere
    fits into a field of view of 50 degrees. `far` is the far end of the sphere, and `near` makes its centre the pivot.
    If the radius is 0, it is three standard deviations of the largest Gaussian. Raises `GaussiansError` if there are no
    Gaussians, or if the camera would be too far away.
    """
    if not len(gaussians):
        raise GaussiansError(
            "0 Gaussians, need at least 1 for a camera to look at",
            field="scene",
            cure="is it the right file, and whole?",
        )
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
    pose = rigid_motion(np.eye(3), centre - [0, 0, distance])
    far = distance + radius
    return SceneViews([Camera.make(SIDE, SIDE, focal, focal, SIDE / 2, SIDE / 2, pose)], distance**2 / far, far)


def _quantile(values: F64, weights: F64, share: float) -> float:
    """The weighted quantile: the smallest value at which the cumulative weight reaches `share`."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(total, share * total[-1])]])
