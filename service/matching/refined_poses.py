"""Cameras that are slightly wrong, corrected until what they have in common stands where they allow it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..cameras.rotations import about_axis, rotation_angle
from ..cameras.view_checks import Notice
from .epipolar import SHIFT, TURN, ZOOM, epipolar_distances, longest_baseline
from .inexact_poses import LEFT, MOST_SHIFT, MOST_TURN, MOST_ZOOM, EpipolarResidual
from .pair_matches import PairMatches
from .pose_changes import PoseChanges

F64 = NDArray[np.float64]

ROUNDS = 3  # of matching and least squares


def refined_cameras(
    pairs: PairMatches, before: Sequence[EpipolarResidual], numbers: Sequence[int]
) -> tuple[list[Camera], Notice] | None:
    """The cameras of the views, all but one turned, moved and with other focal lengths, and what is told of it; None
    without residuals `before` that are `doubted`, or where more than LEFT of the largest remains. Of views that no
    match joins to the others, one stays as well. `numbers` are what the caller calls the views.
    """
    if not before:
        return None
    given = [view.camera for view in pairs.views]
    refined, found = pairs, PoseChanges.of(pairs)
    stiffness = found.stiffness()
    for done in range(ROUNDS):
        found, unit = PoseChanges.of(refined) if done else found, longest_baseline(refined.views)
        changes = found.changes(stiffness)
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
    held = np.flatnonzero(np.isinf(stiffness)).tolist()
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
