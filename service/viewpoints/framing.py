"""Changing the size of a camera's picture: cropped about its centre to another aspect and scaled, never stretched."""

from __future__ import annotations

import re

from ..cameras.camera import Camera
from ..errors import ViewError


def frame(camera: Camera, width: int | None = None, height: int | None = None) -> Camera:
    """The same view at `width` x `height` px. If one is None, the aspect is kept; if both are, the camera is unchanged.

    For another aspect the picture is cropped about its centre, and the intrinsics follow: the ratio of fx and fy is
    kept.
    """
    if width is None:
        if height is None:
            return camera
        width = max(1, round(camera.width * height / camera.height))
    if height is None:
        height = max(1, round(camera.height * width / camera.width))
    scale = max(width / camera.width, height / camera.height)
    left = (camera.width - width / scale) / 2
    top = (camera.height - height / scale) / 2
    return Camera(
        width,
        height,
        camera.fx * scale,
        camera.fy * scale,
        (camera.cx - left) * scale,
        (camera.cy - top) * scale,
        camera.world_from_cam,
    )


def square(camera: Camera) -> Camera:
    """The largest centred square of the view."""
    side = min(camera.width, camera.height)
    return frame(camera, side, side)


def within(camera: Camera, side: int) -> Camera:
    """The same view with no side longer than `side` px."""
    if max(camera.width, camera.height) <= side:
        return camera
    return frame(camera, width=side) if camera.width >= camera.height else frame(camera, height=side)


def even(camera: Camera) -> Camera:
    """The view with an odd last row or column of pixels cropped, as MP4 needs even sides; other pixels keep their
    rays."""
    width, height = (side - side % 2 if side > 1 else side for side in (camera.width, camera.height))
    return camera.cropped(0, 0, width, height) if (width, height) != (camera.width, camera.height) else camera


def parse_size(text: str) -> tuple[int, int]:
    """(width, height) of `WxH` in pixels, such as 640x480. Raises `ViewError`."""
    match = re.fullmatch(r"([1-9]\d{0,8})[x×]([1-9]\d{0,8})", text.strip().lower())
    if match is None:
        raise ViewError(f"{text!r} is not a size", field="size", cure="give WIDTHxHEIGHT in pixels, such as 640x480")
    return int(match[1]), int(match[2])
