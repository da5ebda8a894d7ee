"""Parsing of JSON camera files: the service's own cameras.json and, by `transforms_file`, transforms.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..arguments import shown
from ..errors import CameraError, IntrinsicsError
from .camera import Camera
from .camera_fields import CameraFile as CameraFile
from .camera_fields import NamedView as NamedView
from .camera_fields import SizeOf, image_name, json_kind, list_of, number_of, opencv_pose, optional_number
from .lens_keys import COEFFICIENTS, in_a_matrix, refuse_distorting_model, refuse_other_names
from .pose_cures import CAMERAS_JSON
from .transforms_file import parse_transforms

_NUMBERS = ("width", "height", "fx", "fy", "cx", "cy")
_OF_THE_FILE = ("axes", "pose", "near", "far")
_MISSPELT = {"axis": "axes", "poses": "pose", "near_plane": "near", "znear": "near", "far_plane": "far", "zfar": "far"}


def parse_camera_file(
    obj: object, *, size_of: SizeOf | None = None, indices: Sequence[int] | None = None
) -> CameraFile:
    """Parse a decoded cameras.json or transforms.json into OpenCV camera-to-world cameras.

    `size_of` supplies image sizes that a transforms.json omits. Unknown keys are ignored, except those that would
    change the result: a cameras.json is refused with distortion coefficients or another lens model than a pinhole, with
    conventions or bounds inside a view, and with a misspelt key of these. `indices` selects views and their order.
    Raises `CameraError` or a subclass, naming field and view index.
    """
    document = _json_object(obj)
    if _list_name(document) == "views":
        return _parse_views(document, indices)
    return parse_transforms(document, size_of=size_of, indices=indices)


def view_names(obj: object) -> tuple[str, tuple[str | None, ...]]:
    """The format of a decoded file, "cameras.json" or "transforms.json", and the names of its photographs, None where a
    view has none. Raises `CameraError`."""
    document = _json_object(obj)
    entries = _list_name(document)
    kind, name = ("cameras.json", "image") if entries == "views" else ("transforms.json", "file_path")
    listed = list_of(document, entries)
    return kind, tuple(image_name(entry, name, field=entries, index=index) for index, entry in enumerate(listed))


def camera_document(camera: Camera, image: str | None = None) -> dict[str, object]:
    """One entry of `views` in cameras.json; `parse_camera_file` reads it back to the bit."""
    entry = {name: getattr(camera, name) for name in _NUMBERS}
    pose = {"c2w": camera.world_from_cam.tolist()}
    return ({} if image is None else {"image": image}) | entry | pose


def conventions(obj: Mapping, *, field: str) -> tuple[str, str]:
    """The conventions of the poses: `axes` (opencv | opengl) and `pose` (c2w | w2c). Raises `CameraError`."""
    return _choice(obj, "axes", ("opencv", "opengl"), field), _choice(obj, "pose", ("c2w", "w2c"), field)


def meant_key(name: object) -> str | None:
    """The file-level key that `name` is or resembles, in any case and in known misspellings; else None."""
    meant = _MISSPELT.get(str(name).lower(), str(name).lower())
    return meant if meant in _OF_THE_FILE else None


def refuse_misspelt(obj: Mapping, *, field: str) -> None:
    """Raises `CameraError` for a misspelt file-level key, which would be ignored as unknown."""
    for name in obj:
        meant = meant_key(name)
        if meant is not None and name != meant:
            raise CameraError(f"{name!r} is not a key", field=field, cure=f'did you mean "{meant}"?')


def parse_view(entry: Mapping, *, axes: str, pose: str, field: str, index: int | None = None) -> NamedView:
    """Parse one view of a cameras.json under the conventions `axes` and `pose`. Raises `CameraError` or a subclass."""
    _refuse_lens(entry, field, index)
    missing = [name for name in _NUMBERS if name not in entry]
    if missing:
        cure = f"sizes and focal lengths in px{in_a_matrix(entry, 'fx, fy')}"
        raise CameraError(f"{', '.join(missing)} missing", field=field, index=index, cure=cure)
    width, height, fx, fy, cx, cy = (number_of(entry, name, field=field, index=index) for name in _NUMBERS)
    name = _matrix_name(entry, pose, field, index)
    world_from_cam = opencv_pose(
        entry[name], form=CAMERAS_JSON, axes=axes, pose=pose, field=f"{field}.{name}", index=index
    )
    camera = Camera.make(width, height, fx, fy, cx, cy, world_from_cam, index=index, field=field)
    return NamedView(image_name(entry, "image", field=field, index=index), camera)


def _json_object(obj: object) -> Mapping:
    """`obj`, which must be a JSON object. Raises `CameraError`."""
    if isinstance(obj, list) and obj and isinstance(obj[0], Mapping) and "img_name" in obj[0]:
        message = "is the list of cameras that 3DGS training leaves beside its .ply, which lacks principal points"
        raise CameraError(message, field="cameras", cure="give the COLMAP model or transforms.json it was trained from")
    if not isinstance(obj, Mapping):
        cure = 'give the list as "views" of an object: {"views": [...]}' if obj and isinstance(obj, list) else None
        raise CameraError(f"is {json_kind(obj)}, need a JSON object", field="cameras", cure=cure)
    return obj


def _list_name(obj: Mapping) -> str:
    """The name of the list of views, which tells the format. Raises `CameraError`."""
    for name in ("views", "frames"):
        if name in obj:
            return name
    names = sorted(str(name)[:50] for name in obj)[:8]
    raise CameraError(
        f'has neither "views" (cameras.json) nor "frames" (transforms.json), only {names}', field="cameras"
    )


def _parse_views(obj: Mapping, indices: Sequence[int] | None) -> CameraFile:
    refuse_misspelt(obj, field="cameras")
    _refuse_lens(obj, "cameras", None)
    axes, pose = conventions(obj, field="cameras")
    entries = list_of(obj, "views")
    chosen = range(len(entries)) if indices is None else indices
    for index in chosen:
        for name, value in entries[index].items():
            meant = meant_key(name)
            if meant is not None and value is not None:
                raise CameraError(
                    f"{name} = {shown(value)} stands in a view", field=f"views.{name}", index=index,
                    cure=f'say "{meant}" once, beside "views": it holds for all of them',
                )  # fmt: skip
    views = (parse_view(entries[index], axes=axes, pose=pose, field="views", index=index) for index in chosen)
    return CameraFile(tuple(views), optional_number(obj, "near"), optional_number(obj, "far"))


def _refuse_lens(obj: Mapping, field: str, index: int | None) -> None:
    """Raises `IntrinsicsError` for a distortion coefficient other than 0 and for another lens model: the cameras of a
    cameras.json are pinholes."""
    refuse_distorting_model(obj, field=field, index=index)
    refuse_other_names(obj, field=field, index=index)
    for name in COEFFICIENTS:
        if obj.get(name) is not None and number_of(obj, name, field=field, index=index) != 0:
            raise IntrinsicsError(
                f"{name} = {obj[name]}: a cameras.json holds pinholes, without distortion",
                field=f"{field}.{name}",
                index=index,
                cure="send a transforms.json or a COLMAP model, whose photographs are undistorted, or do that",
            )


def _matrix_name(entry: Mapping, pose: str, field: str, index: int | None) -> str:
    """The key of the matrix: the one that `pose` names, else `c2w`, whose matrix then has the direction of `pose`."""
    for name in (pose, "c2w"):
        if name in entry:
            return name
    if "w2c" in entry:
        raise CameraError(
            'has w2c, but the file does not say "pose": "w2c"',
            field=f"{field}.w2c",
            index=index,
            cure="say so at the top",
        )
    raise CameraError("c2w is missing", field=f"{field}.c2w", index=index, cure="give the 4x4 camera-to-world matrix")


def _choice(obj: Mapping, name: str, choices: tuple[str, str], field: str) -> str:
    value = obj.get(name, choices[0])
    if value not in choices:
        raise CameraError(f"{name} = {shown(value)}, need one of {', '.join(choices)}", field=f"{field}.{name}")
    return value
