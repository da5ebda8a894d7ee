"""Turning a still WebP into an animation of two equal frames, where the encoder has merged all frames."""

from __future__ import annotations

import struct
from pathlib import Path

STILL = (b"VP8 ", b"VP8L")  # first chunk of a still image without transparency
ANIMATED = 2  # animation flag of a VP8X chunk


def keep_moving(path: Path, width: int, height: int, duration_ms: int) -> None:
    """Rewrite a still of `width` x `height` px as a looping animation of `duration_ms`; an animation stays unchanged.

    Chunks as in RFC 9649; the picture is not encoded again.
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
