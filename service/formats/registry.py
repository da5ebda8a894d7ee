"""Registry of the formats of Gaussians by extension, detection of formats, and reading and writing of any of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from os import PathLike
from pathlib import Path

from ..arguments import file_path, of_type, shown
from ..errors import InputError
from ..gaussians import GAUSSIANS_CURE, Gaussians
from ..process.disk import replace_file
from .compressed_ply import compressed_ply_bytes, is_compressed, read_compressed_ply
from .dialect import AUTO, DIALECT_CURE, Dialect
from .encoded import Encoded
from .ply_format import parse_header
from .ply_read import inspect_ply
from .ply_write import ply_bytes
from .reading import Reading, Source, bytes_of
from .splat import ROW, read_splat, splat_bytes
from .spz import holds_spz, is_gzip, read_spz, spz_bytes

MEDIA_TYPE = "application/octet-stream"  # of all of them: none has a registered one
Reader = Callable[[bytes, Dialect, bool, int | None], Reading]


@dataclass(frozen=True)
class Format:
    """A format, with its reader, its writer, and the dialect options that apply to it."""

    extension: str  # without the dot in front
    keeps: str
    decode: Reader
    write: Callable[[Gaussians], Encoded]
    choices: tuple[str, ...] = ()  # fields of `Dialect`

    def read(self, data: bytes, dialect: Dialect, drop_invalid: bool, max_count: int | None) -> Reading:
        """Decode a file, with a remark about dialect options that do not apply to the format.

        Raises `FormatError`, and `TooManyGaussians` beyond `max_count`.
        """
        reading = self.decode(data, dialect, drop_invalid, max_count)
        told = [field.name for field in fields(Dialect) if getattr(dialect, field.name) != getattr(AUTO, field.name)]
        idle = [
            f"{name} {getattr(dialect, name)} changes nothing: a .{self.extension} has no such choice"
            for name in told
            if name not in self.choices
        ]
        return replace(reading, remarks=(*idle, *reading.remarks)) if idle else reading


def _ply(data: bytes, dialect: Dialect, drop: bool, most: int | None) -> Reading:
    return inspect_ply(data, dialect=dialect, drop_invalid=drop, max_count=most)


def _compressed(data: bytes, _: Dialect, drop: bool, most: int | None) -> Reading:
    return read_compressed_ply(data, drop_invalid=drop, max_count=most)


def _splat(data: bytes, _: Dialect, drop: bool, most: int | None) -> Reading:
    return read_splat(data, drop_invalid=drop, max_count=most)


def _spz(data: bytes, dialect: Dialect, drop: bool, most: int | None) -> Reading:
    return read_spz(data, axes=dialect.axes, drop_invalid=drop, max_count=most)


_ALL = (
    Format(
        "ply",
        "everything, as float32",
        _ply,
        lambda gaussians: Encoded(ply_bytes(gaussians)),
        ("opacity", "scales", "rotation"),
    ),
    Format("compressed.ply", "everything, in 8 to 11 bits; the order changes", _compressed, compressed_ply_bytes),
    Format("splat", "position and size as float32, one colour in 8 bits, no harmonics", _splat, splat_bytes),
    Format("spz", "everything, in 8 to 24 bits, compressed", _spz, spz_bytes, ("axes",)),
)
FORMATS = {entry.extension: entry for entry in _ALL}
NAMES = ", ".join(FORMATS)


def format_named(extension: str, field: str = "format") -> Format:
    """The format of an extension, with or without its dot. Raises `InputError`."""
    found = FORMATS.get(extension.lower().removeprefix(".")) if isinstance(extension, str) else None
    if found is None:
        raise InputError(f"{shown(extension)} is no format of Gaussians", field=field, cure=f"one of {NAMES}")
    return found


def format_of_path(path: str | PathLike[str], field: str = "format", cure: str = "end it in one of them") -> Format:
    """The format that a file's name ends in, the longest extension first. Raises `InputError`."""
    name = Path(path).name.lower()
    for extension in sorted(FORMATS, key=len, reverse=True):
        if name.endswith(f".{extension}"):
            return FORMATS[extension]
    raise InputError(f"{name[-100:]!r} ends in none of {NAMES}", field=field, cure=cure)


def format_of_bytes(data: bytes, name: str | None = None) -> Format:
    """The format of a file by its first bytes, else by its name, as a .splat has no signature.

    A file named .splat that consists of whole rows may start with any bytes: more than three must match for another
    format. Raises `InputError` if neither tells, and `PlyError` for a damaged header of a .ply.
    """
    rows = name is not None and name.lower().endswith(".splat") and len(data) % ROW.itemsize == 0
    if data[:3] == b"ply" and (data[3:4].isspace() or not rows):
        return FORMATS["compressed.ply" if is_compressed(parse_header(data)) else "ply"]
    if data[:4] == b"NGSP" or (is_gzip(data) and (holds_spz(data) or not rows)):
        return FORMATS["spz"]
    if name:
        return format_of_path(name, cure="name the format: --from, format= over HTTP and in Python")
    if not data:
        raise InputError("0 bytes", field="file", cure=f"send a file of Gaussians, one of {NAMES}")
    message = f"the first bytes, {data[:8]!r}, are those of no .ply or .spz, and there is no name to tell"
    raise InputError(message, field="format", cure=f"name the format, one of {NAMES}; a .splat has nothing that tells")


def inspect_gaussians(
    source: Source,
    *,
    format: str | None = None,
    name: str | None = None,
    dialect: Dialect = AUTO,
    drop_invalid: bool = False,
    max_count: int | None = None,
) -> tuple[Reading, Format]:
    """Read a path, the bytes of a file or an open binary file of any format; returns the format, too.

    Without `format` it is detected from the content, then from `name` or the path. Raises `FormatError` (for a .ply
    `PlyError`) naming field and row, `TooManyGaussians` for more than `max_count`, and `InputError` for an unknown
    format.
    """
    of_type(dialect, Dialect, "dialect", DIALECT_CURE)
    data = bytes_of(source)
    if name is None and isinstance(source, str | PathLike):
        name = str(source)
    chosen = format_of_bytes(data, name) if format is None else format_named(format)
    return chosen.read(data, dialect, drop_invalid, max_count), chosen


def read_gaussians(source: Source, *, format: str | None = None, dialect: Dialect = AUTO) -> Gaussians:
    """The Gaussians of a file of any format; see `inspect_gaussians`, which also returns notes."""
    return inspect_gaussians(source, format=format, dialect=dialect)[0].gaussians


def write_gaussians(path: str | PathLike[str], gaussians: Gaussians, *, format: str | None = None) -> Encoded:
    """Write a file in the format of its extension, or in `format`, replacing it atomically; returns it with notes about
    what the format could not hold.
    """
    file = file_path(path, "path", "name the file to write")
    chosen = format_of_path(file, field="path") if format is None else format_named(format)
    encoded = chosen.write(of_type(gaussians, Gaussians, "gaussians", GAUSSIANS_CURE))
    replace_file(file, encoded.data)
    return encoded
