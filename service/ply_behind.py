"""What a .ply has behind the rows that its header declares: another count than was meant, or something appended."""

from __future__ import annotations

import re
from itertools import islice

from .ply_format import Header, end_of_binary

_LINE = re.compile(rb"[^\r\n]*[^\s][^\r\n]*")  # not blank


def behind(data: bytes, header: Header) -> list[str]:
    """A remark for it. Of a binary file nothing is said where elements with lists stand behind the vertices."""
    rows = header.vertex.count
    if header.byte_order is None:
        declared = sum(element.count for element in header.elements if element.properties)
        more = sum(1 for _ in islice(_LINE.finditer(data, header.body), declared, None))
        what = "lines"
    else:
        later = header.elements[len(header.before("vertex")) + 1 :]
        if any(element.lists for element in later):
            return []
        more, what = len(data) - end_of_binary(data, header), "bytes"
    if more <= 0:
        return []
    return [f"{more} {what} behind the {rows} rows that the header declares were passed over: is their number right?"]
