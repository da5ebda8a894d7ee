"""An animated WebP of one picture: what the encoder makes a still of stays a film, of two frames that are equal."""

from __future__ import annotations

import struct
from pathlib import Path

STILL = (b"VP8 ", b"VP8L")  # the first chunk of a picture without animation and without transparency
ANIMATED = 2  # a flag of the first chunk of any other


def keep_moving(path: Path, width: int, height: int, duration_ms: int) -> None:
    """Where the file is a still of `width` x `height` px, make it a film of that time that begins anew by itself.

    Chunks as in RFC 9649; the picture itself is not encoded again.
    """
    if not _is_still(path):
        return
    data = path.read_bytes()
    size = _three(width - 1) + _three(height - 1)
    chunks = _chunk(b"VP8X", struct.pack("<I", ANIMATED) + size)
    chunks += _chunk(b"ANIM", bytes(6))  # no background, no end of the loop
    first = duration_ms // 2
    for time in (first, duration_ms - first):
        chunks += _chunk(b"ANMF", bytes(6) + size + _three(time) + bytes(1) + data[12:])
    path.write_bytes(_chunk(b"RIFF", b"WEBP" + chunks))


def _is_still(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(16)[12:] in STILL


def _chunk(name: bytes, data: bytes) -> bytes:
    return name + struct.pack("<I", len(data)) + data + bytes(len(data) % 2)


def _three(number: int) -> bytes:
    return number.to_bytes(3, "little")
