"""The size of a picture: a camera cropped about its centre to another aspect and scaled, never stretched."""

from __future__ import annotations

import re

from ..cameras.camera import Camera
from ..errors import ViewError


def frame(camera: Camera, width: int | None = None, height: int | None = None) -> Camera:
    """The same view at `width` x `height` px; one of them alone keeps the aspect, none of them keeps the camera.

    Where the aspect changes, the longer side is cropped about the middle of the picture and the intrinsics follow:
    pixels stay as square as they were.
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
    """The view without its last row or column of pixels where their number is odd, as a film in MP4 needs it; the
    others show what they did, at the same rays."""
    width, height = (side - side % 2 if side > 1 else side for side in (camera.width, camera.height))
    return camera.cropped(0, 0, width, height) if (width, height) != (camera.width, camera.height) else camera


def parse_size(text: str) -> tuple[int, int]:
    """`WxH` in pixels, such as 640x480."""
    match = re.fullmatch(r"([1-9]\d{0,8})[x×]([1-9]\d{0,8})", text.strip().lower())
    if match is None:
        raise ViewError(f"{text!r} is not a size", field="size", cure="give WIDTHxHEIGHT in pixels, such as 640x480")
    return int(match[1]), int(match[2])
