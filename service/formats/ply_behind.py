"""Rows of a .ply behind those that its header declares: another count than was meant hides them."""

from __future__ import annotations

from itertools import islice

from .ply_format import Header, filled_lines, row_type


def behind(data: bytes, header: Header) -> list[str]:
    """A remark for them. Of a binary file with lists nothing is said: where they end would have to be walked to."""
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
    return [f"of {vertex.count + more} rows {more} lie behind those that the header declares and were passed over"]
