"""One camera given on its own: a view object of cameras.json, as `camera_document` writes it."""

from __future__ import annotations

from collections.abc import Mapping

from ..arguments import shown
from ..errors import CameraError
from .camera import Camera
from .camera_fields import json_kind
from .camera_file import conventions, meant_key, parse_view, refuse_misspelt


def camera_from_json(obj: object) -> Camera:
    """Parse one view object; `axes` and `pose` in it say otherwise as they do in a camera file.

    Raises `CameraError` or one of its children, for bounds and for misspelt conventions too; their fields are `camera`
    or begin with `camera.`, without an index.
    """
    if not isinstance(obj, Mapping):
        raise CameraError(f"is {json_kind(obj)}, need an object", field="camera", cure="one view of a cameras.json")
    for name, value in obj.items():
        if meant_key(name) in ("near", "far") and value is not None:
            raise CameraError(
                f"{name} = {shown(value)} stands in a camera", field=f"camera.{name}",
                cure="leave it out: a picture begins at a tenth of its scene's near",
            )  # fmt: skip
    refuse_misspelt(obj, field="camera")
    axes, pose = conventions(obj, field="camera")
    return parse_view(obj, axes=axes, pose=pose, field="camera").camera
