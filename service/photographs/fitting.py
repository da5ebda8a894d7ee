"""Photographs on the grid of the scene: undistorted, matched with their cameras and cropped to its shape, with the
warnings due."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..cameras.camera import Camera
from ..cameras.distortion import Lens, pinhole_window
from ..cameras.view_checks import Notice
from ..errors import ImageError
from .borders import Bars, bars_notice, without_bars
from .images import EncodedPhoto, FittedView, PackedView, Photo, check_aspect, fit_view, match_photo
from .masks import check_kept
from .undistort import match_lens, undistorted, undistorted_size
from .upright import ON_ITS_SIDE
from .whole import Shape

Bytes = bytes | bytearray | memoryview  # of a file
Picture = NDArray[np.uint8] | Photo | EncodedPhoto | Image.Image | str | PathLike[str] | Bytes
"""What is taken for a photograph."""
View = TypeVar("View", FittedView, PackedView)


@dataclass(frozen=True, eq=False)
class FittedPhotos:
    """Each photograph in the scene's shape, at the resolutions that are needed, and the warnings about them."""

    seen: list[FittedView]  # with the network's pixels along the side that it sees at full resolution (`whole.py`)
    shown: list[FittedView]  # with those of the scene, `detail` times as many per axis
    fine: list[PackedView]  # at `finer` times as many per axis, whatever the detail
    notices: list[Notice]

    def without_detail(self, indices: Sequence[int]) -> FittedPhotos:
        """The views of these `indices`, for a scene without detail."""
        seen = [self.seen[index] for index in indices]
        return FittedPhotos(seen, seen, [self.fine[index] for index in indices], [])

    def with_cameras(self, cameras: Sequence[Camera]) -> FittedPhotos:
        """The photographs with the poses of these `cameras` of `seen`, and focal lengths changed as theirs are."""
        given = [view.camera for view in self.seen]

        def changed(views: Sequence[View]) -> list[View]:
            return [
                replace(
                    view,
                    camera=replace(
                        view.camera.posed(new.world_from_cam),
                        fx=view.camera.fx * (new.fx / old.fx),
                        fy=view.camera.fy * (new.fy / old.fy),
                    ),
                )
                for view, old, new in zip(views, given, cameras, strict=True)
            ]

        return FittedPhotos(changed(self.seen), changed(self.shown), changed(self.fine), self.notices)


def fitted_photos(
    images: Sequence[Picture],
    cameras: Sequence[Camera],
    numbers: Sequence[int],
    shapes: Sequence[Shape],
    detail: int,
    *,
    finer: int,
    done: Callable[[int], None],
) -> FittedPhotos:
    """`fitted` for each photograph in turn, so that one at a time is in memory at full size; `finer` is at least 1, and
    `detail` is 1 or `finer`. `done` receives the number of photographs done. Raises as `fitted`."""
    found = FittedPhotos([], [], [], [])
    for number, image, camera, shape in zip(numbers, images, cameras, shapes, strict=True):
        small, large, notices = fitted(image, camera, number, shape, detail, finer=finer)
        found.seen.append(small)
        found.shown.append(large if detail == finer else small)
        found.fine.append(PackedView.of(large))
        found.notices.extend(notices)
        done(len(found.seen))
    return found


def fitted(
    image: Picture, camera: Camera, index: int, shape: Shape, detail: int = 1, *, finer: int = 1
) -> tuple[FittedView, FittedView, list[Notice]]:
    """The photograph of view `index` in a `shape` of height and width, the same with `finer` times the pixels each way,
    and the warnings that belong to it in a scene of this `detail`.

    A path is read, and bytes are an encoded file; a memoryview is either that, if it has one axis, or pixels. Raises
    `ImageError` for what is no photograph, one that is too small or differs from its camera in aspect, and one whose
    mask keeps nothing of what the scene has of it.
    """
    if isinstance(image, str | PathLike):
        image = _read(image, index)
    if isinstance(image, bytes | bytearray) or (isinstance(image, memoryview) and image.ndim == 1):
        image = EncodedPhoto(bytes(image))
    if isinstance(image, EncodedPhoto):
        return _fitted(image.decode(index=index), camera, image.lens, index, shape, detail, finer)
    photo = image if isinstance(image, Photo) else Photo.from_array(image, index=index)
    return _fitted(photo, camera, None, index, shape, detail, finer)


def _read(path: str | PathLike[str], index: int) -> bytes:
    """The bytes of a file. Raises `ImageError`."""
    try:
        return Path(path).read_bytes()
    except (OSError, ValueError) as error:  # such as a null byte in the path
        why = error.strerror if isinstance(error, OSError) else error
        cure = "may this user read it?"
        if isinstance(error, IsADirectoryError):
            cure = "give the photographs in it, each by its path"
        elif isinstance(error, FileNotFoundError | ValueError):
            cure = "is it spelled so? a relative path counts from the working folder"
        raise ImageError(f"{path} cannot be read: {why}", field="images", index=index, cure=cure) from error


