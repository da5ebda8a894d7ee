"""Cameras that are slightly wrong, corrected until what they have in common stands where they allow it.

Matches say how cameras stand to each other, not which of them is wrong. Of three or more as few are changed as explain
the distances, since an error of one camera is likelier than one of all others that looks the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..cameras.rotations import about_axis, rotation_angle
from ..cameras.spanning_tree import first_joined
from ..cameras.view_checks import Notice
from .epipolar import (
    CHANGES,
    LIKE_NOISE_PX,
    SHIFT,
    TURN,
    UNSEEN_PX,
    ZOOM,
    best_change,
    epipolar_distances,
    longest_baseline,
)
from .inexact_poses import LEFT, MOST_SHIFT, MOST_TURN, MOST_ZOOM, EpipolarResidual
from .pair_matches import PairMatches

F64 = NDArray[np.float64]

ROUNDS = 3  # of matching and least squares
FEW = 2  # cameras that are tried alone
# Fewer cameras are changed if that leaves up to this times what changes of all but one leave. In 89 scenes of three
# photographs, one with a wrong camera, changes of that one leave 1.00 to 1.06 times as much; those of another one more
# than 1.07 times in 73, and in 6 less than those of the wrong one, which hardly differ.
WELL = 1.07
CLEARLY = 0.9  # of the change beside the first of views: another is held where it is less


def refined_cameras(
    pairs: PairMatches, before: Sequence[EpipolarResidual], numbers: Sequence[int]
) -> tuple[list[Camera], Notice] | None:
    """The cameras of the views, at most all but one turned, moved and with other focal lengths, and what is told of it;
    None without residuals `before` that are `doubted`, or where more than LEFT of the largest remains. Of views that no
    match joins to the others, one stays as well. `numbers` are what the caller calls the views.
    """
    if not before:
        return None
    given = [view.camera for view in pairs.views]
    refined, held = pairs, None
    for _ in range(ROUNDS):
        equations, unit = _Equations.of(refined), longest_baseline(refined.views)
        held = equations.held() if held is None else held
        changes = equations.changes(held)
        views = [
            replace(view, camera=_changed(view.camera, change, unit))
            for view, change in zip(refined.views, changes, strict=True)
        ]
        refined = PairMatches(views, pairs.depths)
    cameras = [view.camera for view in refined.views]
    turns, zooms, shifts = _differences(given, cameras, longest_baseline(pairs.views))
    worst = max(residual.px for residual in before)
    after = {pair.pair: float(np.median(np.abs(pair.px))) for pair in epipolar_distances(refined, pairs.joined())}
    left = max(after.values(), default=np.inf)
    far = turns.max() > MOST_TURN or np.abs(zooms).max() > MOST_ZOOM or shifts.max() > MOST_SHIFT
    lost = any(residual.pair not in after for residual in before)  # it matches no more
    if far or lost or left > LEFT * worst:
        return None
    held = held or []
    told = [
        f"view {number} was turned by {np.degrees(turn):.2g} degrees and moved by {100 * shift:.2g} % of the longest "
        f"baseline, its focal length is {np.exp(zoom):.4f} times the given one"
        for view, (number, turn, zoom, shift) in enumerate(zip(numbers, turns, zooms, shifts, strict=True))
        if view not in held
    ]
    stay = ", ".join(str(numbers[view]) for view in held)
    message = (
        f"what the views have in common stood up to {worst:.2f} px (median of a pair) beside where their cameras "
        f"allow it, and stands {left:.2f} px beside it since they were corrected: {'; '.join(told)}; "
        f"{'the cameras of views' if len(held) > 1 else 'the camera of view'} {stay} "
        f"{'are' if len(held) > 1 else 'is'} as given"
    )
    of_px = {"px": round(worst, 3), "left_px": round(left, 3)}
    return cameras, {"code": "poses_refined", "field": "cameras", "message": message, **of_px}


@dataclass(frozen=True, eq=False)
class _Equations:
    """The distances of all pairs of V views, linear in the changes of the cameras."""

    px: F64  # (N,)
    slopes: F64  # (N, V, CHANGES)
    first: list[int]  # (V,) of each view the lowest one that matches join it with

    @classmethod
    def of(cls, pairs: PairMatches) -> _Equations:
        views = len(pairs.views)
        found = epipolar_distances(pairs, combinations(range(views), 2))
        px = np.concatenate([np.zeros(0), *(each.px for each in found)])
        slopes, row = np.zeros((len(px), views, CHANGES)), 0
        for each in found:
            slopes[row : row + len(each.px), each.pair] = each.slopes
            row += len(each.px)
        return cls(px, slopes, first_joined(views, [each.pair for each in found]))

    def held(self) -> list[int]:
        """The views that stay as they are given: one at least of each set that matches join."""
        found = []
        for lowest in sorted(set(self.first)):
            joined = [view for view, first in enumerate(self.first) if first == lowest]
            if len(joined) > 2:
                stays = self._beside_which_least(joined)
                few = self._few(joined, [view for view in joined if view != stays])
                found += [view for view in joined if view not in few] if few else [stays]
            else:
                found.append(lowest)
        return found

    def changes(self, held: list[int]) -> F64:
        """(V, CHANGES) the changes of the cameras that explain the distances best; 0 of those `held`."""
        return self._changes_of([view for view in range(len(self.first)) if view not in held])

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
        left = self.px[theirs] + np.einsum("nvc,vc->n", self.slopes[theirs], self._changes_of(free))
        return float(np.log1p(np.abs(left) / LIKE_NOISE_PX).mean())

    def _changes_of(self, free: list[int]) -> F64:
        changes = np.zeros((len(self.first), CHANGES))
        if free:
            of_free = self.slopes[:, free].reshape(len(self.px), len(free) * CHANGES)
            changes[free] = best_change(self.px, of_free, np.tile(UNSEEN_PX, len(free)))[0].reshape(-1, CHANGES)
        return changes


def _changed(camera: Camera, change: F64, unit: float) -> Camera:
    """The camera turned about its centre, with another focal length, and shifted in multiples of `unit`."""
    pose, zoom = camera.world_from_cam.copy(), float(np.exp(change[ZOOM]))
    angle = float(np.linalg.norm(change[TURN]))
    if angle > 0:
        pose[:3, :3] = about_axis(change[TURN] / angle, angle) @ pose[:3, :3]
    pose[:3, 3] += unit * change[SHIFT]
    return replace(camera.posed(pose), fx=camera.fx * zoom, fy=camera.fy * zoom)


def _differences(given: Sequence[Camera], found: Sequence[Camera], unit: float) -> tuple[F64, F64, F64]:
    """Per camera the angle between its orientations in rad, the logarithm of the ratio of its focal lengths, and the
    distance of its positions in multiples of `unit`."""
    pairs = list(zip(given, found, strict=True))
    turns = np.array([rotation_angle(one.rotation.T @ other.rotation) for one, other in pairs])
    zooms = np.array([np.log(other.fx / one.fx) for one, other in pairs])
    shifts = np.array([np.linalg.norm(other.center - one.center) / unit for one, other in pairs])
    return turns, zooms, shifts
