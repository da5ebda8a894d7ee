"""A scene from a file of Gaussians: read, given cameras and depths, and stored like a reconstruction."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np

from ..cameras.camera import Camera
from ..cameras.camera_file import camera_document
from ..cameras.depth_range import depth_range
from ..cameras.view_checks import Notice
from ..errors import DepthRangeError, FormatError, InputError
from ..formats.dialect import Dialect
from ..formats.ply import ply_bytes
from ..formats.reading import Reading
from ..formats.registry import FORMATS, format_of_bytes
from ..gaussians import Gaussians
from ..progress import Stages
from ..revision import ALGORITHM_REVISION
from ..viewpoints.default_framing import default_views
from ..viewpoints.scene_views import SceneViews
from ..viewpoints.seen_depths import seen_depths
from .store import SceneStore

# Largest extent of a scene, and inverse of its smallest near depth: their squares and inverses fit float32.
MOST_UNITS = 1e15
OPTION = re.compile(r"--(opacity|scales|rotation|axes) (\w+)")  # of `gapmes convert` and `gapmes render`


@dataclass(frozen=True)
class LoadedFile:
    """A file and how to read it; equal `scene_id` means equal scenes."""

    data: bytes
    format: str  # its extension
    dialect: Dialect
    drop_invalid: bool
    cameras: tuple[Camera, ...] = ()  # empty: the default framing
    near: float | None = None
    far: float | None = None
    notices: tuple[Notice, ...] = ()  # warnings about the cameras

    @classmethod
    def of(cls, data: bytes, format: str | None, name: str | None, dialect: Dialect, **rest: Any) -> LoadedFile:
        """With `format`, else the format found by content or by file name. Raises `InputError`."""
        return cls(data, format or format_of_bytes(data, name).extension, dialect, **rest)

    def scene_id(self) -> str:
        """Hash of everything that the stored scene depends on, and of nothing else."""
        options = {
            "format": self.format,
            "drop_invalid": self.drop_invalid,
            "near": self.near,
            "far": self.far,
            "algorithm_revision": ALGORITHM_REVISION,
            **asdict(self.dialect),
        }
        return SceneStore.scene_id("a file", [self.data], [camera_document(camera) for camera in self.cameras], options)


def load(file: LoadedFile, scene_id: str, store: SceneStore, max_count: int) -> tuple[dict[str, Any], bool]:
    """Read and store; the scene is stored as a whole or not at all. Returns its document, and False where it was there.

    Raises `FormatError` for a file that cannot be read or is empty, `TooManyGaussians` for more than `max_count`, and
    `DepthRangeError` for a near and far that are no range.
    """
    stages = Stages()
    with stages.stage("read"):
        reading = FORMATS[file.format].read(file.data, file.dialect, file.drop_invalid, max_count)
        if not len(reading.gaussians):
            raise FormatError(f"{reading.rows} rows hold no Gaussian", field="file", cure="is it the right file?")
    with stages.stage("frame"):
        views, source = framed(reading.gaussians, file.cameras, file.near, file.far)
        _require_drawable(reading.gaussians, views)
    with stages.stage("encode"):
        ply = ply_bytes(reading.gaussians)
    document = {
        "id": scene_id,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "model": None,
        "file": {
            "format": file.format,
            "bytes": len(file.data),
            "sha256": hashlib.sha256(file.data).hexdigest(),
            "rows": reading.rows,
        },
        "near": views.near,
        "far": views.far,
        "depth_range_source": source,
        "cameras": [camera_document(camera) for camera in views.cameras],
        "view_cameras": [camera_document(camera) for camera in views.cameras],
        "gaussians": {"count": len(reading.gaussians), "sh_degree": reading.gaussians.sh_degree},
        "dropped": [{"reason": f"invalid {name}", "count": count} for name, count in reading.invalid.items()],
        "warnings": [*file.notices, *_warnings(reading)],
        "timings": {stage: round(seconds, 6) for stage, seconds in stages.timings.items()},
    }
    return document, store.put(scene_id, ply, document)


def framed(
    gaussians: Gaussians, cameras: Sequence[Camera], near: float | None, far: float | None
) -> tuple[SceneViews, str]:
    """The views of Gaussians from the given cameras, else from the default one; and the source of near and far:
    `given`, `gaussians` (the depths that the given cameras see) or `framing` (the default camera's).

    Raises `FormatError` and `DepthRangeError`.
    """
    try:
        framing = default_views(gaussians)
    except InputError as error:
        extent = float(np.abs(gaussians.means).max())
        raise _too_far(f"its positions reach {extent:.3g}") from error
    found, source = (framing.near, framing.far), "framing"
    if cameras:
        seen = seen_depths(gaussians, cameras)
        found, source = (seen, "gaussians") if seen is not None else (found, source)
    chosen = tuple(own if own is not None else other for own, other in zip((near, far), found, strict=True))
    views = list(cameras) or list(framing.cameras)
    if near is None and far is None:
        return SceneViews(views, *chosen), source
    low, high = chosen
    if (near is None or far is None) and low is not None and high is not None and math.inf > low >= high > 0:
        given = "near" if far is None else "far"
        cure = f"{given} alone is given, the other one is from the {source}: give both"
        raise DepthRangeError(f"near = {low:g}, far = {high:g}, need near < far", field=given, cure=cure)
    depths = depth_range(views, *chosen)  # refuses what is no range
    return SceneViews(views, depths.near, depths.far), source if near is None or far is None else "given"


def _require_drawable(gaussians: Gaussians, views: SceneViews) -> None:
    """Raises `FormatError` for a scene whose extent or depths would overflow or underflow in the float32 splatter."""
    reach = float(np.abs(gaussians.means).max())
    if not (reach < MOST_UNITS and views.near and views.near > 1 / MOST_UNITS and (views.far or 0) < MOST_UNITS):
        raise _too_far(f"its positions reach {reach:.3g}, its depths from {views.near:.3g} to {views.far:.3g}")


def _too_far(what: str) -> FormatError:
    return FormatError(
        f"the scene is too large or too small to be drawn: {what}; pictures reach from {1 / MOST_UNITS:g} to "
        f"{MOST_UNITS:g} units",
        field="file",
        cure="are all its positions and sizes right? leave out the Gaussians that are not, or scale the scene",
    )


def _warnings(reading: Reading) -> list[dict[str, str]]:
    """What was not taken as it was. The notes name options of the command; the fields of a request have their names."""
    notes = [OPTION.sub(r"\1=\2", note) for note in reading.notes()]
    return [{"code": "file_read_with_notes", "message": note} for note in notes]
