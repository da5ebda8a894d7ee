"""Which camera belongs to which posted image: by file name where the names settle it, else by order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from ..camera import Camera
from ..camera_fields import NamedView
from ..captures.names import same_file, sorted_places
from ..errors import CameraError, InputError, ViewCountError
from ..image_files import image_size
from ..plain_number import counted


@dataclass(frozen=True)
class NamedImage:
    """An encoded photograph as it was sent."""

    name: str
    data: bytes


@dataclass(frozen=True)
class Pairing:
    """Images with their views, in the order of the images; `by` is "name", "order" or "sorted name"."""

    images: tuple[NamedImage, ...]
    views: tuple[NamedView, ...]
    by: str
    warnings: tuple[dict[str, Any], ...] = ()

    @property
    def cameras(self) -> tuple[Camera, ...]:
        return tuple(view.camera for view in self.views)

    def chosen(self, places: Sequence[int]) -> Pairing:
        """These images alone, in this order."""
        images, views = tuple(self.images[place] for place in places), tuple(self.views[place] for place in places)
        return replace(self, images=images, views=views)


@dataclass(frozen=True)
class Match:
    """Which camera of a file belongs to each posted image, and by what that was found out."""

    cameras: tuple[int, ...]  # places in the file, in the order of the images
    by: str
    warnings: tuple[dict[str, Any], ...] = ()


def match_names(images: Sequence[str], cameras: Sequence[str | None], *, by_sorted_name: bool = False) -> Match:
    """By name when every camera names its image and each posted name is the name of exactly one camera: of names alone,
    so that the cameras which no image belongs to are never looked at.

    A camera file may then hold more cameras than images were posted. Otherwise the counts must agree and order decides:
    that of the images as they were sent, or with `by_sorted_name` that of their names. Raises `ViewCountError`, which
    names the first image without a camera of its own where others have one, and `InputError` for an image that order
    would give to another camera than the one that names it.
    """
    named = all(cameras)
    found = [[place for place, name in enumerate(cameras) if same_file(image, name)] for image in images]
    if named and all(len(places) == 1 for places in found):
        chosen = tuple(places[0] for places in found)
        if len(set(chosen)) == len(images):
            return Match(chosen, "name")
    if len(images) != len(cameras):
        counts = f"{counted(len(cameras), 'camera')} for {counted(len(images), 'image')}"
        strays = [place for place, places in enumerate(found) if len(places) != 1]
        if named and 0 < len(strays) < len(images):  # one file too many, not names of another kind
            name, several = images[strays[0]], len(found[strays[0]])
            those = f"{several} of them name" if several else "none of them names"
            cure = "leave it out, or name the file as its view names it, and no other"
            raise ViewCountError(f"{counts}, and {those} {name!r}", field="images", index=strays[0], cure=cure)
        cure = "send one camera per image, or name each view's image as its file is named"
        raise ViewCountError(counts, field="cameras", cure=cure)
    if named:
        _check_order(images, cameras, found)
    if by_sorted_name:
        place_of = {place: row for row, place in enumerate(sorted_places(images))}
        return Match(tuple(place_of[place] for place in range(len(images))), "sorted name")
    warnings: tuple[dict[str, Any], ...] = ()
    if named:
        message = f"images are named {list(images)}, the cameras name {list(cameras)}; they were paired by order"
        warnings = ({"code": "names_differ", "message": message},)
    return Match(tuple(range(len(images))), "order", warnings)


def _check_order(images: Sequence[str], cameras: Sequence[str | None], found: Sequence[Sequence[int]]) -> None:
    """Raises `InputError` where an image and the camera of the same place have names that contradict each other."""
    for place, places in enumerate(found):
        if len(places) == 1 and places[0] != place:
            raise InputError(
                f"{images[place]!r} is named by camera {places[0]}, and by order would get camera {place}, which names "
                f"{cameras[place]!r}",
                field="images",
                index=place,
                cure="name all images as the cameras name theirs, each once, or leave the names out of the camera file",
            )


class PostedSizes:
    """Sizes of the posted images for cameras that have none, from their headers alone; each is read at most once."""

    def __init__(self, images: Sequence[NamedImage], max_pixels: int) -> None:
        self._images = images
        self._max_pixels = max_pixels
        self._sizes: dict[int, tuple[int, int]] = {}

    def __call__(self, name: str | None, index: int) -> tuple[int, int]:
        """(width, height) in px of the image that the camera at `index` belongs to. Raises `CameraError`."""
        places = [place for place, image in enumerate(self._images) if same_file(image.name, name)]
        if len(places) != 1:
            places = [index] if index < len(self._images) else []
        if not places:
            cure = "write w and h into the file; no image of this name was sent to read them from"
            raise CameraError("has no image size", field="frames", index=index, cure=cure)
        (place,) = places
        if place not in self._sizes:
            self._sizes[place] = image_size(self._images[place].data, index=place, max_pixels=self._max_pixels)
        return self._sizes[place]
