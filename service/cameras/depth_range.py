"""The depth range of the plane sweep: given by the caller, or estimated from the cameras alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..arguments import real_number, shown
from ..errors import BaselineError, DepthRangeError
from .camera import Camera
from .overlap import best_partner_shares
from .pose_readings import apart_when_inverted

F64 = NDArray[np.float64]

SPREAD = 8.0  # near = convergence / 8, far = 8 x convergence: wide, since the photographs narrow it (depth_sweep)
NEAR_ACROSS = 0.5  # near over baseline for cameras side by side; stereo rigs have 3 and more, a row before a sofa 0.8
NEAR_ALONG = 0.4  # near over baseline for cameras one behind the other; nothing in view is passed on the way
NEAR_TURNED = 0.4  # near over baseline for axes that miss each other: cameras around a thing are at most 2 depths apart
FAR = 50.0  # far over baseline
MIN_CONVERGENCE = math.radians(2.0)  # below this angle between optical axes, as lines, where they meet is chance
MIN_REACH = 0.1  # of the largest baseline; axes that meet closer to a camera than this meet at the camera itself
MAX_PARALLEL = math.radians(5.0)  # the widest angle between the axes of cameras that count as side by side
MAX_MISS = 0.1  # of the depth: axes that pass each other farther off than this do not meet
MIN_SHARE = 0.1  # of a view; what fewer than this share sees in two views cannot be matched
MAX_DEPTH = 1e32  # caller's units, and at least its inverse: float32 scales of what lies there keep all their digits
MAX_RATIO = 1e30  # near is the network's unit, and it reckons in float32
MIN_EXCESS = 1e-6  # of far over near, as a share of near: with less than half a float32 step they are one number to it
ENOUGH_STEPS = 100.0  # of float64 at the cameras' largest coordinate: a shorter baseline has less than two digits
FAR_OFF = 1e6  # units from the origin: coinciding cameras farther off may have lost their baseline to rounding
_SCAN = 24  # depths at which the overlap is evaluated


@dataclass(frozen=True)
class DepthRange:
    """near < far, z-depth in the caller's units, the same for all views."""

    near: float
    far: float
    source: Literal["given", "narrowed", "estimated"]  # narrowed: by the photographs

    def half_step(self, planes: int, depth: float) -> float:
        """Half a step between `planes` planes from near to far, as a share of the z-depth `depth`.

        They are uniform in inverse depth: with half a step h = (1/near - 1/far) / (2 (planes - 1)) the depth z becomes
        1 / (1/z + h), which is nearer by z h / (1 + z h) of itself.
        """
        half = (1 / self.near - 1 / self.far) / (2 * (planes - 1))
        return depth * half / (1 + depth * half)


def depth_range(cameras: Sequence[Camera], near: float | None = None, far: float | None = None) -> DepthRange:
    """Check a given range of z-depths, caller's units, or estimate one where both ends are None.

    Estimate: let D_v be the z-depth in view v of the point closest to all optical axes (least squares), and B the
    largest distance between two cameras. If the axes really meet in front of the cameras (as lines at least 2 degrees
    apart at the widest, every D_v at least B / 10, every axis within D_v / 10 of the point), then

        near = min D_v / 8,   far = 8 max D_v.

    Else, with the parts of B across and along the cameras' mean axis,

        near = 0.5 B_across + 0.4 B_along   where all axes are within 5 degrees of parallel: a rig, a pan, a walk,
        near = 0.4 B                      otherwise: cameras held by hand around something, which miss it a little,
        far = 50 B.

    The range is then cut to where at least one pair of views shares a tenth of its picture: outside nothing can be
    matched. Of 4000 simulated pairs around an object (10 to 90 degrees apart, aim off by up to 8 degrees standard
    deviation) 18 had the object outside the range, nearly all of them with narrow lenses that hardly share it.

    Raises `DepthRangeError` for an empty or malformed range and for one beyond 1e-32 to 1e32 units, and `BaselineError`
    where all camera centres coincide.
    """
    if near is None and far is None:
        return _estimated(cameras)
    if near is None or far is None:
        missing = "near" if near is None else "far"
        cure = "give near and far, or neither to have both estimated"
        raise DepthRangeError(f"{missing} is missing", field=missing, cure=cure)
    return _checked(near, far)


