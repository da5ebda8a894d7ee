"""Encoded photographs: header, size and structure checked before any pixel is decoded."""

from __future__ import annotations

import io
import re
import struct
import threading
import warnings
from collections.abc import Sequence

from PIL import Image, PngImagePlugin, UnidentifiedImageError

from ..errors import ImageError, ImageTooLarge, ImageUnreadable

FORMATS = ("JPEG", "PNG", "WEBP")
MAX_PIXELS = 64_000_000  # 192 MB once decoded; the largest phone photographs have 50 to 60 million
MAX_SCANS = 100  # of one JPEG; encoders write about ten, and each costs a pass over all coefficients
MAX_SEGMENTS = 10_000  # of one JPEG; a photograph has some dozens, and each costs an iteration of the header's parser
# Segments of a JPEG and chunks of a PNG or WebP that a file of any size may have, and bytes of it for each further one;
# most encoders put 8 KiB or more of a PNG's pixels into one chunk.
FEW_PARTS, PART_BYTES = 500, 256
DAMAGED = (OSError, SyntaxError, ValueError, EOFError, struct.error)  # what Pillow's decoders raise on damaged files

_LONG_TEXT = "MAX_TEXT_"  # in Pillow's errors about a PNG's chunks of text, of which the colour profile is one
_PNG = b"\x89PNG\r\n\x1a\n"
_CHUNK = re.compile(rb"\w{4}")  # the name of one; decoders stop at anything else
_START_OF_SCAN, _END_OF_IMAGE, _START_OF_IMAGE = 0xDA, 0xD9, 0xD8
# ITU-T T.81, B.1.1.2: inside a scan 0xFF stands before 0 (stuffed) or a restart marker; 1 (TEM) has no parameters.
_MARKER = re.compile(rb"\xff([^\x00\x01\xd0-\xd7\xff])", re.DOTALL)
_OTHERS = {  # what cameras and phones write beside these formats, by their first bytes
    "HEIC": re.compile(rb"....ftyp(?:he[iv][cmsx]|m[is]f1)", re.DOTALL),
    "AVIF": re.compile(rb"....ftypavi[fs]", re.DOTALL),
    "TIFF or raw": re.compile(rb"II\*\0|MM\0\*"),
}
_quiet = threading.Lock()  # the filters of `warnings` belong to the whole process


def open_image(data: bytes, *, index: int, max_pixels: int = MAX_PIXELS) -> Image.Image:
    """Open an image lazily: its header is read and its size checked, no pixel is decoded.

    Raises `ImageUnreadable`, `ImageTooLarge` (more than `max_pixels`) or `ImageError` (a file of too many parts).
    """
    most = FEW_PARTS + len(data) // PART_BYTES
    if data[:2] == b"\xff\xd8":
        scans, segments = jpeg_parts(data)
        _check_parts(scans, MAX_SCANS, "JPEG", "scans", index)
        _check_parts(segments, min(most, MAX_SEGMENTS), "JPEG", "segments", index)
    elif data.startswith(_PNG):
        _check_parts(png_chunks(data, most), most, "PNG", "chunks", index)
    elif data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        _check_parts(webp_chunks(data, most), most, "WebP", "chunks", index)
    try:
        with _quiet, warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # the bound below is the tighter one
            image = Image.open(io.BytesIO(data), formats=FORMATS)
    except UnidentifiedImageError as error:
        raise ImageUnreadable(
            f"{len(data)} bytes are not a {', '.join(FORMATS)} file{_but(data)}",
            field="images",
            index=index,
            cure="save the photograph in one of these formats; its content counts, not its name",
        ) from error
    except Image.DecompressionBombError as error:
        limit = min(max_pixels, 2 * (Image.MAX_IMAGE_PIXELS or max_pixels))  # Pillow refuses twice its own limit
        raise ImageTooLarge(
            f"has more pixels than the limit of {limit}", field="images", index=index, cure="scale it down"
        ) from error
    except DAMAGED as error:
        raise damaged(error, index) from error
    width, height = image.size
    if width * height > max_pixels:
        raise ImageTooLarge(
            f"has {width} x {height} = {width * height} pixels, the limit is {max_pixels}",
            field="images",
            index=index,
            cure="scale it down; the network works on far smaller images",
        )
    return image


