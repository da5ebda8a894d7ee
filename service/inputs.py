"""From photographs and cameras to the inputs of a scene: on its grid, checked against each other, equalised."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from .cameras.camera import Camera
from .cameras.depth_range import DepthRange
from .cameras.other_size import told_first
from .cameras.view_checks import DEPTH_PLANES, Notice, range_notices
from .errors import ContradictionError
from .matching.depth_sweep import coarse_notices, narrowed
from .matching.exposures import equalised
from .matching.inexact_poses import doubted, inexact_poses
from .matching.missed_depths import missed_depths
from .matching.pair_matches import PairMatches
from .matching.photo_checks import check_photos
from .matching.refined_poses import refined_cameras
from .matching.sharpness import less_sharp, views_less_sharp
from .network.model_info import ModelInfo
from .photographs.fitting import FittedPhotos, Picture, fitted_photos
from .photographs.rolled import quarter_turns, turned_photos
from .photographs.whole import view_shapes


@dataclass(frozen=True, eq=False)
class Inputs:
    """Photographs on the scene's grid, and what matching them has shown."""

    photos: FittedPhotos  # at one exposure, as their cameras stand
    turned: FittedPhotos  # the same, turned by quarter turns to stand alike (`rolled.py`)
    turns: list[int]  # counterclockwise quarter turns of each
    depths: DepthRange  # narrowed to where the photographs match
    warnings: list[Notice]


def prepared_inputs(
    images: Sequence[Picture],
    cameras: Sequence[Camera],
    numbers: Sequence[int],
    depths: DepthRange,
    info: ModelInfo,
    *,
    detail: int,
    finer: int,
    trust_poses: bool,
    refine_poses: bool,
    whole: bool,
    done: Callable[[int], None],
) -> Inputs:
    """Fit, check and equalise V photographs of V cameras for the network of `info`.

    `depths` is the range as given or estimated from the cameras; `detail`, `finer` and `done` are those of
    `fitted_photos`, `trust_poses` that of `check_photos`; `numbers` are what the caller calls the views. With
    `refine_poses` cameras that are doubted, and nothing else is, are replaced by `refined_cameras`, with `whole`
    False photographs are cropped to the network's shape. Raises `ImageError` for a photograph that cannot be used and
    `ContradictionError` where the photographs refute the poses.
    """
    turns = quarter_turns(cameras, square=info.height == info.width)
    shapes = view_shapes(cameras, turns, info.shape) if whole else [info.shape] * len(cameras)
    fitted = fitted_photos(images, cameras, numbers, shapes, detail, finer=finer, done=done)
    given = turned_photos(fitted, turns)  # of one shape, which what follows needs
    try:
        doubts = check_photos(given.seen, depths, trust_poses=trust_poses, numbers=numbers)
    except ContradictionError as error:
        if error.field == "cameras":  # else two photographs are one
            told_first(cameras, error)
        raise
    planes = info.depth_planes or DEPTH_PLANES
    found = narrowed(depths, given.seen, planes)
    pairs = PairMatches(given.seen, found)
    inexact = [] if doubts else doubted(pairs, views_less_sharp(pairs).keys())
    refined = refined_cameras(pairs, inexact, numbers) if refine_poses else None
    told: list[Notice] = []
    if refined is not None:
        given, told = given.with_cameras(refined[0]), [refined[1]]
        found = narrowed(depths, given.seen, planes)
        pairs = PairMatches(given.seen, found)
        inexact = doubted(pairs, views_less_sharp(pairs).keys())
    told += inexact_poses(pairs, inexact, numbers, tried=refine_poses)
    turned, exposure = equalised(given, pairs, numbers)
    warnings = [
        *given.notices,
        *range_notices(found, planes),
        *coarse_notices(depths, found, given.seen, planes),
        *(doubts or [*told, *([] if inexact else missed_depths(pairs)), *less_sharp(pairs, numbers)]),
        *exposure,
    ]
    return Inputs(turned_photos(turned, [-turn for turn in turns]), turned, turns, found, warnings)
