"""Encoding depth as grey levels, and the text chunks of a PNG that describe the encoding."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL.PngImagePlugin import PngInfo

from ..errors import InputError


@dataclass(frozen=True)
class DepthCode:
    """Level 0 is empty; level L > 0 is z-depth `offset` + L x `scale`. All in the caller's units."""

    low: float  # smallest depth of the picture; in an empty picture 0, as `high` and `offset`
    high: float  # largest
    scale: float  # per level; 0 where all depths are equal
    offset: float  # 0 if the scale was given

    def named(self) -> dict[str, float]:
        """The numbers by their names in headers and text chunks."""
        return {"Min": self.low, "Max": self.high, "Scale": self.scale, "Offset": self.offset}


def depth_levels(
    depth: NDArray[np.floating], there: NDArray[np.bool_], top: int, scale: float | None
) -> tuple[NDArray[np.unsignedinteger], DepthCode]:
    """Levels (H, W), 8 bits for `top` 255 and 16 for more, of depths (H, W) where `there` (H, W) is true.

    Without `scale` the smallest depth becomes level 1 and the largest `top`; with it a level is that many of the
    caller's units, counted from 0. Raises `InputError` if the depths do not fit.
    """
    dtype = np.uint16 if top > 255 else np.uint8
    if not there.any():
        return np.zeros(depth.shape, dtype), DepthCode(0.0, 0.0, scale or 0.0, 0.0)
    levels = np.zeros(depth.shape, dtype)
    found = depth[there].astype(np.float64)
    low, high = float(found.min()), float(found.max())
    if scale is None:
        scale = (high - low) / (top - 1)
        levels[there] = np.rint(1 + (top - 1) * (found - low) / max(high - low, np.finfo(np.float64).tiny))
        return levels, DepthCode(low, high, scale, low - scale)
    if high > (top + 0.5) * scale:
        raise InputError(
            f"depth {high:.6g} is level {high / scale:.0f} at {scale:g} per level, the highest is {top}",
            field="depth_scale",
            cure=f"ask for {_two_digits(high / top, np.ceil):g} or more"
            + (", or for png, which has 16 bits" if top == 255 else ""),
        )
    if np.rint(low / scale) < 1:  # rounded as the levels are, half to even
        raise InputError(
            f"depth {low:.6g} is level 0 at {scale:g} per level, which means that nothing is there",
            field="depth_scale",
            cure=f"ask for less than {_two_digits(2 * low, np.floor):g}",
        )
    levels[there] = np.minimum(np.rint(found / scale), top)
    return levels, DepthCode(low, high, scale, 0.0)


def png_text(code: DepthCode) -> PngInfo:
    """Text chunks with the numbers of the encoding, and a sentence that explains them."""
    info = PngInfo()
    for name, value in code.named().items():
        info.add_text(f"gapmes:depth_{name.lower()}", repr(value))
    info.add_text("Comment", "z-depth = gapmes:depth_offset + level x gapmes:depth_scale; level 0: nothing is there")
    return info


def _two_digits(value: float, rounded: np.ufunc) -> float:
    """The value rounded to two significant digits, up with `np.ceil` or down with `np.floor`."""
    digit = 10.0 ** (np.floor(np.log10(max(value, 1e-300))) - 1)
    return float(rounded(value / digit) * digit)