def checked_depth(value: object, name: str) -> float:
    """The finite number above 0 that it is. Raises `DepthRangeError`, for the field `name`, for anything else."""
    number = real_number(value)
    if number is None or not math.isfinite(number) or number <= 0:
        told = shown(value) if number is None else f"{number:g}"
        cure = "depths are counted from the camera along its axis; leave near and far out to have them estimated"
        raise DepthRangeError(f"{name} = {told}, need a finite depth above 0", field=name, cure=cure)
    return number


def _checked(near: float, far: float) -> DepthRange:
    """The given range. Raises `DepthRangeError`."""
    near, far = checked_depth(near, "near"), checked_depth(far, "far")
    if not near < far:
        swapped = "are they swapped, or one of them the file's? then give both"
        cure = swapped if near > far else "the scene needs some depth"
        raise DepthRangeError(f"near = {near:.12g}, far = {far:.12g}, need near < far", field="near", cure=cure)
    if far < near * (1 + MIN_EXCESS):  # which the shortest decimals of exactly as much pass
        message = f"near = {near:.12g}, far = {far:.12g}, need far to exceed near by {MIN_EXCESS:g} of it at least"
        raise DepthRangeError(message, field="near", cure="the scene needs some depth")
    for name, value in (("near", near), ("far", far)):
        if not 1 / MAX_DEPTH <= value <= MAX_DEPTH:
            message = f"{name} = {value:g}, need {1 / MAX_DEPTH:g} to {MAX_DEPTH:g}"
            raise DepthRangeError(message, field=name, cure="give near, far and the poses in one unit, such as metres")
    if far / near > MAX_RATIO:
        cure = "with more than some 1000 no depth candidate is left for the scene"
        raise DepthRangeError(f"far / near = {far / near:.3g}, need at most {MAX_RATIO:g}", field="near", cure=cure)
    return DepthRange(near, far, "given")


def depth_range_of_reading(cameras: Sequence[Camera], depths: DepthRange) -> DepthRange | None:
    """The range for `cameras`, another interpretation of the poses that `depths` belongs to; None where none can be
    estimated, as for coinciding centres.

    A given range holds for every interpretation; an estimate depends on the poses and is repeated.
    """
    if depths.source == "given":
        return depths
    try:
        return depth_range(cameras)
    except (BaselineError, DepthRangeError):
        return None


def _estimated(cameras: Sequence[Camera]) -> DepthRange:
    """The estimate of `depth_range`."""
    baseline = largest_baseline(cameras)
    depths = convergence_depths(cameras)
    if depths is None:
        low, high = _range_from_baseline(cameras, baseline)
    else:
        low, high = float(depths.min()) / SPREAD, float(depths.max()) * SPREAD
    scan = np.geomspace(low, high, _SCAN)
    shared = np.flatnonzero(best_partner_shares(cameras, scan).max(axis=0) >= MIN_SHARE)
    if len(shared) >= 2:
        low, high = float(scan[shared[0]]), float(scan[shared[-1]])
    if low < 1 / MAX_DEPTH or high > MAX_DEPTH:
        raise DepthRangeError(
            f"the cameras stand {float(np.linalg.norm(baseline)):.3g} apart: near = {low:.3g} and far = {high:.3g} as "
            f"estimated, need {1 / MAX_DEPTH:g} to {MAX_DEPTH:g}",
            field="cameras",
            cure="give the poses in one unit, such as metres",
        )
    return DepthRange(low, high, "estimated")


