"""Parse camera files that are JSON: the service's own cameras.json and, through transforms_file, transforms.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..errors import CameraError, IntrinsicsError
from .camera import Camera
from .camera_fields import CameraFile as CameraFile
from .camera_fields import NamedView as NamedView
from .camera_fields import SizeOf, image_name, list_of, number_of, opencv_pose, optional_number
from .lens_keys import COEFFICIENTS, refuse_bending_model, refuse_other_names
from .transforms_file import parse_transforms

_NUMBERS = ("width", "height", "fx", "fy", "cx", "cy")
_OF_THE_FILE = ("axes", "pose", "near", "far")
_MISSPELT = {"axis": "axes", "poses": "pose", "near_plane": "near", "znear": "near", "far_plane": "far", "zfar": "far"}


def parse_camera_file(
    obj: object, *, size_of: SizeOf | None = None, indices: Sequence[int] | None = None
) -> CameraFile:
    """Parse a decoded cameras.json or transforms.json into OpenCV camera-to-world cameras.

    `size_of` supplies image sizes where a transforms.json leaves them out. Unknown keys are ignored, but for those that
    would mean something elsewhere: a cameras.json with coefficients of a lens or a model that bends, with a view that
    has conventions or bounds of its own, or with one of these misspelt is refused. With `indices` only those views are
    looked at, and come in that order.
    Raises `CameraError` or one of its children, naming field and view index.
    """
    document = _json_object(obj)
    if _list_name(document) == "views":
        return _parse_views(document, indices)
    return parse_transforms(document, size_of=size_of, indices=indices)


def view_names(obj: object) -> tuple[str, tuple[str | None, ...]]:
    """Which of the two formats a decoded file is, and the names of its photographs. Raises `CameraError`."""
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
    """What the poses mean: `axes` (opencv | opengl) and `pose` (c2w | w2c). Raises `CameraError`."""
    return _choice(obj, "axes", ("opencv", "opengl"), field), _choice(obj, "pose", ("c2w", "w2c"), field)


def meant_key(name: object) -> str | None:
    """Which of the file's own keys a key is or nearly is: it would be passed over as unknown."""
    meant = _MISSPELT.get(str(name).lower(), str(name).lower())
    return meant if meant in _OF_THE_FILE else None


def refuse_misspelt(obj: Mapping, *, field: str) -> None:
    """Raises `CameraError` for a key that is nearly one of the file's own."""
    for name in obj:
        meant = meant_key(name)
        if meant is not None and name != meant:
            raise CameraError(f"{name!r} is not a key", field=field, cure=f'did you mean "{meant}"?')


def parse_view(entry: Mapping, *, axes: str, pose: str, field: str, index: int | None = None) -> NamedView:
    """One view object of a cameras.json. Raises `CameraError` or one of its children."""
    _refuse_lens(entry, field, index)
    missing = [name for name in _NUMBERS if name not in entry]
    if missing:
        raise CameraError(
            f"{', '.join(missing)} missing", field=field, index=index, cure="sizes and focal lengths in px"
        )
    width, height, fx, fy, cx, cy = (number_of(entry, name, field=field, index=index) for name in _NUMBERS)
    matrix = _matrix(entry, pose, field, index)
    world_from_cam = opencv_pose(matrix, axes=axes, pose=pose, field=f"{field}.c2w", index=index)
    camera = Camera.make(width, height, fx, fy, cx, cy, world_from_cam, index=index, field=field)
    return NamedView(image_name(entry, "image", field=field, index=index), camera)


def _json_object(obj: object) -> Mapping:
    """The decoded file, which must be a JSON object. Raises `CameraError`."""
    if isinstance(obj, list) and obj and isinstance(obj[0], Mapping) and "img_name" in obj[0]:
        message = "is the list of cameras that 3DGS training leaves beside its .ply, which lacks principal points"
        raise CameraError(message, field="cameras", cure="give the COLMAP model or transforms.json it was trained from")
    if not isinstance(obj, Mapping):
        raise CameraError(f"is a {type(obj).__name__}, need a JSON object", field="cameras")
    return obj


def _list_name(obj: Mapping) -> str:
    """Which of the two formats this is: the name of its list of views. Raises `CameraError`."""
    for name in ("views", "frames"):
        if name in obj:
            return name
    raise CameraError(
        f'has neither "views" (cameras.json) nor "frames" (transforms.json), only {sorted(map(str, obj))[:8]}',
        field="cameras",
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
                    f"{name} = {value!r} stands in a view", field=f"views.{name}", index=index,
                    cure=f'say "{meant}" once, beside "views": it holds for all of them',
                )  # fmt: skip
    views = (parse_view(entries[index], axes=axes, pose=pose, field="views", index=index) for index in chosen)
    return CameraFile(tuple(views), optional_number(obj, "near"), optional_number(obj, "far"))


def _refuse_lens(obj: Mapping, field: str, index: int | None) -> None:
    """The cameras of a cameras.json are pinholes. Raises `IntrinsicsError` for a coefficient other than 0, and for
    what says of another lens."""
    refuse_bending_model(obj, field=field, index=index)
    refuse_other_names(obj, field=field, index=index)
    for name in COEFFICIENTS:
        if obj.get(name) is not None and number_of(obj, name, field=field, index=index) != 0:
            raise IntrinsicsError(
                f"{name} = {obj[name]}: a cameras.json holds pinholes, without distortion",
                field=f"{field}.{name}",
                index=index,
                cure="send a transforms.json or a COLMAP model, whose photographs are undistorted, or do that",
            )


def _matrix(entry: Mapping, pose: str, field: str, index: int | None) -> object:
    """The pose matrix under `c2w`, or under `w2c` where the file says that this is its direction."""
    if "c2w" in entry:
        return entry["c2w"]
    if "w2c" in entry:
        if pose == "w2c":
            return entry["w2c"]
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
        raise CameraError(f"{name} = {value!r}, need one of {', '.join(choices)}", field=f"{field}.{name}")
    return value
