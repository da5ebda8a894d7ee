"""Read a 3DGS .ply of any writer: ASCII or binary of either byte order, any property order, other elements around it.

Scales are exponentiated, and opacities mapped by the logistic function, unless the file has another dialect. Invalid
values raise an error that names property, row and both numbers, or on request their rows are dropped and counted.
"""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

from ..arguments import of_type
from ..errors import PlyError
from ..gaussians import Gaussians
from ..harmonics import C0
from .compressed_ply import is_compressed
from .dialect import AUTO, DIALECT_CURE, ROTATION_NAMES, SCALE_NAMES, Dialect, OpacityForm, ScaleForm, Taken, taken_as
from .ply_behind import behind
from .ply_format import TYPE_NAMES, Header, parse_header, vertex_columns
from .reading import DROP_CURE, LARGEST, LARGEST_LOG, Reading, Source, bytes_of, check_count, passed_over

F64 = NDArray[np.float64]

CONSTANT = ("f_dc_0", "f_dc_1", "f_dc_2")
REQUIRED = ("x", "y", "z", *CONSTANT, "opacity", *SCALE_NAMES, *ROTATION_NAMES)
REST_COUNTS = (0, 9, 24, 45)  # 3 ((degree + 1)^2 - 1) for degrees 0 to 3
COLOURS = ("red", "green", "blue")  # of point clouds, used if f_dc is missing
NORMALS = ("nx", "ny", "nz")  # ignored: zero or meaningless in files of all writers
FORMS: tuple[tuple[OpacityForm, ScaleForm], ...] = (("logit", "log"), ("linear", "linear"))
_log = logging.getLogger("gapmes")


def read_ply(source: Source) -> Gaussians:
    """The Gaussians of a path, the bytes of a file or an open binary file, as `inspect_ply` reads them.

    Notes of the reading are logged as warnings.
    """
    reading = inspect_ply(source)
    for note in reading.notes():
        _log.warning("%s", note)
    return reading.gaussians


def inspect_ply(
    source: Source, *, drop_invalid: bool = False, dialect: Dialect = AUTO, max_count: int | None = None
) -> Reading:
    """Read a path, the bytes of a file or an open binary file.

    A logit opacity of +-inf means 1 or 0, and a log scale of -inf means 0, as in files of writers that do not clamp.
    All other numbers must be finite and within the range of float32; with `drop_invalid` rows in which one is not are
    dropped and counted. Raises `PlyError` naming property and row, and `TooManyGaussians` for more than `max_count`.
    """
    data = bytes_of(source)
    header = parse_header(data)
    rest, coloured = _checked_properties(header)
    check_count(header.vertex.count, max_count, "vertex")
    of_type(dialect, Dialect, "dialect", DIALECT_CURE)
    names = (*REQUIRED, *(f"f_rest_{i}" for i in range(rest)))
    columns = vertex_columns(data, header, {*names, *(COLOURS if coloured else ())})
    remarks = _passed_over(header, rest, coloured) + behind(data, header)
    if coloured:
        remarks.append(_colours(columns, header))
    taken = taken_as(_readable(columns, names, dialect), dialect)
    remarks += taken.remarks
    rows = header.vertex.count
    keep, invalid = np.ones(rows, np.bool_), {}
    for name in names:
        column = columns[name]
        ok, need = _valid(name, column, taken)
        if not drop_invalid:
            _require(ok, column, name, need, _cure(name, column, ok, dialect))
        elif not ok.all():
            keep &= ok
            invalid[name] = int((~ok).sum())
    if invalid:
        columns = {name: column[keep] for name, column in columns.items()}
    endless = int(np.isinf(columns["opacity"]).sum())
    if endless:
        remarks.append(f"{endless} of {int(keep.sum())} opacities are infinite logits and were taken as 0 or 1")
    gaussians = _gaussians(columns, rest, taken)
    zero = ~np.stack([columns[name] for name in ROTATION_NAMES], axis=1).any(axis=1)
    return Reading(gaussians, rows, invalid, int(zero.sum()), tuple(remarks))


def _readable(columns: dict[str, F64], names: tuple[str, ...], dialect: Dialect) -> dict[str, F64]:
    """The columns without rows that are invalid in every dialect, for detecting the dialect."""
    usual, other = (
        Taken(
            opacity if dialect.opacity == "auto" else dialect.opacity,
            scales if dialect.scales == "auto" else dialect.scales,
            "wxyz",
            (),
        )
        for opacity, scales in FORMS
    )
    ok = np.ones(len(columns["x"]), np.bool_)
    for name in names:
        found, _ = _valid(name, columns[name], usual)
        ok &= found if found.all() else found | _valid(name, columns[name], other)[0]
    return columns if ok.all() else {name: columns[name][ok] for name in REQUIRED}