def convergence_depths(cameras: Sequence[Camera]) -> F64 | None:
    """(V,) z-depths of the point where the optical axes meet; None where they do not meet in front of all cameras.

    The point p is the least-squares solution of sum_v (I - a_v a_v^T)(p - c_v) = 0 with centres c_v and unit axes a_v.
    Centres are relative to the first, which avoids cancellation far from the origin. Parallel and antiparallel axes
    have no such point. Where a camera lies on the axis of another, as after a step forward and a turn, p is that
    camera's centre and its depth is rounding noise; hence MIN_REACH.
    """
    axes = np.stack([camera.rotation[:, 2] for camera in cameras])
    centers = np.stack([camera.center for camera in cameras]) - cameras[0].center
    if _widest_between_lines(axes) < MIN_CONVERGENCE:
        return None
    projectors = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    point = np.linalg.solve(projectors.sum(axis=0), np.einsum("vij,vj->i", projectors, centers))
    to_point = point - centers
    depths = np.einsum("vi,vi->v", to_point, axes)
    misses = np.linalg.norm(np.cross(to_point, axes), axis=1)
    least = MIN_REACH * float(np.linalg.norm(largest_baseline(cameras)))
    return depths if (depths >= least).all() and (misses <= MAX_MISS * depths).all() else None


def widest_angle(axes: F64) -> float:
    """The largest angle in radians between two of the unit vectors (V, 3)."""
    return max((angle_between(axes[i], axes[j]) for i in range(len(axes)) for j in range(i)), default=0.0)


def _widest_between_lines(axes: F64) -> float:
    """The largest angle in radians, at most pi / 2, between the undirected lines along the unit vectors (V, 3)."""
    angles = (angle_between(axes[i], axes[j]) for i in range(len(axes)) for j in range(i))
    return max((min(angle, math.pi - angle) for angle in angles), default=0.0)


def angle_between(one: F64, other: F64) -> float:
    """Angle in radians between two unit vectors (3,), by atan2, which is accurate for small angles."""
    return float(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other))


def longest_between(cameras: Sequence[Camera]) -> F64:
    """(3,) the longest vector between two camera centres, 0 where all coincide."""
    centers = np.stack([camera.center for camera in cameras])
    vectors = (centers[:, None] - centers[None]).reshape(-1, 3)
    return np.asarray(vectors[np.argmax(np.linalg.norm(vectors, axis=1))])


def largest_baseline(cameras: Sequence[Camera]) -> F64:
    """As `longest_between`. Raises `BaselineError` where it is zero within rounding."""
    longest = longest_between(cameras)
    length, away = float(np.linalg.norm(longest)), max(float(np.abs(camera.center).max()) for camera in cameras)
    step = float(np.spacing(away))
    if length <= ENOUGH_STEPS * step:
        cure = "move the camera between the photographs"
        if away <= FAR_OFF:
            cure += apart_when_inverted(cameras)
        else:
            cure = (
                f"they are up to {away:.3g} units from the origin, perhaps too far for float64, whose steps are "
                f"{step:.2g} there: subtract a common offset; or {cure}"
            )
        raise BaselineError(
            f"all {len(cameras)} cameras stand in one place (largest distance {length:.3g}): without a baseline "
            "there is no depth",
            field="cameras",
            cure=cure,
        )
    return longest


def _range_from_baseline(cameras: Sequence[Camera], baseline: F64) -> tuple[float, float]:
    """Near and far of cameras whose axes do not meet, from their longest `baseline` (3,)."""
    size = float(np.linalg.norm(baseline))
    axes = np.stack([camera.rotation[:, 2] for camera in cameras])
    if widest_angle(axes) > MAX_PARALLEL:
        return NEAR_TURNED * size, FAR * size
    axis = axes.mean(axis=0) / np.linalg.norm(axes.mean(axis=0))
    across, along = float(np.linalg.norm(np.cross(baseline, axis))), abs(float(baseline @ axis))
    return NEAR_ACROSS * across + NEAR_ALONG * along, FAR * size
