"""Do the photographs agree with their cameras? A coarse plane sweep scores the poses against other readings of them.

Frusta alone cannot distinguish a forward-facing capture from its mirrored reading; photographs can, since under wrong
poses they match at no depth.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..cameras.depth_range import DepthRange, depth_range_of_reading
from ..cameras.pose_readings import (
    Reading,
    other_orders,
    other_readings,
    robot_readings,
    turned_photographs,
    with_cures,
)
from ..cameras.view_checks import MIN_VIEWS, Notice
from ..errors import ContradictionError
from ..photographs.images import FittedView
from ..photographs.upright import ON_ITS_SIDE, SAME_SIZE, upright
from .coarse_views import CoarseView, coarse_view, nearest_neighbours
from .duplicates import duplicates
from .given_range import estimated_instead, range_doubtful
from .plain_views import plain_notices, plain_views
from .plane_sweep import STEP_PX, best_planes, plane_depths, step_px
from .window_match import match_score

PLANES = 32  # at least
# Scores lie in 0..1. Over 97 pairs and triples of seven real captures right poses gave 0.75..0.95, at most 0.003 less
# than a wrong reading; cut or stretched to up to eight times as wide as high they lost by less than MARGIN.
CLEAR_MARGIN = 0.15  # another reading that wins by this much,
GOOD_SCORE = 0.7  # and matches this well,
POOR_SCORE = 0.68  # where the given poses match worse than this: refused
# Other orders of three photographs are tried below the first, of more, which are many, below the second: most right
# poses score more than the one, all of the above as much as the other. The axes of a robot, whose range takes many
# planes, are tried below the first: 120 pairs and triples of five captures in such axes gave at most 0.83.
RIGHT_SCORES = (0.85, 0.75)
MARGIN = 0.06  # another reading that wins by this much: a warning
# So is the estimated range, over a given one: of 170 pairs of six captures right ranges lost at most 0.016 to it, of
# 124 generated scenes 0.063; the sample's twice as far, or cut to 0.6 of far, 0.13 to 0.16, others up to 0.7.
RANGE_MARGIN = 0.08
TIE = 0.03  # of the best: readings that match about equally are all named
# No reading matches better than this: a warning. 140 right pairs of five captures have 0.73 and more, 16 pairs of
# photographs of two scenes 0.63 and less; of a hundred generated pairs, which show more that is plain, five have less.
HARDLY = 0.64
# A view of three or more that matches none of the others better: a warning. Of 48 right triples of six captures every
# view has 0.73 or more, photographs of another scene in their midst 0.28 to 0.67.
ODD = 0.68


def check_photos(
    views: Sequence[FittedView],
    depths: DepthRange,
    *,
    trust_poses: bool = False,
    numbers: Sequence[int] | None = None,
) -> list[Notice]:
    """Warnings from how well the photographs match under the poses, compared with other readings of them.

    Raises `ContradictionError`, unless `trust_poses`, where another reading is right beyond doubt or two photographs of
    different poses are identical. Masked pixels are not compared. `numbers` are what the caller calls the views.
    """
    numbers = range(len(views)) if numbers is None else numbers
    coarse = [coarse_view(view) for view in views]
    notices = duplicates(views, depths, numbers, trust_poses) + plain_notices(coarse, numbers)
    # As somebody's nearest neighbour a plain view would refute right poses.
    places = [place for place, plain in enumerate(plain_views(coarse)) if not plain]
    if len(places) < MIN_VIEWS:
        return notices
    shown, their_numbers = [views[place] for place in places], [numbers[place] for place in places]
    return notices + _matching(shown, [coarse[place] for place in places], depths, their_numbers, trust_poses)


def _matching(
    views: Sequence[FittedView],
    coarse: Sequence[CoarseView],
    depths: DepthRange,
    numbers: Sequence[int],
    trust_poses: bool,
) -> list[Notice]:
    """The warnings of `check_photos` about anything but duplicates and plain views."""
    cameras = [view.camera for view in coarse]
    step = step_px(cameras, depths)  # for other readings as well: none wins by finer ones
    swept = plane_depths(cameras, depths, PLANES, step)
    scores = view_scores(coarse, cameras, depths, step)
    given = _mean(scores)
    doubts, floor = _range_doubts(views, coarse, swept, depths, step, given or 0.0)
    if given is None:
        no_texture = "the photographs have nothing to match in common"
        return doubts or [{"code": "no_texture", "field": "images", "message": no_texture}]
    better: list[tuple[float, Reading]] = []
    for other, seen in _readings(views, coarse, numbers, floor):
        other_depths = depth_range_of_reading(other.cameras, depths)
        score = None if other_depths is None else consistency(seen, other.cameras, other_depths, step)
        if score is None or (given < HARDLY and score < (GOOD_SCORE if other.order else HARDLY)):
            continue  # by chance; of orders there are many
        if score > floor + MARGIN:
            better.append((score, other))
    if better:
        return [_other_reading(better, given, trust_poses)]
    odd = [] if doubts else _odd(coarse, scores, swept, numbers)
    if doubts or given >= HARDLY or 0 < len(odd) < len(views) - 1:  # the others match each other
        return doubts or odd
    message = f"the photographs hardly match under these cameras: score {given:.2f}, usual is 0.7 to 0.95"
    cure = "do all show one scene, is each pose the one of its own photograph, and are near and far right?"
    return [{"code": "photos_hardly_match", "field": "cameras", "message": f"{message} ({cure})", "score": given}]


def _range_doubts(
    views: Sequence[FittedView],
    coarse: Sequence[CoarseView],
    swept: NDArray[np.float64],
    depths: DepthRange,
    step: float,
    given: float,
) -> tuple[list[Notice], float]:
    """The warning about a given range, where there is reason for one, and the score that other readings have to beat:
    `given`, that of the poses in this range, or that in the estimated range, which the poses are not to blame for."""
    cameras = [view.camera for view in coarse]
    estimate = estimated_instead(cameras, depths)
    elsewhere = None if estimate is None else consistency(coarse, cameras, estimate, step)
    if estimate is None or elsewhere is None or elsewhere <= max(given + RANGE_MARGIN, GOOD_SCORE):
        return [], given
    return [range_doubtful(views, coarse, swept, depths, estimate, (given, elsewhere))], elsewhere


def _other_reading(better: Sequence[tuple[float, Reading]], given: float, trust_poses: bool) -> Notice:
    """The warning about other readings with `better` scores than the `given` one, all those that match about equally.
    Raises `ContradictionError` instead where the best is right beyond doubt, unless `trust_poses`."""
    best = max(score for score, _ in better)
    message = f"the photographs match with score {given:.2f} under these poses and {best:.2f} under another reading"
    cure = f"these look like {with_cures(reading for score, reading in better if score >= best - TIE)}"
    beyond_doubt = given < POOR_SCORE and best >= GOOD_SCORE and best - given >= CLEAR_MARGIN
    if beyond_doubt and not trust_poses:
        cure += "; if the poses are right as they are, set trust_poses"
        raise ContradictionError(message, field="cameras", cure=cure, score=given, other_score=best)
    return {"code": "poses_doubtful", "field": "cameras", "message": f"{message} ({cure})", "score": given}


def consistency(
    views: Sequence[CoarseView], cameras: Sequence[Camera], depths: DepthRange, step: float = STEP_PX
) -> float | None:
    """Mean match score of the views with their nearest neighbours, under `cameras`; None without overlap or texture.

    The planes are at most about `step` px of parallax apart, within the limit of `plane_depths`.
    """
    return _mean(view_scores(views, cameras, depths, step))


def view_scores(
    views: Sequence[CoarseView], cameras: Sequence[Camera], depths: DepthRange, step: float
) -> list[tuple[float, float]]:
    """Per view its match score with its nearest neighbour, and the score's weight; arguments as for `consistency`."""
    views = [replace(view, camera=camera) for view, camera in zip(views, cameras, strict=True)]
    swept = plane_depths(cameras, depths, PLANES, step)
    return [_score(view, views[near], swept) for view, near in zip(views, nearest_neighbours(cameras), strict=True)]


