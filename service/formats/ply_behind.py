"""Detecting extra rows of a .ply after those that its header declares."""

from __future__ import annotations

from itertools import islice

from .ply_format import Header, filled_lines, row_type


def behind(data: bytes, header: Header) -> list[str]:
    """A remark about extra rows; none for binary files with lists, whose end is not known without reading them."""
    vertex = header.vertex
    if header.byte_order is None:
        declared = sum(element.count for element in header.elements if element.properties)
        lines = islice(filled_lines(data, header), declared, None)
        more = sum(len(line.split()) == len(vertex.properties) for line in lines)
    elif any(element.lists and element.count for element in header.elements):
        return []
    else:
        sizes = {element.name: row_type(element, header.byte_order).itemsize for element in header.elements}
        end = header.body + sum(element.count * sizes[element.name] for element in header.elements)
        more = (len(data) - end) // max(sizes[vertex.name], 1)
    if more <= 0:
        return []
    return [f"of {vertex.count + more} rows {more} lie behind those that the header declares and were ignored"]
