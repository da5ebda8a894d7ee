"""Detecting extra rows of a .ply after those that its header declares."""

from __future__ import annotations

from itertools import islice

from .ply_format import MAX_LINES, Header, filled_lines, row_type

MOST = 10_000  # lines of an ASCII file that are looked at one by one


def behind(data: bytes, header: Header) -> list[str]:
    """A remark about extra rows; none for binary files with lists, whose end is not known without reading them, and for
    ASCII files with more than MAX_LINES lines of other elements, which would be walked past."""
    vertex, unlooked = header.vertex, False
    if header.byte_order is None:
        declared = sum(element.count for element in header.elements if element.properties)
        if declared - vertex.count > MAX_LINES:
            return []
        lines = filled_lines(data, header)
        found = list(islice(lines, declared, declared + MOST))
        more = sum(len(line.split()) == len(vertex.properties) for line in found)
        unlooked = next(lines, None) is not None
    elif any(element.lists and element.count for element in header.elements):
        return []
    else:
        sizes = {element.name: row_type(element, header.byte_order).itemsize for element in header.elements}
        end = header.body + sum(element.count * sizes[element.name] for element in header.elements)
        more = (len(data) - end) // max(sizes[vertex.name], 1)
    if more <= 0:
        return []
    if unlooked:
        return [f"{more} rows or more lie behind the {vertex.count} that the header declares and were ignored"]
    return [f"of {vertex.count + more} rows {more} lie behind those that the header declares and were ignored"]
