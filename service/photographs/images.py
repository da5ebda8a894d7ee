"""Photographs: decoding within bounds, matching with their camera, resampling to the network's grid."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..cameras.camera import Camera
from ..cameras.distortion import Lens
from ..errors import ImageError
from .arrays import checked_pixels
from .eight_bit import check_mode, eight_bit, narrow_transparency
from .image_files import DAMAGED, MAX_PIXELS, damaged, open_image
from .resampling import OPAQUE, resampled
from .upright import ON_ITS_SIDE, upright

MIN_SIDE = 32  # px; two patches of the network, below that there is nothing to match
_ORIENTATION = 0x0112  # EXIF tag
_NEARLY_SQUARE = 0.01  # sides that differ by this share fit a camera of 100 px either way


@dataclass(frozen=True, eq=False)
class Photo:
    """A decoded photograph as stored in its file (EXIF orientation not applied, but remembered)."""

    rgb: NDArray[np.uint8]  # (H, W, 3), sRGB
    mask: NDArray[np.bool_] | None = None  # (H, W), True keeps; None keeps everything
    orientation: int = 1  # EXIF 1..8
    own_mask: bool = False  # it came with an alpha channel, perhaps opaque everywhere: no bars are masked
    profile_problem: str | None = None  # why its colour profile was not used

    @property
    def height(self) -> int:
        return self.rgb.shape[0]

    @property
    def width(self) -> int:
        return self.rgb.shape[1]

    @classmethod
    def from_array(cls, array: object, *, index: int | None = None) -> Photo:
        """Check (H, W, 3) or (H, W, 4) uint8 RGB values; the fourth channel is the mask. A PIL image is taken as by
        `from_image`. Raises `ImageError`."""
        if isinstance(array, Image.Image):
            return cls.from_image(array, index=index)
        pixels = checked_pixels(array, index)
        _check_smallest(pixels.shape[1], pixels.shape[0], index)
        rgb = np.ascontiguousarray(pixels[:, :, :3])
        if pixels.shape[2] == 3:
            return cls(rgb)
        mask = pixels[:, :, 3] >= OPAQUE
        if not mask.any():
            message = f"alpha is below {OPAQUE} everywhere: the mask leaves no pixel"
            cure = "save the photograph without transparency, or with what is to be kept opaque"
            raise ImageError(message, field="images", index=index, cure=cure)
        return cls(rgb, None if mask.all() else mask, own_mask=True)

    @classmethod
    def from_image(cls, image: Image.Image, *, index: int | None = None) -> Photo:
        """Convert a PIL image as `decode_image` does that of a file. Raises `ImageError`, also for modes whose colours
        or transparency cannot be interpreted without the file."""
        if not isinstance(image, Image.Image):
            what, cure = f"is a {type(image).__name__}, need a PIL image", "an array is taken by from_array"
            raise ImageError(what, field="images", index=index, cure=cure)
        check_mode(image, index)
        try:
            (pixels, problem), orientation = eight_bit(image), _orientation(image)
        except DAMAGED as error:
            raise damaged(error, index) from error
        return replace(cls.from_array(pixels, index=index), orientation=orientation, profile_problem=problem)


@dataclass(frozen=True, eq=False)
class FittedView:
    """A photograph on the network's pixel grid, with the camera that belongs to that grid."""

    image: NDArray[np.float32]  # (3, H, W) in [0, 1]
    mask: NDArray[np.bool_] | None  # (H, W), True keeps
    camera: Camera
    kept_share: float  # share of the photograph's area inside the crop
    step: float = 1.0  # pixel pitch in pixels of the photograph; below 1 it was upsampled
    orientation: int = 1  # EXIF orientation that was not applied though it fits the camera as well; else 1

    @property
    def kept(self) -> NDArray[np.bool_]:
        """(H, W) the mask, all True where there is none."""
        return np.ones(self.image.shape[1:], np.bool_) if self.mask is None else self.mask

    @property
    def grey(self) -> NDArray[np.float64]:
        """(H, W) mean of the channels."""
        return self.image.mean(axis=0, dtype=np.float64)

    def pixels(self) -> NDArray[np.uint8]:
        """(H, W, 3) uint8, or (H, W, 4) with the mask as alpha."""
        rgb = np.rint(self.image.transpose(1, 2, 0) * 255).astype(np.uint8)
        if self.mask is None:
            return rgb
        return np.dstack([rgb, np.where(self.mask, 255, 0).astype(np.uint8)])


