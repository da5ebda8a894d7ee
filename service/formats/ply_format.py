"""The .ply container (Turk 1994): parsing the header, skipping elements, and reading the rows of one."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import PlyError

F64 = NDArray[np.float64]

TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
TYPE_NAMES = {kind: name for name, kind in reversed(TYPES.items())}  # those of most writers
LENGTH_TYPES = frozenset(name for name, kind in TYPES.items() if kind[0] != "f")
BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": None}
MAX_LISTS = 200_000  # before the vertices, where they are walked past one by one; faces of a mesh come after them
MAX_LINES = 1_000_000  # of a text, the same
_FILLED = re.compile(rb"\S[^\r\n]*")  # a line from its first word on, so that blank ones are passed over at once
MAX_HEADER = 1 << 16  # bytes; a 3DGS header has about 1,500


@dataclass(frozen=True)
class Property:
    """A column of an element; for lists `length_kind` is the type of the length."""

    name: str
    kind: str  # numpy type code without byte order
    length_kind: str | None = None


@dataclass(frozen=True)
class Element:
    """One table of the file."""

    name: str
    count: int
    properties: tuple[Property, ...]

    @property
    def lists(self) -> int:
        """Number of list properties."""
        return sum(prop.length_kind is not None for prop in self.properties)


@dataclass(frozen=True)
class Header:
    """A parsed header; `body` is the offset of the first byte after it."""

    byte_order: str | None  # "<", ">" or None for ASCII
    elements: tuple[Element, ...]
    body: int

    @property
    def vertex(self) -> Element:
        """The element of that name, of which every header has one."""
        return self.elements[self._place("vertex")]

    def element(self, name: str) -> Element | None:
        """The first element of this name, None where there is none."""
        return next((element for element in self.elements if element.name == name), None)

    def before(self, name: str) -> tuple[Element, ...]:
        """The elements that precede the first one of this name."""
        return self.elements[: self._place(name)]

    def _place(self, name: str) -> int:
        return [element.name for element in self.elements].index(name)


def parse_header(data: bytes) -> Header:
    """Parse the header. Raises `PlyError` with the number of an invalid line."""
    start = re.match(rb"ply[ \t]*(\r\n|\n|\r)", data)
    if start is None:
        raise PlyError(
            f"starts with {data[:4]!r}, need 'ply' and a line end", field="header", cure="is this a .ply file?"
        )
    # The first line defines the line end, so that a line feed at the start of a binary body is not skipped.
    line_end = re.escape(start[1])
    end = re.search(line_end + rb"[ \t]*end_header[ \t]*" + line_end, data[:MAX_HEADER])
    if end is None:
        raise PlyError(
            f"no end_header line in the first {min(len(data), MAX_HEADER)} bytes",
            field="header",
            cure="is it truncated?",
        )
    lines = [line.decode("latin-1") for line in data[: end.start()].split(start[1])]
    format_name: str | None = None
    tables: list[tuple[str, int, list[Property]]] = []
    for number, line in enumerate(lines[1:], start=2):
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) == 3 and words[1] in BYTE_ORDERS and words[2] == "1.0":
            format_name = words[1]
        elif words[0] == "element" and len(words) == 3 and re.fullmatch("[0-9]{1,15}", words[2]):
            tables.append((words[1], int(words[2]), []))
        elif words[0] == "property" and tables:
            tables[-1][2].append(_parse_property(words, number, line))
        else:
            raise PlyError(f"line {number} is not understood: {line[:80]!r}", field="header", index=number)
    if format_name is None:
        raise PlyError("no format line", field="header", cure="need 'format binary_little_endian 1.0' or another")
    elements = [_checked_element(*table) for table in tables]
    names = [element.name for element in elements]
    if names.count("vertex") != 1:
        raise PlyError(f"elements are {names}, need one named vertex", field="header")
    header = Header(BYTE_ORDERS[format_name], tuple(elements), end.end())
    if header.vertex.lists:
        raise PlyError("has list properties, need numbers only", field="vertex")
    return header


def _parse_property(words: list[str], number: int, line: str) -> Property:
    if len(words) == 3 and words[1] in TYPES:
        return Property(words[2], TYPES[words[1]])
    if len(words) == 5 and words[1] == "list" and words[2] in LENGTH_TYPES and words[3] in TYPES:
        return Property(words[4], TYPES[words[3]], TYPES[words[2]])
    raise PlyError(f"line {number} is no known property: {line[:80]!r}", field="header", index=number)


def _checked_element(name: str, count: int, properties: list[Property]) -> Element:
    for prop, times in Counter(prop.name for prop in properties).items():
        if times > 1:
            raise PlyError(f"property {prop!r} is declared {times} times", field=name)
    return Element(name, count, tuple(properties))


def vertex_columns(data: bytes, header: Header, names: Collection[str]) -> dict[str, F64]:
    """Those of the vertex table's columns that have one of `names`, as float64. Raises `PlyError` for a truncated
    file."""
    if header.byte_order is None:
        return _ascii_columns(data, header, names)
    table = binary_rows(data, header, header.vertex)
    with np.errstate(invalid="ignore"):  # signalling NaNs; columns that are used are checked for NaN
        return {name: table[name].astype(np.float64) for name in table.dtype.names or () if name in names}


def binary_rows(data: bytes, header: Header, element: Element) -> NDArray:
    """The rows of an element without lists in a binary file, as a structured array with a field per property.

    Raises `PlyError` for a truncated file.
    """
    order = header.byte_order or "<"
    offset = header.body
    before = header.before(element.name)
    _require_passable(sum(other.count * other.lists for other in before), MAX_LISTS, "lists", element)
    for other in before:
        offset = _skip_binary(data, offset, other, order)
    row = row_type(element, order)
    return np.frombuffer(data, row, count=_whole_rows(data, offset, element, row.itemsize), offset=offset)


def row_type(element: Element, byte_order: str) -> np.dtype:
    """Structured type of a row of an element without lists."""
    return np.dtype([(prop.name, byte_order + prop.kind) for prop in element.properties])


def _require_passable(count: int, most: int, what: str, element: Element) -> None:
    if count > most:
        raise PlyError(
            f"{count} {what} stand before it, at most {most} are walked past",
            field=element.name,
            cure="write the vertices first",
        )


def _whole_rows(data: bytes, offset: int, element: Element, row_bytes: int) -> int:
    """`element.count`. Raises `PlyError` if the file is too short for it."""
    room = max(len(data) - offset, 0)
    if element.count * row_bytes > room:
        raise PlyError(
            f"{element.count} rows of {row_bytes} bytes need {element.count * row_bytes} bytes, "
            f"the file has {room} left ({room // row_bytes} whole rows)",
            field=element.name,
            index=room // row_bytes,
            cure="is the file truncated?",
        )
    return element.count


def _skip_binary(data: bytes, offset: int, element: Element, byte_order: str) -> int:
    if not element.lists:
        row_bytes = row_type(element, byte_order).itemsize
        return offset + _whole_rows(data, offset, element, row_bytes) * row_bytes
    lists, between = [], 0  # bytes of the numbers before each list, which are passed over at once
    for prop in element.properties:
        size = np.dtype(prop.kind).itemsize
        if prop.length_kind is None:
            between += size
        else:
            length = np.dtype(prop.length_kind)
            lists.append((between, length.itemsize, length.kind == "i", size, prop.name))
            between = 0
    order: Literal["little", "big"] = "little" if byte_order == "<" else "big"
    for index in range(element.count):
        for before, bytes_of_count, signed, size, name in lists:
            _require_bytes(data, offset, before + bytes_of_count, element, index)
            offset += before + bytes_of_count
            count = int.from_bytes(data[offset - bytes_of_count : offset], order, signed=signed)
            if count < 0:
                raise PlyError(f"a list has length {count}", field=f"{element.name}.{name}", index=index)
            _require_bytes(data, offset, size * count, element, index)
            offset += size * count
        _require_bytes(data, offset, between, element, index)
        offset += between
    return offset


def _require_bytes(data: bytes, offset: int, size: int, element: Element, index: int) -> None:
    if offset + size > len(data):
        raise PlyError(
            f"row {index} of {element.count} needs {size} bytes at {offset}, the file has {len(data)}",
            field=element.name,
            index=index,
            cure="is the file truncated?",
        )


def filled_lines(data: bytes, header: Header) -> Iterator[bytes]:
    """The lines in the body of an ASCII file that are not blank."""
    return (match.group() for match in _FILLED.finditer(data, header.body))


def _ascii_columns(data: bytes, header: Header, names: Collection[str]) -> dict[str, F64]:
    """The named columns of an ASCII file with one row per line; blank lines are skipped."""
    start = sum(element.count for element in header.before("vertex") if element.properties)
    vertex = header.vertex
    _require_passable(start, MAX_LINES, "lines", vertex)
    lines = list(islice(filled_lines(data, header), start, start + vertex.count))  # skips earlier elements
    if vertex.count > len(lines):
        raise PlyError(
            f"{vertex.count} rows are declared, the file has {len(lines)} lines of them",
            field="vertex",
            index=len(lines),
            cure="is the file truncated?",
        )
    need = len(vertex.properties)
    if 2 * need * vertex.count > len(data):  # a row is too short, which is told before memory for all is taken
        for index, line in enumerate(lines):
            _words(line, need, index)
    taken = {prop.name: place for place, prop in enumerate(vertex.properties) if prop.name in names}
    places = list(taken.values())
    table = np.empty((len(taken), vertex.count))
    for index, line in enumerate(lines):
        words = _words(line, need, index)
        try:
            numbers = [float(word) for word in words]
        except ValueError as error:
            raise PlyError(f"row {index} is not made of numbers: {line[:80]!r}", field="vertex", index=index) from error
        table[:, index] = [numbers[place] for place in places]
    return dict(zip(taken, table, strict=True))


def _words(line: bytes, need: int, index: int) -> list[bytes]:
    words = line.split()
    if len(words) != need:
        raise PlyError(f"row {index} has {len(words)} numbers, need {need}", field="vertex", index=index)
    return words