def _but(data: bytes) -> str:
    """The end of a refusal: which other format the bytes have, if they show one of `_OTHERS`."""
    return next((f", but {name}" for name, start in _OTHERS.items() if start.match(data)), "")


def image_size(data: bytes, *, index: int, max_pixels: int = MAX_PIXELS) -> tuple[int, int]:
    """(width, height) in px from the header alone. Raises as `open_image`."""
    with open_image(data, index=index, max_pixels=max_pixels) as image:
        return image.size


def check_total(
    photos: Sequence[bytes], *, max_pixels: int, max_total: int, numbers: Sequence[int] | None = None
) -> None:
    """Refuse photographs with more than `max_total` pixels together.

    Raises `ImageTooLarge`, and what `open_image` raises for a single one, with its index or its entry of `numbers`.
    """
    numbers = range(len(photos)) if numbers is None else numbers
    sizes = [
        image_size(data, index=number, max_pixels=max_pixels) for number, data in zip(numbers, photos, strict=True)
    ]
    total = sum(width * height for width, height in sizes)
    if total > max_total:
        raise ImageTooLarge(
            f"the {len(sizes)} photographs have {total} pixels together, the limit is {max_total}",
            field="images",
            cure="scale them down; the network works on far smaller images",
        )


def _check_parts(count: int, most: int, kind: str, what: str, index: int) -> None:
    if count > most:
        raise ImageError(
            f"is a {kind} of {min(count, most + 1)} {what} or more, the limit is {most}",
            field="images",
            index=index,
            cure="save it anew; no encoder writes so many",
        )


def png_chunks(data: bytes, most: int) -> int:
    """Number of chunks of a PNG up to its end chunk, or to what is no chunk; counting stops just above `most`."""
    count, place = 0, len(_PNG)
    while count <= most and (name := _CHUNK.match(data, place + 4)) is not None:
        count += 1
        if name[0] == b"IEND":
            break
        place += 12 + int.from_bytes(data[place : place + 4], "big")  # length, name and checksum beside the content
    return count


def webp_chunks(data: bytes, most: int) -> int:
    """Number of chunks of a WebP within the length that its first bytes tell; counting stops just above `most`."""
    count, place, end = 0, 12, min(len(data), 8 + int.from_bytes(data[4:8], "little"))
    while count <= most and place < end:
        count += 1
        length = int.from_bytes(data[place + 4 : place + 8], "little")
        place += 8 + length + length % 2  # to an even place
    return count


def jpeg_parts(data: bytes) -> tuple[int, int]:
    """Numbers of scans and segments of a JPEG up to its end marker; counting stops just above the limits.

    Thumbnails inside metadata segments and data behind the end marker are not counted.
    """
    scans = segments = place = 0
    while scans <= MAX_SCANS and segments <= MAX_SEGMENTS and (match := _MARKER.search(data, place)) is not None:
        marker, place = match[1][0], match.end()
        if marker == _END_OF_IMAGE:
            break
        if marker == _START_OF_IMAGE:
            continue
        segments += 1
        scans += marker == _START_OF_SCAN
        place += int.from_bytes(data[place : place + 2], "big")  # the segment's length counts its own two bytes
    return scans, segments


def damaged(error: Exception, index: int | None) -> ImageUnreadable:
    """The refusal of photograph `index` whose decoder raised `error`."""
    if _LONG_TEXT in str(error):
        one, all_of_them = PngImagePlugin.MAX_TEXT_CHUNK, PngImagePlugin.MAX_TEXT_MEMORY
        return ImageUnreadable(
            "has texts or a colour profile beside its pixels that unpack to more than "
            f"{one} bytes, or {all_of_them} together",
            field="images",
            index=index,
            cure="save it without them",
        )
    return ImageUnreadable(f"cannot be decoded: {error}", field="images", index=index, cure="is the upload complete?")
