"""Parse a transforms.json as nerfstudio, instant-ngp and Blender scripts write it: OpenGL axes, camera to world."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from ..arguments import shown
from ..errors import CameraError, IntrinsicsError
from .camera import LEAST_FOCAL, MOST_FOCAL, checked_side
from .camera_fields import (
    CameraFile,
    SizeOf,
    image_name,
    list_of,
    number_of,
    opencv_pose,
    optional_number,
    view_through,
)
from .distortion import Lens
from .lens_keys import COEFFICIENTS, OTHER_NAMES, in_a_matrix, refuse_other_names, require_pinhole_model, too_long
from .pose_cures import TRANSFORMS_JSON

NARROWEST, WIDEST = (2 * math.atan(0.5 / focal) for focal in (MOST_FOCAL, LEAST_FOCAL))  # radians
_LENGTHS, _ANGLES = ("fl_x", "fl_y"), ("camera_angle_x", "camera_angle_y")
_OTHERS = ("w", "h", "cx", "cy", "skew", "camera_model", "is_fisheye")
_OF_A_FRAME = (*_LENGTHS, *_ANGLES, *COEFFICIENTS, *OTHER_NAMES, *_OTHERS)  # the top says it for all


def parse_transforms(obj: Mapping, *, size_of: SizeOf | None, indices: Sequence[int] | None) -> CameraFile:
    """Views in the order of `frames`, or those of `indices`; a value of a frame wins over the same name at the top,
    and its own field of view over the focal lengths there.

    Focal lengths are `fl_x`, `fl_y` (the latter defaults to the former) or `camera_angle_x`, `camera_angle_y`; the
    principal point defaults to the image centre, the size to `size_of`. Distortion that moves no point of the picture
    by 0.5 px is left out; with more the view has its lens, and the pinhole that this becomes. `applied_transform` says
    what was done to the poses that are in the file: they are taken as they are. Raises `IntrinsicsError` for a lens
    that does not become a pinhole (fisheye, folds) and `CameraError` for what is missing, and for the keys of a
    cameras.json that would state another convention. A value of null counts as left out.
    """
    _refuse_conventions(obj)
    views = []
    frames = list_of(obj, "frames")
    common = {name: value for name, value in obj.items() if name in _OF_A_FRAME and value is not None}
    for name, value in common.items():
        if too_long(value):  # it is looked at again for every frame
            message = f"{name} = {shown(value)}... is longer than the numbers of a lens"
            raise CameraError(message, field=f"cameras.{name}", cure="is it the right key? leave it out")
    for index in range(len(frames)) if indices is None else indices:
        frame = {name: value for name, value in frames[index].items() if value is not None}
        values = {**_of_the_top(common, frame), **frame}
        name = image_name(frame, "file_path", field="frames", index=index)
        require_pinhole_model(values, field="frames", index=index)
        refuse_other_names(values, field="frames", index=index)
        width, height = _size(values, name, size_of, index)
        fx = _focal(values, "x", width, index)
        has_fy = "fl_y" in values or "camera_angle_y" in values
        fy = _focal(values, "y", height, index) if has_fy else fx
        cx = number_of(values, "cx", field="frames", index=index) if "cx" in values else width / 2
        cy = number_of(values, "cy", field="frames", index=index) if "cy" in values else height / 2
        if "transform_matrix" not in frame:
            cure = "give each frame its 4x4 camera-to-world matrix in OpenGL axes under this name"
            raise CameraError("transform_matrix is missing", field="frames.transform_matrix", index=index, cure=cure)
        matrix, field = frame["transform_matrix"], "frames.transform_matrix"
        pose = opencv_pose(matrix, form=TRANSFORMS_JSON, axes="opengl", pose="c2w", field=field, index=index)
        lens = _lens(values, (width, height), (fx, fy), (cx, cy), index)
        try:
            views.append(view_through(name, lens, pose, field="frames", index=index))
        except IntrinsicsError as error:
            error.field = f"frames.{_member(values, (error.field or '').removeprefix('frames.'))}"
            raise
    return CameraFile(tuple(views), optional_number(obj, "near"), optional_number(obj, "far"))


def _refuse_conventions(obj: Mapping) -> None:
    for key, other, fixed in (("axes", "opencv", "opengl"), ("pose", "w2c", "c2w")):
        if str(obj.get(key)).lower() == other:
            message = f"{key} is {other}, and poses of a transforms.json are {fixed}"
            cure = f'convert the poses and leave {key} out, or list the views in a cameras.json with "{key}": "{other}"'
            raise CameraError(message, field=f"cameras.{key}", cure=cure)


def _of_the_top(common: Mapping, frame: Mapping) -> dict[str, Any]:
    """What the top says for this frame: no focal lengths where the frame has a field of view, and the reverse. What it
    has for y alone leaves the top's for x."""
    dropped: set[str] = set()
    for own, other in ((_LENGTHS, _ANGLES), (_ANGLES, _LENGTHS)):
        if own[0] in frame:
            dropped.update(other)
        elif own[1] in frame:
            dropped.add(other[1])
    return {name: value for name, value in common.items() if name not in dropped}


