"""The cameras and the depth range of a scene: resolving views to cameras, camera paths, and the near plane."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypedDict

import numpy as np

from ..cameras.camera import Camera
from ..errors import ViewError
from .camera_path import Path, PathName, camera_path
from .views import resolve_view

# Hardly anything lies closer to a scene's own cameras than its near depth; a tenth of it leaves room to move closer,
# and scales with the caller's units.
NEAR_PLANE_SHARE = 0.1


class NearPlane(TypedDict, total=False):
    """The splatter's argument `near`, if it is known."""

    near: float


@dataclass(frozen=True)
class SceneViews:
    """Cameras with their near and far depth, given or estimated, if there are any."""

    cameras: Sequence[Camera]
    near: float | None = None
    far: float | None = None

    @classmethod
    def of_document(cls, document: Mapping[str, Any]) -> SceneViews:
        """The fitted cameras of a scene document, so that views have the crop and size of the scene."""
        cameras = [_stored(camera) for camera in document["view_cameras"]]
        return cls(cameras, document["near"], document["far"])

    def resolve(self, spec: str, *, field: str = "view") -> Camera:
        """The camera of "2", "1.5" or "orbit:30", see `resolve_view`. Raises `ViewError` about `field`."""
        try:
            return resolve_view(spec, self.cameras, pivot_depth=self.pivot_depth)
        except ViewError as error:
            error.field = field
            raise

    def path(self, name: PathName, swing: float | None = None) -> Path:
        """A camera path among these cameras, about the pivot. Raises `ViewError`."""
        return camera_path(name, self.cameras, pivot_depth=self.pivot_depth, swing=swing)

    @property
    def pivot_depth(self) -> float:
        """z-depth of the pivot of orbits: the geometric mean of near and far, or 1 if they are unknown."""
        return math.sqrt(self.near * self.far) if self.near and self.far else 1.0

    @property
    def near_plane(self) -> NearPlane:
        """The splatter's argument `near`, empty if the scene's depth is unknown."""
        return {} if self.near is None else {"near": NEAR_PLANE_SHARE * self.near}


def _stored(entry: Mapping[str, Any]) -> Camera:
    """A camera of a scene document, unchecked: a crop may have its principal point anywhere."""
    fx, fy, cx, cy = (float(entry[name]) for name in ("fx", "fy", "cx", "cy"))
    return Camera(entry["width"], entry["height"], fx, fy, cx, cy, np.array(entry["c2w"], dtype=np.float64))
