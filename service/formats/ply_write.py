"""Write Gaussians as a 3DGS .ply: binary little-endian, deterministic, without comments, which some readers reject."""

from __future__ import annotations

from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from ..arguments import of_type
from ..errors import FormatError, InputError, PlyError
from ..gaussians import GAUSSIANS_CURE, Gaussians
from ..process.disk import replace_file
from .reading import LARGEST_LOG

Positions = Literal["auto", "float32", "float64"]

# sigmoid(17) = 1 - 4.1e-8 rounds to the float32 below 1: a wider range would store infinities and gain nothing.
LOGIT_MAX = 17.0

# A zero scale has no logarithm; this multiple of the median scale is a dot in every picture.
ZERO_SCALE = 1e-12

# Positions are stored as float32 if that moves a Gaussian by at most this multiple of the typical size.
POSITION_TOLERANCE = 1 / 8


def write_ply(target: str | PathLike[str] | BinaryIO, gaussians: Gaussians, *, positions: Positions = "auto") -> None:
    """Write to a path, replacing its file atomically, or to an open binary file; see `ply_bytes`."""
    if not isinstance(target, str | PathLike) and not hasattr(target, "write"):
        cure = "give a path, or a file opened for bytes"
        raise InputError(f"is a {type(target).__name__}, which cannot be written to", field="target", cure=cure)
    data = ply_bytes(of_type(gaussians, Gaussians, "gaussians", GAUSSIANS_CURE), positions=positions)
    if isinstance(target, str | PathLike):
        replace_file(Path(target), data)
    else:
        target.write(data)


def ply_bytes(gaussians: Gaussians, *, positions: Positions = "auto") -> bytes:
    """The file as bytes; all numbers are float32, but x, y and z may be float64.

    `positions`: "auto" stores x, y, z as float64 only where float32 would move a Gaussian by more than an eighth of the
    median largest scale (a world far from its origin). Opacities are clamped to logit +-17, a scale of 0 becomes 1e-12
    of the median positive scale, and one whose logarithm would round beyond float32 the largest that can be read back.
    Raises `PlyError` if a position exceeds the range of float32 and has to be stored as such.
    """
    if positions not in ("auto", "float32", "float64"):
        raise PlyError(f'is {positions!r}, need "auto", "float32" or "float64"', field="positions")
    wide = positions == "float64" or (positions == "auto" and _needs_float64(gaussians))
    if not wide:
        require_float32(gaussians, PlyError, 'write them with positions="float64"')
    rest = gaussians.harmonics.shape[1] - 1
    record, names, word = _layout(rest, wide)
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(gaussians)}"]
    header += [f"property {word} {axis}" for axis in "xyz"] + [f"property float {name}" for name in names]
    header += ["end_header", ""]
    rows = np.zeros(len(gaussians), record)
    rows["xyz"] = gaussians.means
    columns = rows["rest"]  # filled in place: a second table of doubles would be larger than the file; normals stay 0
    columns[:, 3:6] = gaussians.harmonics[:, 0]
    # Channel-major, as in the 3DGS code: all higher coefficients of red, then green, then blue.
    columns[:, 6:-8] = gaussians.harmonics[:, 1:].transpose(0, 2, 1).reshape(len(gaussians), 3 * rest)
    columns[:, -8] = _logit(gaussians.opacities)
    columns[:, -7:-4] = _log_scales(gaussians.scales)
    columns[:, -4:] = gaussians.rotations_wxyz
    return b"".join(["\n".join(header).encode("ascii"), rows.view(np.uint8).data])


def as_stored(gaussians: Gaussians) -> Gaussians:
    """The Gaussians with positions as a .ply stores them: rounded to float32 unless "auto" needs float64.

    Neighbours on a surface differ so little in depth that rounding changes their order, and pictures by up to 8/255.
    Errors are measured on rounded positions, so that they hold for the file. The file's other roundings change colours
    by at most 1e-5, if no Gaussian lies at the threshold of a cut.
    """
    if _needs_float64(gaussians):
        return gaussians
    return replace(gaussians, means=gaussians.means.astype(np.float32).astype(np.float64))


def stored_positions(gaussians: Gaussians) -> Positions:
    """The type in which positions from `as_stored`, or a subset of them, are written exactly."""
    with np.errstate(over="ignore"):
        return "float32" if (gaussians.means == gaussians.means.astype(np.float32)).all() else "float64"


def ply_size(gaussians: Gaussians) -> int:
    """Bytes of the rows that `ply_bytes` writes for Gaussians from `as_stored`, with their `stored_positions`."""
    record, _, _ = _layout(gaussians.harmonics.shape[1] - 1, stored_positions(gaussians) == "float64")
    return len(gaussians) * record.itemsize


def _layout(rest: int, wide: bool) -> tuple[np.dtype, list[str], str]:
    """The structured type of a row with `rest` higher coefficients per channel, the names of its float32 columns, and
    the .ply type of its positions."""
    names = ["nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{i}" for i in range(3 * rest)), "opacity"]
    names += ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    kind, word = ("<f8", "double") if wide else ("<f4", "float")
    return np.dtype([("xyz", kind, 3), ("rest", "<f4", len(names))]), names, word


def _logit(opacities: NDArray[np.float32]) -> NDArray[np.float64]:
    low = 1.0 / (1.0 + np.exp(LOGIT_MAX))
    p = np.clip(opacities.astype(np.float64), low, 1.0 - low)
    return np.log(p) - np.log1p(-p)


def _log_scales(scales: NDArray[np.float32]) -> NDArray[np.float64]:
    wide = scales.astype(np.float64)
    positive = wide[wide > 0]
    dot = ZERO_SCALE * (np.median(positive) if len(positive) else 1.0)
    return np.minimum(np.log(np.where(wide > 0, wide, dot)), LARGEST_LOG)


def _needs_float64(gaussians: Gaussians) -> bool:
    if not len(gaussians):
        return False
    with np.errstate(over="ignore"):
        moved = float(np.abs(gaussians.means - gaussians.means.astype(np.float32)).max())
    largest = gaussians.scales.max(axis=1).astype(np.float64)
    positive = largest[largest > 0]
    if len(positive):
        return moved > POSITION_TOLERANCE * float(np.median(positive))
    # All scales are 0: compare with the extent.
    return moved > 1e-4 * float(np.ptp(gaussians.means, axis=0).max())


def require_float32(gaussians: Gaussians, refusal: type[FormatError], cure: str) -> None:
    """Raises `refusal` naming the first Gaussian whose position exceeds the range of float32."""
    largest = float(np.finfo(np.float32).max)
    large = np.abs(gaussians.means).max(axis=1, initial=0.0) > largest
    if large.any():
        index = int(np.flatnonzero(large)[0])
        raise refusal(
            f"{int(large.sum())} of {len(gaussians)} positions do not fit float32, which ends at {largest:.4g}, first "
            f"at index {index}: {gaussians.means[index].tolist()}",
            field="means",
            index=index,
            cure=cure,
        )