@dataclass(frozen=True, eq=False)
class PackedView:
    """A `FittedView` in 8 bits, a quarter of its memory; `image` and `mask` are computed at every access."""

    pixels: NDArray[np.uint8]  # as of `FittedView.pixels`
    camera: Camera

    @classmethod
    def of(cls, view: FittedView) -> PackedView:
        """`view`, rounded to 8 bits."""
        return cls(view.pixels(), view.camera)

    @property
    def image(self) -> NDArray[np.float32]:
        """(3, H, W) in [0, 1]."""
        return np.divide(self.pixels[:, :, :3], 255, dtype=np.float32).transpose(2, 0, 1)

    @property
    def mask(self) -> NDArray[np.bool_] | None:
        """(H, W), True keeps."""
        return self.pixels[:, :, 3] > 0 if self.pixels.shape[2] == 4 else None


def decode_image(data: bytes, *, index: int, max_pixels: int = MAX_PIXELS) -> Photo:
    """Decode JPEG, PNG or WEBP bytes; the size is checked before any pixel is decoded.

    Greyscale, palette, CMYK and 16-bit images become 8-bit RGB, in sRGB where a colour profile says that they have
    other colours. An alpha channel or the transparent level, colour or palette entry of a PNG becomes the mask. 16-bit
    grey is rounded to eight; of colours, and of grey with an alpha channel, Pillow keeps the upper eight bits, one
    level off at most.
    Raises `ImageUnreadable`, `ImageTooLarge` (more than `max_pixels`) or `ImageError` (below 32 x 32, animated, a
    JPEG of hundreds of scans).
    """
    with open_image(data, index=index, max_pixels=max_pixels) as image:
        _check_smallest(*image.size, index)
        if getattr(image, "is_animated", False) and image.format in ("PNG", "WEBP"):
            frames = getattr(image, "n_frames", 1)  # of the format's own class, not of every image
            raise ImageError(
                f"is an animation of {frames} frames, need one",
                field="images",
                index=index,
                cure="save its frames as files of their own",
            )
        try:
            orientation = _orientation(image)
            image.load()
            narrow_transparency(image, data)
            pixels, problem = eight_bit(image, in_place=True)
        except DAMAGED as error:
            raise damaged(error, index) from error
    return replace(Photo.from_array(pixels, index=index), orientation=orientation, profile_problem=problem)


@dataclass(frozen=True, eq=False)
class EncodedPhoto:
    """A photograph that is still encoded: decoded when it is needed, so that one at a time is in memory."""

    data: bytes = field(repr=False)
    max_pixels: int = MAX_PIXELS
    lens: Lens | None = None  # distortion to remove when it is resampled to its camera; None: it is a pinhole's picture

    def decode(self, *, index: int) -> Photo:
        """Decode it. Raises as `decode_image`."""
        return decode_image(self.data, index=index, max_pixels=self.max_pixels)


def match_photo(photo: Photo, camera: Camera, *, index: int | None = None) -> tuple[Photo, Camera]:
    """The photograph and its camera at the same size.

    Sizes whose aspects agree within 1 px (of the coarser grid) are taken for one view at two resolutions, and the
    camera is resized. EXIF orientation is applied only where the camera has the upright aspect and not the stored one.
    Raises `ImageError` with both sizes.
    """
    if _same_aspect(photo.width, photo.height, camera):
        return photo, camera.resized(photo.width, photo.height)
    if photo.orientation in ON_ITS_SIDE and _same_aspect(photo.height, photo.width, camera):
        turned = _turned_upright(photo)
        return turned, camera.resized(turned.width, turned.height)
    raise _aspects_differ(photo.width, photo.height, camera, index)


