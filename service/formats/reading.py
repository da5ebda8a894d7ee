"""The result of readers: Gaussians and notes; and checks that all formats share."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, InputError, TooManyGaussians
from ..gaussians import Gaussians
from ..process.streams import visible

Source = str | PathLike[str] | bytes | bytearray | memoryview | BinaryIO

LARGEST = float(np.finfo(np.float32).max)
# The largest float32 whose exponential is one; the logarithm of LARGEST itself rounds to the one above.
LARGEST_LOG = float(np.nextafter(np.float32(np.log(LARGEST)), np.float32(0)))
DROP_CURE = "such rows are left out with --drop-invalid, drop_invalid=true over HTTP, inspect_ply(drop_invalid=True)"


@dataclass(frozen=True, eq=False)
class Reading:
    """The Gaussians of a file, and what was dropped or changed while reading."""

    gaussians: Gaussians
    rows: int  # in the file
    invalid: dict[str, int]  # dropped rows by invalid property; a row counts for each of them
    zero_rotations: int  # all-zero quaternions, which became the identity
    remarks: tuple[str, ...] = ()  # detected dialect, and what was ignored

    def notes(self) -> list[str]:
        """A sentence for each thing that was dropped, changed or ignored."""
        notes = list(self.remarks)
        if self.invalid:
            listed = ", ".join(f"{name} ({count})" for name, count in self.invalid.items())
            notes.append(f"{self.rows - len(self.gaussians)} of {self.rows} Gaussians dropped, invalid in {listed}")
        if self.zero_rotations:
            notes.append(
                f"{self.zero_rotations} of {len(self.gaussians)} rotations are zero and were taken as no rotation"
            )
        return notes


def bytes_of(source: Source) -> bytes:
    """The content of a path or an open binary file, or the bytes themselves. Raises `InputError` for anything else."""
    if isinstance(source, str | PathLike):
        return Path(source).read_bytes()
    data = source.read() if hasattr(source, "read") else source
    if isinstance(data, bytes):
        return data
    if isinstance(data, bytearray | memoryview):
        return bytes(data)
    what = f"is a {type(source).__name__}{' that gives text' if isinstance(data, str) else ''}"
    cure = "give a path, the bytes of a file, or a file opened for bytes"
    raise InputError(f"{what}, need the bytes of a file", field="source", cure=cure)


def check_count(count: int, max_count: int | None, field: str) -> None:
    """Raises `TooManyGaussians` by the count in a header, before memory is allocated."""
    if max_count is not None and count > max_count:
        raise TooManyGaussians(
            f"the file has {count} Gaussians, the limit is {max_count}", field=field, cure="thin it out first"
        )


def passed_over(**named: Sequence[str]) -> list[str]:
    """A remark for each kind of ignored things, with the first names."""
    remarks = []
    for what, names in named.items():
        if names:
            listed = ", ".join(visible(name[:40]) for name in names[:8]) + (" and more" if len(names) > 8 else "")
            remarks.append(f"{what} ignored: {listed}")
    return remarks


def gaussians_of(
    fields: Mapping[str, NDArray], kind: str, *, drop_invalid: bool, remarks: tuple[str, ...] = ()
) -> Reading:
    """Check decoded rows, by field of `Gaussians`; opacities are in [0, 1] by their encoding.

    Raises `FormatError` naming `kind` and field, the first invalid row and their number; with `drop_invalid` invalid
    rows are dropped and counted instead.
    """
    rows = len(fields["means"])
    keep, invalid = np.ones(rows, np.bool_), {}
    for name, need in (
        ("means", "a finite number"),
        ("scales", "a number from 0 on"),
        ("harmonics", "a finite number"),
    ):
        values = fields[name].reshape(rows, math.prod(fields[name].shape[1:]))
        with np.errstate(invalid="ignore"):
            ok = (np.abs(values) <= LARGEST).all(axis=1) & ((values >= 0).all(axis=1) if name == "scales" else True)
        if ok.all():
            continue
        invalid[name] = int((~ok).sum())
        keep &= ok
        if not drop_invalid:
            first = int(np.flatnonzero(~ok)[0])
            raise FormatError(
                f"{invalid[name]} of {rows} rows are outside the range, first at row {first}: "
                f"{values[first, :3].tolist()}, need {need} within float32",
                field=f"{kind}.{name}",
                index=first,
                count=invalid[name],
                cure=DROP_CURE,
            )
    kept = {name: values[keep] if invalid else values for name, values in fields.items()}
    zero = int((~kept["rotations_wxyz"].any(axis=1)).sum())
    return Reading(Gaussians.make(**kept), rows, invalid, zero, remarks)
