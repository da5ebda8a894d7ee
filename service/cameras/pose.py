"""Rigid motions: parse a pose matrix, project its rotation onto SO(3) where it was rounded, and invert it."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import PoseError
from .float32 import half_step

F64 = NDArray[np.float64]
Refusal = Callable[..., PoseError]  # of a message and a cure

# At this distance from orthonormal the projection onto SO(3) moves the principal ray by 0.05 px each way at f = 1000
# px; rounding to six decimals in a text file stays far below.
MAX_ORTHONORMALITY_ERROR = 1e-4
FEW_DIGITS = 0.03  # what two digits behind the point leave of orthonormality: at most 0.016 of a thousand rotations
LEAST_SCALE = 1e-3  # from 1; what is less may be rounding unless it explains nine tenths of the drift
MAX_OFFSET = 1e100  # caller's units: squares and cubes stay finite
NOT_FOUND = "was the pose of this view found at all? leave it out"
ROUNDING = 1e-14  # what float64 leaves of orthonormality (some 1e-15); such a matrix is kept to the bit


class Given(NamedTuple):
    """How a pose was given: how precise, and by which convention."""

    drift: float = 0.0  # max |R^T R - I|, camera to world; 0 where it is mere float64 rounding and R is kept to the bit
    shift: float = 0.0  # how far projecting R onto SO(3) moved the camera centre, units; 0 for camera to world
    step: float = 0.0  # half a float32 step of its translation, see `float32.py`
    form: str = ""  # of the file that it comes from, such as cameras.json; empty for a matrix of the caller's
    axes: str = "opencv"  # or opengl, in the file
    pose: str = "c2w"  # or w2c, in the file

    @property
    def precision(self) -> tuple[float, float, float]:
        """What a scene depends on."""
        return self.drift, self.shift, self.step

    @property
    def convention(self) -> tuple[str, str, str]:
        """What only the words of a cure depend on."""
        return self.form, self.axes, self.pose


AS_IT_IS = Given()


class Pose(NamedTuple):
    """A checked rigid motion."""

    matrix: F64  # (4, 4)
    given: Given

    def written(self, form: str, axes: str, pose: str) -> Pose:
        """The same, with a word on how it was written: see `Given`."""
        return Pose(self.matrix, self.given._replace(form=form, axes=axes, pose=pose))


def rigid_motion(rotation: F64, translation: F64) -> F64:
    """(4, 4) matrix [R | t] of a `rotation` (3, 3) and a `translation` (3,)."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, translation
    return matrix


def rigid_inverse(matrix: F64) -> F64:
    """(4, 4) inverse of a rigid motion, exact to rounding: [R^T | -R^T t]."""
    inverse = matrix[:3, :3].T
    return rigid_motion(inverse, -inverse @ matrix[:3, 3])


def checked_pose(value: object, *, field: str = "c2w", index: int | None = None) -> Pose:
    """Parse a (4, 4) or (3, 4) rigid motion; R within 1e-4 of orthonormal is projected onto SO(3).

    An R that is orthonormal to float64 rounding keeps its bits, so that checking twice changes nothing. Raises
    `PoseError` for anything else, naming field, index and numbers.
    """
    refusal = partial(PoseError, field=field, index=index)
    matrix = _numbers(value, refusal)
    if matrix.shape == (3, 4):
        matrix = np.vstack([matrix, [0.0, 0.0, 0.0, 1.0]])
    if matrix.shape != (4, 4):
        raise refusal(f"shape is {matrix.shape}, need (4, 4)", cure="give 4 rows of 4 numbers, or the upper 3 of them")
    bad = int((~np.isfinite(matrix)).sum())
    if bad:
        raise refusal(f"{bad} of 16 numbers are NaN or infinite", cure=NOT_FOUND)
    if not np.allclose(matrix[3], [0, 0, 0, 1], atol=1e-6):
        raise refusal(f"last row is {matrix[3].tolist()}, need [0, 0, 0, 1]", cure="is it transposed?")
    rotation, translation = matrix[:3, :3], matrix[:3, 3]
    offset = float(np.abs(translation).max())
    if offset > MAX_OFFSET:
        raise refusal(f"the camera is {offset:.3g} units away, need at most {MAX_OFFSET:g}", cure=NOT_FOUND)
    drift = _checked_drift(rotation, refusal)
    if drift <= ROUNDING:
        drift = 0.0
    else:
        u, _, vt = np.linalg.svd(rotation)
        rotation = u @ vt
    return Pose(rigid_motion(rotation, translation), Given(drift, 0.0, half_step(translation)))


