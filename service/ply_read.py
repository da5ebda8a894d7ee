"""Read a 3DGS .ply of any writer: ASCII or binary of either byte order, any property order, other elements around it.

The rows that are read become `Gaussians`: exp of the scales, logistic function of the opacity. What cannot be read
rightly is refused with the property, the row and both numbers, or dropped and counted where the caller asks for that.
"""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from .errors import PlyError
from .gaussians import Gaussians
from .ply_format import Header, parse_header, vertex_columns

F64 = NDArray[np.float64]

REQUIRED = (
    "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2",
    "rot_0", "rot_1", "rot_2", "rot_3",
)  # fmt: skip
REST_COUNTS = (0, 9, 24, 45)  # 3 ((degree + 1)^2 - 1) for degrees 0 to 3
LARGEST = float(np.finfo(np.float32).max)


Source = str | PathLike[str] | bytes | bytearray | memoryview | BinaryIO


@dataclass(frozen=True, eq=False)
class PlyReading:
    """What a file held, and what could not be taken as it was."""

    gaussians: Gaussians
    rows: int  # in the file
    invalid: dict[str, int]  # property: rows that were dropped because of it; a row counts under each of its properties
    zero_rotations: int  # all-zero quaternions, which became the identity

    def notes(self) -> list[str]:
        """A sentence for each thing that was not taken as it was."""
        notes = []
        if self.invalid:
            listed = ", ".join(f"{name} ({count})" for name, count in self.invalid.items())
            notes.append(f"{self.rows - len(self.gaussians)} of {self.rows} Gaussians dropped, invalid in {listed}")
        if self.zero_rotations:
            notes.append(
                f"{self.zero_rotations} of {len(self.gaussians)} rotations are zero and were taken as no rotation"
            )
        return notes


def read_ply(source: Source) -> Gaussians:
    """The Gaussians of a path, the bytes of a file or an open binary file, as `inspect_ply` reads them."""
    return inspect_ply(source).gaussians


def inspect_ply(source: Source, *, drop_invalid: bool = False) -> PlyReading:
    """Read a path, the bytes of a file or an open binary file.

    A logit opacity of +-inf is 1 or 0 and a log scale of -inf is 0, as writers without a clamp mean them; every other
    number must be finite and within float32. With `drop_invalid` rows where one is not are dropped and counted. Raises
    `PlyError` that says what is wrong where.
    """
    if isinstance(source, str | PathLike):
        data = Path(source).read_bytes()
    else:
        data = bytes(source) if isinstance(source, bytes | bytearray | memoryview) else source.read()
    header = parse_header(data)
    rest = _checked_properties(header)
    columns = vertex_columns(data, header)
    rows = header.vertex.count
    keep, invalid = np.ones(rows, np.bool_), {}
    for name in (*REQUIRED, *(f"f_rest_{i}" for i in range(rest))):
        column = columns[name]
        ok, need = _valid(name, column)
        if not drop_invalid:
            _require(ok, column, name, need)
        elif not ok.all():
            keep &= ok
            invalid[name] = int((~ok).sum())
    if invalid:
        columns = {name: column[keep] for name, column in columns.items()}
    count = int(keep.sum())
    harmonics = np.empty((count, 1 + rest // 3, 3))
    for channel in range(3):
        harmonics[:, 0, channel] = columns[f"f_dc_{channel}"]
        for k in range(rest // 3):
            harmonics[:, 1 + k, channel] = columns[f"f_rest_{channel * (rest // 3) + k}"]
    logit = np.clip(columns["opacity"], -700.0, 700.0)  # beyond it exp leaves float64 and the value is 0 or 1 anyway
    rotations = np.stack([columns[f"rot_{part}"] for part in range(4)], axis=1).astype(np.float32)
    gaussians = Gaussians.make(
        means=np.stack([columns[axis] for axis in "xyz"], axis=1),
        scales=np.exp(np.stack([columns[f"scale_{axis}"] for axis in range(3)], axis=1)),
        rotations_wxyz=rotations,
        opacities=1.0 / (1.0 + np.exp(-logit)),
        harmonics=harmonics,
    )
    return PlyReading(gaussians, rows, invalid, int((~rotations.any(axis=1)).sum()))


def _checked_properties(header: Header) -> int:
    """The number of f_rest properties, once all that is needed is there."""
    names = {prop.name for prop in header.vertex.properties}
    missing = [name for name in REQUIRED if name not in names]
    if missing:
        raise PlyError(
            f"{len(missing)} of {len(REQUIRED)} properties are missing: {', '.join(missing)}",
            field="vertex",
            cure="is this a mesh or a point cloud? Gaussians need position, colour, opacity, scale and rotation",
        )
    rest = sum(name.startswith("f_rest_") for name in names)
    if rest not in REST_COUNTS:
        raise PlyError(f"there are {rest}, need 0, 9, 24 or 45 (SH degree 0 to 3)", field="vertex.f_rest")
    gaps = [i for i in range(rest) if f"f_rest_{i}" not in names]
    if gaps:
        raise PlyError(f"of {rest} the one with index {gaps[0]} is missing", field="vertex.f_rest", index=gaps[0])
    return rest


def _valid(name: str, column: F64) -> tuple[NDArray[np.bool_], str]:
    """Which values of a property can be read rightly, and what they need."""
    if name == "opacity":
        return ~np.isnan(column), "a number"
    if name.startswith("scale_"):
        with np.errstate(over="ignore"):
            return np.exp(column) <= LARGEST, f"at most {np.log(LARGEST):.4g}, the logarithm of the largest float32"
    if name in ("x", "y", "z"):  # those stay float64
        return np.isfinite(column), "a finite number"
    return np.abs(column) <= LARGEST, "a finite number within float32"


def _require(ok: NDArray[np.bool_], column: F64, name: str, need: str) -> None:
    if ok.all():
        return
    bad = np.flatnonzero(~ok)
    raise PlyError(
        f"{len(bad)} of {len(column)} values are outside the range, first at row {bad[0]}: {column[bad[0]]:g}, "
        f"need {need}",
        field=f"vertex.{name}",
        index=int(bad[0]),
        count=len(bad),
        cure="inspect_ply(drop_invalid=True), or --drop-invalid of gapmes render, leaves such rows out",
    )
