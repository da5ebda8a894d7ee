"""Checks of a set of cameras before reconstruction: count, intrinsics, baseline, depth range, overlap."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import BaselineError, IntrinsicsError, OverlapError, ViewCountError
from ..plain_number import counted
from .camera import Camera
from .depth_range import MAX_RATIO, DepthRange, depth_range_of_reading, largest_baseline
from .other_size import other_size, told_first
from .overlap import best_partner_shares, inverse_depth_steps
from .pose_readings import apart_when_inverted, other_readings, robot_readings, with_cures
from .rotations import rotation_angle

MIN_VIEWS = 2
MAX_VIEWS = 6
MIN_PARALLAX_PX = 0.25  # parallax between near and infinity, below which depth is noise
SAME_POSITION = 1e-6  # of the near depth: 1e-3 px at f = 1000 px
SAME_ROTATION = 1e-6  # rad
MIN_SHARE = 0.1  # of a view, at the depth where it shares most; real captures have 0.9 and more
LITTLE_SHARE = 0.3  # below it, a warning
TIE = 0.1  # readings of the poses that overlap about equally are all named
WIDE_RANGE = 1000.0  # far / near from which the depth steps are too coarse beyond some 10 x near
DEPTH_PLANES = 64  # of the shipped network, for the depth-step table in the warning
DECADES = np.array([1.0, 10.0, 100.0, 1000.0])  # of near: the depths in that table
_DEPTHS = 16  # depths at which the overlap is evaluated
_ANY_DEPTH = np.geomspace(0.1, 1000.0, 32)  # in baselines: wide enough where an estimated range may be wrong

Notice = dict[str, Any]  # code, message and what it is about


def check_views(
    cameras: Sequence[Camera],
    depths: DepthRange,
    *,
    trust_poses: bool = False,
    numbers: Sequence[int] | None = None,
) -> list[Notice]:
    """Refuse cameras from which no scene can be reconstructed; return warnings about little overlap, and about
    intrinsics that look like those of pictures of another size.

    Raises `ViewCountError`, `IntrinsicsError`, `BaselineError` (the same pose twice, no parallax, or a distance beyond
    float32) or `OverlapError`, which names other interpretations of the poses under which the views overlap. Where the
    range is estimated, views are refused only if they overlap at no other depth either; with `trust_poses` never.
    `numbers`: what errors and warnings call the views, one each; by default 0, 1, 2...
    """
    check_count(len(cameras))
    numbers = range(len(cameras)) if numbers is None else numbers
    for number, camera in zip(numbers, cameras, strict=True):
        _check_principal_point(camera, number)
    _check_baselines(cameras, depths, numbers)
    try:
        return other_size(cameras) + _check_overlap(cameras, depths, trust_poses, numbers)
    except OverlapError as error:  # a wrong focal length makes views share less
        told_first(cameras, error)
        raise


def range_notices(depths: DepthRange, planes: int = DEPTH_PLANES) -> list[Notice]:
    """A warning where `far / near` is so large that the sweep's `planes` are coarse; else an empty list."""
    ratio = depths.far / depths.near
    if ratio <= WIDE_RANGE:
        return []
    table = (f"{z:.4g}: {100 * depths.half_step(planes, z):.2g} %" for z in depths.near * DECADES)
    message = (
        f"far / near = {ratio:.3g}: depth steps are coarse beyond {10 * depths.near:.3g}; half a step with {planes} "
        f"planes, by depth: {', '.join(table)}"
    )
    return [{"code": "depth_range_wide", "field": "near", "message": message}]


def check_count(count: int) -> None:
    """Raises `ViewCountError` outside 2..6."""
    if not MIN_VIEWS <= count <= MAX_VIEWS:
        few, many = "one view has no parallax", "choose views that overlap, from different places"
        message = f"{counted(count, 'view')}, need {MIN_VIEWS} to {MAX_VIEWS}"
        raise ViewCountError(message, field="cameras", cure=few if count < MIN_VIEWS else many)


def parallax_px(one: Camera, other: Camera, near: float) -> float:
    """Upper bound, px, on the parallax of a point at depth `near` against one at infinity between two views."""
    return max(one.fx, one.fy, other.fx, other.fy) * float(np.linalg.norm(one.center - other.center)) / near


def _check_principal_point(camera: Camera, index: int) -> None:
    """Refuse a principal point within one pixel of the upper left corner: it is normalised by the image size."""
    if 0 < camera.cx <= 1 < camera.width / 8 and 0 < camera.cy <= 1 < camera.height / 8:
        raise IntrinsicsError(
            f"cx, cy = {camera.cx:g}, {camera.cy:g} px in an image of {camera.width} x {camera.height} px",
            field="cameras.cx",
            index=index,
            cure=f"these look normalised; in pixels they are {camera.cx * camera.width:g}, "
            f"{camera.cy * camera.height:g}",
        )


