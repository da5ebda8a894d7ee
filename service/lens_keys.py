"""Keys of a camera file that say what no reader of ours would act on: another lens than a pinhole, or one whose
coefficients have other names."""

from __future__ import annotations

from collections.abc import Mapping

from .errors import IntrinsicsError

COEFFICIENTS = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
# Pinholes, and what can be undistorted to one.
MODELS = ("PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")
OTHER_NAMES = (
    "distortion",
    "distortion_params",
    "distortion_parameters",
    "distortion_coefficients",
    "distortion_coeffs",
    "dist_coeffs",
    "radial_distortion",
    "tangential_distortion",
    "skew",
)


def require_known_lens(values: Mapping, *, field: str, index: int | None) -> None:
    """Raises `IntrinsicsError` for a model that does not become a pinhole, and for what is no 0 under other names than
    those of COEFFICIENTS: passed over, a bent picture would be taken for a straight one."""
    model = values.get("camera_model") or "OPENCV"
    if model not in MODELS or values.get("is_fisheye"):
        shown = "fisheye" if values.get("is_fisheye") else model
        raise IntrinsicsError(
            f"camera_model is {shown}, need a pinhole ({', '.join(MODELS)})",
            field=f"{field}.camera_model",
            index=index,
            cure="undistort the photographs first",
        )
    for name in OTHER_NAMES:
        if _says_something(values.get(name)):
            raise IntrinsicsError(
                f"{name} = {str(values[name])[:60]}: a lens is read from {', '.join(COEFFICIENTS)} alone",
                field=f"{field}.{name}",
                index=index,
                cure="undistort the photographs, or write a transforms.json with the coefficients under these names",
            )


def _says_something(value: object) -> bool:
    """Whether it is neither nothing nor zeros."""
    if isinstance(value, list | tuple):
        return any(map(_says_something, value))
    if isinstance(value, Mapping):
        return any(map(_says_something, value.values()))
    return value not in (None, 0, "", False)
