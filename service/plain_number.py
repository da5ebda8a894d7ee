"""Numbers in text, which Python's own `float` reads in more forms than people write; and counts with their noun."""

from __future__ import annotations


def plain_float(text: str) -> float:
    """The number, which may be infinite or NaN. Raises `ValueError` for anything else, also 1_0 and other digits."""
    if not text.isascii() or "_" in text:
        raise ValueError(f"{text[:50]!r} is not a number")
    return float(text)


def counted(count: int, noun: str) -> str:
    """`1 view`, `2 views`."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
