"""Fading what the photographs contradict: each view's Gaussians stand in the other views' pictures too, often wrongly.

A Gaussian of one view whose depth is wrong hides in another view what that one shows rightly. The scene is drawn from
its inputs' cameras; where a picture differs from its photograph, the Gaussians whose absence would mend that lose
opacity. They never gain any: a scene that is only faded cannot learn its inputs by heart with splats that nothing else
supports.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .fade_passes import DEFAULT_PASSES, checked_passes
from .gaussians import Gaussians
from .images import FittedView
from .splat import Definition, Leverage, leverage, render
from .splat.parallel import checked_threads, run_ranges

STEP = 0.7  # of Newton's, which takes each Gaussian for the only one that moves
DAMPING = 0.1  # pixels that change by all of a channel; a Gaussian that moves the pictures less hardly fades
ROBUST = 0.1  # of a channel: difference at which a pixel counts half of itself; exposures and highlights differ as well
COVERED = 1e-3  # opacity below which a pixel shows no colour that could be right or wrong


@dataclass(frozen=True, eq=False)
class Fading:
    """The scene with lower opacities, nothing else changed."""

    gaussians: Gaussians
    passes: int
    lowered: int  # by a level of 8 bits or more
    gone: int  # of those: too faint by now to be drawn
    mean_opacity: tuple[float, float]  # before, after

    def document(self) -> dict[str, Any]:
        """Plain JSON values."""
        return {
            "passes": self.passes,
            "lowered": self.lowered,
            "gone": self.gone,
            "mean_opacity": [round(value, 6) for value in self.mean_opacity],
        }


def faded(
    gaussians: Gaussians,
    views: Sequence[FittedView],
    passes: int = DEFAULT_PASSES,
    *,
    near: float | None = None,
    threads: int | None = None,
) -> Fading:
    """Lower opacities so that the scene, drawn from the cameras of `views`, comes closer to their photographs.

    A pass draws every view once and lowers the opacity o of each Gaussian by STEP sum(r J) / (sum(J^2) + DAMPING), down
    to 0 at most and never above what it was at first: J = dC/do, r the difference C - photograph, both over all pixels
    and channels of all views. A difference of mean size d over the channels is divided by 1 + d / ROBUST (the weight of
    Geman's and McClure's kind of loss that falls with the first power). A pixel that a mask leaves out counts nothing.
    Where a pixel is not covered in full, its own mean colour stands behind it: no Gaussian goes for being brighter than
    a background that nobody knows. `near` is that of `render`. The bits do not depend on the number of threads.

    Raises `InputError` for a number of passes that is out of range.
    """
    checked_passes(passes)
    threads = checked_threads(threads)
    opacities = gaussians.opacities
    for _ in range(passes):
        opacities = _passed(replace(gaussians, opacities=opacities), gaussians, views, near, threads)
    level = np.float32(1 / 255)
    lowered = gaussians.opacities - opacities >= level
    return Fading(
        replace(gaussians, opacities=opacities) if passes else gaussians,
        passes,
        int(lowered.sum()),
        int((lowered & (opacities < Definition().alpha_min)).sum()),
        (_mean(gaussians.opacities), _mean(opacities)),
    )


def _passed(
    now: Gaussians, first: Gaussians, views: Sequence[FittedView], near: float | None, threads: int
) -> np.ndarray:
    """(N,) the opacities after one pass."""
    found = run_ranges(lambda index, _: _leverage(now, views[index], near), range(len(views) + 1), threads)
    slope = np.sum([one.slope for one in found], axis=0)
    moved = np.sum([one.moved for one in found], axis=0)
    with np.errstate(invalid="ignore"):  # colours near the end of float32: what is not finite moves nothing
        step = np.nan_to_num(STEP * slope / (moved + DAMPING), nan=0.0, posinf=0.0, neginf=0.0)
    return np.clip(now.opacities - step, 0.0, first.opacities).astype(np.float32)


def _leverage(gaussians: Gaussians, view: FittedView, near: float | None) -> Leverage:
    image = render(gaussians, view.camera, near=near, outputs=("alpha",), threads=1)
    counted = image.alpha > COVERED
    if view.mask is not None:
        counted &= view.mask
    picture = image.rgb / np.maximum(image.alpha, np.float32(COVERED))[..., None]
    residual = picture - view.image.transpose(1, 2, 0)
    residual /= 1 + np.abs(residual).mean(axis=2, keepdims=True) / np.float32(ROBUST)
    return leverage(gaussians, view.camera, picture, residual, counted, near=near)


def _mean(opacities: np.ndarray) -> float:
    return float(opacities.mean(dtype=np.float64)) if len(opacities) else 0.0
