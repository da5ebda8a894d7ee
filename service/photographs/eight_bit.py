"""Conversion of PIL images of any mode to 8-bit RGB, or RGBA where they have transparency."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..errors import ImageError
from .colour_profile import grey_problem, in_srgb

_STRIP = 64  # rows of a 16-bit image that are converted at a time
_PNG_BIT_DEPTH = 24  # byte offset: behind the signature, the length and name of the header, width and height
_GREY = ("1", "L", "LA", "La")
_NO_COLOURS = ("F", "I", "LAB", "La")  # modes of Pillow without a known range, or that it does not convert
_OF_A_DEPTH = ("L", "RGB")  # modes whose transparent level or colour has the file's bit depth, not the pixels'


def eight_bit(image: Image.Image, *, in_place: bool = False) -> tuple[NDArray[np.uint8], str | None]:
    """(H, W, 3) sRGB or (H, W, 4) sRGB and alpha, uint8, of an image of any mode that JPEG, PNG and WEBP can have; and
    why its colour profile was not used, if so. With `in_place` the image may be overwritten."""
    if image.mode.startswith("I"):  # 16-bit greyscale; Pillow's own conversion would clip it at 255
        return _eight_bit_grey(image), grey_problem(image)
    transparent = image.mode in ("RGBA", "LA", "PA", "La", "RGBa") or "transparency" in image.info
    mode = "RGBA" if transparent else "RGB"
    if image.mode in _GREY:
        return np.asarray(image.convert(mode)), grey_problem(image)
    if image.mode not in (mode, "CMYK"):
        image, in_place = image.convert(mode), True
    image, problem = in_srgb(image, in_place=in_place)
    return np.asarray(image if image.mode == mode else image.convert(mode)), problem


def check_mode(image: Image.Image, index: int | None) -> None:
    """Raises `ImageError` for a PIL image that `eight_bit` would misinterpret without its file."""
    what, cure = None, "give 8-bit RGB, such as Image.fromarray makes of uint8 (H, W, 3)"
    if image.mode in _NO_COLOURS:
        what = f"is a PIL image of mode {image.mode}, need one that becomes 8-bit RGB"
    elif image.mode in _OF_A_DEPTH and "transparency" in image.info:
        what = f"is a PIL image of mode {image.mode} with a transparent level or colour, whose bits only its file tells"
        cure = 'give the path or the bytes of its file, or what convert("RGBA") makes of it'
    if what is not None:
        raise ImageError(what, field="images", index=index, cure=cure)


def narrow_transparency(image: Image.Image, data: bytes) -> None:
    """Convert a PNG's transparent level or colour to the 8 bits of the decoded pixels, which Pillow does not do.

    Levels of 2 and 4 bits are scaled to 8. Of 16-bit colours the upper eight bits are compared, which is all that
    Pillow keeps.
    """
    if image.format != "PNG":
        return
    bits, transparent = data[_PNG_BIT_DEPTH], image.info.get("transparency")
    if image.mode == "L" and bits in (2, 4) and isinstance(transparent, int):
        image.info["transparency"] = transparent * (255 // (2**bits - 1))
    if image.mode == "RGB" and bits == 16 and isinstance(transparent, tuple):
        image.info["transparency"] = tuple(value >> 8 for value in transparent)


def _eight_bit_grey(image: Image.Image) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 from 16-bit grey levels: round(level / 257), which has no ties; (H, W, 4) where one level is
    transparent, which is compared in 16 bits. Converted strip by strip to save memory."""
    transparent = image.info.get("transparency")
    pixels = np.empty((image.height, image.width, 3 if transparent is None else 4), np.uint8)
    for top in range(0, image.height, _STRIP):
        bottom = min(top + _STRIP, image.height)
        levels = np.asarray(image.crop((0, top, image.width, bottom)), dtype=np.int32).clip(0, 65535)
        pixels[top:bottom, :, :3] = ((levels + 128) // 257)[:, :, None]
        if transparent is not None:
            pixels[top:bottom, :, 3] = np.where(levels == transparent, 0, 255)
    return pixels
