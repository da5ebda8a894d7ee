"""Parse a transforms.json as nerfstudio, instant-ngp and Blender scripts write it: OpenGL axes, camera to world."""

from __future__ import annotations

import math
from collections.abc import Mapping

from .camera import Camera
from .camera_fields import CameraFile, NamedView, SizeOf, image_name, list_of, number_of, opencv_pose, optional_number
from .errors import CameraError, IntrinsicsError

_DISTORTION = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
_PINHOLES = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE")


def parse_transforms(obj: Mapping, *, size_of: SizeOf | None = None) -> CameraFile:
    """Views in the order of `frames`; a value of a frame wins over the same name at the top.

    Focal lengths are `fl_x`, `fl_y` (the latter defaults to the former) or `camera_angle_x`, `camera_angle_y`; the
    principal point defaults to the image centre, the size to `size_of`. Raises `IntrinsicsError` for a lens that is not
    a pinhole (non-zero distortion, fisheye) and `CameraError` for what is missing.
    """
    views = []
    for index, frame in enumerate(list_of(obj, "frames")):
        values = {**{k: v for k, v in obj.items() if k != "frames"}, **frame}
        name = image_name(frame, "file_path", field="frames", index=index)
        _require_pinhole(values, index)
        width, height = _size(values, name, size_of, index)
        fx = _focal(values, "x", width, index)
        has_fy = "fl_y" in values or "camera_angle_y" in values
        fy = _focal(values, "y", height, index) if has_fy else fx
        cx = number_of(values, "cx", field="frames", index=index) if "cx" in values else width / 2
        cy = number_of(values, "cy", field="frames", index=index) if "cy" in values else height / 2
        if "transform_matrix" not in frame:
            raise CameraError("transform_matrix is missing", field="frames.transform_matrix", index=index)
        pose = opencv_pose(
            frame["transform_matrix"], axes="opengl", pose="c2w", field="frames.transform_matrix", index=index
        )
        views.append(NamedView(name, Camera.make(width, height, fx, fy, cx, cy, pose, index=index, field="frames")))
    return CameraFile(tuple(views), optional_number(obj, "near"), optional_number(obj, "far"))


def _require_pinhole(values: Mapping, index: int) -> None:
    model = values.get("camera_model", "OPENCV")
    if model not in _PINHOLES or values.get("is_fisheye"):
        shown = "fisheye" if values.get("is_fisheye") else model
        raise IntrinsicsError(
            f"camera_model is {shown}, need a pinhole ({', '.join(_PINHOLES)})",
            field="frames.camera_model",
            index=index,
            cure="undistort the photographs first",
        )
    for name in _DISTORTION:
        if name in values and number_of(values, name, field="frames", index=index) != 0:
            raise IntrinsicsError(
                f"distortion {name} = {values[name]:g}, need 0",
                field=f"frames.{name}",
                index=index,
                cure="undistort the photographs first, for example with colmap image_undistorter",
            )


def _size(values: Mapping, name: str | None, size_of: SizeOf | None, index: int) -> tuple[int, int]:
    if "w" in values and "h" in values:
        size = (
            number_of(values, "w", field="frames", index=index),
            number_of(values, "h", field="frames", index=index),
        )
        if any(side != int(side) for side in size):
            raise CameraError(f"w, h = {size[0]:g}, {size[1]:g}, need whole numbers", field="frames.w", index=index)
        return int(size[0]), int(size[1])
    if size_of is None:
        raise CameraError("w and h are missing", field="frames.w", index=index, cure="add the image size in px")
    return size_of(name, index)


def _focal(values: Mapping, axis: str, size: int, index: int) -> float:
    """Focal length in px; from a field of view a, half the size over tan(a / 2)."""
    if f"fl_{axis}" in values:
        return number_of(values, f"fl_{axis}", field="frames", index=index)
    name = f"camera_angle_{axis}"
    if name not in values:
        raise CameraError(f"neither fl_{axis} nor {name} is given", field=f"frames.fl_{axis}", index=index)
    angle = number_of(values, name, field="frames", index=index)
    if not 0 < angle < math.pi:
        raise IntrinsicsError(
            f"{name} = {angle:g}, need between 0 and pi",
            field=f"frames.{name}",
            index=index,
            cure="angles are in radians",
        )
    return 0.5 * size / math.tan(0.5 * angle)
