"""Fading what the photographs contradict: each view's Gaussians stand in the other views' pictures too, often wrongly.

A Gaussian of one view whose depth is wrong hides in another view what that one shows rightly. The scene is drawn from
its inputs' cameras; where a picture differs from its photograph, the Gaussians whose absence would mend that lose
opacity. None rises above the network's own: no splat that nothing else supports becomes opaque for the one photograph
that it fits. Colours follow one pass behind: what should go is not first given the colour that it hides. Between the
inputs, where there is no photograph, pictures of what two views confirm (`anchors.py`) stand in for one. At the end the
photographs are compared at another size as well: what suits one grid of pixels alone shows in every other picture.
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
from .compared import Compared
from .fade_passes import DEFAULT_PASSES, checked_passes
from .heavy_ball import HeavyBall

STEP = 0.6  # of Newton's, which takes each Gaussian for the only one that moves
DAMPING = 0.05  # of one channel of one pixel; a Gaussian that moves the pictures less hardly fades
# Of its opacity, at least: it is there for views that nobody has asked for. One sheet of 0.97 alone then stops more
# than half of the light, and is no hole.
BEHIND_KEEPS = 0.55
ANCHORED = 1.5  # weight of a pixel of what is sure: between the inputs a few pictures stand for all views there
COLOUR_STEP = 1.6  # of the mean that the pixels which show a Gaussian have too much: those share it with others
COLOUR_DAMPING = 0.05  # of a pixel; a Gaussian of which less is to be seen in all keeps most of its colour
RESIZED_ROUNDS = 3  # of the drawing, the last: as good as all of them, and the others cost less
RESIZED_SHARE = 0.25  # of the sums, what the photographs at another size have at least
OWN_SHARE = 0.4  # where all pixels of a larger size are the photographs' own: they then tell something new


@dataclass(frozen=True, eq=False)
class Fading:
    """The scene with lower opacities and other base colours, nothing else changed."""

    gaussians: Gaussians
    passes: int
    halved: int  # lost half of their opacity or more
    gone: NDArray[np.bool_]  # (N,) too faint by now to be drawn, and were not at first
    mean_opacity: tuple[float, float]  # before, after
    recoloured: float  # mean change of a base colour's channel, of 1

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
    """Lower opacities and correct colours so that the scene, drawn from the cameras of `views`, comes closer to their
    photographs.

    A pass draws every view once and moves each opacity o by -STEP sum(w r J) / (sum(w J^2) + DAMPING), to what it was
    at first at most and to 0 at least, or to BEHIND_KEEPS of what it was where it stands `behind` (N,) the scene:
    J = dC/do, r the picture (clipped to [0, 1]) less the photograph, sums over all pixels and channels of all views,
    with their weights w and what stands behind them as `Compared` says. The next pass, or one more after the last,
    moves the base colour by -COLOUR_STEP sum(w r s) / (sum(w s) + COLOUR_DAMPING) in each channel, with s = T a of
    `leverage`, and not beyond [0, 1] where the network's own was within (simultaneous iterative reconstruction,
    Gilbert 1972): also of what stands behind, which new views see past the edges of what hides it. Both keep some of
    their way (`HeavyBall`). A Gaussian too faint to be drawn is not seen again, and stays so.

    In the last RESIZED_ROUNDS of the drawing the sums go over `resized` as well: the same photographs on another grid,
    one size for all. They then have RESIZED_SHARE of the weight, those of `views` the rest, by area; up to OWN_SHARE
    where they are larger and the photographs were not enlarged to that (`FittedView.step`).

    For the Gaussians that `anchors` says, the sums of a pass go over its pictures as well, with ANCHORED as their
    weight; colours follow photographs alone. `near` is that of `render`; `done` hears how many rounds of drawing are
    done, passes + 1 in all. The bits do not depend on the number of threads.

    Raises `InputError` for a number of passes that is out of range.
    """
    checked_passes(passes)
    before, own = gaussians.opacities, _base_colours(gaussians)
    opacities = HeavyBall(before, 0.0 if behind is None else np.where(behind, BEHIND_KEEPS * before, 0), before)
    colours = HeavyBall(own, 0.0, 1.0)
    given, sure = _Photographs(views, resized), Compared(() if anchors is None else anchors.pictures)
    for number in range(passes + 1 if passes else 0):
        now = _changed(gaussians, opacities.now, colours.now - own)
        between = (0.0, 0.0) if number == passes else _between(now, anchors, sure, near, threads)
        sums = given.sums(now, near, threads, at_both=number > passes - RESIZED_ROUNDS)
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
    """What the scene should show from its inputs' cameras, at one size or at both."""

    def __init__(self, views: Sequence[FittedView], resized: Sequence[PackedView]) -> None:
        self._given, self._resized = Compared(views), Compared(resized)
        # Of one pixel there, so that both sizes have the same sums for the same differences
        self._area = _pixels(views[0]) / _pixels(resized[0]) if views and resized else 0.0
        self._share = _share(views, resized)

    def sums(self, now: Gaussians, near: float | None, threads: int | None, *, at_both: bool) -> Leverage:
        """Over the photographs, and those of the other size where there are any and `at_both` asks for them."""
        if not (at_both and self._resized.views):
            return self._given.sums(now, near, threads)
        sums = self._given.sums(now, near, threads, share=1 - self._share)
        return self._resized.sums(now, near, threads, share=self._share * self._area, onto=sums)


