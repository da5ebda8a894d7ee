"""What the benchmarks' command lines share, without torch: what is out of bounds is wrong usage, told at once, and a
refusal is a line."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from gapmes.service.cameras.view_checks import MAX_VIEWS, MIN_VIEWS
from gapmes.service.errors import GapmesError
from gapmes.service.mending.fade_passes import MAX_PASSES


@contextmanager
def refusals_told() -> Iterator[None]:
    """End the process with a line on stderr and exit code 1 where the project or the system refuses something."""
    try:
        yield
    except (GapmesError, OSError) as error:
        raise SystemExit(f"error: {error}") from error


def _between(least: int, most: float = math.inf) -> Callable[[str], int]:
    def number(text: str) -> int:
        value = int(text)
        if not least <= value <= most:
            need = f"at least {least}" if value < least else f"at most {most}"
            raise argparse.ArgumentTypeError(f"is {value}, need {need}")
        return value

    number.__name__ = "whole number"  # argparse's name of it, for text that is no number
    return number


at_least_one = _between(1)
none_or_more = _between(0)
view_count = _between(MIN_VIEWS, MAX_VIEWS)
passes = _between(0, MAX_PASSES)


def there(text: str) -> Path:
    """A file or folder that exists."""
    if not Path(text).exists():
        raise argparse.ArgumentTypeError(f"{text} does not exist")
    return Path(text)


def model_files(*, least: int = 2, most: int = 2) -> Callable[[str], tuple[Path, ...]]:
    """So many files that exist, with = between them."""

    def files(text: str) -> tuple[Path, ...]:
        parts = text.split("=")
        if not least <= len(parts) <= most:
            need = f"need {least}" if least == most else f"need {least} to {most}"
            raise argparse.ArgumentTypeError(f"{text} names {len(parts)} files, {need}, with = between them")
        return tuple(map(there, parts))

    return files


def duration(text: str) -> float:
    """A time above 0, and finite."""
    value = float(text)
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"is {value:g}, need more than 0")
    return value
