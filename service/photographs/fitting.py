"""Photographs on the network's grid: resampled to a pinhole, matched with their cameras, cropped; and what to tell."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..cameras.camera import Camera
from ..cameras.distortion import Lens, PinholeWindow, pinhole_window
from ..cameras.view_checks import Notice
from ..errors import ImageError
from ..network.model_info import ModelInfo
from .images import EncodedPhoto, FittedView, PackedView, Photo, fit_view, match_photo
from .masks import check_kept
from .undistort import match_lens, undistorted

Bytes = bytes | bytearray | memoryview  # of a file
Picture = NDArray[np.uint8] | Photo | EncodedPhoto | Image.Image | str | PathLike[str] | Bytes
"""What is taken for a photograph."""


@dataclass(frozen=True, eq=False)
class FittedPhotos:
    """Photographs by what looks at them, one crop of each, and the warnings that belong to them."""

    seen: list[FittedView]  # by the network
    shown: list[FittedView]  # by the scene: with `detail` times as many pixels each way
    fine: list[PackedView]  # with `finer` times as many, whatever the detail
    notices: list[Notice]


def fitted_photos(
    images: Sequence[Picture],
    cameras: Sequence[Camera],
    numbers: Sequence[int],
    info: ModelInfo,
    detail: int,
    *,
    finer: int,
    done: Callable[[int], None],
) -> FittedPhotos:
    """Each as `fitted` has it, one after the other, so that one is in memory at full size; `finer` is 1 or more and
    `detail` 1 or that; `done` hears how many are fitted. Raises as `fitted`."""
    found = FittedPhotos([], [], [], [])
    for number, image, camera in zip(numbers, images, cameras, strict=True):
        small, large, notices = fitted(image, camera, number, info, detail, finer=finer)
        found.seen.append(small)
        found.shown.append(large if detail == finer else small)
        found.fine.append(PackedView.of(large))
        found.notices.extend(notices)
        done(len(found.seen))
    return found


def fitted(
    image: Picture, camera: Camera, index: int, info: ModelInfo, detail: int = 1, *, finer: int = 1
) -> tuple[FittedView, FittedView, list[Notice]]:
    """The photograph of view `index` as the network of `info` sees it, the same crop with `finer` times the pixels
    each way, and the warnings that belong to it in a scene of this `detail`.

    A path is read, bytes are those of a file; a view of memory is bytes unless it has the shape of pixels. At full size
    it lives in here only. Raises `ImageError` where it is none, too small, of another shape than its camera, or its
    mask keeps nothing of the crop.
    """
    if isinstance(image, str | PathLike):
        image = _read(image, index)
    if isinstance(image, bytes | bytearray) or (isinstance(image, memoryview) and image.ndim == 1):
        image = EncodedPhoto(bytes(image))
    if isinstance(image, EncodedPhoto):
        return _fitted(image.decode(index=index), camera, image.lens, index, info, detail, finer)
    photo = image if isinstance(image, Photo) else Photo.from_array(image, index=index)
    return _fitted(photo, camera, None, index, info, detail, finer)


def _read(path: str | PathLike[str], index: int) -> bytes:
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
    photo: Photo, camera: Camera, lens: Lens | None, index: int, info: ModelInfo, detail: int = 1
) -> list[Notice]:
    """The warnings and refusals of `fitted`, without the resampling of a photograph that has no mask."""
    if photo.mask is not None:
        return _fitted(photo, camera, lens, index, info, detail)[2]
    if lens is None:
        size: Photo | PinholeWindow = match_photo(photo, camera, index=index)[0]
    else:
        match_lens(photo, lens, index=index)
        size = pinhole_window(lens)
    return _notices(photo, camera, lens, index) + _too_small(size.width, size.height, info, detail, index)


def _fitted(
    photo: Photo, camera: Camera, lens: Lens | None, index: int, info: ModelInfo, detail: int, finer: int = 1
) -> tuple[FittedView, FittedView, list[Notice]]:
    notices = _notices(photo, camera, lens, index)
    if lens is not None:
        photo = undistorted(photo, lens, index=index)
    photo, camera = match_photo(photo, camera, index=index)
    view = fit_view(photo, camera, info.height, info.width)
    check_kept(view, index)
    notices += _too_small(photo.width, photo.height, info, detail, index)
    if finer == 1:
        return view, view, notices
    return view, _within(fit_view(photo, camera, finer * info.height, finer * info.width), view.mask), notices


def _notices(photo: Photo, camera: Camera, lens: Lens | None, index: int) -> list[Notice]:
    if lens is None:
        return _photo_notices(photo, camera.width, camera.height, index)
    return [*_photo_notices(photo, lens.width, lens.height, index), _lens_notice(lens, index)]


def _within(fine: FittedView, mask: NDArray[np.bool_] | None) -> FittedView:
    """Without the pixels that the network's view (H, W) of them leaves out: it has neither colour nor depth there."""
    if mask is None:
        return fine
    k = fine.image.shape[1] // len(mask)
    kept = mask.repeat(k, axis=0).repeat(k, axis=1)
    return replace(fine, mask=kept if fine.mask is None else fine.mask & kept)


def _too_small(width: int, height: int, info: ModelInfo, detail: int, index: int) -> list[Notice]:
    """A photograph of this size has fewer pixels in its crop than the scene shows of it."""
    crop, shown = min(width, height * info.width / info.height), detail * info.width
    if detail == 1 or crop >= shown:
        return []
    message = (
        f"the crop of the photograph is {crop:.0f} px wide, the scene with detail {detail} {shown} px: it is as "
        "sharp as the photograph, not sharper"
    )
    return [{"code": "detail_beyond_photograph", "field": "images", "index": index, "message": message}]


def _lens_notice(lens: Lens, index: int) -> Notice:
    """The photograph is not what the network saw: how much it was bent, and what is left of it."""
    window = pinhole_window(lens)
    message = (
        f"the lens moves points by up to {lens.largest_shift():.3g} px: resampled to a pinhole of {window.width} x "
        f"{window.height} px, which holds {window.kept_share:.1%} of the photograph's pixels"
    )
    return {"code": "undistorted", "field": "images", "index": index, "message": message}


def _photo_notices(photo: Photo, width: int, height: int, index: int) -> list[Notice]:
    """EXIF says turned, but the camera has the stored size: the pixels are left as stored, which is worth knowing."""
    if photo.orientation == 1 or abs(photo.width / photo.height - width / height) > 0.01:
        return []
    message = f"EXIF orientation {photo.orientation} is not applied: the camera has the stored size {width} x {height}"
    return [{"code": "exif_orientation_ignored", "field": "images", "index": index, "message": message}]
