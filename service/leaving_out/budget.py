"""The budget of pruning: the largest change of colour, and the views for which that bound is proved."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..arguments import listed, of_type, real_number, shown, whole_number
from ..errors import InputError
from ..plain_number import plain_float
from .stride import STRIDES

DEFAULT_MAX_ERROR = 1 / 255  # one level of an 8-bit picture
DEFAULT_CERTIFY = 1  # views between two neighbouring inputs: what only these views see is kept
MAX_CERTIFY = 30


@dataclass(frozen=True)
class Budget:
    """Which Gaussians may be pruned. Raises `InputError` for numbers out of range."""

    max_error: float | None = DEFAULT_MAX_ERROR  # largest change of a colour in the certified views; None: keep all
    certify: int = DEFAULT_CERTIFY  # certified views between two neighbouring inputs
    asked: tuple[str, ...] = ()  # further certified views, such as "orbit:20"; sorted, without duplicates
    min_opacity: float = 0.0  # fainter Gaussians are removed whatever that changes; the change is bounded and reported
    stride: int = 1  # one Gaussian per stride x stride pixels: a different model, for which there is no bound

    def __post_init__(self) -> None:
        if isinstance(self.asked, str | bytes):
            message = f"is the text {self.asked[:50]!r}, need several of them"
            raise InputError(message, field="asked", cure='give a tuple such as ("orbit:20",)')
        asked = listed(self.asked, "asked")
        for index, view in enumerate(asked):
            if not isinstance(view, str):
                cure = 'views are named by text, such as "1.5" or "orbit:20"'
                raise InputError(f"is {shown(view)}, need text", field="asked", index=index, cure=cure)
        max_error = None if self.max_error is None else checked_max_error(self.max_error, "; None keeps all")
        certify, stride = whole_number(self.certify), whole_number(self.stride)
        if certify is None or not 0 <= certify <= MAX_CERTIFY:
            raise InputError(f"is {shown(self.certify)}, need a whole number from 0 to {MAX_CERTIFY}", field="certify")
        min_opacity = _share(self.min_opacity, "min_opacity")
        if stride not in STRIDES:
            raise InputError(f"is {shown(self.stride)}, need one of {STRIDES}", field="stride")
        plain = {"max_error": max_error, "certify": certify, "min_opacity": min_opacity, "stride": stride}
        for name, value in {"asked": tuple(sorted(set(asked))), **plain}.items():
            object.__setattr__(self, name, value)


def checked_budget(budget: Budget | None) -> Budget:
    """`budget`, or the default one for None. Raises `InputError` for anything else."""
    if budget is None:
        return Budget()
    return of_type(budget, Budget, "budget", "give a Budget, or leave it out for the default one")


def checked_max_error(value: float, keeps_all: str = "") -> float:
    """`value` as a float in [0, 1]; `keeps_all` says how else everything is kept. Raises `InputError`."""
    return _share(value, "max_error", f"1/255 = 0.0039 is one level of 8 bits{keeps_all}")


def parse_max_error(text: str) -> float | None:
    """Parse a number, a fraction such as 1/255, or "off" (None). Raises `InputError`."""
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
    return checked_max_error(value + 0.0, "; off keeps all")  # -0 is 0


def _share(value: float, field: str, cure: str | None = None) -> float:
    number = real_number(value)
    if number is None or not 0 <= number <= 1:
        told = shown(value) if number is None else f"{number:g}"
        raise InputError(f"is {told}, need 0 to 1", field=field, cure=cure)
    return number


KEEP_ALL = Budget(None)
