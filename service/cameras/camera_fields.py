"""The value types that camera files parse into, and the checks of their single fields."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arguments import real_number, shown
from ..errors import CameraError, IntrinsicsError
from .camera import Camera
from .distortion import MAX_SHIFT_PX, Lens, pinhole_window
from .pose import Pose, checked_pose, inverted_pose

F64 = NDArray[np.float64]

SizeOf = Callable[[str | None, int], tuple[int, int]]  # (image name, view index) -> (width, height) in px
# x right, y up, z backward -> x right, y down, z forward; its own inverse
OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class NamedView:
    """A camera and the name of its photograph, as the file has it."""

    image: str | None
    camera: Camera
    lens: Lens | None = None  # what the photograph is resampled from to the camera's pinhole, None where it shows it
    bounds: tuple[float, float] | None = None  # nearest and farthest depth of this view, where the file has them


@dataclass(frozen=True)
class CameraFile:
    """What a camera file says; near and far are None where it says nothing."""

    views: tuple[NamedView, ...]
    near: float | None = None
    far: float | None = None

    @property
    def cameras(self) -> tuple[Camera, ...]:
        return tuple(view.camera for view in self.views)

    @classmethod
    def bounded(cls, views: Sequence[NamedView]) -> CameraFile:
        """Of views with bounds of their own: from the nearest of the near ones to the farthest of the far ones."""
        bounds = [view.bounds for view in views if view.bounds is not None]
        near, far = (min(near for near, _ in bounds), max(far for _, far in bounds)) if bounds else (None, None)
        return cls(tuple(views), near, far)

    def chosen(self, indices: Sequence[int]) -> CameraFile:
        """These views in this order; where views have bounds, near and far are those of the chosen ones, if any."""
        views = tuple(self.views[index] for index in indices)
        if self._by_view:
            return self.bounded(views)
        return CameraFile(views, self.near, self.far)

    def depths(self, near: float | None, far: float | None) -> tuple[float | None, float | None]:
        """Near and far: each as it is given here, else the file's."""
        return self.near if near is None else near, self.far if far is None else far

    def middles(self, near: float | None, far: float | None) -> list[float | None]:
        """The harmonic mean of nearest and farthest depth of each view: of `near` and `far` if one of them is given,
        else of its bounds, else of the file's unless other views have bounds; None where one end is unknown."""
        if near is None and far is None and self._by_view:
            return [None if view.bounds is None else harmonic_mean(*view.bounds) for view in self.views]
        near, far = self.depths(near, far)
        return [None if near is None or far is None else harmonic_mean(near, far)] * len(self.views)

    @property
    def _by_view(self) -> bool:
        """Whether near and far of the file are those of single views."""
        return any(view.bounds is not None for view in self.views)


def harmonic_mean(near: float, far: float) -> float:
    """Of two depths; NaN unless 0 < near < far, which is refused later."""
    return 2.0 / (1.0 / near + 1.0 / far) if 0 < near < far else math.nan


def number_of(entry: Mapping, name: str, *, field: str, index: int | None = None) -> float:
    """The finite number under `name`. Raises `CameraError` where it is missing or anything else."""
    if name not in entry:
        raise CameraError(f"{name} is missing", field=field, index=index)
    value = entry[name]
    number = real_number(value)
    if number is None:
        cure = "write it without quotation marks" if isinstance(value, str) else None
        raise CameraError(f"{name} = {shown(value)} is not a number", field=f"{field}.{name}", index=index, cure=cure)
    if not math.isfinite(number):
        raise CameraError(f"{name} = {number}, need a finite number", field=f"{field}.{name}", index=index)
    return number


def optional_number(obj: Mapping, name: str) -> float | None:
    """The number under `name`, None where it is absent or null."""
    return None if obj.get(name) is None else number_of(obj, name, field="cameras")


def image_name(entry: Mapping, name: str, *, field: str, index: int | None) -> str | None:
    """The string under `name`, None where it is absent or null. Raises `CameraError`."""
    value = entry.get(name)
    if value is not None and not isinstance(value, str):
        raise CameraError(f"{name} = {shown(value)} is not a file name", field=f"{field}.{name}", index=index)
    return value


def json_kind(value: object) -> str:
    """For a message: what a decoded value was in the file."""
    kinds = {dict: "an object", list: "a list", str: "a text", bool: "true or false", type(None): "null"}
    return kinds.get(type(value), "a number" if isinstance(value, int | float) else f"a {type(value).__name__}")


def list_of(obj: Mapping, name: str) -> Sequence[Mapping]:
    """The non-empty list of objects under `name`. Raises `CameraError`."""
    entries = obj[name]
    if not isinstance(entries, list) or not entries:
        raise CameraError(f"{name} must be a non-empty list of views", field=f"cameras.{name}")
    for index, entry in enumerate(entries):
        if not isinstance(entry, Mapping):
            raise CameraError(f"is {json_kind(entry)}, need an object", field=f"cameras.{name}", index=index)
    return entries


def opencv_pose(matrix: object, *, form: str, axes: str, pose: str, field: str, index: int | None) -> Pose:
    """world_from_cam in OpenCV axes; `axes` (opencv | opengl) and `pose` (c2w | w2c) say what `matrix` is, in a file of
    this `form`."""
    parse = inverted_pose if pose == "w2c" else checked_pose
    world_from_cam, given = parse(matrix, field=field, index=index)
    turned = world_from_cam @ OPENCV_FROM_OPENGL if axes == "opengl" else world_from_cam
    return Pose(turned, given).written(form, axes, pose)


def view_through(image: str | None, lens: Lens, pose: Pose, *, field: str, index: int | None = None) -> NamedView:
    """The view of a photograph through a lens: as a pinhole where no point moves by 0.5 px, else as the pinhole that
    its photograph is to be resampled to. Raises `IntrinsicsError` for intrinsics that no lens has, and for distortion
    that no pinhole can show.
    """
    camera = Camera.make(lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy, pose, index=index, field=field)
    if lens.largest_shift() < MAX_SHIFT_PX:
        return NamedView(image, camera)
    try:
        window = pinhole_window(lens)
    except IntrinsicsError as error:
        raise IntrinsicsError(error.message, field=f"{field}.distortion", index=index, cure=error.cure) from error
    center = lens.cx - window.left, lens.cy - window.top
    camera = Camera.make(window.width, window.height, lens.fx, lens.fy, *center, pose, index=index, field=field)
    return NamedView(image, camera, lens)
