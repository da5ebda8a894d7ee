"""The certified views, for which the bounds hold: the inputs, views interpolated between them, and requested ones."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise

from ..cameras.camera import Camera
from ..viewpoints.views import between


def certified_views(cameras: Sequence[Camera], certify: int, asked: Sequence[Camera] = ()) -> list[Camera]:
    """The inputs `cameras`, then `certify` equidistant views between each and the next, then `asked`."""
    return [*cameras, *views_between(pairwise(cameras), certify), *asked]


def views_between(pairs: Iterable[tuple[Camera, Camera]], count: int) -> list[Camera]:
    """`count` equidistant views between the two cameras of each pair.

    The views nearest to the middle come first: where these need every Gaussian, `prune` does not draw the others.
    """
    steps = sorted((step / (count + 1) for step in range(1, count + 1)), key=lambda share: abs(share - 0.5))
    pairs = list(pairs)
    return [between(first, second, share) for share in steps for first, second in pairs]
