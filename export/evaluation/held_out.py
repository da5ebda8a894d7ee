"""Views of a capture that suggests none: inputs as a reconstruction chooses them, and held-out targets between them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gapmes.service.cameras.camera import Camera
from gapmes.service.captures.choose import MAX_SCORED, chosen_views, compared_depths, evenly, parallax, seen_by

SEEN = 0.9  # least share of a target, at its depth, that the inputs see together
BETWEEN = 0.6  # largest parallax between a target and its nearest input, relative to the largest between two inputs
MOST_TARGETS = 4


def held_out_views(
    cameras: Sequence[Camera], middles: Sequence[float | None], inputs: int
) -> tuple[list[int], list[int]]:
    """Ascending indices of `inputs` views and of up to four targets, which may be none.

    Every second view is held out. The inputs are those that `chosen_views` chooses among the others, with `middles` as
    there; too few views give fewer. A held-out view can be a target if the inputs see 90 % of it and its parallax from
    the nearest of them is at most 0.6 of the largest between two of them: about what lies between the inputs. Targets
    are taken one after the other, each the farthest from the inputs and the targets before it, so that of a film not
    only the frames next to an input are compared.
    """
    kept, held = list(range(0, len(cameras), 2)), [2 * i + 1 for i in evenly(len(cameras) // 2, MAX_SCORED)]
    if len(kept) < inputs:
        return kept, []
    choice = chosen_views([cameras[i] for i in kept], inputs, [middles[i] for i in kept])
    chosen = [kept[place] for place in choice.places]
    looked = [*chosen, *held]
    some = [cameras[i] for i in looked]
    depths = compared_depths(some, [middles[i] for i in looked])
    angles = parallax(some, depths)
    seen = seen_by(some[inputs:], depths[inputs:], some[:inputs]).any(axis=0).mean(axis=1)
    allowed = np.concatenate([np.zeros(inputs, dtype=np.bool_), seen >= SEEN])
    allowed &= angles[:, :inputs].min(axis=1) <= BETWEEN * angles[:inputs, :inputs].max()
    return chosen, sorted(looked[place] for place in _spread(angles, inputs, allowed))


def _spread(angles: NDArray[np.float64], inputs: int, allowed: NDArray[np.bool_]) -> list[int]:
    """Places of up to `MOST_TARGETS` allowed views, each the farthest from the inputs and those before it."""
    distance = np.where(allowed, angles[:, :inputs].min(axis=1), 0.0)
    found: list[int] = []
    while len(found) < MOST_TARGETS and distance.max() > 0.0:
        found.append(int(np.argmax(distance)))
        distance = np.minimum(distance, angles[:, found[-1]])
        distance[found[-1]] = 0.0  # rounding apart
    return found
