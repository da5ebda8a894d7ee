"""The cameras of a scene and the depths between which it lies: which camera a view means, and where drawing begins."""

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

# Hardly anything of a scene lies in front of its near depth as its own cameras see it; a tenth of it leaves room to
# move in and keeps the near plane in the caller's units, whatever they are.
NEAR_PLANE_SHARE = 0.1


class NearPlane(TypedDict, total=False):
    """A keyword of the splatter."""

    near: float


@dataclass(frozen=True)
class SceneViews:
    """Cameras with the near and far depth that were given or estimated for them, where there were any."""

    cameras: Sequence[Camera]
    near: float | None = None
    far: float | None = None

    @classmethod
    def of_document(cls, document: Mapping[str, Any]) -> SceneViews:
        """The fitted cameras, so that a view renders at the size and crop that the network saw."""
        cameras = [_stored(camera) for camera in document["view_cameras"]]
        return cls(cameras, document["near"], document["far"])

    def resolve(self, spec: str, *, field: str = "view") -> Camera:
        """The camera of "2", "1.5" or "orbit:30"; an orbit turns about the pivot."""
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
        """z-depth of what the scene turns about: the geometric mean of near and far, 1 where they are unknown."""
        return math.sqrt(self.near * self.far) if self.near and self.far else 1.0

    @property
    def near_plane(self) -> NearPlane:
        """The splatter's `near` as a keyword, or nothing where the scene's depth is unknown."""
        return {} if self.near is None else {"near": NEAR_PLANE_SHARE * self.near}


def _stored(entry: Mapping[str, Any]) -> Camera:
    """A camera of a scene document. It was checked when it was given; a crop of it may have any principal point."""
    fx, fy, cx, cy = (float(entry[name]) for name in ("fx", "fy", "cx", "cy"))
    return Camera(entry["width"], entry["height"], fx, fy, cx, cy, np.array(entry["c2w"], dtype=np.float64))
