"""Refuse keys of a camera file that would be ignored though they matter: other camera models than a pinhole, and
distortion coefficients under other names."""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import islice
from typing import Any

from ..errors import IntrinsicsError
from ..plain_number import plain_float

COEFFICIENTS = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
# Pinholes, and what can be undistorted to one.
MODELS = ("PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")
# Words in the names of other camera models. Short ones count only as the whole name: devices have them in theirs.
NOT_PINHOLE = {
    *("FISHEYE", "EQUIDISTANT", "EQUISOLID", "STEREOGRAPHIC", "ORTHOGRAPHIC", "KANNALA", "BRANDT", "EUCM"),
    *("SPHERE", "SPHERICAL", "EQUIRECTANGULAR", "PANORAMA", "PANORAMIC", "CYLINDRICAL", "OMNIDIRECTIONAL", "PRISM"),
}
NOT_PINHOLE_ALONE = {"FOV", "OMNI", "UCM", "MEI", "ORTHO", "DIVISION"}
OTHER_NAMES = (
    "distortion",
    "distortion_params",
    "distortion_parameters",
    "distortion_coefficients",
    "distortion_coeffs",
    "dist_coeffs",
    "radial_distortion",
    "tangential_distortion",
)
NOTHING = 1e-6  # of a coefficient: at the corner of a picture of 90 degrees it moves a point by a thousandth of a px
NO_SKEW = 0.01  # px
MOST_VALUES, LONGEST_TEXT = 100, 2000  # of one key; a lens has about 16 numbers
UNDISTORT = "undistort the photographs first"


def require_pinhole_model(values: Mapping, *, field: str, index: int | None) -> None:
    """Raises `IntrinsicsError` unless `camera_model` is one of MODELS, and for `is_fisheye`."""
    model = str(values.get("camera_model") or "OPENCV")
    if model.upper() not in MODELS:
        _refuse(f"camera_model is {model[:60]}, need a pinhole ({', '.join(MODELS)})", f"{field}.camera_model", index)
    _refuse_fisheye(values, field, index)


def refuse_distorting_model(values: Mapping, *, field: str, index: int | None) -> None:
    """Raises `IntrinsicsError` for a `camera_model` whose name says that it is no pinhole, and for `is_fisheye`; the
    name of a device passes."""
    model = str(values.get("camera_model") or "")
    if NOT_PINHOLE & set(re.split("[^A-Z]+", model.upper())) or model.upper() in NOT_PINHOLE_ALONE:
        _refuse(f"camera_model is {model[:60]}, need a pinhole", f"{field}.camera_model", index)
    _refuse_fisheye(values, field, index)


def refuse_other_names(values: Mapping, *, field: str, index: int | None) -> None:
    """Raises `IntrinsicsError` for nonzero coefficients under one of OTHER_NAMES while all of COEFFICIENTS are 0 or
    missing (ignored, a distorted picture would be taken for a pinhole's), and for `skew`."""
    told = any(_distorts(values.get(known)) for known in COEFFICIENTS)
    for name in OTHER_NAMES:
        if not told and _distorts(values.get(name)):
            message = f"{name} = {str(values[name])[:60]}: coefficients are read from {', '.join(COEFFICIENTS)} alone"
            cure = "undistort the photographs, or name the coefficients so in a transforms.json"
            _refuse(message, f"{field}.{name}", index, cure)
    if _distorts(values.get("skew"), NO_SKEW):
        _refuse(f"skew = {str(values['skew'])[:60]}, need 0: a pinhole has none", f"{field}.skew", index)


def _refuse_fisheye(values: Mapping, field: str, index: int | None) -> None:
    if str(values.get("is_fisheye") or "false").lower() not in ("false", "0", "no", "off"):
        _refuse("is_fisheye is set: the lens is a fisheye, need a pinhole", f"{field}.is_fisheye", index)


def _refuse(message: str, field: str, index: int | None, cure: str = UNDISTORT) -> None:
    raise IntrinsicsError(message, field=field, index=index, cure=cure)


def in_a_matrix(values: Mapping, focal: str) -> str:
    """Where the intrinsics of a view are, if it has them as a matrix K; `focal` is what the file calls the focal
    lengths."""
    for name, value in values.items():
        match value:
            case [[int() | float() as fx, *_], _, [0, 0, 1]] if fx > 1:  # else a rotation, or not in px
                return f"; of a matrix {str(name)[:20]} {focal}, cx, cy are [0][0], [1][1], [0][2], [1][2]"
    return ""


def too_long(value: object) -> bool:
    """Whether it has more values, in lists at any depth, or more letters than a lens can need."""
    waiting, count = [value], 0
    while waiting:
        one = waiting.pop()
        count += 1
        if count > MOST_VALUES or (isinstance(one, str) and len(one) > LONGEST_TEXT):
            return True
        if isinstance(one, list | tuple | Mapping):
            waiting += islice(one.values() if isinstance(one, Mapping) else one, MOST_VALUES)
    return False


def _distorts(value: Any, nothing: float = NOTHING) -> bool:
    """Whether `value` is, or contains, a number, also as text, of a magnitude above `nothing`, or is `too_long`."""
    return too_long(value) or _holds(value, nothing)


def _holds(value: Any, nothing: float) -> bool:
    if isinstance(value, str):
        value = [_number(word) for word in re.split(r"[\s,;\[\]()]+", value)]
    if isinstance(value, list | tuple | Mapping):
        listed = value.values() if isinstance(value, Mapping) else value
        return any(_holds(one, nothing) for one in listed)
    return isinstance(value, int | float) and not abs(value) <= nothing


def _number(word: str) -> float | None:
    try:
        return plain_float(word)
    except ValueError:
        return None
