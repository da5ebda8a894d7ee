"""Do the photographs agree with their cameras? A coarse plane sweep scores the poses against other readings of them.

Frusta alone cannot tell a capture that faces one way from its mirrored reading; the photographs can, since under wrong
poses no depth makes them match.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from .camera import Camera
from .coarse_views import CoarseView, coarse_view, nearest_neighbours
from .depth_range import DepthRange, depth_range_of_reading
from .errors import ContradictionError
from .images import FittedView
from .plane_sweep import STEP_PX, best_planes, planes, step_px
from .pose_readings import Reading, other_orders, other_readings
from .view_checks import Notice
from .window_match import match_score

PLANES = 32  # at least
# Scores lie in 0..1. Over 97 pairs and triples of seven real captures right poses gave 0.75..0.95, at most 0.003 less
# than a wrong reading; cut or stretched to up to eight times as wide as high they lost by less than MARGIN.
CLEAR_MARGIN = 0.15  # another reading that wins by this much,
GOOD_SCORE = 0.7  # and matches this well,
POOR_SCORE = 0.68  # where the given poses match worse than this: refused
# Other orders of three photographs are tried below the first, of more, which are many, below the second: most right
# poses score more than the one, all of the above as much as the other.
RIGHT_SCORES = (0.85, 0.75)
MARGIN = 0.06  # another reading that wins by this much: a warning
TIE = 0.03  # among other readings the one named first must lose by this much: the usual mistakes come first
PLAIN = 0.05  # of white; pictures whose values differ by less show nothing that could tell them apart
HARDLY = 0.55  # no reading matches better than this: a warning


def check_photos(
    views: Sequence[FittedView],
    depths: DepthRange,
    *,
    trust_poses: bool = False,
    numbers: Sequence[int] | None = None,
) -> list[Notice]:
    """Compare how well the photographs match under the poses and under other readings of them.

    Returns warnings; raises `ContradictionError` where another reading is right beyond doubt, or where two photographs
    of different poses are one, unless the caller says that the poses are to be trusted. What masks leave out is not
    compared. `numbers` are what the caller calls the views.
    """
    numbers = range(len(views)) if numbers is None else numbers
    return _twins(views, numbers, trust_poses) + _matching(views, depths, numbers, trust_poses)


def _twins(views: Sequence[FittedView], numbers: Sequence[int], trust_poses: bool) -> list[Notice]:
    """Photographs that are equal to the bit, and not of one colour; the poses are not, or the cameras were refused."""
    notices: list[Notice] = []
    for (i, one), (j, other) in combinations(zip(numbers, views, strict=True), 2):
        shown = one.image if one.mask is None else one.image[:, one.mask]
        if np.ptp(shown) < PLAIN or not np.array_equal(one.image, other.image):
            continue
        message = f"photographs {i} and {j} are the same picture, under poses that differ"
        cure = "was one of them sent twice? send each photograph with the pose of its own"
        if not trust_poses:
            raise ContradictionError(message, field="images", index=j, cure=cure)
        notices.append({"code": "photos_equal", "field": "images", "index": j, "message": f"{message} ({cure})"})
    return notices


def _matching(
    views: Sequence[FittedView], depths: DepthRange, numbers: Sequence[int], trust_poses: bool
) -> list[Notice]:
    coarse = [coarse_view(view) for view in views]
    cameras = [view.camera for view in coarse]
    step = step_px(cameras, depths)  # for other readings as well: none wins by finer ones
    given = consistency(coarse, cameras, depths, step)
    if given is None:
        return [{"code": "no_texture", "field": "images", "message": "the photographs have nothing to match in common"}]
    best, reading = given + MARGIN, None
    for other in _readings(cameras, numbers, given):
        other_depths = depth_range_of_reading(other.cameras, depths)
        score = None if other_depths is None else consistency(coarse, other.cameras, other_depths, step)
        if score is None or (other.order and given < HARDLY and score < GOOD_SCORE):  # by chance, of so many
            continue
        if score > best + (TIE if reading is not None else 0.0):
            best, reading = score, other
    if reading is None:
        if given >= HARDLY:
            return []
        message = f"the photographs hardly match under these cameras: score {given:.2f}, usual is 0.7 to 0.95"
        cure = "is each pose the one of its own photograph, and are near and far right?"
        return [{"code": "photos_hardly_match", "field": "cameras", "message": f"{message} ({cure})", "score": given}]
    message = f"the photographs match with score {given:.2f} under these poses and {best:.2f} under another reading"
    cure = f"these look like {reading.looks_like}: {reading.cure}"
    beyond_doubt = given < POOR_SCORE and best >= GOOD_SCORE and best - given >= CLEAR_MARGIN
    if beyond_doubt and not trust_poses:
        cure += "; if the poses are right as they are, set trust_poses"
        raise ContradictionError(message, field="cameras", cure=cure, score=given, other_score=best)
    return [{"code": "poses_doubtful", "field": "cameras", "message": f"{message} ({cure})", "score": given}]


def consistency(
    views: Sequence[CoarseView], cameras: Sequence[Camera], depths: DepthRange, step: float = STEP_PX
) -> float | None:
    """Mean match score of every view with its nearest neighbour, None where nothing overlaps or has texture.

    The planes are about `step` px of parallax apart, unless they become too many.
    """
    views = [replace(view, camera=camera) for view, camera in zip(views, cameras, strict=True)]
    swept = planes(cameras, depths, PLANES, step)
    total, weight = 0.0, 0.0
    for view, neighbour in zip(views, nearest_neighbours(cameras), strict=True):
        best, _ = best_planes(view, views[neighbour], swept)
        score, amount = match_score(view.grey, best, view.kept)
        total, weight = total + score * amount, weight + amount
    return total / weight if weight > 0 else None


def _readings(cameras: Sequence[Camera], numbers: Sequence[int], given: float) -> Iterator[Reading]:
    yield from other_readings(cameras)
    if len(cameras) == 2 or given < RIGHT_SCORES[len(cameras) > 3]:
        yield from other_orders(cameras, numbers)
