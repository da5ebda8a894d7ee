"""The input size of a network in px: `256` for a square, `256x336` for height and width."""

from __future__ import annotations

import re
from typing import NamedTuple

from gapmes.service.errors import InputError

LEAST, MOST = 32, 4096


class Size(NamedTuple):
    """Height and width in px."""

    height: int
    width: int

    @classmethod
    def square(cls, side: int) -> Size:
        return cls(side, side)

    @classmethod
    def parse(cls, text: str) -> Size:
        """Parse SIDE or HEIGHTxWIDTH. Raises `InputError` for other text and for sides outside `LEAST` to `MOST`."""
        found = re.fullmatch(r"(\d{1,9})(?:x(\d{1,9}))?", text, re.ASCII)
        if not found:
            raise InputError(f"{text!r} is no size", field="size", cure="give a side, 256, or HEIGHTxWIDTH, 256x336")
        size = cls(int(found[1]), int(found[2] or found[1]))
        if min(size) < LEAST:
            raise InputError(f"is {size} px, need {LEAST} or more for each side", field="size")
        if max(size) > MOST:
            cure = "the network looks at small pictures: 256 is usual"
            raise InputError(f"is {size} px, need {MOST} or less for each side", field="size", cure=cure)
        return size

    def misfit(self, step: int) -> str | None:
        """Why the size does not suit a network whose sides are multiples of `step` px; None where it does."""
        for name, side in zip(self._fields, self, strict=True):
            if side < LEAST or side % step:
                return f"{name} is {side} px, need a multiple of {step} of at least {LEAST}"
        return None

    def order(self) -> tuple[int, int, int]:
        """Sort key: number of pixels, then height and width."""
        return (self.height * self.width, *self)

    @property
    def twice(self) -> Size:
        return Size(2 * self.height, 2 * self.width)

    def __str__(self) -> str:
        return str(self.height) if self.height == self.width else f"{self.height}x{self.width}"
