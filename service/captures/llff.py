"""Reader of LLFF's poses_bounds.npy: a row per photograph, in the order of their names."""

from __future__ import annotations

import io
from collections.abc import Sequence
from tokenize import TokenError

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..cameras.camera_fields import CameraFile, NamedView, SizeOf
from ..cameras.pose import checked_pose
from ..cameras.pose_cures import LLFF
from ..errors import CameraError
from .table import CameraTable, check_listed

SIGNATURE = b"\x93NUMPY"
COLUMNS = 17  # 3 rows of (R | t | height, width, focal), then the nearest and the farthest depth


def read_llff(data: bytes, source: str) -> CameraTable:
    """The cameras of an LLFF file: world_from_cam with columns of R pointing down, right and backwards; size and focal
    length in px; the principal point is the centre. Raises `CameraError`.
    """
    rows = _rows(data, source)
    check_listed(len(rows), source)

    def parse(indices: Sequence[int], size_of: SizeOf | None) -> CameraFile:
        return CameraFile.bounded([_view(rows[index], index) for index in indices])

    return CameraTable("llff", source, (None,) * len(rows), parse, by_sorted_name=True)


def _view(row: NDArray[np.float64], index: int) -> NamedView:
    matrix = row[:15].reshape(3, 5)
    down, right, back, center = matrix[:, :4].T
    height, width, focal = matrix[:, 4]
    pose = checked_pose(np.stack([right, down, -back, center], axis=1), field="cameras", index=index)
    pose = pose.written(LLFF, "opencv", "c2w")
    camera = Camera.make(width, height, focal, focal, width / 2, height / 2, pose, field="cameras", index=index)
    near, far = float(row[15]), float(row[16])
    if not (np.isfinite([near, far]).all() and 0 < near < far):
        message = f"bounds are {near:g} and {far:g}, need 0 < near < far"
        cure = "was this view registered at all? leave out its row and its photograph"
        raise CameraError(message, field="cameras", index=index, cure=cure)
    return NamedView(None, camera, bounds=(near, far))


def _rows(data: bytes, source: str) -> NDArray[np.float64]:
    """(N, 17) rows; the header is checked against the size of the data first. Raises `CameraError`."""
    stream = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        if version == (1, 0):
            shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
        elif version == (2, 0):
            shape, fortran, dtype = np.lib.format.read_array_header_2_0(stream)
        else:
            raise ValueError(f"its version is {version}")
    except (ValueError, SyntaxError, TypeError, OverflowError, MemoryError, RecursionError, TokenError) as error:
        message = f"{source} is not a readable .npy file: {error}"
        raise CameraError(message, field="cameras", cure="is the file complete?") from error
    if dtype.kind != "f" or len(shape) != 2 or shape[1] != COLUMNS:
        need = f"need floating-point numbers of shape (N, {COLUMNS}), as LLFF writes them"
        message = f"{source} holds {dtype} of shape {shape}, {need}"
        raise CameraError(message, field="cameras", cure="is it the poses_bounds.npy of the capture?")
    body = data[stream.tell() :]
    if shape[0] * COLUMNS * dtype.itemsize != len(body):
        message = f"{source} has {len(body)} bytes of numbers, its header says {shape[0]} x {COLUMNS} of {dtype}"
        raise CameraError(message, field="cameras", cure="is the file complete?")
    rows = np.frombuffer(body, dtype=dtype).reshape(shape, order="F" if fortran else "C")
    return rows.astype(np.float64)