def _share(views: Sequence[FittedView], resized: Sequence[PackedView]) -> float:
    """Of the weight, what `resized` has: more, the farther the photographs' own pixels reach towards a finer grid."""
    larger = resized[0].camera.width / views[0].camera.width if views and resized else 1.0
    if larger <= 1:
        return RESIZED_SHARE
    own = np.mean([min(max((view.step - 1) / (larger - 1), 0.0), 1.0) for view in views])
    return RESIZED_SHARE + (OWN_SHARE - RESIZED_SHARE) * float(own)


def _pixels(view: FittedView | PackedView) -> int:
    return view.camera.width * view.camera.height


def _base_colours(gaussians: Gaussians) -> NDArray[np.float32]:
    """(N, 3) what is the same from all sides."""
    return np.float32(0.5) + np.float32(C0) * gaussians.harmonics[:, 0]


def _changed(gaussians: Gaussians, opacities: NDArray[np.float32], change: NDArray[np.float32]) -> Gaussians:
    """With these opacities, and base colours that have moved by `change` (N, 3): the same values where it is 0."""
    harmonics = gaussians.harmonics.copy()
    harmonics[:, 0] += change / np.float32(C0)
    return replace(gaussians, opacities=opacities, harmonics=harmonics)


def _finite(over: NDArray[np.float64], under: NDArray[np.float64]) -> NDArray[np.float64]:
    """The quotient; 0 where a sum was not finite, of colours near the end of float32."""
    with np.errstate(invalid="ignore", over="ignore"):
        return np.nan_to_num(over / under, nan=0.0, posinf=0.0, neginf=0.0)


def _between(
    now: Gaussians, anchors: Anchors | None, sure: Compared, near: float | None, threads: int | None
) -> tuple[NDArray[np.float64] | float, NDArray[np.float64] | float]:
    """What the pictures of what is sure add to `slope` and `moved` (N,) of the Gaussians that must not hide it."""
    if anchors is None or not sure.views:
        return 0.0, 0.0
    sums = sure.sums(now, near, threads)
    slope, moved = (np.where(anchors.may_fade, ANCHORED * values, 0.0) for values in (sums.slope, sums.moved))
    return slope, moved


def _mean(values: NDArray[np.floating]) -> float:
    return float(values.mean(dtype=np.float64)) if len(values) else 0.0
