"""The metadata and external data references of an .onnx file, read without a runtime.

Only the protobuf fields that hold these are parsed; weights are skipped, so the time depends on the graph alone, not on
the size of the file.
"""

from __future__ import annotations

import mmap
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

# Field numbers of onnx.proto3; they are the format and never change.
_GRAPH, _METADATA, _FUNCTION = 7, 14, 25  # of ModelProto
_NODE, _INITIALIZER, _SPARSE = 1, 5, 15  # of GraphProto
_FUNCTION_NODE = 7  # of FunctionProto
_SPARSE_PARTS = (1, 2)  # of SparseTensorProto: values and indices
_ATTRIBUTE = 5  # of NodeProto
_TENSOR, _BODY, _TENSORS, _BODIES = 5, 6, 10, 11  # of AttributeProto
_EXTERNAL, _LOCATION = 13, 14  # of TensorProto
_IN_A_FILE = 1  # value of _LOCATION

_VARINT, _EIGHT_BYTES, _BYTES, _FOUR_BYTES = 0, 1, 2, 5


@dataclass(frozen=True)
class OnnxHeader:
    """What an ONNX file says about itself."""

    metadata: dict[str, str]
    external: dict[str, int]  # name of each external file -> bytes that it must have at least


def read_header(path: Path) -> OnnxHeader:
    """Parse the file at `path`. Raises `OSError` where it cannot be read and `ValueError` where it is no ONNX file."""
    if not (path.is_file() or path.is_dir()) and path.exists():  # reading a pipe would wait for who writes
        raise ValueError("it is a device or a pipe")
    with path.open("rb") as file:
        if not file.seek(0, 2):
            raise ValueError("it is empty")
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            try:
                return _Reader(data).header()
            except RecursionError as error:
                raise ValueError("its graphs are nested too deeply") from error


class _Reader:
    """Walks the fields of a ModelProto; positions are byte offsets in the file."""

    def __init__(self, data: mmap.mmap) -> None:
        self._data = data
        self._external: dict[str, int] = {}

    def header(self) -> OnnxHeader:
        metadata, graphs = {}, 0
        for number, start, end in self._parts(0, len(self._data)):
            if number == _METADATA:
                key, value = self._entry(start, end)
                metadata[key] = value
            elif number == _FUNCTION:
                for kind, first, last in self._parts(start, end):
                    if kind == _FUNCTION_NODE:
                        self._node(first, last)
            elif number == _GRAPH:
                graphs += 1
                self._graph(start, end)
        if not graphs:
            raise ValueError("it holds no graph")
        return OnnxHeader(metadata, self._external)

    def _graph(self, start: int, end: int) -> None:
        for number, first, last in self._parts(start, end):
            if number == _INITIALIZER:
                self._tensor(first, last)
            elif number == _SPARSE:
                for kind, inner, outer in self._parts(first, last):
                    if kind in _SPARSE_PARTS:
                        self._tensor(inner, outer)
            elif number == _NODE:
                self._node(first, last)

    def _node(self, start: int, end: int) -> None:
        """Collect from attributes: tensors, and the graphs of If, Loop and Scan."""
        for number, first, last in self._parts(start, end):
            if number != _ATTRIBUTE:
                continue
            for kind, inner, outer in self._parts(first, last):
                if kind in (_TENSOR, _TENSORS):
                    self._tensor(inner, outer)
                elif kind in (_BODY, _BODIES):
                    self._graph(inner, outer)

    def _tensor(self, start: int, end: int) -> None:
        entries, elsewhere = {}, False
        for number, wire, first, last in self._fields(start, end):
            if number == _EXTERNAL and wire == _BYTES:
                key, value = self._entry(first, last)
                entries[key] = value
            elif number == _LOCATION and wire == _VARINT:
                elsewhere = first == _IN_A_FILE
        if elsewhere:
            if "location" not in entries:
                raise ValueError("a tensor lies in another file that is not named")
            reach = int(entries.get("offset", 0)) + int(entries.get("length", 0))
            name = entries["location"]
            self._external[name] = max(reach, self._external.get(name, 0))

    def _entry(self, start: int, end: int) -> tuple[str, str]:
        """Key and value of a StringStringEntryProto."""
        texts = {number: self._data[first:last].decode("utf-8") for number, first, last in self._parts(start, end)}
        return texts.get(1, ""), texts.get(2, "")

    def _parts(self, start: int, end: int) -> Iterator[tuple[int, int, int]]:
        """Number, start and end of the length-delimited fields."""
        return ((number, first, last) for number, wire, first, last in self._fields(start, end) if wire == _BYTES)

    def _fields(self, start: int, end: int) -> Iterator[tuple[int, int, int, int]]:
        """Number, wire type, start and end of every field; for a varint its value instead of the start."""
        at = start
        while at < end:
            tag, at = self._varint(at, end)
            number, wire = tag >> 3, tag & 7
            value, size = at, 0
            if wire == _VARINT:
                value, at = self._varint(at, end)
            elif wire == _BYTES:
                size, value = self._varint(at, end)
                at = value + size
            elif wire in (_EIGHT_BYTES, _FOUR_BYTES):
                at += 8 if wire == _EIGHT_BYTES else 4
            else:
                raise ValueError(f"field {number} at byte {at} has the type {wire}, which ONNX does not use")
            if number == 0 or at > end:
                raise ValueError(f"field {number} ends at byte {at}, what it lies in at byte {end}")
            yield number, wire, value, at

    def _varint(self, at: int, end: int) -> tuple[int, int]:
        """The base-128 varint at `at`, and the offset behind it. Raises `ValueError` where it does not end."""
        value = shift = 0
        while at < end and shift < 64:
            byte = self._data[at]
            value |= (byte & 0x7F) << shift
            at, shift = at + 1, shift + 7
            if byte < 0x80:
                return value, at
        raise ValueError(f"a number at byte {at} does not end")
