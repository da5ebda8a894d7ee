"""The .spz of Niantic: header and quantised columns, gzipped; versions 2 and 3 are read, version 3 is written.

The columns one after the other, N rows each: position as three 24-bit fixed-point numbers of f fractional bits, opacity
in 255 levels, colour (0.15 f_dc + 0.5) in 255 levels, log scale 16 levels per unit from -10 on, rotation (version 2: x,
y, z at 127.5 levels per unit; version 3: the smallest three of x, y, z, w as sign and 9 bits), harmonics 128 levels per
unit from -1 on, colour channel fastest. The frame of the file is right-up-back by its definition, that of the .ply
that such files are made from right-down-front: y and z change their sign on the way.
"""

from __future__ import annotations

import gzip
import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError
from ..gaussians import Gaussians
from ..harmonics import band_rotations
from .dialect import Axes
from .encoded import INTO_THE_SCENE, Encoded, clamped_note, faint_note, position_note, quantized, typical_size
from .reading import Reading, check_count, gaussians_of
from .smallest_three import BOUND, join, split

HEADER = struct.Struct("<IIIBBBB")  # magic, version, rows, degree, fractional bits, flags, reserved
ANTIALIASED, EXTENDED = 1, 2  # flags
MAGIC = 0x5053474E  # NGSP
VERSION = 3
LEGACY = {2: 3, 3: 4}  # version: bytes of a rotation
DEFLATE_RATIO = 1032  # upper bound for deflate (RFC 1951): 258 bytes from two bits
MAX_FRACTION = 24
# Position steps per typical size: on two scenes half as many lose up to 0.6 dB, and more gain at most that and cost 4
# to 11 % of bytes.
SHARE_OF_SIZE = 32
TOP = 2**23 - 1  # the largest fixed-point number
ALPHA_LEVELS = COLOUR_LEVELS = 255
COLOUR_SHARE = 0.15
SCALE_LEVELS, SCALE_LOW = 16, -10.0
BAND_LEVELS = 128
MAGNITUDES = 511  # of a rotation component, for 0 to 1/sqrt(2)
COMPRESSION = 6
TURN = np.diag([1.0, -1.0, -1.0])  # rotation by 180 degrees about x


def is_gzip(data: bytes) -> bool:
    """Whether a file starts like gzip (RFC 1952): magic number, deflate, and no reserved flags."""
    return data[:3] == b"\x1f\x8b\x08" and len(data) > 3 and not data[3] & 0xE0


def holds_spz(data: bytes) -> bool:
    """Whether the decompressed data starts with the magic number of .spz."""
    try:
        return zlib.decompressobj(31).decompress(data, 4) == MAGIC.to_bytes(4, "little")
    except zlib.error:
        return False


def read_spz(data: bytes, *, axes: Axes, drop_invalid: bool, max_count: int | None) -> Reading:
    """Decode a file; no more is decompressed than its header announces. Raises `FormatError`."""
    columns, degree, fraction, version, remarks = _unpacked(data, max_count)
    positions, alphas, colours, scales, rotations, higher = columns
    count, rest = len(alphas), (degree + 1) ** 2 - 1
    parts = positions.reshape(count, 3, 3).astype(np.int32)
    fixed = parts[..., 0] | parts[..., 1] << 8 | parts[..., 2] << 16
    fixed -= (fixed > TOP).astype(np.int32) << 24
    harmonics = np.empty((count, 1 + rest, 3), np.float32)
    harmonics[:, 0] = (colours.reshape(count, 3) / COLOUR_LEVELS - 0.5) / COLOUR_SHARE
    harmonics[:, 1:] = (higher.reshape(count, rest, 3).astype(np.float32) - BAND_LEVELS) / BAND_LEVELS
    fields = {
        "means": fixed / 2.0**fraction,
        "scales": np.exp(scales.reshape(count, 3) / SCALE_LEVELS + SCALE_LOW),
        "rotations_wxyz": _rotations(rotations, version),
        "opacities": alphas / ALPHA_LEVELS,
        "harmonics": harmonics,
    }
    if axes == "rub":
        remarks.append("y and z changed their sign, from right-up-back to right-down-front; --axes rdf keeps them")
        fields = _turned(fields)
    return gaussians_of(fields, "spz", drop_invalid=drop_invalid, remarks=tuple(remarks))