def fit_notices(
    photo: Photo, camera: Camera, lens: Lens | None, index: int, shape: Shape, detail: int = 1
) -> list[Notice]:
    """The warnings and errors of `fitted`; a photograph without a mask is not resampled for them."""
    bounded, _ = _bounded(photo, camera, lens, index)
    if bounded.mask is not None:
        return _fitted(photo, camera, lens, index, shape, detail)[2]
    width, height = (bounded.width, bounded.height) if lens is None else undistorted_size(bounded, lens)
    return _notices(bounded, camera, lens, index) + _too_small(width, height, shape, detail, index)


def _bounded(photo: Photo, camera: Camera, lens: Lens | None, index: int) -> tuple[Photo, list[Bars]]:
    """The photograph turned as its camera or lens has it, with the bars at its borders masked, and these. Bars are
    looked for before a lens is undistorted, while they are straight, and after turning, so that their sides are named
    right."""
    if lens is None:
        return without_bars(match_photo(photo, camera, index=index)[0])
    window = pinhole_window(lens)
    check_aspect(window.width, window.height, camera, index=index)
    return without_bars(match_lens(photo, lens, index=index))


def _fitted(
    photo: Photo, camera: Camera, lens: Lens | None, index: int, shape: Shape, detail: int, finer: int = 1
) -> tuple[FittedView, FittedView, list[Notice]]:
    """`fitted` for a decoded photograph."""
    photo, bars = _bounded(photo, camera, lens, index)
    notices = _notices(photo, camera, lens, index)
    of_bars = [bars_notice(bars, photo, index)] if bars else []
    if lens is not None:
        photo = undistorted(photo, lens, index=index)
    camera = camera.resized(photo.width, photo.height)  # undistorted: whole pixels, whatever aspect these have
    height, width = shape
    view = fit_view(photo, camera, height, width)
    check_kept(view, index)
    notices += of_bars if view.mask is not None else []  # what the scene does not have is nothing to tell
    notices += _too_small(photo.width, photo.height, shape, detail, index)
    if finer == 1:
        return view, view, notices
    return view, _within(fit_view(photo, camera, finer * height, finer * width), view.mask), notices


def _notices(photo: Photo, camera: Camera, lens: Lens | None, index: int) -> list[Notice]:
    """The warnings that a colour profile cannot be used, that an EXIF orientation is not applied, as camera or lens has
    the size of the pixels as stored, and that the photograph is undistorted; `photo` is turned as these have it."""
    notices: list[Notice] = []
    if photo.profile_problem is not None:
        message = f"its colour profile is not used, {photo.profile_problem}; levels are taken as sRGB"
        cure = "save the photograph in sRGB if its colours look wrong"
        where: Notice = {"field": "images", "index": index}
        notices.append({"code": "colour_profile_ignored", "message": f"{message} ({cure})", **where})
    if photo.orientation != 1:  # 1 also where it was turned
        size = f"{camera.width} x {camera.height}" if lens is None else f"{lens.width} x {lens.height}"
        message = f"EXIF orientation {photo.orientation} is not applied: the camera has the stored size {size}"
        if photo.orientation in ON_ITS_SIDE:
            message += "; pictures and films of the scene lie on their side as it does"
        notices.append({"code": "exif_orientation_ignored", "field": "images", "index": index, "message": message})
    return notices if lens is None else [*notices, _lens_notice(photo, lens, index)]


def _within(fine: FittedView, mask: NDArray[np.bool_] | None) -> FittedView:
    """`fine` without the pixels that the coarser `mask` (H, W) leaves out: the scene has nothing there."""
    if mask is None:
        return fine
    k = fine.image.shape[1] // len(mask)
    kept = mask.repeat(k, axis=0).repeat(k, axis=1)
    return replace(fine, mask=kept if fine.mask is None else fine.mask & kept)


def _too_small(width: int, height: int, shape: Shape, detail: int, index: int) -> list[Notice]:
    """The warning about a photograph that has fewer pixels than the scene has of it with this detail."""
    crop, shown = min(width, height * shape[1] / shape[0]), detail * shape[1]
    if detail == 1 or crop >= shown:
        return []
    message = (
        f"the photograph has {crop:.0f} px where a row of the scene with detail {detail} has {shown} px: it is as "
        "sharp as the photograph, not sharper"
    )
    return [{"code": "detail_beyond_photograph", "field": "images", "index": index, "message": message}]


def _lens_notice(photo: Photo, lens: Lens, index: int) -> Notice:
    """The warning that the photograph was undistorted: by how many of its pixels, and which share of it is left."""
    (width, height), shift = undistorted_size(photo, lens), lens.largest_shift() * photo.width / lens.width
    message = (
        f"the lens moves points by up to {shift:.3g} px: resampled to a pinhole of {width} x {height} px, which shows "
        f"{pinhole_window(lens).kept_share:.1%} of the photograph"
    )
    return {"code": "undistorted", "field": "images", "index": index, "message": message}
