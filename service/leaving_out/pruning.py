"""Leaving Gaussians out within a proved bound on the colours of certified views.

Colour at a pixel is a sum of weights times colours, and the weights with the background's add up to 1. Leaving out a
set whose weights sum to `m` frees `m`, which reappears on what is kept: no channel moves by more than `m R`, with `R`
the range of all colours and the background. The early stop of either picture adds at most its own share. The sum `m` is
measured at every pixel of every certified view, so the bound holds there and is an estimate elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..errors import InputError
from ..gaussians import Gaussians
from ..splat import Definition, Render, render
from ..splat.footprint import RADIUS_SLACK
from ..splat.options import checked_definition
from .budget import checked_max_error

SHARE = 1 / 8  # of what a pixel may lose: a Gaussian with a larger weight stays, so that sums seldom lose too much
WORTH = 0.01  # share of the Gaussians below which leaving them out does not pay for deciding which
ROUNDING = 1e-5  # of the measured sums: each alpha has the same bits in both pictures, float32 adds 3e-8 a layer
# Largest value of a band's basis functions for coefficients of norm 1: sqrt((2 l + 1) / (4 pi)), l = 1, 2, 3.
BAND_NORMS = tuple(math.sqrt((2 * band + 1) / (4 * math.pi)) for band in (1, 2, 3))


@dataclass(frozen=True, eq=False)
class Pruning:
    """Which Gaussians are kept, and what leaving the others out does to a pixel of the certified views at most."""

    keep: NDArray[np.bool_]  # (N,)
    bound: float  # colour, proved; never above the budget
    actual: float  # colour, the largest change that was found in `pictures`, over black
    unseen: int  # of those left out: had no weight at any certified pixel
    pictures: list[Render]  # with opacity, of the first cameras, after leaving out

    @property
    def dropped(self) -> int:
        """How many are left out."""
        return int((~self.keep).sum())


def colour_range(gaussians: Gaussians) -> float:
    """The largest difference of two colours among the Gaussians and any background in [0, 1], from any direction.

    Colours are not negative, and one is at most its constant band plus the norms of the others.
    """
    harmonics = gaussians.harmonics.astype(np.float64)
    if not len(harmonics):
        return 1.0
    most = 0.5 + harmonics[:, 0] / (2 * math.sqrt(math.pi))
    start = 1
    for band, norm in enumerate(BAND_NORMS[: gaussians.sh_degree], 1):
        stop = start + 2 * band + 1
        most += norm * np.linalg.norm(harmonics[:, start:stop], axis=1)
        start = stop
    return max(1.0, float(most.max()))


def prune(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    max_error: float,
    *,
    may_go: NDArray[np.bool_] | None = None,
    worth: float = WORTH,
    pictures: int = 0,
    near: float | None = None,
    definition: Definition | None = None,
    threads: int | None = None,
) -> Pruning:
    """Leave out the Gaussians of `may_go` (N,) whose weight no pixel of `cameras` misses beyond `max_error`.

    `max_error` is a change of colour, 0..1, over any background in [0, 1], in pictures that are drawn with `near` and
    `definition`. With 0 only those go that have no weight at all: the pictures keep their bits. As soon as less than
    the share `worth` is left to drop, everything is kept, and further views are not looked at. The result has the first
    `pictures` views as they are drawn afterwards. Raises `InputError`, also for a definition whose stop is exclusive:
    there a Gaussian without weight may end a pixel.

    A drawing of a view yields the weights that candidates have there and, of those that are left from the views before,
    the mass that each pixel would lose. Where that is too much, the candidates that reach the pixel stay. Leaving out
    fewer loses less at every pixel, so what was measured for a larger set holds for the smaller one.
    """
    max_error = checked_max_error(max_error)
    rule = _rule(definition, near)
    extent = colour_range(gaussians)
    # What is left for the freed mass once both pictures' early stops and the rounding of the sums are paid; rounded
    # down to float32, in which the masses are.
    mass = float(np.nextafter(np.float32(max_error / extent - 2 * rule.stop - ROUNDING), np.float32(-1)))
    mass = max(mass, 0.0)
    going = np.ones(len(gaussians), np.bool_) if may_go is None else may_go.copy()
    seen = np.zeros(len(gaussians), np.bool_)
    least = max(worth * len(gaussians), 1)
    before: list[Render] = []
    losses: list[NDArray[np.floating] | None] = []  # None where a pixel loses too much, or nothing was known yet
    for index, camera in enumerate(cameras):
        planes = ("peaks", "removed", "alpha") if index < pictures else ("peaks", "removed")
        subset = going if index else np.zeros_like(going)
        image = render(gaussians, camera, outputs=planes, subset=subset, definition=rule, threads=threads)
        going &= image.peaks <= SHARE * mass
        seen |= image.peaks > 0
        losses.append(image.removed if index and image.removed.max(initial=0.0) <= mass else None)
        if index < pictures:
            before.append(image)
        if going.sum() < least and index + 1 >= pictures:
            return _everything(len(gaussians), before)
    unseen = going & ~seen
    freed = 0.0
    if mass > 0 and (going & seen).sum() >= least:
        freed = _settle(gaussians, cameras, going, seen, losses, mass, rule, threads)
    if mass == 0 or (going & seen).sum() < least:
        if unseen.sum() < least:
            return _everything(len(gaussians), before)
        return Pruning(~unseen, 0.0, 0.0, int(unseen.sum()), before)
    kept = gaussians[~going]
    after = [
        render(kept, camera, outputs=("alpha",), definition=rule, threads=threads) for camera in cameras[:pictures]
    ]
    bound = (freed + ROUNDING + 2 * rule.stop) * extent
    return Pruning(~going, bound, largest_change(after, before), int(unseen.sum()), after)


def _settle(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    going: NDArray[np.bool_],
    seen: NDArray[np.bool_],
    losses: Sequence[NDArray[np.floating] | None],
    mass: float,
    rule: Definition,
    threads: int | None,
) -> float:
    """Take out of `going` what reaches a pixel that would lose more than `mass`; the most that a pixel loses then."""
    freed = 0.0
    for camera, known in zip(cameras, losses, strict=True):
        lost = known
        if lost is None:
            image = render(gaussians, camera, outputs=("removed",), subset=going, definition=rule, threads=threads)
            lost = image.removed
        over = lost > mass
        if over.any():
            rows = np.flatnonzero(going & seen)
            going[rows[reaches(gaussians[rows], camera, over, rule)]] = False
        freed = max(freed, float(lost[~over].max(initial=0.0)))
    return freed


def removal_bound(
    gaussians: Gaussians,
    gone: NDArray[np.bool_],
    cameras: Sequence[Camera],
    *,
    near: float | None = None,
    definition: Definition | None = None,
    threads: int | None = None,
) -> float:
    """The most that leaving out `gone` (N,) changes a colour of any pixel of `cameras`, over any background in [0, 1].

    Raises `InputError` for a definition whose stop is exclusive.
    """
    options: dict[str, Any] = {"definition": _rule(definition, near), "threads": threads}
    lost = [render(gaussians, camera, outputs=("removed",), subset=gone, **options).removed for camera in cameras]
    freed = max((float(plane.max(initial=0.0)) for plane in lost), default=0.0)
    if freed == 0:
        return 0.0
    return min(freed + ROUNDING + 2 * options["definition"].stop, 1.0) * colour_range(gaussians)


def largest_change(after: Sequence[Render], before: Sequence[Render]) -> float:
    """Of a colour between pairs of pictures."""
    return max((float(np.abs(a.rgb - b.rgb).max()) for a, b in zip(after, before, strict=True)), default=0.0)


def _everything(count: int, pictures: list[Render]) -> Pruning:
    return Pruning(np.ones(count, np.bool_), 0.0, 0.0, 0, pictures)


def _rule(definition: Definition | None, near: float | None) -> Definition:
    rule = checked_definition(definition, near, None)
    if not rule.inclusive_stop:
        raise InputError(
            "has an exclusive stop, under which what has no weight may still end a pixel",
            field="definition",
            cure="leave out for the default definition",
        )
    return rule


def reaches(gaussians: Gaussians, camera: Camera, pixels: NDArray[np.bool_], rule: Definition) -> NDArray[np.bool_]:
    """(N,) whether any of `pixels` (H, W) lies in the square about a Gaussian that holds its footprint; True also where
    it may not.

    With t the tangents of the centre's ray, the affine projection stretches by at most f / z sqrt(1 + |t|^2) (its rows
    are f / z (1, 0, -t_x) and f / z (0, 1, -t_y)); t is taken at most `fov_margin` outside the picture.
    """
    at, z = camera.project(gaussians.means)
    size = np.array([camera.width, camera.height])
    focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    widest = (np.maximum(centre, size - centre) + 0.5 * rule.fov_margin * size) / focal
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        stretch = focal.max() / z * math.sqrt(1 + float(np.square(widest).sum()))
        spread = np.sqrt(np.square(gaussians.scales.max(axis=1, initial=0.0) * stretch) + rule.dilation)
        opacity = np.maximum(gaussians.opacities.astype(np.float64) / rule.alpha_min, 1.0)
        radius = np.sqrt(2 * np.log(opacity) + RADIUS_SLACK) * spread + 1.0  # and a pixel for rounding
        low = np.clip(np.nan_to_num(np.floor(at - radius[:, None]), nan=0.0), 0, size).astype(np.intp)
        high = np.clip(np.nan_to_num(np.ceil(at + radius[:, None]), nan=np.inf), 0, size).astype(np.intp)
    counts = np.zeros((camera.height + 1, camera.width + 1), np.intp)
    counts[1:, 1:] = pixels.cumsum(axis=0).cumsum(axis=1)
    (left, top), (right, bottom) = low.T, high.T
    inside = counts[bottom, right] - counts[top, right] - counts[bottom, left] + counts[top, left]
    return (inside > 0) | ~(z > rule.near)