def spz_bytes(gaussians: Gaussians) -> Encoded:
    """Encode in the given order and in right-up-back axes.

    The position step is at most 1/32 of a typical Gaussian's size, if the farthest position leaves enough bits; finer
    steps would cost bytes without visible gain. Raises `FormatError` if a position is too far for one fractional bit.
    """
    names = ("means", "rotations_wxyz", "harmonics")
    turned = _turned({name: getattr(gaussians, name).astype(np.float64) for name in names})
    means, count = turned["means"], len(gaussians)
    fraction = _fraction(gaussians.means, typical_size(gaussians))  # its errors name the given position
    fixed = np.rint(means * 2.0**fraction).astype(np.int32)
    colours, colours_outside = quantized(
        (COLOUR_SHARE * turned["harmonics"][:, 0] + 0.5) * COLOUR_LEVELS, COLOUR_LEVELS
    )
    with np.errstate(divide="ignore"):  # a scale of 0 becomes the lowest level
        logs = np.log(gaussians.scales.astype(np.float64))
    scales, scales_outside = quantized((logs - SCALE_LOW) * SCALE_LEVELS, 255)
    higher, higher_outside = quantized((turned["harmonics"][:, 1:] + 1) * BAND_LEVELS, 255)
    columns = [
        fixed.astype("<i4")[..., None].view(np.uint8)[..., :3],
        np.rint(gaussians.opacities.astype(np.float64) * ALPHA_LEVELS),
        colours,
        scales,
        _smallest_three(turned["rotations_wxyz"]).astype("<u4").view(np.uint8),
        higher,
    ]
    header = HEADER.pack(MAGIC, VERSION, count, gaussians.sh_degree, fraction, 0, 0)
    raw = header + b"".join(column.astype(np.uint8).tobytes() for column in columns)
    colour_end = 0.5 / COLOUR_SHARE
    low, high = np.exp(SCALE_LOW), np.exp(SCALE_LOW + 255 / SCALE_LEVELS)
    notes = [
        *faint_note(gaussians),
        *clamped_note("colour coefficients", colours_outside, colours.size, -colour_end, colour_end),
        *clamped_note("scales", scales_outside, scales.size, low, high),
        *clamped_note("higher harmonics", higher_outside, higher.size, -1, 127 / BAND_LEVELS),
        *position_note(gaussians, 0.5**fraction / 2 if count else 0.0),
    ]
    return Encoded(gzip.compress(raw, COMPRESSION, mtime=0), tuple(notes))


def _unpacked(data: bytes, max_count: int | None) -> tuple[list[NDArray[np.uint8]], int, int, int, list[str]]:
    """The six columns as bytes, degree, fractional bits, version, and remarks."""
    if data[:4] == MAGIC.to_bytes(4, "little"):
        raise FormatError(
            "is of version 4 or later (zstd), versions 2 and 3 are read", field="spz", cure="save it as version 3"
        )
    stream = zlib.decompressobj(31)
    header = _inflated(stream, data, HEADER.size)
    magic, version, count, degree, fraction, flags, _ = HEADER.unpack(header)
    if magic != MAGIC:
        raise FormatError(f"the magic number is {magic:#010x}, need {MAGIC:#010x}", field="spz", cure="is it a .spz?")
    if version not in LEGACY:
        raise FormatError(
            f"is of version {version}, versions 2 and 3 are read", field="spz", cure="save it as version 3"
        )
    if degree > 3 or not 0 <= fraction <= MAX_FRACTION:
        raise FormatError(
            f"degree is {degree} and fractional bits are {fraction}, need 0 to 3 and 0 to {MAX_FRACTION}",
            field="spz",
            cure="is it a damaged .spz?",
        )
    check_count(count, max_count, "spz")
    sizes = [size * count for size in (9, 1, 3, 3, LEGACY[version], 3 * ((degree + 1) ** 2 - 1))]
    if sum(sizes) > DEFLATE_RATIO * len(data):
        raise FormatError(
            f"{count} Gaussians need {sum(sizes)} bytes, "
            f"a file of {len(data)} holds {DEFLATE_RATIO * len(data)} at most",
            field="spz",
            cure="is it truncated?",
        )
    body = np.frombuffer(_inflated(stream, stream.unconsumed_tail, sum(sizes)), np.uint8)
    more = _more(stream)
    rest = "an extension behind the Gaussians" if flags & EXTENDED else "what follows the Gaussians"
    remarks = [f"{rest} was ignored"] if more else []
    if flags & ANTIALIASED:
        remarks.append(
            "the file says that its Gaussians were trained with an antialiasing filter; they are taken and drawn "
            "without it, so that small ones look too strong"
        )
    return np.split(body, np.cumsum(sizes)[:-1]), degree, fraction, version, remarks