def check_aspect(width: int, height: int, camera: Camera, *, index: int | None) -> None:
    """Raises `ImageError` unless the size and the camera's agree in aspect, as `match_photo` requires."""
    if not _same_aspect(width, height, camera):
        raise _aspects_differ(width, height, camera, index)


def fit_view(photo: Photo, camera: Camera, height: int, width: int) -> FittedView:
    """Centre-crop to the aspect of `height` x `width` and resample; `camera` must have the photograph's size.

    The crop window is real-valued, without rounding: a pixel position p maps to (p - corner) * (new size / window
    size), and the intrinsics are mapped alike.
    """
    window_w = min(photo.width, photo.height * width / height)
    window_h = min(photo.height, photo.width * height / width)
    left, top = (photo.width - window_w) / 2, (photo.height - window_h) / 2
    sx, sy = width / window_w, height / window_h
    fitted = replace(
        camera,
        width=width,
        height=height,
        fx=camera.fx * sx,
        fy=camera.fy * sy,
        cx=(camera.cx - left) * sx,
        cy=(camera.cy - top) * sy,
    )
    box = (left, top, left + window_w, top + window_h)
    rgb, mask = resampled(photo.rgb, photo.mask, (width, height), box)
    image = np.ascontiguousarray(rgb.transpose(2, 0, 1), dtype=np.float32) / np.float32(255)
    kept_share = window_w * window_h / (photo.width * photo.height)
    return FittedView(image, mask, fitted, kept_share, window_w / width, _ambiguous_orientation(photo))


def resized(photo: Photo, width: int, height: int) -> Photo:
    """The photograph resampled to another size without cropping; EXIF orientation is not applied."""
    rgb, mask = resampled(photo.rgb, photo.mask, (width, height), (0, 0, photo.width, photo.height))
    return replace(photo, rgb=rgb, mask=mask)


def _orientation(image: Image.Image) -> int:
    orientation = image.getexif().get(_ORIENTATION, 1)
    return orientation if orientation in range(1, 9) else 1


def _ambiguous_orientation(photo: Photo) -> int:
    """The EXIF orientation where the aspect does not tell whether to apply it; else 1."""
    lying = photo.orientation in ON_ITS_SIDE
    square = abs(photo.width - photo.height) <= max(1, _NEARLY_SQUARE * max(photo.width, photo.height))
    return photo.orientation if not lying or square else 1


def _turned_upright(photo: Photo) -> Photo:
    """Apply the EXIF orientation to pixels and mask."""
    mask = None if photo.mask is None else upright(photo.mask, photo.orientation)
    return replace(photo, rgb=upright(photo.rgb, photo.orientation), mask=mask, orientation=1)


def _same_aspect(width: int, height: int, camera: Camera) -> bool:
    """Whether one size is the other at another resolution, with one side off by at most 1 px of the smaller."""
    if width > camera.width:
        small, large = (camera.width, camera.height), (width, height)
    else:
        small, large = (width, height), (camera.width, camera.height)
    by_width = abs(large[1] * small[0] / large[0] - small[1])
    by_height = abs(large[0] * small[1] / large[1] - small[0])
    return min(by_width, by_height) <= 1.0


def _aspects_differ(width: int, height: int, camera: Camera, index: int | None) -> ImageError:
    cure = "the camera must describe this very image: crop neither alone"
    if _same_aspect(height, width, camera):
        cure = "one of them is turned by 90 degrees"
    message = (
        f"the photograph is {width} x {height} px, its camera {camera.width} x {camera.height} px: the aspects differ"
    )
    return ImageError(message, field="images", index=index, cure=cure)


def _check_smallest(width: int, height: int, index: int | None) -> None:
    if width < MIN_SIDE or height < MIN_SIDE:
        raise ImageError(
            f"is {width} x {height} px, need at least {MIN_SIDE} x {MIN_SIDE}",
            field="images",
            index=index,
            cure="send the photograph itself, not a thumbnail of it",
        )
