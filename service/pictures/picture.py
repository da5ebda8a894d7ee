"""A render as an image file: colour, opacity or depth, as PNG, WebP or JPEG."""

from __future__ import annotations

import io
import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..errors import InputError, ViewError
from .depth_levels import DepthCode, depth_levels, png_text

if TYPE_CHECKING:
    from ..splat import Render

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
    """An encoded picture; `depth` says what the grey levels of a depth picture mean."""

    data: bytes
    media_type: str
    depth: DepthCode | None


def check_format(width: int, height: int, channel: Channel, format: Format, depth_scale: float | None = None) -> None:
    """Raises `InputError` for a picture that `encode` could not write, before anything is drawn."""
    if format == "jpeg" and channel != "rgb":
        raise InputError(
            f"{channel} in JPEG would lose its levels", field="format", cure="ask for png or webp, which are exact"
        )
    if depth_scale is not None:
        if channel != "depth":
            raise InputError(f"goes with channel depth, not with {channel}", field="depth_scale", cure="leave it out")
        if not 0 < depth_scale < math.inf:
            raise InputError(f"is {depth_scale:g}, need a finite number above 0", field="depth_scale")
    for field, side in (("width", width), ("height", height)):
        if side > MAX_SIDE[format]:
            raise InputError(
                f"{field} is {side} px, the limit of {format} is {MAX_SIDE[format]}",
                field=field,
                cure="ask for a smaller picture or for png",
            )


def encode(
    render: Render, channel: Channel = "rgb", format: Format = "png", depth_scale: float | None = None
) -> Picture:
    """Encode one channel of a render that `check_format` accepts.

    Depth has 16 bits in PNG, else 8; `depth_scale` as in `depth_levels`, whose errors pass. A PNG of depth describes
    its levels in text chunks.
    """
    code: DepthCode | None = None
    more: dict[str, Any] = {}
    if channel == "rgb":
        pixels = render.rgb8()
    elif channel == "alpha":
        pixels = np.rint(np.clip(render.alpha, 0.0, 1.0) * 255).astype(np.uint8)
    else:
        pixels, code = depth_levels(render.depth, render.alpha > 0, 65535 if format == "png" else 255, depth_scale)
        if format == "png":
            more["pnginfo"] = png_text(code)
    data = encode_image(Image.fromarray(pixels), format, exact=channel != "rgb", **more)
    return Picture(data, f"image/{format}", code)


def encode_image(image: Image.Image, format: Format, *, exact: bool = False, **options: Any) -> bytes:
    """Encode an image; `exact`: lossless WebP. `options` are passed to Pillow."""
    buffer = io.BytesIO()
    image.save(buffer, format.upper(), **(_EXACT_WEBP if exact and format == "webp" else _SAVE[format]), **options)
    return buffer.getvalue()


def png(pixels: NDArray[np.uint8]) -> bytes:
    """Encode (H, W, 3) or (H, W, 4) pixels as PNG."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG", **_SAVE["png"])
    return buffer.getvalue()


def parse_background(text: str) -> tuple[float, float, float]:
    """`#rrggbb`, with or without #, or a name of `COLOURS`, as sRGB in [0, 1]. Raises `ViewError`."""
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
