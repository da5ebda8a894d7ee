"""One camera given on its own: a view object of cameras.json, as `camera_document` writes it."""

from __future__ import annotations

from collections.abc import Mapping

from .camera import Camera
from .camera_file import parse_camera_file
from .errors import CameraError


def camera_from_json(obj: object) -> Camera:
    """Parse one view object; `axes` and `pose` in it say otherwise as they do in a camera file."""
    if not isinstance(obj, Mapping):
        raise CameraError(
            f"is a {type(obj).__name__}, need an object", field="camera", cure="one view of a cameras.json"
        )
    switches = {name: obj[name] for name in ("axes", "pose") if name in obj}
    return parse_camera_file({**switches, "views": [obj]}).views[0].camera
