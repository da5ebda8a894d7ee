"""Pairs of views with one camera turned, or of another focal length."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.matching.pair_matches import PairMatches


def turned_camera(camera: Camera, axis: Sequence[float], degrees: float) -> Camera:
    """The camera rotated about an axis of its own."""
    pose = camera.world_from_cam.copy()
    pose[:3, :3] = pose[:3, :3] @ about_axis(np.asarray(axis, float), np.radians(degrees))
    return camera.posed(pose)


def zoomed_camera(camera: Camera, factor: float) -> Camera:
    return replace(camera, fx=camera.fx * factor, fy=camera.fy * factor)


def turned(pairs: PairMatches, which: int, axis: Sequence[float], degrees: float) -> PairMatches:
    """The views with the camera of one of them turned."""
    return _with_camera(pairs, which, turned_camera(pairs.views[which].camera, axis, degrees))


def zoomed(pairs: PairMatches, which: int, factor: float) -> PairMatches:
    """The views with the focal length of one of them that many times as long."""
    return _with_camera(pairs, which, zoomed_camera(pairs.views[which].camera, factor))


def _with_camera(pairs: PairMatches, which: int, camera: Camera) -> PairMatches:
    views = list(pairs.views)
    views[which] = replace(views[which], camera=camera)
    return PairMatches(views, pairs.depths)