def _score(view: CoarseView, other: CoarseView, swept: NDArray[np.float64]) -> tuple[float, float]:
    return match_score(view.grey, best_planes(view, other, swept)[0], view.kept)


def _mean(scores: Sequence[tuple[float, float]]) -> float | None:
    weight = sum(amount for _, amount in scores)
    return sum(score * amount for score, amount in scores) / weight if weight > 0 else None


def _odd(
    views: Sequence[CoarseView],
    scores: Sequence[tuple[float, float]],
    swept: NDArray[np.float64],
    numbers: Sequence[int],
) -> list[Notice]:
    """Of three views or more, a warning about each that matches none of the others; `scores` are `view_scores`, `swept`
    (D,) the z-depths of the planes."""
    notices: list[Notice] = []
    nearest = nearest_neighbours([view.camera for view in views])
    for index, (score, amount) in enumerate(scores):
        if len(views) <= MIN_VIEWS or score >= ODD or amount == 0:
            continue
        best = max(_score(views[index], other, swept)[0] for place, other in enumerate(views) if place != index)
        if best < ODD:
            message = f"view {numbers[index]} hardly matches any of the others: score {best:.2f}, usual is 0.7 to 0.95"
            cure = (
                f"is it a photograph of this scene, and are its pose and that of view {numbers[nearest[index]]}, the "
                "nearest, right? leave out which is not"
            )
            where: Notice = {"field": "images", "index": numbers[index], "score": best}
            notices.append({"code": "view_hardly_matches", "message": f"{message} ({cure})", **where})
    return notices


def _readings(
    views: Sequence[FittedView], coarse: Sequence[CoarseView], numbers: Sequence[int], given: float
) -> Iterator[tuple[Reading, Sequence[CoarseView]]]:
    """Other readings, each with the coarse views under it, in the order in which a cure names them; `given` is the
    score that they have to beat."""
    cameras = [view.camera for view in coarse]
    turned = [number for number, view in zip(numbers, views, strict=True) if _may_be_turned(view)]
    if turned:
        yield turned_photographs(cameras, turned), [coarse_view(_turned(view)) for view in views]
    pair = len(cameras) == 2
    orders = other_orders(cameras, numbers) if pair or given < RIGHT_SCORES[len(cameras) > 3] else ()
    robot = robot_readings(cameras) if given < RIGHT_SCORES[0] else ()
    readings = (*other_readings(cameras), *robot)
    for reading in (*orders, *readings) if pair else (*readings, *orders):
        yield reading, coarse


def _may_be_turned(view: FittedView) -> bool:
    """Whether the EXIF orientation would turn the photograph without changing its size."""
    square = view.image.shape[1] == view.image.shape[2]
    return view.orientation in SAME_SIZE or (square and view.orientation in ON_ITS_SIDE)


def _turned(view: FittedView) -> FittedView:
    """`view` turned as EXIF says, if that keeps its size."""
    if not _may_be_turned(view):
        return view
    image = upright(view.image.transpose(1, 2, 0), view.orientation).transpose(2, 0, 1)
    return replace(view, image=image, mask=None if view.mask is None else upright(view.mask, view.orientation))
