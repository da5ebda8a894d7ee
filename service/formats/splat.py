"""The .splat of antimatter15: 32 bytes per Gaussian without a header, one colour, no harmonics.

A row is x, y, z and three standard deviations as little-endian float32, then red, green, blue, opacity and the rotation
wxyz as bytes. A colour is 0.5 + C0 f_dc in 255 levels from 0 to 1, a rotation component 128 levels per unit from -1 on.
"""

from __future__ import annotations

import numpy as np

from ..errors import FormatError
from ..gaussians import Gaussians
from ..harmonics import C0
from .encoded import INTO_THE_SCENE, Encoded, bands_note, clamped_note, faint_note, position_note, quantized
from .ply_write import require_float32
from .reading import Reading, check_count, gaussians_of

ROW = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("rgba", "u1", 4), ("rotation", "u1", 4)])
COLOUR_LEVELS = 255
ROTATION_LEVELS = 128  # per unit; 1 exceeds the range and is stored as 127/128


def read_splat(data: bytes, *, drop_invalid: bool, max_count: int | None) -> Reading:
    """Decode a file. Raises `FormatError` for an incomplete row or an invalid one."""
    count, left = divmod(len(data), ROW.itemsize)
    if left:
        raise FormatError(
            f"{len(data)} bytes are {count} rows of {ROW.itemsize} and {left} bytes more",
            field="splat",
            index=count,
            cure="is it truncated, or another format?",
        )
    check_count(count, max_count, "splat")
    rows = np.frombuffer(data, ROW)
    rgba = rows["rgba"] / COLOUR_LEVELS
    fields = {
        "means": rows["means"],
        "scales": rows["scales"],
        "rotations_wxyz": (rows["rotation"].astype(np.float32) - ROTATION_LEVELS) / ROTATION_LEVELS,
        "opacities": rgba[:, 3],
        "harmonics": ((rgba[:, :3] - 0.5) / C0)[:, None, :],
    }
    return gaussians_of(fields, "splat", drop_invalid=drop_invalid)


def splat_bytes(gaussians: Gaussians) -> Encoded:
    """Encode in the given order. Raises `FormatError` if a position exceeds the range of float32."""
    require_float32(gaussians, FormatError, INTO_THE_SCENE)
    rows = np.zeros(len(gaussians), ROW)
    rows["means"], rows["scales"] = gaussians.means, gaussians.scales
    colours, outside = quantized(
        (0.5 + C0 * gaussians.harmonics[:, 0].astype(np.float64)) * COLOUR_LEVELS, COLOUR_LEVELS
    )
    rows["rgba"][:, :3] = colours
    rows["rgba"][:, 3] = np.rint(gaussians.opacities.astype(np.float64) * COLOUR_LEVELS)
    rows["rotation"], _ = quantized((gaussians.rotations_wxyz.astype(np.float64) + 1) * ROTATION_LEVELS, 255)
    moved = float(np.abs(gaussians.means - rows["means"]).max(initial=0.0))
    notes = [
        *bands_note(gaussians),
        *faint_note(gaussians),
        *clamped_note("colour values", outside, colours.size, 0, 1),
        *position_note(gaussians, moved),
    ]
    return Encoded(rows.tobytes(), tuple(notes))