def _lens(
    values: Mapping, size: tuple[int, int], focal: tuple[float, float], center: tuple[float, float], index: int
) -> Lens:
    """With k5 or k6 the coefficient k4 is one of the denominator; without them that of r^8, as nerfstudio has it."""
    given: dict[str, Any] = {
        name: number_of(values, name, field="frames", index=index) for name in COEFFICIENTS if name in values
    }
    if not (given.get("k5") or given.get("k6")) and str(values.get("camera_model")).upper() != "FULL_OPENCV":
        given["r8"] = given.pop("k4", 0.0)
    return Lens(*size, *focal, *center, **given)


def _size(values: Mapping, name: str | None, size_of: SizeOf | None, index: int) -> tuple[int, int]:
    if "w" in values and "h" in values:
        sides = [number_of(values, name, field="frames", index=index) for name in "wh"]
        width, height = (checked_side(side, name, "frames", index) for side, name in zip(sides, "wh", strict=True))
        return width, height
    if lacking := [name for name in "wh" if name not in values and ("w" in values or "h" in values)]:
        cure = "add it, or leave both out: then the photographs tell"
        raise CameraError(f"{lacking[0]} is missing", field=f"frames.{lacking[0]}", index=index, cure=cure)
    if size_of is None:
        raise CameraError("w and h are missing", field="frames.w", index=index, cure="add the image size in px")
    return size_of(name, index)


def _member(values: Mapping, name: str) -> str:
    """What the file calls `fx` and `fy`, of which the latter may be left out; other names are its own."""
    meant = {"fx": ("fl_x", "camera_angle_x"), "fy": ("fl_y", "camera_angle_y", "fl_x", "camera_angle_x")}
    return next((member for member in meant.get(name, ()) if member in values), name)


def _focal(values: Mapping, axis: str, size: int, index: int) -> float:
    """Focal length in px; from a field of view a, half the size over tan(a / 2)."""
    if f"fl_{axis}" in values:
        return number_of(values, f"fl_{axis}", field="frames", index=index)
    name = f"camera_angle_{axis}"
    if name not in values:
        cure = f"give fl_{axis}, the focal length in px, at the top of the file or in the frame"
        cure += in_a_matrix(values, "fl_x, fl_y")
        raise CameraError(f"neither fl_{axis} nor {name} is given", field=f"frames.fl_{axis}", index=index, cure=cure)
    angle = number_of(values, name, field="frames", index=index)
    if not NARROWEST <= angle <= WIDEST:
        raise IntrinsicsError(
            f"{name} = {angle:g}, need between {NARROWEST:.3g} and {WIDEST:.3g}",
            field=f"frames.{name}",
            index=index,
            cure="it is the whole field of view, in radians",
        )
    return 0.5 * size / math.tan(0.5 * angle)
