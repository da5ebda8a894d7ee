"""How much may be left out of a scene: a budget on the change of colour, and the views for which it is proved."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real

from ..errors import InputError
from ..plain_number import plain_float
from .stride import STRIDES

DEFAULT_MAX_ERROR = 1 / 255  # one level of an 8-bit picture
DEFAULT_CERTIFY = 1  # views between two neighbouring inputs: what only they see stays
MAX_CERTIFY = 30


@dataclass(frozen=True)
class Budget:
    """What may be left out: `max_error` is a change of colour (None: nothing goes), `certify` how many views between
    two neighbouring inputs it holds for, `asked` further views (such as "orbit:20"; kept sorted, once each).

    Raises `InputError` for numbers out of range.
    """

    max_error: float | None = DEFAULT_MAX_ERROR
    certify: int = DEFAULT_CERTIFY
    asked: tuple[str, ...] = ()
    min_opacity: float = 0.0  # fainter Gaussians go whatever that changes; the change is bounded and reported
    stride: int = 1  # a Gaussian per so many pixels in both directions; another model, of which no bound is known

    def __post_init__(self) -> None:
        if isinstance(self.asked, str | bytes):
            message = f"is the text {self.asked[:50]!r}, need several of them"
            raise InputError(message, field="asked", cure='give a tuple such as ("orbit:20",)')
        object.__setattr__(self, "asked", tuple(sorted(set(self.asked))))
        if self.max_error is not None:
            checked_max_error(self.max_error)
        if isinstance(self.certify, bool) or not isinstance(self.certify, int) or not 0 <= self.certify <= MAX_CERTIFY:
            raise InputError(f"is {self.certify}, need a whole number from 0 to {MAX_CERTIFY}", field="certify")
        if isinstance(self.min_opacity, bool) or not 0 <= self.min_opacity <= 1:
            raise InputError(f"is {self.min_opacity:g}, need 0 to 1", field="min_opacity")
        if isinstance(self.stride, bool) or not isinstance(self.stride, int) or self.stride not in STRIDES:
            raise InputError(f"is {self.stride}, need one of {STRIDES}", field="stride")


KEEP_ALL = Budget(None)


def checked_max_error(value: float) -> float:
    """A budget on a change of colour, 0..1. Raises `InputError`."""
    number = isinstance(value, Real) and not isinstance(value, bool)
    if not number or not 0 <= value <= 1:
        shown = f"{value:g}" if number else f"{value}"
        raise InputError(
            f"is {shown}, need 0 to 1", field="max_error", cure="1/255 = 0.0039 is one level of 8 bits; off keeps all"
        )
    return float(value)


def parse_max_error(text: str) -> float | None:
    """The budget that `text` names: a number, a fraction such as 1/255, or "off". Raises `InputError`."""
    if text.strip().lower() == "off":
        return None
    try:
        above, slash, below = text.partition("/")
        divisor = plain_float(below) if slash else 1.0
        value = plain_float(above) / divisor if math.isfinite(divisor) else math.nan
    except (ValueError, ZeroDivisionError) as error:
        raise InputError(
            f"{text[:50]!r} is not a budget", field="max_error", cure="give a change of colour such as 1/255, 0, or off"
        ) from error
    return checked_max_error(value + 0.0)  # -0 is 0
