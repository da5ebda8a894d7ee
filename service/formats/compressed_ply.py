"""The .compressed.ply of PlayCanvas: 16 bytes per Gaussian, quantised between the bounds of chunks of 256.

A row packs position and log scale as 11, 10 and 11 bits between the bounds of its chunk, the rotation as the index of
its largest component and 10 bits for each other one, colour as 8 bits each between bounds, and opacity as 8 bits. An
element `sh` holds the harmonics above the constant one, channel by channel, in 256 steps from -4 to 4.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import PlyError
from ..gaussians import Gaussians
from ..harmonics import C0
from .encoded import INTO_THE_SCENE, Encoded, clamped_note, faint_note, position_note, quantized
from .morton import morton_order
from .ply_behind import behind
from .ply_format import Element, Header, binary_rows, parse_header
from .ply_write import require_float32
from .reading import LARGEST, Reading, check_count, gaussians_of, passed_over
from .smallest_three import BOUND, join, split

F64 = NDArray[np.float64]

CHUNK = 256
BITS = ((21, 2047), (11, 1023), (0, 2047))  # shift and largest level of the three numbers in a word
AXES, COLOURS = ("x", "y", "z"), ("r", "g", "b")
SCALES = tuple(f"scale_{axis}" for axis in AXES)
GROUPS = (AXES, SCALES, COLOURS)
PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
ROTATION_LEVELS, COLOUR_LEVELS = 1023, 255
COLOUR_TOLERANCE = 1 / 255  # half a step of a chunk's colours above it is worth a note
LOG_LIMIT = 20.0  # of log scales: readers of the format clamp to it
BAND_STEP, BAND_LOW = 1 / 32, -4.0
BAND_EDGE = -BAND_LOW - 0.75 * BAND_STEP  # halfway between an end, the value of the first or last byte, and the next


def is_compressed(header: Header) -> bool:
    """Whether a .ply is of this format and not of the usual one."""
    chunk = header.element("chunk")
    return chunk is not None and any(prop.name in PACKED for prop in header.vertex.properties)


def read_compressed_ply(data: bytes, *, drop_invalid: bool, max_count: int | None) -> Reading:
    """Decode a binary file; colours without bounds range from 0 to 1.

    Raises `PlyError` naming element and row.
    """
    header = parse_header(data)
    chunk, sh = header.element("chunk"), header.element("sh")
    if chunk is None:
        raise PlyError("is of no compressed .ply: no element chunk", field="header", cure="read it as a .ply")
    if header.byte_order is None:
        raise PlyError("is ASCII, need binary", field="header", cure="save it as binary")
    count = header.vertex.count
    check_count(count, max_count, "vertex")
    groups = [group for group in GROUPS if any(prop.name == f"min_{group[0]}" for prop in chunk.properties)]
    _require_properties(
        chunk, [f"{end}_{name}" for group in (AXES, SCALES, *groups) for name in group for end in ("min", "max")]
    )
    _require_properties(header.vertex, PACKED)
    if chunk.count != -(-count // CHUNK):
        message = f"{chunk.count} chunks for {count} Gaussians, need {-(-count // CHUNK)}"
        raise PlyError(message, field="chunk", cure="is it a damaged .compressed.ply?")
    bounds, rows = binary_rows(data, header, chunk), binary_rows(data, header, header.vertex)
    place = np.arange(count) // CHUNK
    position, rotation, scale, colour = (rows[name].astype(np.int64) for name in PACKED)
    parts = np.stack([colour >> 24, colour >> 16, colour >> 8, colour], axis=1) & 255
    unit = parts / COLOUR_LEVELS
    others = np.stack([rotation >> 20, rotation >> 10, rotation], axis=1) & ROTATION_LEVELS
    with np.errstate(over="ignore", invalid="ignore"):  # bounds of a damaged file; rows are checked
        if COLOURS in groups:
            unit[:, :3] = _between(bounds, COLOURS, place, unit[:, :3])
        constant = ((unit[:, :3] - 0.5) / C0)[:, None, :].astype(np.float32)
        scales = np.exp(_between(bounds, SCALES, place, _unpacked(scale)))
        scales[~(scales <= LARGEST)] = np.inf
        means = _between(bounds, AXES, place, _unpacked(position))
    higher = _higher(data, header, sh, count)
    fields = {
        "means": means,
        "scales": scales,
        "rotations_wxyz": join(rotation >> 30, (others / ROTATION_LEVELS - 0.5) * (2 * BOUND)),
        "opacities": unit[:, 3],
        "harmonics": np.concatenate([constant, higher], axis=1),
    }
    remarks = (*_passed_over(header, chunk), *behind(data, header))
    return gaussians_of(fields, "compressed_ply", drop_invalid=drop_invalid, remarks=remarks)


def compressed_ply_bytes(gaussians: Gaussians) -> Encoded:
    """Encode in Morton order, so that the Gaussians of a chunk are close together and its bounds tight.

    Raises `PlyError` where a position does not fit float32.
    """
    require_float32(gaussians, PlyError, INTO_THE_SCENE)
    ordered = gaussians[morton_order(gaussians.means)]
    count, rest = len(ordered), ordered.harmonics.shape[1] - 1
    with np.errstate(divide="ignore"):  # a scale of 0 is clamped
        logs = np.log(ordered.scales.astype(np.float64))
    colours = 0.5 + C0 * ordered.harmonics[:, 0].astype(np.float64)
    values = {AXES: ordered.means, SCALES: np.clip(logs, -LOG_LIMIT, LOG_LIMIT), COLOURS: colours}
    names = [f"{end}_{name}" for group in GROUPS for end in ("min", "max") for name in group]
    bounds = np.zeros(-(-count // CHUNK), [(name, "<f4") for name in names])
    place = np.arange(count) // CHUNK
    shares = {group: _shares(bounds, group, place, values[group]) for group in GROUPS}
    rows = np.zeros(count, [(name, "<u4") for name in PACKED])
    rows["packed_position"], rows["packed_scale"] = _packed(shares[AXES]), _packed(shares[SCALES])
    index, others = split(ordered.rotations_wxyz)
    three, _ = quantized((others / (2 * BOUND) + 0.5) * ROTATION_LEVELS, ROTATION_LEVELS)
    rows["packed_rotation"] = index << 30 | three[:, 0] << 20 | three[:, 1] << 10 | three[:, 2]
    four = np.concatenate([shares[COLOURS], ordered.opacities[:, None].astype(np.float64)], axis=1)
    red, green, blue, alpha = np.rint(four * COLOUR_LEVELS).astype(np.int64).T
    rows["packed_color"] = red << 24 | green << 16 | blue << 8 | alpha
    higher = ordered.harmonics[:, 1:].transpose(0, 2, 1).reshape(count, 3 * rest).astype(np.float64)
    levels = np.clip(np.floor((higher - BAND_LOW) / BAND_STEP), 1, 254)
    levels[higher < -BAND_EDGE], levels[higher > BAND_EDGE] = 0, 255
    outside = int((np.abs(higher) > -BAND_LOW).sum())
    header = ["ply", "format binary_little_endian 1.0", f"element chunk {len(bounds)}"]
    header += [f"property float {name}" for name in names] + [f"element vertex {count}"]
    header += [f"property uint {name}" for name in PACKED] + ([f"element sh {count}"] if rest else [])
    header += [f"property uchar f_rest_{index}" for index in range(3 * rest)] + ["end_header", ""]
    tables = rows.tobytes() + levels.astype(np.uint8).tobytes()
    decoded = _between(bounds, AXES, place, _unpacked(rows["packed_position"].astype(np.int64)))
    notes = [
        *faint_note(gaussians),
        *clamped_note(
            "scales", int((np.abs(logs) > LOG_LIMIT).sum()), logs.size, np.exp(-LOG_LIMIT), np.exp(LOG_LIMIT)
        ),
        *clamped_note("higher harmonics", outside, higher.size, BAND_LOW, -BAND_LOW),
        *position_note(gaussians, float(np.abs(ordered.means - decoded).max(initial=0.0))),
        *_colour_note(bounds, place),
    ]
    return Encoded("\n".join(header).encode("ascii") + bounds.tobytes() + tables, tuple(notes))


def _colour_note(bounds: NDArray, place: NDArray[np.int64]) -> list[str]:
    """A note if outliers make the colour steps of their whole chunk coarse."""
    ends = [np.stack([bounds[f"{end}_{name}"].astype(np.float64) for name in COLOURS]) for end in ("min", "max")]
    moved = (ends[1] - ends[0]).max(axis=0) / (2 * COLOUR_LEVELS)
    coarse = (moved > COLOUR_TOLERANCE)[place]
    if not coarse.any():
        return []
    return [
        f"{int(coarse.sum())} of {len(place)} colours move by up to {moved.max():.3g}, where 1 is white: in their "
        f"chunks of {CHUNK} there are some far outside 0 to 1"
    ]


def _shares(bounds: NDArray, group: tuple[str, ...], place: NDArray[np.int64], values: F64) -> F64:
    """Fill in the bounds of a group of columns; returns the values (N, 3) scaled to [0, 1] between them."""
    shares = np.zeros(values.shape)
    for column, name in enumerate(group):
        if not len(values):
            continue
        starts = np.arange(0, len(values), CHUNK)
        bounds[f"min_{name}"] = np.minimum.reduceat(values[:, column], starts)
        bounds[f"max_{name}"] = np.maximum.reduceat(values[:, column], starts)
        low, high = (bounds[f"{end}_{name}"].astype(np.float64)[place] for end in ("min", "max"))
        shares[:, column] = (values[:, column] - low) / np.where(high > low, high - low, 1.0)
    return np.clip(shares, 0.0, 1.0)  # the bounds were rounded to float32


def _between(bounds: NDArray, group: tuple[str, ...], place: NDArray[np.int64], shares: F64) -> F64:
    """(N, 3) values interpolated at `shares` (N, 3) between the bounds of each row's chunk."""
    ends = [np.stack([bounds[f"{end}_{name}"].astype(np.float64) for name in group], axis=1) for end in ("min", "max")]
    low, high = (end[place] for end in ends)
    return low * (1 - shares) + high * shares