def _gaussians(columns: dict[str, F64], rest: int, taken: Taken) -> Gaussians:
    """Gaussians from checked columns."""
    harmonics = np.empty((len(columns["x"]), 1 + rest // 3, 3))
    for channel in range(3):
        harmonics[:, 0, channel] = columns[CONSTANT[channel]]
        for k in range(rest // 3):
            harmonics[:, 1 + k, channel] = columns[f"f_rest_{channel * (rest // 3) + k}"]
    opacities = columns["opacity"]
    if taken.opacity == "logit":
        logit = np.clip(opacities, -700.0, 700.0)  # beyond it exp overflows, and the value is 0 or 1
        opacities = 1.0 / (1.0 + np.exp(-logit))
    scales = np.stack([columns[name] for name in SCALE_NAMES], axis=1)
    rotations = np.stack([columns[name] for name in ROTATION_NAMES], axis=1)
    return Gaussians.make(
        means=np.stack([columns[axis] for axis in "xyz"], axis=1),
        scales=np.exp(scales) if taken.scales == "log" else scales,
        rotations_wxyz=rotations if taken.rotation == "wxyz" else np.roll(rotations, 1, axis=1),
        opacities=opacities,
        harmonics=harmonics,
    )


def _passed_over(header: Header, rest: int, coloured: bool) -> list[str]:
    """A remark about ignored properties, and one about other elements."""
    known = {*REQUIRED, *NORMALS, *(f"f_rest_{i}" for i in range(rest)), *(COLOURS if coloured else ())}
    more = [prop.name for prop in header.vertex.properties if prop.name not in known]
    others = [element.name for element in header.elements if element.name != "vertex"]
    return passed_over(properties=more, elements=others)


def _colours(columns: dict[str, F64], header: Header) -> str:
    """Add f_dc columns from red, green and blue, scaled by the largest integer of their type or 1; returns a remark."""
    kinds = {prop.name: prop.kind for prop in header.vertex.properties}
    for name, colour in zip(CONSTANT, COLOURS, strict=True):
        kind = np.dtype(kinds[colour])
        if kind.kind != "f" and kind not in (np.uint8, np.uint16):  # it is unknown which value is white
            message = f"is of type {TYPE_NAMES[kinds[colour]]}, need uchar, ushort, float or double"
            raise PlyError(message, field=f"vertex.{colour}", cure="write them so, or f_dc_0, f_dc_1 and f_dc_2")
        full = 1.0 if kind.kind == "f" else float(np.iinfo(kind).max)
        _require((columns[colour] >= 0) & (columns[colour] <= full), columns[colour], colour, f"from 0 to {full:g}")
        columns[name] = (columns[colour] / full - 0.5) / C0
    kind_name = TYPE_NAMES[kinds["red"]]
    return f"colours were taken from red, green and blue ({kind_name}): the file has no f_dc_0, f_dc_1, f_dc_2"


def _checked_properties(header: Header) -> tuple[int, bool]:
    """The number of f_rest properties, and whether colours replace f_dc. Raises `PlyError` for missing properties."""
    names = {prop.name for prop in header.vertex.properties}
    coloured = not names.intersection(CONSTANT) and names.issuperset(COLOURS)
    missing = [name for name in REQUIRED if name not in names and not (coloured and name in CONSTANT)]
    if missing:
        cure = "is this a mesh or a point cloud? Gaussians need position, colour, opacity, scale and rotation"
        if is_compressed(header):
            cure = "this is a compressed .ply, which read_gaussians reads"
        raise PlyError(
            f"{len(missing)} of {len(REQUIRED)} properties are missing: {', '.join(missing)}", field="vertex", cure=cure
        )
    rest = sum(name.startswith("f_rest_") for name in names)
    if rest not in REST_COUNTS:
        raise PlyError(f"there are {rest}, need 0, 9, 24 or 45 (SH degree 0 to 3)", field="vertex.f_rest")
    gaps = [i for i in range(rest) if f"f_rest_{i}" not in names]
    if gaps:
        raise PlyError(f"of {rest} the one with index {gaps[0]} is missing", field="vertex.f_rest", index=gaps[0])
    return rest, coloured


def _valid(name: str, column: F64, taken: Taken) -> tuple[NDArray[np.bool_], str]:
    """Mask of the valid values of a property, and the requirement in words."""
    if name == "opacity":
        if taken.opacity == "linear":
            return (column >= 0) & (column <= 1), "in [0, 1]"
        return ~np.isnan(column), "a number"
    if name.startswith("scale_"):
        if taken.scales == "linear":
            return (column >= 0) & (column <= LARGEST), "a size from 0 on"
        with np.errstate(over="ignore"):
            return np.exp(column) <= LARGEST, f"at most {LARGEST_LOG:.7g}, the logarithm of the largest float32"
    if name in ("x", "y", "z"):  # positions are float64
        return np.isfinite(column), "a finite number"
    return np.abs(column) <= LARGEST, "a finite number within float32"


def _cure(name: str, column: F64, ok: NDArray[np.bool_], dialect: Dialect) -> str:
    """The cure for invalid values: if most contradict a form that the caller has named, to leave that out."""
    kind = "opacity" if name == "opacity" else "scales" if name in SCALE_NAMES else None
    form = "auto" if kind is None else getattr(dialect, kind)
    if form == "auto" or 2 * int((np.isfinite(column) & ~ok).sum()) < len(ok):
        return DROP_CURE
    return f"these are no {form} numbers: leave out --{kind} {form}, {kind}={form} over HTTP"


def _require(ok: NDArray[np.bool_], column: F64, name: str, need: str, cure: str = DROP_CURE) -> None:
    if ok.all():
        return
    bad = np.flatnonzero(~ok)
    raise PlyError(
        f"{len(bad)} of {len(column)} values are outside the range, first at row {bad[0]}: {column[bad[0]]:.7g}, "
        f"need {need}",
        field=f"vertex.{name}",
        index=int(bad[0]),
        count=len(bad),
        cure=cure,
    )
