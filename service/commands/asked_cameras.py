"""The cameras that pictures are drawn from: all of a capture, or those that the asked views need."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ..cameras.camera_fields import CameraFile
from ..cameras.depth_range import depth_range
from ..captures.capture import Capture
from ..errors import ImageError, IntrinsicsError, PoseError
from ..viewpoints.scene_views import SceneViews
from .input_file import capture_of_option

_UNUSABLE = (IntrinsicsError, PoseError, ImageError)  # the last where a photograph is to tell a camera's size


def views_of_file(path: Path, specs: Sequence[str] | None) -> tuple[SceneViews, list[str]]:
    """The views of the option `--cameras`, as `asked_cameras`, and notes of the file. Raises as `capture_of_option` and
    `asked_cameras`, and for an invalid depth range in it, or one end alone."""
    capture = capture_of_option(path, "cameras")
    file, notes = asked_cameras(capture, specs)
    if file.near is not None or file.far is not None:
        depth_range(file.cameras, file.near, file.far)
    told = [notice["message"] for notice in capture.table.warnings]
    return SceneViews(file.cameras, file.near, file.far), [*told, *notes]


def asked_cameras(capture: Capture, specs: Sequence[str] | None) -> tuple[CameraFile, list[str]]:
    """The cameras of all views in their order, and notes.

    Where one cannot be used, and `specs` name input views or places between them alone, those that these need suffice:
    the others have the first of these in their places, near and far are those of these, and a note names the first
    that cannot be used. Raises as `Capture.cameras`, for a camera that is needed.
    """
    count = len(capture.table.names)
    try:
        return capture.cameras(range(count)), []
    except _UNUSABLE as error:
        needed = _needed(specs or (), count)
        if not needed:
            raise
        passed_over = str(error) if error.index is None else f"view {error.index}: {error}"
    found = capture.cameras(needed)
    there = dict(zip(needed, found.views, strict=True))
    views = tuple(there.get(index, found.views[0]) for index in range(count))
    return replace(found, views=views), [f"a camera that is not asked for cannot be used: {passed_over}"]


def _needed(specs: Sequence[str], count: int) -> list[int]:
    """The input views that these are, or lie between; none where one is neither."""
    needed: set[int] = set()
    for spec in specs:
        try:
            place = float(spec)
        except ValueError:  # an orbit, which is about all
            return []
        if not 0 <= place <= count - 1:
            return []
        needed |= {math.floor(place), math.ceil(place)}
    return sorted(needed)
