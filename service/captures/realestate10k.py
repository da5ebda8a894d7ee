"""Reader of the text files of RealEstate10K and ACID: a line per video frame, with normalised intrinsics."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..cameras.camera import Camera
from ..cameras.camera_fields import CameraFile, NamedView, SizeOf
from ..cameras.pose import inverted_pose
from ..cameras.pose_cures import REALESTATE10K
from ..errors import CameraError
from .table import CameraTable, check_listed

COLUMNS = 19  # time stamp, fx, fy, cx, cy, two zeros, 3 rows of world to camera


def looks_like_realestate10k(data: bytes) -> bool:
    """Whether the first line, or the one after a URL, has the columns of a frame."""
    lines = [line for line in data[:4096].decode("utf-8-sig", "replace").splitlines() if line.strip()][:2]
    rows = lines[1:] if lines and _is_address(lines[0]) else lines[:1]
    return bool(rows) and len(rows[0].split()) == COLUMNS and rows[0].split()[0].isdigit()


def read_realestate10k(data: bytes, source: str) -> CameraTable:
    """The cameras of a file; views are named by time stamps, sizes come from photographs. Raises `CameraError`."""
    lines = [line for line in data.decode("utf-8-sig", "replace").splitlines() if line.strip()]
    if lines and _is_address(lines[0]):
        lines = lines[1:]
    check_listed(len(lines), source)
    rows = [line.split() for line in lines]

    def parse(indices: Sequence[int], size_of: SizeOf | None) -> CameraFile:
        return CameraFile(tuple(_view(rows[index], index, source, size_of) for index in indices))

    return CameraTable("realestate10k", source, tuple(row[0] for row in rows), parse)


def _view(row: Sequence[str], index: int, source: str, size_of: SizeOf | None) -> NamedView:
    try:
        numbers = [float(word) for word in row[1:]]
    except ValueError as error:
        cure = "is it a file of RealEstate10K, and complete?"
        raise CameraError(f"{source}: {error!s:.200}", field="cameras", index=index, cure=cure) from error
    if len(row) != COLUMNS:
        message = f"{source}: the line has {len(row)} columns, need {COLUMNS}"
        raise CameraError(message, field="cameras", index=index, cure="is the file complete?")
    fx, fy, cx, cy, *rest = numbers
    if rest[0] != 0 or rest[1] != 0:
        message = f"{source}: columns 6 and 7 are {rest[0]:g} and {rest[1]:g}, need 0: a pinhole"
        raise CameraError(message, field="cameras", index=index, cure="undistort the photographs first")
    if not all(map(math.isfinite, (fx, fy, cx, cy))) or max(abs(fx), abs(fy)) > 20:
        message = f"{source}: fx, fy = {fx:g}, {fy:g}, need shares of the picture's width and height"
        raise CameraError(message, field="cameras", index=index, cure="divide pixels by the width and the height")
    if size_of is None:
        raise CameraError(f"{source} has no picture sizes", field="cameras", index=index, cure="send the photographs")
    width, height = size_of(row[0], index)
    pose = inverted_pose([rest[2:6], rest[6:10], rest[10:14]], field="cameras", index=index)
    pose = pose.written(REALESTATE10K, "opencv", "w2c")
    camera = Camera.make(
        width, height, fx * width, fy * height, cx * width, cy * height, pose, field="cameras", index=index
    )
    return NamedView(row[0], camera)


def _is_address(line: str) -> bool:
    return line.startswith(("http://", "https://"))