def _inflated(stream: zlib._Decompress, data: bytes, size: int) -> bytes:
    """Decompress exactly the next `size` bytes. Raises `FormatError`."""
    found = _decompressed(stream, data, size) if size else b""
    if len(found) < size:
        raise FormatError(
            f"ends after {len(found)} of {size} bytes", field="spz", index=len(found), cure="is it truncated?"
        )
    return found


def _more(stream: zlib._Decompress) -> bool:
    """Whether more data follows; if none does, the checksum was verified. Raises `FormatError`."""
    found = _decompressed(stream, stream.unconsumed_tail, 1)
    if not found and not stream.eof:
        raise FormatError("ends before its checksum", field="spz", cure="is it truncated?")
    return bool(found or stream.unused_data)


def _decompressed(stream: zlib._Decompress, data: bytes, most: int) -> bytes:
    """Decompress up to `most` > 0 bytes (0 would be no limit for zlib). Raises `FormatError`."""
    try:
        return stream.decompress(data, most)
    except zlib.error as error:
        raise FormatError(f"cannot be decompressed: {error}", field="spz", cure="is it a damaged .spz?") from error


def _rotations(column: NDArray[np.uint8], version: int) -> NDArray[np.float64]:
    """(N, 4) quaternions wxyz."""
    if version == 2:
        xyz = column.reshape(-1, 3) / 127.5 - 1
        w = np.sqrt(np.maximum(0.0, 1.0 - np.square(xyz).sum(axis=1)))
        return np.concatenate([w[:, None], xyz], axis=1)
    packed = np.frombuffer(column.tobytes(), "<u4")
    parts = np.stack([packed >> 20, packed >> 10, packed], axis=1) & 1023
    others = np.where(parts & 512, -1.0, 1.0) * (parts & MAGNITUDES) * (BOUND / MAGNITUDES)
    return np.roll(join(packed >> 30, others), 1, axis=1)


def _smallest_three(wxyz: NDArray) -> NDArray[np.int64]:
    """(N,) words of 32 bits: index of the component of x, y, z, w left out, sign and magnitude of the others."""
    index, others = split(np.roll(wxyz, -1, axis=1))
    magnitudes, _ = quantized(np.abs(others) * (MAGNITUDES / BOUND), MAGNITUDES)
    parts = magnitudes | (others < 0).astype(np.int64) << 9
    return index << 30 | parts[:, 0] << 20 | parts[:, 1] << 10 | parts[:, 2]


def _turned(fields: dict[str, NDArray]) -> dict[str, NDArray]:
    """Exact rotation by 180 degrees about x. Local axes of Gaussians are mirrored too, which keeps their ellipsoids."""
    degree = round(fields["harmonics"].shape[1] ** 0.5) - 1
    signs = np.rint(np.concatenate([np.diag(band) for band in band_rotations(TURN, degree)]))
    return fields | {
        "means": fields["means"] * [1, -1, -1],
        "rotations_wxyz": fields["rotations_wxyz"] * [1, 1, -1, -1],
        "harmonics": fields["harmonics"] * signs[:, None].astype(fields["harmonics"].dtype),
    }


def _fraction(means: NDArray[np.floating], size: float) -> int:
    """Number of fractional bits: as the typical size needs, limited by the largest coordinate."""
    farthest = float(np.abs(means).max(initial=0.0))
    wanted = np.ceil(np.log2(SHARE_OF_SIZE / size)) if size > 0 else MAX_FRACTION
    for fraction in range(int(np.clip(wanted, 1, MAX_FRACTION)), 0, -1):  # some readers reject 0
        if farthest * 2.0**fraction <= TOP:
            return fraction
    index = int(np.abs(means).max(axis=1).argmax())
    raise FormatError(
        f"position {means[index].tolist()} is farther from the origin than the {TOP / 2:g} that the format holds with "
        "one fractional bit, the fewest that all readers take",
        field="means",
        index=index,
        cure=INTO_THE_SCENE,
    )
