"""Streaming reader of COLMAP's binary files; the points of images are skipped."""

from __future__ import annotations

import io
import struct
from typing import Any, BinaryIO, TypeVar, cast

import numpy as np

from ..errors import CameraError
from .colmap_model import (
    IDENTITY,
    MODELS,
    ColmapCamera,
    ColmapFrame,
    ColmapImage,
    Points,
    PointsSoFar,
    Sensor,
    check_points,
    repeated_id,
)
from .table import MAX_LISTED

_Entry = TypeVar("_Entry")

_SEEN = 8  # bytes of an image's id and the place of its point
_POINT2D = 24  # bytes of x, y and the point's id
_LONGEST_NAME = 4096
_CHUNK = 2**20


class _Bytes:
    """A little-endian stream that raises `CameraError` if it ends too early."""

    def __init__(self, stream: BinaryIO, source: str) -> None:
        self._stream = (
            stream if isinstance(stream, io.BufferedReader) else io.BufferedReader(cast(io.RawIOBase, stream))
        )
        self._source, self._place = source, 0

    def take(self, size: int) -> bytes:
        data = self._stream.read(size)
        self._place += len(data)
        if len(data) < size:
            message = f"{self._source} ends after {self._place} bytes, in the middle of an entry"
            raise CameraError(message, field="cameras", cure="is the file complete?")
        return data

    def unpack(self, layout: str) -> tuple[Any, ...]:
        return struct.unpack(f"<{layout}", self.take(struct.calcsize(f"<{layout}")))

    def skip(self, size: int) -> None:
        while size > 0:
            size -= len(self.take(min(size, _CHUNK)))

    def count(self, what: str) -> int:
        return self.checked(self.unpack("Q")[0], what)

    def checked(self, count: int, what: str) -> int:
        if count > MAX_LISTED:
            message = f"{self._source} says that it has {count} {what}, the limit is {MAX_LISTED}"
            raise CameraError(message, field="cameras", cure="is it a file of COLMAP, and complete?")
        return count

    def add(self, entries: dict[int, _Entry], key: int, entry: _Entry) -> None:
        """Raises `CameraError` for an id that is there already."""
        if key in entries:
            raise repeated_id(self._source, key)
        entries[key] = entry

    def name(self) -> str:
        name = bytearray()
        while True:
            ahead = self._stream.peek(1)[: _LONGEST_NAME + 1]
            found = ahead.find(b"\0")
            name += self.take(found if found >= 0 else max(len(ahead), 1))
            if found >= 0:
                self.take(1)
                break
            if len(name) > _LONGEST_NAME:
                message = f"{self._source} has a name of more than {_LONGEST_NAME} bytes"
                raise CameraError(message, field="cameras", cure="is it a file of COLMAP, and complete?")
        return name.decode("utf-8", "replace")


def read_cameras(stream: BinaryIO, source: str) -> dict[int, ColmapCamera]:
    """Cameras of a cameras.bin by id."""
    data = _Bytes(stream, source)
    cameras: dict[int, ColmapCamera] = {}
    for _ in range(data.count("cameras")):
        camera_id, model, width, height = data.unpack("IiQQ")
        if model not in MODELS:
            message = f"{source}: camera {camera_id} has model number {model}, need 0 to {max(MODELS)}"
            raise CameraError(message, field="cameras", cure="is it a file of COLMAP?")
        name, params = MODELS[model]
        data.add(cameras, camera_id, ColmapCamera(name, width, height, data.unpack(f"{params}d")))
    return cameras


def read_images(stream: BinaryIO, source: str) -> dict[int, ColmapImage]:
    """Images of an images.bin by id; their points are skipped."""
    data = _Bytes(stream, source)
    images: dict[int, ColmapImage] = {}
    for _ in range(data.count("images")):
        image_id, *pose, camera_id = data.unpack("I7dI")
        name = data.name()
        data.skip(_POINT2D * data.unpack("Q")[0])
        data.add(images, image_id, ColmapImage(name, camera_id, tuple(pose)))
    return images


def read_rigs(stream: BinaryIO, source: str) -> dict[int, dict[Sensor, tuple[float, ...] | None]]:
    """Rigs of a rigs.bin by id; the first sensor of a rig is its reference."""
    data = _Bytes(stream, source)
    rigs: dict[int, dict[Sensor, tuple[float, ...] | None]] = {}
    total = 0
    for _ in range(data.count("rigs")):
        rig_id, count = data.unpack("II")
        total = data.checked(total + count, "sensors")
        sensors: dict[Sensor, tuple[float, ...] | None] = {}
        for place in range(count):
            sensor: Sensor = data.unpack("iI")
            if place == 0:
                sensors[sensor] = IDENTITY
            else:
                sensors[sensor] = data.unpack("7d") if data.unpack("B")[0] else None
        data.add(rigs, rig_id, sensors)
    return rigs


def read_frames(stream: BinaryIO, source: str) -> dict[int, ColmapFrame]:
    """Frames of a frames.bin by id."""
    data = _Bytes(stream, source)
    frames: dict[int, ColmapFrame] = {}
    total = 0
    for _ in range(data.count("frames")):
        frame_id, rig_id, *pose, count = data.unpack("II7dI")
        total = data.checked(total + count, "images of frames")
        images = []
        for _ in range(count):
            kind, sensor_id, image_id = data.unpack("iIQ")
            images.append(((kind, sensor_id), image_id))
        data.add(frames, frame_id, ColmapFrame(rig_id, tuple(pose), tuple(images)))
    return frames


def read_points(stream: BinaryIO, source: str) -> Points:
    """Points of a points3D.bin. Raises `CameraError`, also above the limits of `check_points`."""
    data, found = _Bytes(stream, source), PointsSoFar(source)
    count = data.unpack("Q")[0]
    check_points(count, 0, source)
    for _ in range(count):
        _, x, y, z, _, _, _, error, length = data.unpack("Q3d3BdQ")
        found.check(length)  # before so much is read
        found.add((x, y, z, error), np.frombuffer(data.take(_SEEN * length), "<u4")[::2].astype(np.uint32))
    return found.points()
