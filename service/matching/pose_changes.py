"""Changes of slightly wrong cameras that bring what their photographs have in common to where the cameras allow it.

Matches say how cameras stand to each other, not which of them is wrong: one is held. Of three or more as few as explain
the distances change freely, since an error of one camera is likelier than one of all others that looks the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ..cameras.spanning_tree import first_joined
from .epipolar import CHANGES, LIKE_NOISE_PX, UNSEEN_PX, best_change, epipolar_distances
from .pair_matches import PairMatches

F64 = NDArray[np.float64]

FEW = 2  # cameras that are tried alone
# Few cameras change freely if that leaves up to this times what changes of all but one leave. In 89 scenes of three
# photographs, one with a wrong camera, changes of that one leave 1.00 to 1.06 times as much; those of another one more
# than 1.07 times in 73, and in 6 less than those of the wrong one, which hardly differ.
WELL = 1.07
# Times UNSEEN_PX, of those that do not change freely. Were they held, the few would take on what is left of theirs;
# with 1, they would take on errors of the few. Scenes of three photographs, the middle one turned by half a degree or
# with a focal length 2 % off: 24.4 dB, held 24.2, with 1 24.2.
STIFF = 4.0
CLEARLY = 0.9  # of the change beside the first of views: another is held where it is less


@dataclass(frozen=True, eq=False)
class PoseChanges:
    """The distances of all pairs of V views, linear in the changes of the cameras."""

    px: F64  # (N,)
    slopes: F64  # (N, V, CHANGES)
    first: list[int]  # (V,) of each view the lowest one that matches join it with

    @classmethod
    def of(cls, pairs: PairMatches) -> PoseChanges:
        views = len(pairs.views)
        found = epipolar_distances(pairs, combinations(range(views), 2))
        px = np.concatenate([np.zeros(0), *(each.px for each in found)])
        slopes, row = np.zeros((len(px), views, CHANGES)), 0
        for each in found:
            slopes[row : row + len(each.px), each.pair] = each.slopes
            row += len(each.px)
        return cls(px, slopes, first_joined(views, [each.pair for each in found]))

    def stiffness(self) -> F64:
        """(V,) of each view, for `changes`: of each set that matches join, infinite of one, which stays as it is given;
        of the others 1, or STIFF if the FEW explain the distances."""
        found = np.ones(len(self.first))
        for joined in self._sets():
            stays, few = joined[0], []
            if len(joined) > 2:
                stays = self._beside_which_least(joined)
                few = self._few(joined, [view for view in joined if view != stays])
            if few:
                others = [view for view in joined if view not in few]
                found[others], stays = STIFF, others[0]
            found[stays] = np.inf
        return found

    def culprit(self, view: int) -> int | None:
        """The view, of those that matches join with `view`, whose changes alone explain the distances as WELL as those
        of all but one; None where no view's do or those of several, as of two views."""
        (joined,) = (joined for joined in self._sets() if view in joined)
        if len(joined) < 3:
            return None
        enough = WELL * self._left(joined, joined[1:])
        found = [one for one in joined if self._left(joined, [one]) <= enough]
        return found[0] if len(found) == 1 else None

    def left_px(self, pair: tuple[int, int], view: int) -> float:
        """The median distance of a pair that the best changes of one view leave, as far as distances are linear in
        them: large changes leave more."""
        theirs = np.all(self.slopes[:, list(pair)].any(axis=2), axis=1)
        return float(np.median(np.abs(self._rest([view])[theirs])))

    def changes(self, stiffness: F64) -> F64:
        """(V, CHANGES) the changes of the cameras that explain the distances best, regularised by so many times
        UNSEEN_PX (V,)."""
        changes = np.zeros((len(self.first), CHANGES))
        free = np.flatnonzero(np.isfinite(stiffness))
        if len(free):
            of_free = self.slopes[:, free].reshape(len(self.px), len(free) * CHANGES)
            unseen = np.outer(stiffness[free], UNSEEN_PX).ravel()
            changes[free] = best_change(self.px, of_free, unseen)[0].reshape(-1, CHANGES)
        return changes

    def _sets(self) -> Iterator[list[int]]:
        """The views that matches join, in ascending order."""
        for lowest in sorted(set(self.first)):
            yield [view for view, first in enumerate(self.first) if first == lowest]

    def _few(self, joined: list[int], most: list[int]) -> list[int]:
        """The fewest of the views `joined`, up to FEW, whose changes explain the distances as WELL as those of `most`;
        of as many the best. None, if more are needed."""
        enough = WELL * self._left(joined, most)
        for count in range(1, min(FEW, len(most) - 1) + 1):
            left = {few: self._left(joined, list(few)) for few in combinations(joined, count)}
            best = min(left, key=left.__getitem__)
            if left[best] <= enough:
                return list(best)
        return []

    def _beside_which_least(self, joined: list[int]) -> int:
        """Of the views `joined` the one beside which the others change least, unless it is not CLEARLY less than beside
        the first."""
        amounts = {view: self._amount(joined, view) for view in joined}
        amounts[joined[0]] *= CLEARLY
        return min(amounts, key=amounts.__getitem__)

    def _amount(self, joined: list[int], held: int) -> float:
        """How much the others of the views `joined` change beside the one `held`, in px that they move points by."""
        changes = self._changes_of([view for view in joined if view != held])
        return float(np.linalg.norm(changes * UNSEEN_PX, axis=1).sum())

    def _left(self, joined: list[int], free: list[int]) -> float:
        """The mean distance of the views `joined` that the best changes of those `free` leave; by the logarithm, so
        that wrong matches count little."""
        theirs = self.slopes[:, joined].any(axis=(1, 2))
        return float(np.log1p(np.abs(self._rest(free)[theirs]) / LIKE_NOISE_PX).mean())

    def _rest(self, free: list[int]) -> F64:
        """(N,) the distances that the best changes of the views `free` leave."""
        return self.px + np.einsum("nvc,vc->n", self.slopes, self._changes_of(free))

    def _changes_of(self, free: list[int]) -> F64:
        stiffness = np.full(len(self.first), np.inf)
        stiffness[free] = 1.0
        return self.changes(stiffness)
