"""Cameras that are wrong by little, turned until what they have in common stands where they allow it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..cameras.rotations import about_axis
from ..cameras.view_checks import Notice
from .epipolar import CHANGES, best_change, epipolar_distances
from .inexact_poses import LEFT, doubted
from .pair_matches import PairMatches

F64 = NDArray[np.float64]

ROUNDS = 3  # of matching and least squares
MOST_TURN, MOST_ZOOM = np.radians(3.0), np.log(1.1)  # of a camera, and of its focal length: beyond, it is no refinement


def refined_cameras(pairs: PairMatches, numbers: Sequence[int]) -> tuple[list[Camera], Notice] | None:
    """The cameras of the views, all but the first turned and with other focal lengths, and what is told of it; None
    where none of them is `doubted`, or where that does not take half of the worst pair's distance.

    `numbers` are what the caller calls the views. Positions stay: an error of a position looks like a small turn.
    """
    before = doubted(pairs)
    if not before:
        return None
    given = [view.camera for view in pairs.views]
    turns, zooms = [np.eye(3)] * len(given), np.zeros(len(given))
    refined = pairs
    for _ in range(ROUNDS):
        changes = _changes(refined)
        turns = [_rotation(change[:3]) @ turn for change, turn in zip(changes, turns, strict=True)]
        zooms = zooms + changes[:, 3]
        cameras = [_changed(*each) for each in zip(given, turns, zooms, strict=True)]
        views = [replace(view, camera=camera) for view, camera in zip(pairs.views, cameras, strict=True)]
        refined = PairMatches(views, pairs.depths)
    angles = [_angle(turn) for turn in turns]
    if max(angles) > MOST_TURN or np.abs(zooms).max() > MOST_ZOOM:
        return None
    worst = max(residual.px for residual in before)
    left = max((float(np.median(np.abs(pair.px))) for pair in epipolar_distances(refined)), default=np.inf)
    if left > LEFT * worst:
        return None
    told = [
        f"view {number} by {np.degrees(angle):.2g} degrees"
        + (f" with its focal length times {np.exp(zoom):.4g}" if abs(zoom) > 0.0005 else "")
        for number, angle, zoom in zip(numbers, angles, zooms, strict=True)
    ][1:]
    message = (
        f"what the views have in common stood up to {worst:.2f} px (median of a pair) beside where their cameras "
        f"allow it, and stands {left:.2f} px beside it since cameras were turned, {', '.join(told)}; that of view "
        f"{numbers[0]} is as given"
    )
    notice: Notice = {"code": "poses_refined", "field": "cameras", "px": round(worst, 3), "left_px": round(left, 3)}
    return cameras, {**notice, "message": message}


def _changes(pairs: PairMatches) -> F64:
    """(V, CHANGES) the changes of the cameras, none of the first, that explain the distances of all pairs best."""
    views = len(pairs.views)
    distances, slopes = [np.zeros(0)], [np.zeros((0, views, CHANGES))]
    for found in epipolar_distances(pairs):
        of_all = np.zeros((len(found.px), views, CHANGES))
        of_all[:, found.pair] = found.slopes
        distances.append(found.px)
        slopes.append(of_all)
    px, of_others = np.concatenate(distances), np.concatenate(slopes)[:, 1:]
    change, _ = best_change(px, of_others.reshape(len(px), -1))
    return np.concatenate([np.zeros((1, CHANGES)), change.reshape(views - 1, CHANGES)])


def _changed(camera: Camera, turn: F64, zoom: float) -> Camera:
    """The camera turned about its centre, with its focal length times e^zoom."""
    pose = camera.world_from_cam.copy()
    pose[:3, :3] = turn @ pose[:3, :3]
    return replace(camera.posed(pose), fx=camera.fx * np.exp(zoom), fy=camera.fy * np.exp(zoom))


def _rotation(vector: F64) -> F64:
    """(3, 3) the rotation of a rotation vector (3,)."""
    angle = float(np.linalg.norm(vector))
    return about_axis(vector / angle, angle) if angle > 0 else np.eye(3)


def _angle(rotation: F64) -> float:
    """rad"""
    return float(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1)))
