"""Pruning of Gaussians within a proved bound on the change of colour in certified views.

A pixel's colour is a convex combination: blending weights times colours, where the weights and that of the background
sum to 1. Removing a set with the total weight `m` redistributes `m` over what remains, so no channel changes by more
than `m R`, with `R` the range of all colours and the background. The pruned picture has at least the transmittance of
the full one at every layer and stops no earlier, so early stopping adds what it hides once. Rounding of both pictures
is added. The mass `m` is measured at every pixel of every certified view: there the bound holds, elsewhere it is an
estimate.
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

SHARE = 1 / 8  # of the mass that a pixel may lose: Gaussians of larger weight are kept, so that sums rarely exceed it
WORTH = 0.01  # share of the Gaussians below which pruning them costs more than it saves
EPSILON = 2.0**-24  # unit roundoff of float32
# Largest value of a band's basis functions for coefficients of norm 1: sqrt((2 l + 1) / (4 pi)), l = 1, 2, 3.
BAND_NORMS = tuple(math.sqrt((2 * band + 1) / (4 * math.pi)) for band in (1, 2, 3))


@dataclass(frozen=True, eq=False)
class Pruning:
    """Which Gaussians are kept, and the largest change of colour in the certified views."""

    keep: NDArray[np.bool_]  # (N,)
    bound: float  # proved bound on the change of a colour; never above the budget
    actual: float  # largest change of a colour measured in `pictures`, over black
    unseen: int  # removed Gaussians without weight at any certified pixel
    pictures: list[Render]  # colour and opacity from the first cameras, after pruning

    @property
    def dropped(self) -> int:
        """Number of removed Gaussians."""
        return int((~self.keep).sum())


def colour_range(gaussians: Gaussians) -> float:
    """Upper bound on the difference of two colours, over all Gaussians, directions and backgrounds in [0, 1].

    Colours are clamped at 0 from below; each is at most its constant band plus the norms of the others.
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
    """Remove Gaussians of the mask `may_go` (N,) such that no pixel of `cameras` changes by more than `max_error`.

    `max_error` bounds the change of a colour, 0..1, over any background in [0, 1], in pictures drawn with `near` and
    `definition`. With 0 only Gaussians without any weight are removed, and pictures are equal to the bit. When fewer
    than the share `worth` of all remain as candidates, everything is kept and no further view is drawn. The result has
    renders of the first `pictures` views after pruning. Raises `InputError`, also for a definition with an exclusive
    stop, under which a Gaussian without weight may end a pixel.

    Rendering a view gives each candidate's peak weight and, for the candidates left by the views before, the mass that
    each pixel would lose. Candidates that reach a pixel that would lose too much are kept. The lost mass decreases
    monotonically with the set removed, so a value measured for a larger set bounds that of a subset.
    """
    max_error = checked_max_error(max_error)
    rule = _rule(definition, near)
    extent = colour_range(gaussians)
    stretch, rest = _rounding_terms(rule, len(gaussians))
    # What is left for the freed mass once the early stop and the rounding are paid; rounded down to float32, in which
    # the masses are.
    mass = float(np.nextafter(np.float32((max_error / extent - rest) / stretch), np.float32(-1)))
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
    bound = (freed * stretch + rest) * extent
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
    """Remove from `going`, in place, what reaches a pixel that would lose more than `mass`; returns the largest loss of
    any pixel afterwards. `losses` are the planes (H, W) known so far, None where one must be rendered."""
    freed = 0.0
    for camera, lost in zip(cameras, losses, strict=True):
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
    """Bound on the change of any colour in `cameras` when `gone` (N,) is removed, over any background in [0, 1].

    Raises `InputError` for a definition whose stop is exclusive.
    """
    rule = _rule(definition, near)
    stretch, rest = _rounding_terms(rule, len(gaussians))
    options: dict[str, Any] = {"definition": rule, "threads": threads}
    lost = [render(gaussians, camera, outputs=("removed",), subset=gone, **options).removed for camera in cameras]
    freed = max((float(plane.max(initial=0.0)) for plane in lost), default=0.0)
    if freed == 0:
        return 0.0
    return min(freed * stretch + rest, 1.0) * colour_range(gaussians)


def rounding(rule: Definition, count: int) -> float:
    """Bound on the float32 rounding error of a colour blended from `count` Gaussians, as a share of `R`, for given
    alphas.

    A layer rounds the accumulated colour, at most (1 - T) R, and the transmittance T, which scales at most T R:
    together `EPSILON` R. The weights, which sum to 1, and the background add as much again, and all layers behind a
    transmittance of `EPSILON` no more than that. Alphas of at least `alpha_min`, within a relative error of 1e-4, limit
    the number of layers in front of the stop.
    """
    fall = (1 - 1e-4) * rule.alpha_min - EPSILON  # of T, as a share, at least
    layers = count if fall <= 0 else min(count, math.ceil(-math.log(max(rule.stop, EPSILON)) / fall) + 1)
    return EPSILON * (layers + 4)


def _rounding_terms(rule: Definition, count: int) -> tuple[float, float]:
    """Factor on a measured mass for its rounding and that of the weights, and the term that both pictures add."""
    each = rounding(rule, count)
    return 1 + 2 * each, (1 + each) * rule.stop + 2 * each


def largest_change(after: Sequence[Render], before: Sequence[Render]) -> float:
    """Largest absolute difference of a colour between corresponding renders."""
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
    """(N,) conservative test: False only where no pixel of the mask `pixels` (H, W) lies in the bounding square of a
    Gaussian's footprint.

    With t the tangents of the centre's ray, the affine projection has a norm of at most f / z sqrt(1 + |t|^2) (its rows
    are f / z (1, 0, -t_x) and f / z (0, 1, -t_y)); t is clamped to `fov_margin` outside the picture. The mask is summed
    over squares by its integral image.
    """
    at, z = camera.project(gaussians.means)
    size = np.array([camera.width, camera.height])
    focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    widest = (np.maximum(centre, size - centre) + 0.5 * rule.fov_margin * size) / focal
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        stretch = focal.max() / z * math.sqrt(1 + float(np.square(widest).sum()))
        spread = np.sqrt(np.square(gaussians.scales.max(axis=1, initial=0.0) * stretch) + rule.dilation)
        opacity = np.maximum(gaussians.opacities.astype(np.float64) / rule.alpha_min, 1.0)
        radius = np.sqrt(2 * np.log(opacity) + RADIUS_SLACK) * spread + 1.0  # plus one pixel for rounding
        low = np.clip(np.nan_to_num(np.floor(at - radius[:, None]), nan=0.0), 0, size).astype(np.intp)
        high = np.clip(np.nan_to_num(np.ceil(at + radius[:, None]), nan=np.inf), 0, size).astype(np.intp)
    counts = np.zeros((camera.height + 1, camera.width + 1), np.intp)
    counts[1:, 1:] = pixels.cumsum(axis=0).cumsum(axis=1)
    (left, top), (right, bottom) = low.T, high.T
    inside = counts[bottom, right] - counts[top, right] - counts[bottom, left] + counts[top, left]
    return (inside > 0) | ~(z > rule.near)
