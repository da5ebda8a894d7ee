"""The level of detail of a scene, checked without importing `detail.py`, which loads the network's engine."""

from __future__ import annotations

from ..arguments import shown, whole_number
from ..errors import InputError

DETAILS = (1, 2)  # Gaussians per pixel of the network, each way


def checked_detail(detail: int, stride: int = 1, most: int = max(DETAILS)) -> int:
    """As `int`. Raises `InputError` unless it is one of DETAILS, at most `most`, and 1 if `stride` is above 1."""
    level = whole_number(detail)
    if level not in DETAILS:
        raise InputError(f"is {shown(detail)}, need one of {DETAILS}", field="detail", cure="leave it out for 1")
    if level > most:
        raise InputError(f"is {level}, the limit is {most}", field="detail", cure="leave it out for 1")
    if level > 1 and stride > 1:
        raise InputError(
            f"is {level} beside stride {stride}: the one adds the Gaussians that the other takes away",
            field="detail",
            cure="give one of them",
        )
    return level
