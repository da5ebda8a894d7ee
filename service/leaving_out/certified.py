"""Which views a scene's bounds hold for: its inputs, views on the path between them, and those that were asked for."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise

from ..cameras.camera import Camera
from ..viewpoints.views import between


def certified_views(cameras: Sequence[Camera], certify: int, asked: Sequence[Camera] = ()) -> list[Camera]:
    """The inputs, then `certify` views at equal steps between each and the next, then those asked for."""
    return [*cameras, *views_between(pairwise(cameras), certify), *asked]


def views_between(ways: Iterable[tuple[Camera, Camera]], count: int) -> list[Camera]:
    """`count` views at equal steps on each way from one camera to another.

    The middle of each way comes first among its views: where it shows that all is needed, the others are not drawn.
    """
    steps = sorted((step / (count + 1) for step in range(1, count + 1)), key=lambda share: abs(share - 0.5))
    ways = list(ways)
    return [between(first, second, share) for share in steps for first, second in ways]
