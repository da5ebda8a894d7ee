"""How fine a scene may be beside the network's grid; apart from `detail.py`, which loads what makes it so."""

from __future__ import annotations

from ..errors import InputError

DETAILS = (1, 2)  # Gaussians per pixel of the network, each way


def checked_detail(detail: int, stride: int = 1, most: int = max(DETAILS)) -> int:
    """Raises `InputError` unless it is one of `DETAILS`, `most` at most, and 1 where a `stride` thins the scene."""
    if isinstance(detail, bool) or not isinstance(detail, int) or detail not in DETAILS:
        raise InputError(f"is {detail}, need one of {DETAILS}", field="detail", cure="leave it out for 1")
    if detail > most:
        raise InputError(f"is {detail}, the limit is {most}", field="detail", cure="leave it out for 1")
    if detail > 1 and stride > 1:
        raise InputError(
            f"is {detail} beside stride {stride}: the one adds the Gaussians that the other takes away",
            field="detail",
            cure="give one of them",
        )
    return detail
