"""Small ICC profiles made from primaries and curves, and their colours in sRGB computed in float64."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

D65, D50 = np.array([0.3127, 0.3290]), np.array([0.9642, 1.0, 0.8249])
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
_CURVE_POINTS = 4096


@dataclass(frozen=True)
class Space:
    """RGB colours by their primaries (x, y), white D65; `gamma` None is the curve of sRGB."""

    primaries: tuple[tuple[float, float], ...]
    gamma: float | None = None

    def linear(self, levels: F64) -> F64:
        """Light of `levels`, both 0 to 1."""
        if self.gamma is not None:
            return levels**self.gamma
        return np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4)

    def xyz(self) -> F64:
        """(3, 3) XYZ of linear RGB, white having Y = 1."""
        columns = np.array([[x / y, 1.0, (1 - x - y) / y] for x, y in self.primaries]).T
        white = np.array([D65[0] / D65[1], 1.0, (1 - D65.sum()) / D65[1]])
        return columns * np.linalg.solve(columns, white)

    def profile(self) -> bytes:
        """An ICC profile of version 2: colorants, adapted to D50 by Bradford's matrix, and curves as tables."""
        xyz = self.xyz()
        cones = _BRADFORD @ xyz.sum(axis=1)
        adapted = np.linalg.inv(_BRADFORD) @ np.diag(_BRADFORD @ D50 / cones) @ _BRADFORD @ xyz
        table = np.rint(self.linear(np.linspace(0, 1, _CURVE_POINTS)) * 65535).astype(">u2")
        curve = struct.pack(">4sII", b"curv", 0, _CURVE_POINTS) + table.tobytes()
        tags = {b"wtpt": _xyz(D50), **{name + b"TRC": curve for name in (b"r", b"g", b"b")}}
        tags |= {name + b"XYZ": _xyz(column) for name, column in zip((b"r", b"g", b"b"), adapted.T, strict=True)}
        return _assembled(b"mntr", b"RGB ", b"XYZ ", tags)


SRGB = Space(((0.64, 0.33), (0.30, 0.60), (0.15, 0.06)))
DISPLAY_P3 = Space(((0.680, 0.320), (0.265, 0.690), (0.150, 0.060)))
ADOBE_RGB = Space(((0.64, 0.33), (0.21, 0.71), (0.15, 0.06)), gamma=563 / 256)


def converted(levels: NDArray[np.uint8], source: Space, target: Space) -> F64:
    """(..., 3) levels 0 to 255 of `source` as those of `target`, of which sRGB's curve is asked; not rounded."""
    light = source.linear(levels / 255) @ source.xyz().T @ np.linalg.inv(target.xyz()).T
    light = light.clip(0, 1)
    return 255 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def grey_profile() -> bytes:
    """Grey levels of gamma 1."""
    return _assembled(b"mntr", b"GRAY", b"XYZ ", {b"wtpt": _xyz(D50), b"kTRC": struct.pack(">4sII", b"curv", 0, 0)})


def cmyk_profile() -> bytes:
    """Inks that all make greys: L* falls by 100 with black, by 20 with each of the others, down to 0; for perceptual
    conversions half of that is left."""
    axis = np.stack(np.meshgrid(*[[0, 1]] * 4, indexing="ij"), axis=-1).reshape(16, 4)
    lightness = (100 - 20 * axis[:, :3].sum(axis=1) - 100 * axis[:, 3]).clip(0)
    tables = {b"A2B0": _grey_table(lightness / 2), b"A2B1": _grey_table(lightness)}
    return _assembled(b"prtr", b"CMYK", b"Lab ", {b"wtpt": _xyz(D50), **tables})


def _grey_table(lightness: F64) -> bytes:
    """L* (16,) at the corners of four inks."""
    corners = np.stack([np.rint(lightness * 2.55), np.full(16, 128), np.full(16, 128)], axis=1).astype(np.uint8)
    ramp = np.arange(256, dtype=np.uint8).tobytes()
    matrix = struct.pack(">9i", *np.eye(3, dtype=int).ravel() * 65536)
    return struct.pack(">4sI4B", b"mft1", 0, 4, 3, 2, 0) + matrix + 4 * ramp + corners.tobytes() + 3 * ramp


def _xyz(values: F64) -> bytes:
    return struct.pack(">4sI3i", b"XYZ ", 0, *(round(65536 * value) for value in values))


def _assembled(kind: bytes, space: bytes, connection: bytes, tags: dict[bytes, bytes]) -> bytes:
    text = b"made for a test"
    tags = {b"desc": struct.pack(">4sII", b"desc", 0, len(text) + 1) + text + bytes(79), **tags}
    table, body = struct.pack(">I", len(tags)), b""
    start = 128 + 4 + 12 * len(tags)
    for name, data in tags.items():
        table += struct.pack(">4sII", name, start + len(body), len(data))
        body += data + bytes(-len(data) % 4)
    size = start + len(body)
    illuminant = struct.pack(">3i", *(round(65536 * value) for value in D50))
    header = struct.pack(">I4xI4s4s4s12x4s28x", size, 0x02100000, kind, space, connection, b"acsp") + illuminant
    return header + bytes(128 - len(header)) + table + body
