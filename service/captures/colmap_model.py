"""A COLMAP model as its files have it: cameras, images, and the rigs and frames of newer releases."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..cameras.rotations import matrix_from_quaternion
from ..errors import CameraError, PoseError

F64 = NDArray[np.float64]

CAMERA = 0  # the kind of sensor that is a camera
SENSORS = ("CAMERA", "IMU")

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
    """The intrinsics that images share."""

    model: str
    width: int
    height: int
    params: tuple[float, ...]


@dataclass(frozen=True)
class ColmapImage:
    """A registered photograph; the seven numbers are qw qx qy qz tx ty tz of camera from world."""

    name: str
    camera_id: int
    cam_from_world: tuple[float, ...]


Sensor = tuple[int, int]  # kind and id


@dataclass(frozen=True)
class ColmapFrame:
    """A rig at one moment, and the images that its sensors took."""

    rig_id: int
    rig_from_world: tuple[float, ...]
    images: tuple[tuple[Sensor, int], ...]  # sensor, image id


@dataclass
class ColmapModel:
    """Everything by its id; ids have gaps."""

    cameras: dict[int, ColmapCamera] = field(default_factory=dict)
    images: dict[int, ColmapImage] = field(default_factory=dict)
    # per rig its sensors' poses from the rig, None where it is not known
    rigs: dict[int, dict[Sensor, tuple[float, ...] | None]] = field(default_factory=dict)
    frames: dict[int, ColmapFrame] = field(default_factory=dict)

    def pose(self, image_id: int) -> F64:
        """(4, 4) camera from world: through the frame and its rig where they tell, as COLMAP does, else as the image
        has it. Raises `PoseError` for a quaternion that is none, `CameraError` for a rig that is not there.
        """
        image = self.images[image_id]
        if image_id in self._taken:
            frame_id, sensor = self._taken[image_id]
            frame = self.frames[frame_id]
            rig = self.rigs.get(frame.rig_id)
            if rig is None:
                message = f"frame {frame_id} is of rig {frame.rig_id}, which is missing"
                raise CameraError(message, field="cameras", cure="are both files of one model?")
            sensor_from_rig = rig.get(sensor)
            if sensor_from_rig is not None:
                return rigid(sensor_from_rig, image.name) @ rigid(frame.rig_from_world, image.name)
        return rigid(image.cam_from_world, image.name)

    @cached_property
    def _taken(self) -> dict[int, tuple[int, Sensor]]:
        """The frame and the camera that took an image, by its id."""
        return {
            image_id: (frame_id, sensor)
            for frame_id, frame in self.frames.items()
            for sensor, image_id in frame.images
            if sensor[0] == CAMERA
        }


def rigid(numbers: tuple[float, ...], name: str) -> F64:
    """(4, 4) of qw qx qy qz tx ty tz; the quaternion is brought to length 1, as COLMAP does."""
    wxyz = np.array(numbers[:4])
    with np.errstate(over="ignore"):
        length = float(np.linalg.norm(wxyz))
    if not (np.isfinite(length) and length > 0):
        message = f"image {name!r} has a quaternion of length {length:g}, need 1"
        raise PoseError(message, field="cameras", cure="was the pose of this image found at all? leave it out")
    matrix = np.eye(4)
    matrix[:3, :3] = matrix_from_quaternion(wxyz / length)
    matrix[:3, 3] = numbers[4:]
    return matrix
