"""A render as an image file: colour, opacity or depth, as PNG, WebP or JPEG."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from .errors import InputError, ViewError

if TYPE_CHECKING:
    from .splat import Render

Channel = Literal["rgb", "alpha", "depth"]
Format = Literal["png", "webp", "jpeg"]

COLOURS = {"black": (0.0, 0.0, 0.0), "white": (1.0, 1.0, 1.0), "grey": (0.5, 0.5, 0.5)}

# Quality 90 without chroma subsampling keeps a render within about two 8-bit levels; PNG is exact, and so is WebP for
# alpha and depth, whose levels mean something.
_SAVE: dict[str, dict] = {
    "png": {"compress_level": 4},
    "webp": {"quality": 90, "method": 2},
    "jpeg": {"quality": 90, "subsampling": 0},
}
_EXACT_WEBP = {"lossless": True, "method": 2}
MAX_SIDE: dict[str, int] = {"png": 2**31 - 1, "webp": 16_383, "jpeg": 65_500}  # px; of the format, libjpeg's for JPEG


@dataclass(frozen=True)
class Picture:
    """An encoded picture; `depth_range` gives the depths that the lowest and the highest grey level stand for."""

    data: bytes
    media_type: str
    depth_range: tuple[float, float] | None = None


def check_format(width: int, height: int, channel: Channel, format: Format) -> None:
    """Refuse what `encode` could not write, before anything is drawn. Raises `InputError`."""
    if format == "jpeg" and channel != "rgb":
        raise InputError(
            f"{channel} in JPEG would lose its levels", field="format", cure="ask for png or webp, which are exact"
        )
    for field, side in (("width", width), ("height", height)):
        if side > MAX_SIDE[format]:
            raise InputError(
                f"{field} is {side} px, the limit of {format} is {MAX_SIDE[format]}",
                field=field,
                cure="ask for a smaller picture or for png",
            )


def encode(render: Render, channel: Channel = "rgb", format: Format = "png") -> Picture:
    """Encode one channel of a render; what `check_format` refuses is not for here.

    Depth: grey level 0 means nothing there; level 1 to the highest (65535 in PNG, else 255) is linear from
    `depth_range[0]` to `depth_range[1]`, the smallest and largest depth of this picture, in the caller's units.
    """
    depth_range = None
    if channel == "rgb":
        pixels = render.rgb8()
    elif channel == "alpha":
        pixels = np.rint(np.clip(render.alpha, 0.0, 1.0) * 255).astype(np.uint8)
    else:
        pixels, depth_range = _depth_levels(render, 65535 if format == "png" else 255)
    buffer = io.BytesIO()
    options = _EXACT_WEBP if format == "webp" and channel != "rgb" else _SAVE[format]
    Image.fromarray(pixels).save(buffer, format.upper(), **options)
    return Picture(buffer.getvalue(), f"image/{format}", depth_range)


def png(pixels: NDArray[np.uint8]) -> bytes:
    """(H, W, 3) or (H, W, 4) bytes as a PNG file."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG", **_SAVE["png"])
    return buffer.getvalue()


def parse_background(text: str) -> tuple[float, float, float]:
    """`#rrggbb` (the # may be left out) or a colour's name, as sRGB in [0, 1]."""
    word = text.strip().lower()
    if word in COLOURS:
        return COLOURS[word]
    match = re.fullmatch(r"#?([0-9a-f]{6})", word)
    if match is None:
        names = ", ".join(COLOURS)
        raise ViewError(
            f"{text[:50]!r} is not a colour", field="background", cure=f"give rrggbb in hex or one of {names}"
        )
    red, green, blue = bytes.fromhex(match[1])
    return red / 255, green / 255, blue / 255


def _depth_levels(render: Render, top: int) -> tuple[np.ndarray, tuple[float, float]]:
    dtype = np.uint16 if top > 255 else np.uint8
    there = render.alpha > 0
    if not there.any():
        return np.zeros(render.depth.shape, dtype), (0.0, 0.0)
    depth = render.depth.astype(np.float64)
    low, high = float(depth[there].min()), float(depth[there].max())
    levels = 1 + (top - 1) * (depth - low) / max(high - low, np.finfo(np.float64).tiny)
    return np.where(there, np.rint(levels), 0).astype(dtype), (low, high)
