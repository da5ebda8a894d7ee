"""Poses and focal lengths that are wrong by little, told from distances to epipolar lines."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass

import numpy as np

from ..cameras.view_checks import Notice
from .epipolar import TURN, UNSEEN_PX, ZOOM, best_change, epipolar_distances
from .pair_matches import PairMatches
from .pose_changes import PoseChanges

# Median residual in px from which poses are doubted if a turn of one camera, with or without another focal length,
# leaves less than half of it, and from which they are doubted anyway. Right pairs have up to 0.44 px (109 of six
# captures) and 0.58 (116 that were generated), of which neither takes half.
LEAST_PX, LEFT, MOST_PX = 0.5, 0.5, 1.2
# A change beyond these is no refinement: of a camera's orientation, focal length, and position in longest baselines.
MOST_TURN, MOST_ZOOM, MOST_SHIFT = np.radians(3.0), np.log(1.1), 0.2
SIDE = 256  # px of the shorter side up to which that is so; from there on they grow with it


@dataclass(frozen=True, eq=False)
class EpipolarResidual:
    """Epipolar residuals of a pair of views."""

    pair: tuple[int, int]
    px: float  # median distance from the epipolar line
    turned_px: float  # the same after the best rotation of the second camera
    turn: float  # rad, angle of that rotation
    zoomed_px: float  # after the best rotation together with the best focal length of the second camera
    zoom: float  # natural logarithm of that focal length's ratio to the given one

    def inexact(self, unit: float) -> bool:
        """Whether cameras are doubted, at `unit` times SIDE."""
        return self.px > MOST_PX * unit or (self.px > LEAST_PX * unit and self.explained)

    @property
    def explained(self) -> bool:
        """Whether one of the changes leaves less than half."""
        return min(self.turned_px, self.zoomed_px) < LEFT * self.px

    def cause(self, one: int, other: int) -> str:
        """The change of a camera that explains the most, if it is half; the views are called `one` and `other`."""
        if not self.explained:
            return "no turn and no focal length of one of them explains half of it"
        if self.zoomed_px >= LEFT * self.turned_px:
            return f"with one of them turned by {np.degrees(self.turn):.2g} degrees it would be {self.turned_px:.2f} px"
        shorter, longer = (one, other) if self.zoom > 0 else (other, one)
        percent = 100 * np.expm1(abs(self.zoom))
        return (
            f"with the focal length of view {longer} {percent:.2g} % longer, or that of view {shorter} as much "
            f"shorter, it would be {self.zoomed_px:.2f} px"
        )


def inexact_poses(
    pairs: PairMatches, found: Sequence[EpipolarResidual], numbers: Sequence[int], *, tried: bool = False
) -> list[Notice]:
    """The warning about the pair of neighbouring views with the largest residual of those `found` to be `doubted`, if
    there is one.

    `numbers` are what the caller calls the views; `tried`: whether they are left after `refined_cameras`.
    """
    if not found:
        return []
    height, width = pairs.views[0].image.shape[1:]
    unit = _unit(pairs)
    worst = max(found, key=lambda residual: residual.px)
    one, other = (numbers[view] for view in worst.pair)
    message = (
        f"at {width} x {height} px what views {one} and {other} have in common stands {worst.px:.2f} px (median) "
        f"beside where their cameras allow it, usual is {0.1 * unit:.1f} to {0.5 * unit:.1f}; "
        f"{worst.cause(one, other)}"
    )
    if (wrong := _wrong_camera(pairs, worst)) is not None:
        message += (
            f"; changes of the camera of view {numbers[wrong]} alone explain it as well as those of all but one do"
        )
    if len(found) > 1:
        others = [
            " and ".join(str(numbers[view]) for view in residual.pair) for residual in found if residual is not worst
        ]
        message += f"; the same of views {', '.join(others)}"
    cure = (
        "are poses and intrinsics exact, and those of these very photographs, which show one scene and are sharp? "
        "refine them, for example with COLMAP"
    )
    if tried:
        cure += (
            f", as refine_poses could not altogether: it corrects up to {np.degrees(MOST_TURN):.0f} degrees, "
            f"{np.expm1(MOST_ZOOM):.0%} of a focal length and {MOST_SHIFT:g} of the longest baseline, where less than "
            f"{LEFT:.0%} of the error is left"
        )
    else:
        cure += ", or set refine_poses"
    return [{"code": "poses_inexact", "field": "cameras", "message": f"{message} ({cure})", "px": round(worst.px, 3)}]


def _wrong_camera(pairs: PairMatches, worst: EpipolarResidual) -> int | None:
    """The view, of three or more, whose changes alone explain the residuals and leave less than half of the worst."""
    if len(pairs.views) < 3:  # of two either camera may be wrong: nothing is worth measuring
        return None
    changes = PoseChanges.of(pairs)
    wrong = changes.culprit(worst.pair[0])
    return None if wrong is None or changes.left_px(worst.pair, wrong) >= LEFT * worst.px else wrong


def doubted(pairs: PairMatches, unsharp: Set[int] = frozenset()) -> list[EpipolarResidual]:
    """The residuals beyond noise; of the views that are `unsharp`, whose matches are uncertain by as much, only those
    that a change of a camera explains."""
    unit = _unit(pairs)
    return [
        residual
        for residual in epipolar_residuals(pairs)
        if residual.inexact(unit) and (residual.explained or unsharp.isdisjoint(residual.pair))
    ]


def _unit(pairs: PairMatches) -> float:
    """How many times SIDE the shorter side of the pictures has, at least 1."""
    return max(1.0, min(pairs.views[0].image.shape[1:]) / SIDE)


def epipolar_residuals(pairs: PairMatches) -> list[EpipolarResidual]:
    """Per pair of `PairMatches.joined` that matches enough; distances are in px of the views."""
    residuals = []
    for found in epipolar_distances(pairs, pairs.joined()):
        slopes = found.slopes[:, 1]
        turn, turned = best_change(found.px, slopes[:, TURN], UNSEEN_PX[TURN])
        change, zoomed = best_change(found.px, slopes[:, : ZOOM + 1], UNSEEN_PX[: ZOOM + 1])
        px, turned_px, zoomed_px = (float(np.median(np.abs(rest))) for rest in (found.px, turned, zoomed))
        residuals.append(
            EpipolarResidual(found.pair, px, turned_px, float(np.linalg.norm(turn)), zoomed_px, float(change[ZOOM]))
        )
    return residuals
