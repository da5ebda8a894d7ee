"""A smooth path that interpolates posed cameras and leads back, with continuous position and direction.

Where the cameras exactly retrace their way, the path reverses on the spot. Between two cameras the centre follows a
cubic Hermite curve with the tangents of a centripetal Catmull-Rom spline (Catmull and Rom 1974; Yuksel, Schaefer and
Keyser, Computer-Aided Design 43, 2011: centripetal knots avoid cusps and loops). The rotation follows the cumulative
cubic Bezier curve with the same knots and tangents (Kim, Kim and Shin, SIGGRAPH 1995), which is a slerp for cameras
that turn evenly. Intrinsics are interpolated linearly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..cameras.camera import Camera
from ..cameras.pose import rigid_motion
from ..cameras.rotations import (
    F64,
    matrix_from_quaternion,
    quaternion_from_matrix,
    quaternion_from_vector,
    quaternion_product,
    rotation_vector,
)
from ..errors import ViewError
from .framing import frame
from .views import between

STEPS = 256  # samples per piece for its arc length
TURN_SHARE = 0.15  # of the time each way in which the speed rises from 0, and falls to 0 again
LEAST_STEP = 1e-9  # times the pivot's depth: closer cameras count as one


@dataclass(frozen=True, eq=False)
class Piece:
    """The path from one camera to the next, with parameter u from 0 to 1. Tangents are derivatives by u."""

    start: Camera
    end: Camera
    center_tangents: F64  # (2, 3) caller's units
    turns: F64  # (3, 3) rotation vectors, radians, in the axes of `start`: exp(t0) exp(t1) exp(t2) leads to `end`

    def centers(self, u: F64) -> F64:
        """(N, 3) camera centres at the parameters (N,)."""
        u = u[:, None]
        first, last = self.center_tangents
        from_start = u * u * (3 - 2 * u) * (self.end.center - self.start.center)
        tangents = u * (1 - u) ** 2 * first + u * u * (u - 1) * last
        return self.start.center + from_start + tangents

    def rotations(self, u: F64) -> F64:
        """(N, 4) unit quaternions wxyz, camera to world."""
        shares = (1 - (1 - u) ** 3, u * u * (3 - 2 * u), u**3)
        found = quaternion_from_matrix(self.start.rotation)[None]
        for share, turn in zip(shares, self.turns, strict=True):
            found = quaternion_product(found, quaternion_from_vector(share[:, None] * turn))
        return found

    def camera(self, u: float) -> Camera:
        """The camera at one parameter; at 0 and 1 exactly `start` and `end`."""
        if u in (0.0, 1.0):
            return frame((self.start, self.end)[int(u)], self.start.width, self.start.height)
        at = np.array([u])
        pose = rigid_motion(matrix_from_quaternion(self.rotations(at)[0]), self.centers(at)[0])
        return between(self.start, self.end, u).posed(pose)

    def lengths(self, pivot_depth: float) -> F64:
        """(STEPS + 1,) arc lengths from the start to equidistant parameters, in the metric of `distance`."""
        u = np.linspace(0.0, 1.0, STEPS + 1)
        moved = np.linalg.norm(np.diff(self.centers(u), axis=0), axis=1)
        q = self.rotations(u)
        back = q[:-1] * (1, -1, -1, -1)
        turned = quaternion_product(back, q[1:])
        angles = 2 * np.arctan2(np.linalg.norm(turned[:, 1:], axis=1), np.abs(turned[:, 0]))
        return np.concatenate([[0.0], np.cumsum(np.hypot(moved, pivot_depth * angles))])


@dataclass(frozen=True, eq=False)
class InputPath:
    """The path there and back at constant speed, but slower at both ends. All pictures have the first camera's size."""

    pieces: Sequence[Piece]
    arc_lengths: Sequence[F64]  # of each piece, (STEPS + 1,)

    @classmethod
    def through(cls, cameras: Sequence[Camera], pivot_depth: float) -> InputPath:
        """The path through the cameras. Raises `ViewError` unless two of them have different poses."""
        kept = list(cameras[:1])
        for camera in cameras[1:]:
            if distance(kept[-1], camera, pivot_depth) > LEAST_STEP * pivot_depth:
                kept.append(frame(camera, kept[0].width, kept[0].height))
        if len(kept) < 2:
            raise ViewError(
                f"{len(kept)} place of a camera is no path, need 2", field="path", cure="ask for turntable or orbit"
            )
        knots = np.sqrt([distance(one, other, pivot_depth) for one, other in pairwise(kept)])
        moves = np.diff([camera.center for camera in kept], axis=0)
        turns = np.stack([rotation_vector(one.rotation.T @ other.rotation) for one, other in pairwise(kept)])
        move_tangents, turn_tangents = _tangents(moves, knots), _tangents(turns, knots)
        pieces = []
        for index, h in enumerate(knots):
            first, last = h * turn_tangents[index : index + 2] / 3
            whole = kept[index].rotation.T @ kept[index + 1].rotation
            middle = rotation_vector(_matrix(-first) @ whole @ _matrix(-last))
            turns_of_piece = np.stack([first, middle, last])
            pieces.append(Piece(kept[index], kept[index + 1], h * move_tangents[index : index + 2], turns_of_piece))
        return cls(pieces, [piece.lengths(pivot_depth) for piece in pieces])

    def at(self, time: float) -> Camera:
        """The camera at a time in [0, 1], from the first camera to the last at 1/2, and back."""
        time = time % 1.0
        ends = np.cumsum([0.0, *(lengths[-1] for lengths in self.arc_lengths)])
        gone = ends[-1] * _progress(2 * min(time, 1 - time))
        index = int(np.clip(np.searchsorted(ends, gone, side="right") - 1, 0, len(self.pieces) - 1))
        u = float(np.interp(gone - ends[index], self.arc_lengths[index], np.linspace(0.0, 1.0, STEPS + 1)))
        return self.pieces[index].camera(u)


def distance(one: Camera, other: Camera, pivot_depth: float) -> float:
    """Distance of two poses in the caller's units; a rotation counts by how far it moves points at `pivot_depth`."""
    angle = float(np.linalg.norm(rotation_vector(one.rotation.T @ other.rotation)))
    return float(np.hypot(np.linalg.norm(other.center - one.center), pivot_depth * angle))


def _tangents(steps: F64, knots: F64) -> F64:
    """(N + 1, 3) Catmull-Rom tangents at the knots, from steps (N, 3) over `knots` (N,); one-sided at the ends."""
    speeds = steps / knots[:, None]
    h = knots[:, None]
    inner = speeds[:-1] - (steps[:-1] + steps[1:]) / (h[:-1] + h[1:]) + speeds[1:]
    return np.concatenate([speeds[:1], inner, speeds[-1:]])


def _progress(time: float) -> float:
    """Share of the arc length at a share of the time: constant speed, but for linear ramps of TURN_SHARE at both
    ends."""
    e = TURN_SHARE
    if time > 0.5:
        return 1 - _progress(1 - time)
    return time * time / (2 * e * (1 - e)) if time < e else (time - e / 2) / (1 - e)


def _matrix(vector: F64) -> F64:
    return matrix_from_quaternion(quaternion_from_vector(vector))
