"""Which camera belongs to which posted image: by file name where the names settle it, else by order."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

from PIL import Image

from ..camera import Camera
from ..camera_file import NamedView
from ..errors import CameraError, ImageUnreadable, ViewCountError
from ..images import FORMATS


@dataclass(frozen=True)
class NamedImage:
    """An encoded photograph as it was sent."""

    name: str
    data: bytes


@dataclass(frozen=True)
class Pairing:
    """Images with their cameras, in the order of the images; `by` is "name" or "order"."""

    images: tuple[NamedImage, ...]
    cameras: tuple[Camera, ...]
    by: str
    warnings: tuple[dict[str, Any], ...] = ()


def pair(images: Sequence[NamedImage], views: Sequence[NamedView]) -> Pairing:
    """Match by name when every view names its image and each posted name is the name of exactly one view.

    A camera file may then hold more views than were posted. Otherwise the counts must agree and order decides.
    """
    named = all(view.image for view in views)
    matches = [[view for view in views if _same_file(image.name, view.image)] for image in images]
    if named and all(len(match) == 1 for match in matches):
        cameras = [match[0].camera for match in matches]
        if len({id(camera) for camera in cameras}) == len(images):
            return Pairing(tuple(images), tuple(cameras), "name")
    if len(images) != len(views):
        cure = "send one camera per image, or name each view's image as its file is named"
        raise ViewCountError(f"{len(views)} cameras for {len(images)} images", field="cameras", cure=cure)
    warnings: tuple[dict[str, Any], ...] = ()
    if named:
        posted, wanted = [image.name for image in images], [view.image for view in views]
        message = f"images are named {posted}, the cameras name {wanted}; they were paired by order"
        warnings = ({"code": "names_differ", "message": message},)
    return Pairing(tuple(images), tuple(view.camera for view in views), "order", warnings)


def posted_size(images: Sequence[NamedImage], name: str | None, index: int) -> tuple[int, int]:
    """(width, height) of the image that a camera without a size belongs to, from its header alone."""
    matches = [image for image in images if _same_file(image.name, name)]
    if len(matches) != 1:
        matches = list(images[index : index + 1])
    if not matches:
        cure = "write w and h into the file; no image of this name was sent to read them from"
        raise CameraError("has no image size", field="frames", index=index, cure=cure)
    try:
        with Image.open(io.BytesIO(matches[0].data), formats=FORMATS) as image:
            return image.size
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise ImageUnreadable(
            f"is not a {', '.join(FORMATS)} file", field="images", index=images.index(matches[0])
        ) from error


def _same_file(posted: str, wanted: str | None) -> bool:
    """Whether the last parts of both paths agree; a wanted name without a suffix (Blender's files) matches any."""
    have, want = (PurePosixPath((name or "").replace("\\", "/").lower()) for name in (posted, wanted))
    return bool(want.name) and (have.name == want.name or (not want.suffix and have.stem == want.name))
