"""Depth bounds of the views of a COLMAP model, from the sparse points that each of them was registered with."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..cameras.view_checks import Notice
from ..errors import CameraError, CaptureError, PoseError
from . import colmap_binary, colmap_text
from .colmap_model import ColmapModel, Points
from .files import Files, joined

F64 = NDArray[np.float64]

MAX_ERROR = 2.0  # px of reprojection; points beyond it are often wrong matches
MIN_TRACK = 3  # views of a point; two may agree by chance along an epipolar line
MIN_POINTS = 20  # of a view; fewer say too little about its depths
PERCENTILE = 1.0  # of a view's points at either end, which may be wrong
BEFORE = 0.8  # near = 0.8 x that percentile: room for what has no point, such as plain things at the border
BEYOND = 1.3  # far = 1.3 x that at the other end

SMALLEST, LARGEST = 1e-14, 1e14  # depths that count, units of the model: others make no range that is accepted

_one_at_a_time = threading.Lock()  # points of two models need not be in memory together
_PLACE = np.uint64(2**32 - 1)  # the bits of a pair that are the point's place
_PART = 2**20  # pairs

_READERS: dict[str, Callable[[BinaryIO, str], Points]] = {
    "bin": colmap_binary.read_points,
    "txt": colmap_text.read_points,
}


@dataclass(frozen=True)
class DepthBounds:
    """What the points of a model say of the depths of its views."""

    of: dict[int, tuple[float, float]]  # image id -> nearest and farthest z-depth; without views that have few points
    warnings: tuple[Notice, ...] = ()


def depth_bounds(files: Files, folder: str, form: str, model: ColmapModel) -> DepthBounds:
    """The bounds of the views of `model`, which lies in `folder` in the form `bin` or `txt`; of none where it has no
    file of points. One that cannot be read is passed over, with the warning `points_not_read`."""
    path = joined(folder, f"points3D.{form}")
    if not files.has(path):
        return DepthBounds({})
    try:
        with _one_at_a_time, files.open(path) as stream:
            return DepthBounds(_bounds(_READERS[form](stream, path), model))
    except (CameraError, CaptureError) as error:
        message = f"{error.message}: near and far cannot come from it ({error.cure})"
        return DepthBounds({}, ({"code": "points_not_read", "field": "capture", "message": message},))


def _bounds(points: Points, model: ColmapModel) -> dict[int, tuple[float, float]]:
    """Bounds by image id: percentiles of the z-depths of the points that each view has been matched in."""
    right = np.isfinite(points.xyz).all(axis=1) & (points.error <= MAX_ERROR) & (_tracks(points) >= MIN_TRACK)
    ids = [image_id for image_id in model.images if 0 <= image_id < 2**32]
    first = np.array(ids, dtype=np.uint64) << np.uint64(32)
    starts, ends = np.searchsorted(points.seen, first), np.searchsorted(points.seen, first | _PLACE, side="right")
    bounds = {}
    for image_id, start, end in zip(ids, starts, ends, strict=True):
        places = (points.seen[start:end] & _PLACE).astype(np.intp)
        places = places[right[places]]
        try:
            axis = model.pose(image_id)[2]
        except (CameraError, PoseError):  # refused where this view is used
            continue
        with np.errstate(over="ignore", invalid="ignore"):  # infinite translations, which are refused there too
            depths = points.xyz[places] @ axis[:3] + axis[3]
        depths = depths[(depths >= SMALLEST) & (depths <= LARGEST)]
        if len(depths) >= MIN_POINTS:
            nearest, farthest = np.percentile(depths, (PERCENTILE, 100.0 - PERCENTILE))
            bounds[image_id] = (BEFORE * float(nearest), BEYOND * float(farthest))
    return bounds


def _tracks(points: Points) -> NDArray[np.intp]:
    """(P,) views that each point was matched in, counted part by part to take little memory."""
    tracks = np.zeros(len(points.xyz), np.intp)
    for start in range(0, len(points.seen), _PART):
        places = (points.seen[start : start + _PART] & _PLACE).astype(np.intp)
        tracks += np.bincount(places, minlength=len(tracks))
    return tracks
