"""Value types of a COLMAP model: cameras, images, points, and the rigs and frames of newer releases."""

from __future__ import annotations

from array import array
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..cameras.pose import rigid_motion
from ..cameras.rotations import matrix_from_quaternion
from ..errors import CameraError, PoseError

F64 = NDArray[np.float64]
U64 = NDArray[np.uint64]

MAX_POINTS = 500_000  # of a model that are read; a few hundred photographs have fewer
MAX_SEEN = 20 * MAX_POINTS  # pairs of a point and an image that was matched in it

CAMERA = 0  # sensor kind of cameras
SENSORS = ("CAMERA", "IMU")
IDENTITY = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # qw qx qy qz tx ty tz

# Number, name and count of parameters of every camera model (colmap/sensor/models.h).
MODELS = {
    0: ("SIMPLE_PINHOLE", 3),
    1: ("PINHOLE", 4),
    2: ("SIMPLE_RADIAL", 4),
    3: ("RADIAL", 5),
    4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8),
    6: ("FULL_OPENCV", 12),
    7: ("FOV", 5),
    8: ("SIMPLE_RADIAL_FISHEYE", 4),
    9: ("RADIAL_FISHEYE", 5),
    10: ("THIN_PRISM_FISHEYE", 12),
    11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    12: ("SIMPLE_DIVISION", 4),
    13: ("DIVISION", 5),
    14: ("SIMPLE_FISHEYE", 3),
    15: ("FISHEYE", 4),
    16: ("EUCM", 6),
    17: ("EQUIRECTANGULAR", 2),
}


@dataclass(frozen=True)
class ColmapCamera:
    """Intrinsics, shared by images."""

    model: str
    width: int
    height: int
    params: tuple[float, ...]


@dataclass(frozen=True)
class ColmapImage:
    """A registered photograph; `cam_from_world` is qw qx qy qz tx ty tz."""

    name: str
    camera_id: int
    cam_from_world: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Points:
    """P sparse points, and in M pairs which image has been matched in which of them."""

    xyz: F64  # (P, 3) in the world
    error: F64  # (P,) mean reprojection error in px, negative where it is unknown
    seen: U64  # (M,) an image's id times 2**32, plus a place in `xyz`; ascending, each once


class PointsSoFar:
    """The points of a file while it is read, in arrays: Python's numbers would take hundreds of megabytes."""

    def __init__(self, source: str) -> None:
        self._source = source
        self._rows, self._lengths, self._images = array("d"), array("I"), array("I")

    def check(self, more: int) -> None:
        """Raises `CameraError` if a point with so many matches were one too many, or they."""
        check_points(len(self._lengths) + 1, len(self._images) + more, self._source)

    def add(self, row: Iterable[float], images: NDArray[np.uint32]) -> None:
        """A point's x, y, z and error, and the ids of the images that it was matched in. Raises as `check`."""
        self.check(len(images))
        self._rows.extend(row)
        self._lengths.append(len(images))
        self._images.frombytes(images.tobytes())

    def points(self) -> Points:
        rows = np.array(self._rows).reshape(-1, 4)
        seen = np.array(self._images, dtype=np.uint64)
        seen <<= np.uint64(32)
        seen |= np.repeat(np.arange(len(rows), dtype=np.uint32), np.asarray(self._lengths))
        seen.sort()
        again = np.flatnonzero(seen[1:] == seen[:-1])  # an image may be matched in a point twice
        return Points(rows[:, :3], rows[:, 3], np.delete(seen, again) if len(again) else seen)


Sensor = tuple[int, int]  # kind and id


@dataclass(frozen=True)
class ColmapFrame:
    """The pose of a rig at one moment, and the images of its sensors."""

    rig_id: int
    rig_from_world: tuple[float, ...]
    images: tuple[tuple[Sensor, int], ...]  # sensor, image id


@dataclass
class ColmapModel:
    """All tables by id; ids may have gaps."""

    cameras: dict[int, ColmapCamera] = field(default_factory=dict)
    images: dict[int, ColmapImage] = field(default_factory=dict)
    # sensor_from_rig poses by rig and sensor, None if unknown
    rigs: dict[int, dict[Sensor, tuple[float, ...] | None]] = field(default_factory=dict)
    frames: dict[int, ColmapFrame] = field(default_factory=dict)

    def pose(self, image_id: int, index: int | None = None) -> F64:
        """(4, 4) cam_from_world: by the frame and its rig if they are known, as in COLMAP, else that of the image.
        Raises `PoseError` for an invalid quaternion, `CameraError` for a missing rig, both with the view's `index`.
        """
        image = self.images[image_id]
        if image_id in self._taken:
            frame_id, sensor = self._taken[image_id]
            frame = self.frames[frame_id]
            rig = self.rigs.get(frame.rig_id)
            if rig is None:
                message = f"frame {frame_id} is of rig {frame.rig_id}, which is missing"
                raise CameraError(message, field="cameras", index=index, cure="are both files of one model?")
            sensor_from_rig = rig.get(sensor)
            if sensor_from_rig is not None:
                with np.errstate(invalid="ignore"):  # infinite translations; the pose is checked later
                    in_rig, of_rig = (rigid(of, image.name, index) for of in (sensor_from_rig, frame.rig_from_world))
                    return in_rig @ of_rig
        return rigid(image.cam_from_world, image.name, index)

    @cached_property
    def _taken(self) -> dict[int, tuple[int, Sensor]]:
        """Frame id and sensor by image id."""
        return {
            image_id: (frame_id, sensor)
            for frame_id, frame in self.frames.items()
            for sensor, image_id in frame.images
            if sensor[0] == CAMERA
        }


def repeated_id(where: str, key: int) -> CameraError:
    """The error for an id that another entry of the same file has."""
    cure = "give every entry an id of its own: COLMAP does"
    return CameraError(f"{where}: the id {key} is that of an earlier entry", field="cameras", cure=cure)


def check_points(points: int, seen: int, source: str) -> None:
    """Raises `CameraError` above `MAX_POINTS` points or `MAX_SEEN` pairs."""
    for count, most, what in ((points, MAX_POINTS, "points"), (seen, MAX_SEEN, "matches of points")):
        if count > most:
            message = f"{source} has {count} {what}, at most {most} are read"
            raise CameraError(message, field="capture", cure="give near and far")


def rigid(numbers: tuple[float, ...], name: str, index: int | None) -> F64:
    """(4, 4) matrix of qw qx qy qz tx ty tz; the quaternion is normalised, as in COLMAP. Raises `PoseError`."""
    wxyz = np.array(numbers[:4])
    with np.errstate(over="ignore"):
        length = float(np.linalg.norm(wxyz))
    if not (np.isfinite(length) and length > 0):
        message = f"image {name!r} has a quaternion of length {length:g}, need 1"
        cure = "was the pose of this image found at all? leave it out"
        raise PoseError(message, field="cameras", index=index, cure=cure)
    return rigid_motion(matrix_from_quaternion(wxyz / length), np.array(numbers[4:]))