def _numbers(value: object, refusal: Refusal) -> F64:
    """`value` in float64, of whatever shape. Raises `PoseError` for anything but real numbers, also for text and truth
    values, which numpy would convert."""
    try:
        entries = np.asarray(value)
        if entries.dtype.kind == "c":
            cure = "take its real part, where the imaginary one is rounding"
            raise refusal("holds complex numbers, need real ones", cure=cure)
        numbers = entries.astype(np.float64)
        for entry in np.asarray(value, dtype=object).flat:
            if isinstance(entry, str | bytes | bool | np.bool_):
                text = isinstance(entry, str | bytes)
                cure = "write numbers without quotation marks" if text else "write 1 and 0 for true and false"
                raise refusal(f"holds {entry!r:.50}, need numbers", cure=cure)
    except (TypeError, ValueError, OverflowError, RuntimeError) as error:  # torch raises the last for its gradients
        raise refusal("is not a matrix of numbers", cure="give 4 rows of 4 numbers") from error
    return numbers


def _checked_drift(rotation: F64, refusal: Refusal) -> float:
    """max |R^T R - I| of a `rotation` R (3, 3). Raises `PoseError` where that is above MAX_ORTHONORMALITY_ERROR, and
    for a reflection."""
    largest = float(np.abs(rotation).max())
    if largest > MAX_OFFSET:
        raise refusal(f"R has an entry of {largest:.3g}, need at most 1", cure=NOT_FOUND)
    drift = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
    det = float(rotation[0] @ np.cross(rotation[1], rotation[2]))  # np.linalg.det divides by pivots, which may be 0
    if det < 0:
        raise refusal(f"det(R) = {det:.4g}, need +1", cure="one axis is mirrored; is the source left-handed?")
    if drift <= MAX_ORTHONORMALITY_ERROR:
        return drift
    scale = abs(det) ** (1 / 3)
    left = float(np.abs(rotation.T @ rotation / scale**2 - np.eye(3)).max()) if scale > 0 else math.inf
    scaled = left <= MAX_ORTHONORMALITY_ERROR and abs(scale - 1) > LEAST_SCALE
    if scaled or left <= 0.1 * drift:
        cure = f"R carries a scale of {scale:.6g}; divide it out"
    elif drift < FEW_DIGITS:
        cure = "R is sheared, or was written with too few digits: give five or more behind the point"
    else:
        cure = "R is sheared or not a rotation"
    message = f"max |R^T R - I| = {drift:.3g}, need at most {MAX_ORTHONORMALITY_ERROR:g} (det {det:.4g})"
    raise refusal(message, cure=cure)


def inverted_pose(value: object, *, field: str, index: int | None) -> Pose:
    """The inverse of a motion as `checked_pose` parses it: what is given is world to camera, R x + t.

    The camera is where R x + t = 0; with R projected it is -R^T t, which is another place far from the origin.
    """
    matrix, given = checked_pose(value, field=field, index=index)
    inverse = rigid_inverse(matrix)
    if given.drift == 0:
        return Pose(inverse, given)
    rotation, offset = np.array(value, dtype=np.float64)[:3, :3], matrix[:3, 3]
    drift = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    shift = float(np.linalg.norm(inverse[:3, 3] + np.linalg.solve(rotation, offset)))
    return Pose(inverse, Given(drift, shift, given.step))