def _packed(shares: F64) -> NDArray[np.int64]:
    """(N,) words of 11, 10 and 11 bits from `shares` (N, 3) in [0, 1]."""
    word = np.zeros(len(shares), np.int64)
    for column, (shift, levels) in enumerate(BITS):
        word |= np.rint(shares[:, column] * levels).astype(np.int64) << shift
    return word


def _unpacked(words: NDArray[np.int64]) -> F64:
    """(N, 3) numbers in [0, 1] from words (N,), the inverse of `_packed`."""
    return np.stack([(words >> shift & levels) / levels for shift, levels in BITS], axis=1)


def _higher(data: bytes, header: Header, sh: Element | None, count: int) -> NDArray[np.float32]:
    """(N, K - 1, 3) harmonics above the constant one; bytes 0 and 255 are the ends of the range exactly."""
    if sh is None:
        return np.zeros((count, 0, 3), np.float32)
    numbers = len(sh.properties)
    if numbers not in (9, 24, 45) or sh.count != count:
        message = f"has {numbers} properties and {sh.count} rows, need 9, 24 or 45 and {count}"
        raise PlyError(message, field="sh", cure="is it a damaged .compressed.ply?")
    _require_properties(sh, [f"f_rest_{index}" for index in range(numbers)], kind="u1")
    table = binary_rows(data, header, sh)
    levels = np.stack([table[f"f_rest_{index}"] for index in range(numbers)], axis=1)
    values = (levels.astype(np.float32) + np.float32(0.5)) * np.float32(BAND_STEP) + np.float32(BAND_LOW)
    values[levels == 0], values[levels == 255] = BAND_LOW, -BAND_LOW
    return values.reshape(count, 3, numbers // 3).transpose(0, 2, 1)


def _passed_over(header: Header, chunk: Element) -> list[str]:
    """A remark about unknown properties of vertices and chunks, and one about other elements."""
    known = {*PACKED, *(f"{end}_{name}" for group in GROUPS for end in ("min", "max") for name in group)}
    more = [prop.name for element in (chunk, header.vertex) for prop in element.properties if prop.name not in known]
    others = [element.name for element in header.elements if element.name not in ("chunk", "vertex", "sh")]
    return passed_over(properties=more, elements=others)


def _require_properties(element: Element, names: tuple[str, ...] | list[str], kind: str | None = None) -> None:
    """Raises `PlyError` where the element has lists, whose rows have no fixed size, or lacks one of these properties in
    the type `kind`, by default uint for vertices and float for others."""
    if element.lists:
        raise PlyError("has list properties, need numbers only", field=element.name)
    wanted = kind or ("u4" if element.name == "vertex" else "f4")
    there = {prop.name for prop in element.properties if prop.kind == wanted}
    missing = [name for name in names if name not in there]
    if missing:
        raise PlyError(
            f"{len(missing)} of {len(names)} properties are missing or of another type: {', '.join(missing[:4])}",
            field=element.name,
            cure="is it a compressed .ply of another version?",
        )
