"""Pairing of posted images with cameras: by file name if the names are unambiguous, else by order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..cameras.camera import Camera
from ..cameras.camera_fields import NamedView
from ..captures.names import places_of, sorted_places
from ..errors import InputError, ViewCountError
from ..photographs.image_files import image_size
from ..plain_number import counted

_ESCAPED = {"%22": '"', "%0D": "\r", "%0A": "\n"}  # how browsers escape characters in the file name of a part


@dataclass(frozen=True)
class NamedImage:
    """A posted photograph, still encoded."""

    name: str
    data: bytes


@dataclass(frozen=True)
class Pairing:
    """Images with their views, in the order of the images; `by` is "name", "order" or "sorted name"."""

    images: tuple[NamedImage, ...]
    views: tuple[NamedView, ...]
    by: str
    warnings: tuple[dict[str, Any], ...]

    @property
    def cameras(self) -> tuple[Camera, ...]:
        return tuple(view.camera for view in self.views)


@dataclass(frozen=True)
class Match:
    """The camera of each posted image, and how it was found."""

    cameras: tuple[int, ...]  # indices in the camera file, in the order of the images
    by: str
    warnings: tuple[dict[str, Any], ...] = ()


def match_names(images: Sequence[str], cameras: Sequence[str | None], *, by_sorted_name: bool) -> Match:
    """Pair by name if every camera names its image and each posted name is that of exactly one camera. Only names are
    compared: cameras without an image are never parsed, and the file may hold more cameras than images were posted.

    Otherwise the counts must agree, and images are paired in the order in which they were sent, or with
    `by_sorted_name` in that of their names. Raises `ViewCountError`, which names the first image without a camera of
    its own if others have one, and `InputError` for an image that order would pair with another camera than the one
    that names it.
    """
    found = [places_of(image, cameras) or places_of(_undone(image), cameras) for image in images]
    chosen = tuple(places[0] for places in found if len(places) == 1)
    if all(cameras) and len(set(chosen)) == len(images):
        return Match(chosen, "name")
    if len(images) != len(cameras):
        raise _miscounted(images, cameras, found)
    order = sorted_places(images) if by_sorted_name else list(range(len(images)))
    camera_of = {place: row for row, place in enumerate(order)}
    _check_order(images, cameras, found, camera_of)
    warnings: tuple[dict[str, Any], ...] = ()
    if any(cameras[camera_of[place]] and camera_of[place] not in places for place, places in enumerate(found)):
        message = f"images are named {list(images)}, the cameras name {list(cameras)}; they were paired by order"
        warnings = ({"code": "names_differ", "message": message},)
    by = "sorted name" if by_sorted_name else "order"
    return Match(tuple(camera_of[place] for place in range(len(images))), by, warnings)


def _undone(name: str) -> str:
    """A posted name without the escapes of browsers; to be tried second, as a name may contain them literally."""
    for written, meant in _ESCAPED.items():
        name = name.replace(written, meant)
    return name


def _miscounted(images: Sequence[str], cameras: Sequence[str | None], found: Sequence[Sequence[int]]) -> ViewCountError:
    """The error for different counts of images and cameras that names do not pair."""
    counts = f"{counted(len(cameras), 'camera')} for {counted(len(images), 'image')}"
    first: dict[int, int] = {}  # first image of each camera
    clear = [(place, places[0]) for place, places in enumerate(found) if len(places) == 1]
    twice = [place for place, camera in clear if first.setdefault(camera, place) < place]
    strays = [place for place, places in enumerate(found) if len(places) != 1]
    index = min(twice + strays, default=0)
    cure = "leave it out, or name the file as its view names it, and no other"
    if all(cameras) and twice and index == twice[0]:
        (camera,) = found[index]
        said = f"{images[index]!r} is the image of camera {camera}, as image {first[camera]} is"
        return ViewCountError(f"{counts}, and {said}", field="images", index=index, cure=cure)
    if all(cameras) and 0 < len(strays) < len(images):  # single files are wrong, not the kind of names
        several = len(found[index])
        those = f"{several} of them name" if several else "none of them names"
        return ViewCountError(f"{counts}, and {those} {images[index]!r}", field="images", index=index, cure=cure)
    cure = "send one camera per image, or name each view's image as its file is named"
    return ViewCountError(counts, field="cameras", cure=cure)


def _check_order(
    images: Sequence[str],
    cameras: Sequence[str | None],
    found: Sequence[Sequence[int]],
    camera_of: Mapping[int, int],
) -> None:
    """Raises `InputError` if the name of an image contradicts the camera that it has by order."""
    for place, places in enumerate(found):
        camera = camera_of[place]
        if len(places) == 1 and places[0] != camera:
            names = f"names {cameras[camera]!r}" if cameras[camera] else "names none"
            raise InputError(
                f"{images[place]!r} is named by camera {places[0]}, and by order would get camera {camera}, which "
                f"{names}",
                field="images",
                index=place,
                cure="name all images as the cameras name theirs, each once, or leave the names out of the camera file",
            )


class PostedSizes:
    """Sizes of posted images, for cameras without a size, from the images' headers; each is read at most once."""

    def __init__(self, images: Sequence[NamedImage], match: Match, max_pixels: int) -> None:
        self._image_of = {camera: image for camera, image in zip(match.cameras, images, strict=True)}
        self._place_of = {camera: place for place, camera in enumerate(match.cameras)}
        self._max_pixels = max_pixels
        self._sizes: dict[int, tuple[int, int]] = {}

    def __call__(self, name: str | None, index: int) -> tuple[int, int]:
        """(width, height) in px of the image that belongs to camera `index` of the file. Raises `ImageError`."""
        if index not in self._sizes:
            data, place = self._image_of[index].data, self._place_of[index]
            self._sizes[index] = image_size(data, index=place, max_pixels=self._max_pixels)
        return self._sizes[index]
