"""Optimise opacities and base colours so that the scene, rendered from its inputs' cameras, matches the photographs.

A Gaussian of one view whose depth is wrong occludes, in another view, what that one shows correctly: it should lose
opacity. Opacities never rise above the network's, so that no Gaussian becomes opaque to fit a single photograph.
Colours follow one pass later: what is about to fade is not first given the colour that it hides. Between the inputs,
where there is no photograph, renders of what two views confirm (`anchors.py`) are the targets. The last passes compare
with the photographs at a second resolution as well, against overfitting to one pixel grid.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..gaussians import Gaussians
from ..harmonics import C0
from ..photographs.images import FittedView, PackedView
from ..splat import Definition, Leverage
from .anchors import Anchors
from .fade_passes import DEFAULT_PASSES, checked_passes
from .heavy_ball import HeavyBall
from .targets import Targets

STEP = 0.6  # of the Newton step that treats each Gaussian as the only variable
DAMPING = 0.05  # in units of one channel of one pixel: Gaussians that change the pictures less hardly fade
# Least share of its opacity that a Gaussian behind the scene keeps, for views between the inputs: a sheet of 0.97 then
# still stops more than half of the light, and is no hole.
BEHIND_KEEPS = 0.55
ANCHORED = 1.5  # weight of a pixel of an anchor: a few pictures stand for all views between the inputs
COLOUR_STEP = 1.6  # of the mean residual over the pixels that show a Gaussian, which share it with other Gaussians
COLOUR_DAMPING = 0.05  # in pixels: a Gaussian of which less is visible in all keeps most of its colour
RESIZED_ROUNDS = 3  # last rounds that use the second resolution: as good as in all rounds, and cheaper
RESIZED_SHARE = 0.25  # least share of the weight for the second resolution
OWN_SHARE = 0.4  # share for a larger one to which the photographs were not enlarged: it has new information


@dataclass(frozen=True, eq=False)
class Fading:
    """The scene with changed opacities and base colours, and statistics of the changes."""

    gaussians: Gaussians
    passes: int
    halved: int  # lost half of their opacity or more
    gone: NDArray[np.bool_]  # (N,) became too faint to be drawn
    mean_opacity: tuple[float, float]  # before, after
    recoloured: float  # mean absolute change of a base colour's channel, in [0, 1]

    def document(self) -> dict[str, Any]:
        """Plain JSON values."""
        return {
            "passes": self.passes,
            "halved": self.halved,
            "gone": int(self.gone.sum()),
            "mean_opacity": [round(value, 6) for value in self.mean_opacity],
            "recoloured": round(self.recoloured, 6),
        }


def faded(
    gaussians: Gaussians,
    views: Sequence[FittedView],
    passes: int = DEFAULT_PASSES,
    *,
    behind: NDArray[np.bool_] | None = None,
    resized: Sequence[PackedView] = (),
    anchors: Anchors | None = None,
    near: float | None = None,
    threads: int | None = None,
    done: Callable[[int], None] | None = None,
) -> Fading:
    """Fit opacities and base colours to the photographs of `views`.

    A pass renders every view once and changes each opacity o by -STEP sum(w r J) / (sum(w J^2) + DAMPING), clipped to
    between 0 and its initial value, or from BEHIND_KEEPS of that for Gaussians `behind` (N,) the scene. J = dC/do; r is
    the residual, the render clipped to [0, 1] minus the photograph; sums run over all pixels and channels of all views,
    with weights w and backgrounds as in `Targets`. One pass later (after the last pass in a round of its own) each
    channel of the base colour changes by -COLOUR_STEP sum(w r s) / (sum(w s) + COLOUR_DAMPING), with s = T a of
    `leverage`, clipped to [0, 1] unless it was outside (simultaneous iterative reconstruction, Gilbert 1972); this
    includes Gaussians behind the scene, which novel views see past occluding edges. Both updates have momentum
    (`HeavyBall`). A Gaussian that became too faint to be drawn has no gradient, and stays so.

    In the last RESIZED_ROUNDS rounds the sums also run over `resized`, the same photographs at another resolution, one
    for all. These get RESIZED_SHARE of the weight, normalised by area, and `views` the rest; up to OWN_SHARE if they
    are larger and the photographs were not enlarged to that size (`FittedView.step`).

    For the opacities of `anchors.may_fade` the sums also run over the anchors' pictures, with weight ANCHORED. `near`
    and `threads` are those of `render`; `done` receives the number of rounds done, passes + 1 in all. The bits do not
    depend on the number of threads.

    Raises `InputError` for a number of passes that is out of range.
    """
    checked_passes(passes)
    before, own = gaussians.opacities, _base_colours(gaussians)
    opacities = HeavyBall(before, 0.0 if behind is None else np.where(behind, BEHIND_KEEPS * before, 0), before)
    colours = HeavyBall(own, 0.0, 1.0)
    photographs, anchored = _Photographs(views, resized), Targets(() if anchors is None else anchors.pictures)
    for number in range(passes + 1 if passes else 0):
        now = _changed(gaussians, opacities.now, colours.now - own)
        between = (0.0, 0.0) if number == passes else _between(now, anchors, anchored, near, threads)
        sums = photographs.sums(now, near, threads, at_both=number > passes - RESIZED_ROUNDS)
        if number:
            colours.move(-_finite(COLOUR_STEP * sums.excess, (sums.shown + COLOUR_DAMPING)[:, None]))
        if number < passes:
            with np.errstate(invalid="ignore"):
                step = _finite(STEP * (sums.slope + between[0]), sums.moved + between[1] + DAMPING)
            opacities.move(-step)
        del now, between, sums  # what the splatter keeps of a set lives as long as the set: for one round
        if done is not None:
            done(number + 1)
    after = opacities.now
    cut = np.float32(Definition().alpha_min)
    return Fading(
        _changed(gaussians, after, colours.now - own) if passes else gaussians,
        passes,
        int(((after <= 0.5 * before) & (after < before)).sum()),
        (after < cut) & (before >= cut),
        (_mean(before), _mean(after)),
        _mean(np.abs(colours.now - own)),
    )


class _Photographs:
    """The photographs as targets, at one or two resolutions."""

    def __init__(self, views: Sequence[FittedView], resized: Sequence[PackedView]) -> None:
        self._given, self._resized = Targets(views), Targets(resized)
        # weight of a resized pixel, so that equal residuals give equal sums at both resolutions
        self._area = _pixels(views[0]) / _pixels(resized[0]) if views and resized else 0.0
        self._share = _share(views, resized)

    def sums(self, now: Gaussians, near: float | None, threads: int | None, *, at_both: bool) -> Leverage:
        """Sums over the photographs, with `at_both` also over the resized ones, if there are any."""
        if not (at_both and self._resized.views):
            return self._given.sums(now, near, threads)
        sums = self._given.sums(now, near, threads, share=1 - self._share)
        return self._resized.sums(now, near, threads, share=self._share * self._area, onto=sums)


def _share(views: Sequence[FittedView], resized: Sequence[PackedView]) -> float:
    """The share of `resized` in the weight: the larger, the less the photographs were enlarged to their size."""
    larger = resized[0].camera.width / views[0].camera.width if views and resized else 1.0
    if larger <= 1:
        return RESIZED_SHARE
    own = np.mean([min(max((view.step - 1) / (larger - 1), 0.0), 1.0) for view in views])
    return RESIZED_SHARE + (OWN_SHARE - RESIZED_SHARE) * float(own)


def _pixels(view: FittedView | PackedView) -> int:
    return view.camera.width * view.camera.height


def _base_colours(gaussians: Gaussians) -> NDArray[np.float32]:
    """(N, 3) colours of the constant harmonic."""
    return np.float32(0.5) + np.float32(C0) * gaussians.harmonics[:, 0]


def _changed(gaussians: Gaussians, opacities: NDArray[np.float32], change: NDArray[np.float32]) -> Gaussians:
    """`gaussians` with these opacities (N,) and base colours changed by `change` (N, 3)."""
    harmonics = gaussians.harmonics.copy()
    harmonics[:, 0] += change / np.float32(C0)
    return replace(gaussians, opacities=opacities, harmonics=harmonics)


def _finite(over: NDArray[np.float64], under: NDArray[np.float64]) -> NDArray[np.float64]:
    """The quotient, 0 where it is not finite: sums overflow for colours near the largest float32."""
    with np.errstate(invalid="ignore", over="ignore"):
        return np.nan_to_num(over / under, nan=0.0, posinf=0.0, neginf=0.0)


def _between(
    now: Gaussians, anchors: Anchors | None, anchored: Targets, near: float | None, threads: int | None
) -> tuple[NDArray[np.float64] | float, NDArray[np.float64] | float]:
    """What the anchors' pictures add to `slope` and `moved` (N,), for the Gaussians that may fade for them."""
    if anchors is None or not anchored.views:
        return 0.0, 0.0
    sums = anchored.sums(now, near, threads)
    slope, moved = (np.where(anchors.may_fade, ANCHORED * values, 0.0) for values in (sums.slope, sums.moved))
    return slope, moved


def _mean(values: NDArray[np.floating]) -> float:
    return float(values.mean(dtype=np.float64)) if len(values) else 0.0