def _check_baselines(cameras: Sequence[Camera], depths: DepthRange, numbers: Sequence[int]) -> None:
    """Raises `BaselineError` for views that are too far apart or have the same pose, and where no pair has parallax."""
    widest = (0.0, 0, 1)
    for j, one in enumerate(cameras):
        for i, other in enumerate(cameras[:j]):
            apart = float(np.abs(one.center - other.center).max())
            if apart > MAX_RATIO * depths.near:
                raise BaselineError(
                    f"views {numbers[i]} and {numbers[j]} stand {apart:.3g} apart at near = {depths.near:g}, need at "
                    f"most {MAX_RATIO:g} times near",
                    field="cameras",
                    index=numbers[j],
                    cure="give near, far and the poses in one unit, such as metres",
                )
            baseline = float(np.linalg.norm(one.center - other.center))
            angle = rotation_angle(one.rotation.T @ other.rotation)
            if baseline <= SAME_POSITION * depths.near and angle <= SAME_ROTATION:
                raise BaselineError(
                    f"views {numbers[i]} and {numbers[j]} have the same pose "
                    f"(distance {baseline:.3g}, angle {angle:.3g} rad)",
                    field="cameras",
                    index=numbers[j],
                    cure="leave one of them out; is each pose the one of its own photograph?",
                )
            widest = max(widest, (parallax_px(one, other, depths.near), i, j))
    parallax, i, j = widest
    if parallax < MIN_PARALLAX_PX:
        raise BaselineError(
            f"no pair of views has parallax: the widest, views {numbers[i]} and {numbers[j]}, shifts a point at "
            f"near = {depths.near:g} by {parallax:.3g} px, need at least {MIN_PARALLAX_PX}",
            field="cameras",
            index=numbers[j],
            cure="move the camera between the photographs; are positions and near in the same unit?"
            + apart_when_inverted(cameras),
        )


def _check_overlap(
    cameras: Sequence[Camera], depths: DepthRange, trust_poses: bool, numbers: Sequence[int]
) -> list[Notice]:
    """The warning of `check_views`, about the view that overlaps least. Raises `OverlapError`."""
    steps = inverse_depth_steps(depths.near, depths.far, _DEPTHS)
    shares = best_partner_shares(cameras, steps).max(axis=1)
    lonely = int(np.argmin(shares))
    if shares[lonely] >= LITTLE_SHARE:
        return []
    message = (
        f"view {numbers[lonely]} shares at most {100 * shares[lonely]:.0f} % of its picture with any other view, "
        f"at any depth from {depths.near:.4g} to {depths.far:.4g}"
    )
    notices = [{"code": "little_overlap", "field": "cameras", "index": numbers[lonely], "message": message}]
    if shares[lonely] >= MIN_SHARE or trust_poses:
        return notices
    if depths.source == "estimated":
        steps = _ANY_DEPTH * float(np.linalg.norm(largest_baseline(cameras)))
        shares = best_partner_shares(cameras, steps).max(axis=1)
        if shares.min() >= MIN_SHARE:
            return notices
        lonely = int(np.argmin(shares))
        share = 100 * shares[lonely]
        message = (
            f"view {numbers[lonely]} shares at most {share:.0f} % of its picture with any other view, at any depth"
        )
    cure = f"{_cure_of_overlap(cameras, depths)}; if the poses are right as they are, set trust_poses"
    raise OverlapError(f"{message}; need {100 * MIN_SHARE:.0f} %", field="cameras", index=numbers[lonely], cure=cure)


def _cure_of_overlap(cameras: Sequence[Camera], depths: DepthRange) -> str:
    """What to do about views that do not overlap: names other readings of the poses under which they do."""
    shares = []
    for reading in (*other_readings(cameras), *robot_readings(cameras)):
        other = depth_range_of_reading(reading.cameras, depths)
        if other is not None:
            steps = inverse_depth_steps(other.near, other.far, _DEPTHS)
            shares.append((float(best_partner_shares(reading.cameras, steps).max(axis=1).min()), reading))
    best = max((share for share, _ in shares), default=0.0)
    if best < LITTLE_SHARE:
        return "are near and far in the unit of the poses? is each pose the one of its own photograph?"
    return f"these poses look like {with_cures(reading for share, reading in shares if share >= best - TIE)}"
