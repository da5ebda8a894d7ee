"""Do the photographs agree with their cameras? A coarse plane sweep scores the poses against other readings of them.

Frusta alone cannot tell a capture that faces one way from its mirrored reading; the photographs can, since under wrong
poses no depth makes them match.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from ..cameras.camera import Camera
from ..cameras.depth_range import DepthRange, depth_range_of_reading
from ..cameras.pose_readings import Reading, other_orders, other_readings, turned_photographs
from ..cameras.view_checks import Notice
from ..errors import ContradictionError
from ..photographs.images import FittedView
from ..photographs.upright import UPSIDE_DOWN, upright
from .coarse_views import CoarseView, coarse_view, nearest_neighbours
from .given_range import as_if_none_given, range_doubtful
from .plane_sweep import STEP_PX, best_planes, planes, step_px
from .twins import twins
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
# So is the estimated range, over a given one: of 170 pairs of six captures right ranges lost at most 0.016 to it, of
# 124 generated scenes 0.063; the sample's twice as far, or cut to 0.6 of far, 0.13 to 0.16, others up to 0.7.
RANGE_MARGIN = 0.08
TIE = 0.03  # of the best: readings that match about equally are all named
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
    return twins(views, depths, numbers, trust_poses) + _matching(views, depths, numbers, trust_poses)


def _matching(
    views: Sequence[FittedView], depths: DepthRange, numbers: Sequence[int], trust_poses: bool
) -> list[Notice]:
    coarse = [coarse_view(view) for view in views]
    cameras = [view.camera for view in coarse]
    step = step_px(cameras, depths)  # for other readings as well: none wins by finer ones
    given = consistency(coarse, cameras, depths, step)
    doubts: list[Notice] = []
    floor, estimate = given, as_if_none_given(cameras, depths)
    if estimate is not None:
        elsewhere = consistency(coarse, cameras, estimate, step)
        inside = given or 0.0
        if elsewhere is not None and elsewhere > max(inside + RANGE_MARGIN, GOOD_SCORE):
            swept = planes(cameras, depths, PLANES, step)
            doubts = [range_doubtful(views, coarse, swept, depths, estimate, (inside, elsewhere))]
            floor = elsewhere  # which the poses are not to blame for
    if given is None or floor is None:
        no_texture = "the photographs have nothing to match in common"
        return doubts or [{"code": "no_texture", "field": "images", "message": no_texture}]
    found: list[tuple[float, Reading]] = []
    for other, seen in _readings(views, coarse, numbers, floor):
        other_depths = depth_range_of_reading(other.cameras, depths)
        score = None if other_depths is None else consistency(seen, other.cameras, other_depths, step)
        if score is None or (other.order and given < HARDLY and score < GOOD_SCORE):  # by chance, of so many
            continue
        if score > floor + MARGIN:
            found.append((score, other))
    if not found:
        if doubts or given >= HARDLY:
            return doubts
        message = f"the photographs hardly match under these cameras: score {given:.2f}, usual is 0.7 to 0.95"
        cure = "is each pose the one of its own photograph, and are near and far right?"
        return [{"code": "photos_hardly_match", "field": "cameras", "message": f"{message} ({cure})", "score": given}]
    best = max(score for score, _ in found)
    likely = [reading for score, reading in found if score >= best - TIE]
    message = f"the photographs match with score {given:.2f} under these poses and {best:.2f} under another reading"
    cure = "these look like " + "; or ".join(f"{reading.looks_like}: {reading.cure}" for reading in likely)
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


def _readings(
    views: Sequence[FittedView], coarse: Sequence[CoarseView], numbers: Sequence[int], given: float
) -> Iterator[tuple[Reading, Sequence[CoarseView]]]:
    """Other readings with what is seen under them, in the order in which they are named."""
    cameras = [view.camera for view in coarse]
    told = [number for number, view in zip(numbers, views, strict=True) if view.orientation in UPSIDE_DOWN]
    if told:
        yield turned_photographs(cameras, told), [coarse_view(_turned(view)) for view in views]
    pair = len(cameras) == 2
    orders = other_orders(cameras, numbers) if pair or given < RIGHT_SCORES[len(cameras) > 3] else ()
    for reading in [*orders, *other_readings(cameras)] if pair else [*other_readings(cameras), *orders]:
        yield reading, coarse


def _turned(view: FittedView) -> FittedView:
    """As EXIF says, where that leaves the size."""
    if view.orientation not in UPSIDE_DOWN:
        return view
    image = upright(view.image.transpose(1, 2, 0), view.orientation).transpose(2, 0, 1)
    return replace(view, image=image, mask=None if view.mask is None else upright(view.mask, view.orientation))
