"""Files with bytes flipped, removed or inserted anywhere."""

from __future__ import annotations

from hypothesis import strategies as st


def damaged(data: st.DataObject, source: bytes) -> bytes:
    """`data` with damage in one to four places."""
    raw = bytearray(source)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, max(0, len(raw) - 1)))
        match data.draw(st.sampled_from(["flip", "cut", "insert"])):
            case "flip" if raw:
                raw[at] ^= data.draw(st.integers(1, 255))
            case "cut":
                del raw[at : at + data.draw(st.integers(1, 40))]
            case "insert":
                raw[at:at] = data.draw(st.binary(min_size=1, max_size=8))
    return bytes(raw)
