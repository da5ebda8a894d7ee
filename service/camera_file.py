"""Read camera files: the service's own cameras.json and, through transforms_file, a nerfstudio transforms.json."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from .camera import Camera
from .camera_fields import CameraFile as CameraFile
from .camera_fields import NamedView as NamedView
from .camera_fields import SizeOf, image_name, list_of, number_of, opencv_pose, optional_number
from .errors import CameraError, ImageError, ImageUnreadable
from .transforms_file import parse_transforms

_FILE_NAMES = ("cameras.json", "transforms.json")
_NUMBERS = ("width", "height", "fx", "fy", "cx", "cy")
_SUFFIXES = ("", ".png", ".jpg", ".jpeg", ".webp", ".PNG", ".JPG", ".JPEG")  # a Blender file names images without one


@dataclass(frozen=True)
class SceneFolder:
    """A folder with a camera file and the photographs that it names, one path per view."""

    root: Path
    file: CameraFile
    image_paths: tuple[Path, ...]


def parse_camera_file(obj: object, *, size_of: SizeOf | None = None) -> CameraFile:
    """Parse a decoded cameras.json or transforms.json into OpenCV camera-to-world cameras.

    `size_of` supplies image sizes where a transforms.json leaves them out. Unknown keys are ignored.
    Raises `CameraError` or one of its children, naming field and view index.
    """
    if not isinstance(obj, Mapping):
        raise CameraError(f"is a {type(obj).__name__}, need a JSON object", field="cameras")
    if "views" in obj:
        return _parse_views(obj)
    if "frames" in obj:
        return parse_transforms(obj, size_of=size_of)
    raise CameraError(
        f'has neither "views" (cameras.json) nor "frames" (transforms.json), only {sorted(map(str, obj))[:8]}',
        field="cameras",
    )


def load_scene_folder(path: str | Path) -> SceneFolder:
    """Read `cameras.json`, else `transforms.json`, of a folder, or the named file; images are found, not decoded.

    Raises `CameraError` for a missing or malformed file and `ImageError` for a photograph that is not there.
    """
    path = Path(path)
    source = path if path.is_file() else next((path / name for name in _FILE_NAMES if (path / name).is_file()), None)
    if source is None:
        raise CameraError(f"{path} holds neither {' nor '.join(_FILE_NAMES)}", field="cameras")
    root = source.parent
    try:
        obj = json.loads(source.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise CameraError(f"{source} is not readable JSON: {error}", field="cameras") from error
    file = parse_camera_file(obj, size_of=lambda name, index: _size_in_file(_find_image(root, name, index), index))
    return SceneFolder(root, file, tuple(_find_image(root, v.image, i) for i, v in enumerate(file.views)))


def camera_document(camera: Camera, image: str | None = None) -> dict[str, object]:
    """One entry of `views` in cameras.json; `parse_camera_file` reads it back to the bit."""
    entry = {name: getattr(camera, name) for name in _NUMBERS}
    pose = {"c2w": camera.world_from_cam.tolist()}
    return ({} if image is None else {"image": image}) | entry | pose


def _parse_views(obj: Mapping) -> CameraFile:
    axes = _choice(obj, "axes", ("opencv", "opengl"))
    pose = _choice(obj, "pose", ("c2w", "w2c"))
    views = []
    for index, entry in enumerate(list_of(obj, "views")):
        missing = [name for name in _NUMBERS if name not in entry]
        if missing:
            raise CameraError(
                f"{', '.join(missing)} missing", field="views", index=index, cure="sizes and focal lengths in px"
            )
        numbers = [number_of(entry, name, field="views", index=index) for name in _NUMBERS]
        matrix = _matrix(entry, pose, index)
        world_from_cam = opencv_pose(matrix, axes=axes, pose=pose, field="views.c2w", index=index)
        camera = Camera.make(*numbers, world_from_cam, index=index, field="views")
        views.append(NamedView(image_name(entry, "image", field="views", index=index), camera))
    return CameraFile(tuple(views), optional_number(obj, "near"), optional_number(obj, "far"))


def _matrix(entry: Mapping, pose: str, index: int) -> object:
    """The pose matrix under `c2w`, or under `w2c` where the file says that this is its direction."""
    if "c2w" in entry:
        return entry["c2w"]
    if "w2c" in entry:
        if pose == "w2c":
            return entry["w2c"]
        raise CameraError(
            'has w2c, but the file does not say "pose": "w2c"', field="views.w2c", index=index, cure="say so at the top"
        )
    raise CameraError("c2w is missing", field="views.c2w", index=index, cure="give the 4x4 camera-to-world matrix")


def _choice(obj: Mapping, name: str, choices: tuple[str, str]) -> str:
    value = obj.get(name, choices[0])
    if value not in choices:
        raise CameraError(f"{name} = {value!r}, need one of {', '.join(choices)}", field=f"cameras.{name}")
    return value


def _find_image(root: Path, name: str | None, index: int) -> Path:
    if name is None:
        raise ImageError("the camera file names no photograph for this view", field="views.image", index=index)
    for suffix in _SUFFIXES:
        candidate = root / (name + suffix)
        if candidate.is_file():
            return candidate
    raise ImageError(f"{root / name} does not exist", field="views.image", index=index)


def _size_in_file(path: Path, index: int) -> tuple[int, int]:
    try:
        with Image.open(path) as image:
            return image.size
    except OSError as error:
        raise ImageUnreadable(f"{path} is not an image: {error}", field="views.image", index=index) from error
