"""Filtering views with usable cameras, with a warning about the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ..cameras.camera_fields import CameraFile
from ..cameras.view_checks import MAX_VIEWS, MIN_VIEWS, Notice, check_count
from ..errors import IntrinsicsError, PoseError

Cameras = Callable[[Sequence[int]], CameraFile]  # of these views


def usable_views(indices: Sequence[int], cameras: Cameras) -> tuple[list[int], CameraFile, tuple[Notice, ...]]:
    """Indices of views with an undistortable lens and a valid pose, their cameras, and a warning about the others.
    Raises `ViewCountError` for a single view, and the first view's error if fewer than two are left."""
    check_count(min(len(indices), MAX_VIEWS))
    try:
        return list(indices), cameras(indices), ()
    except (IntrinsicsError, PoseError):
        pass
    refused: list[tuple[int, IntrinsicsError | PoseError]] = []
    usable = _sifted(indices, cameras, refused)
    if not refused:  # every view alone is valid: the error is about all of them
        return usable, cameras(usable), ()
    index, first = refused[0]
    if len(usable) < MIN_VIEWS:
        raise first
    message = f"{len(refused)} of {len(indices)} views have no camera that can be used, the first is {index}: {first}"
    warning: Notice = {"code": "views_refused", "field": "cameras", "index": index, "message": message}
    return usable, cameras(usable), (warning,)


def _sifted(
    indices: Sequence[int], cameras: Cameras, refused: list[tuple[int, IntrinsicsError | PoseError]]
) -> list[int]:
    """The usable views, by bisection, since most are usable."""
    try:
        cameras(indices)
        return list(indices)
    except (IntrinsicsError, PoseError) as error:
        if len(indices) == 1:
            refused.append((indices[0], error))
            return []
    middle = len(indices) // 2
    return _sifted(indices[:middle], cameras, refused) + _sifted(indices[middle:], cameras, refused)
