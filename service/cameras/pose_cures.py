"""What to change in poses that follow another convention than the one they were read by, in the words of their file."""

from __future__ import annotations

from collections.abc import Sequence

from .camera import Camera
from .pose import AS_IT_IS, Given

CAMERAS_JSON, TRANSFORMS_JSON, COLMAP, LLFF, REALESTATE10K = (
    "cameras.json",
    "transforms.json",
    "COLMAP",
    "LLFF",
    "RealEstate10K",
)

_AXES = {"opencv": "OpenCV axes (x right, y down, z forward)", "opengl": "OpenGL axes (x right, y up, z backward)"}
_POSES = {"c2w": "camera-to-world", "w2c": "world-to-camera"}
_MATRICES = {  # that are changed as the cure says; a caller's own are named as their pose
    CAMERAS_JSON: "matrix",
    TRANSFORMS_JSON: "transform_matrix",
    COLMAP: "[R | t] of quaternion and translation",
    LLFF: "[right | down | -back | centre]",  # in the file the columns are down, right, back, centre
    REALESTATE10K: "[R | t]",
}


def convention(cameras: Sequence[Camera]) -> Given:
    """How the poses were written; a caller's own matrices where not all were written alike."""
    first = cameras[0].given
    return first if all(camera.given.convention == first.convention for camera in cameras) else AS_IT_IS


def other_convention(given: Given, *, inverted: bool, axes: str) -> tuple[str, str]:
    """What poses look like that are the inverse of what they were read as, or have these other `axes`, and the cure."""
    pose = given.pose if not inverted else "w2c" if given.pose == "c2w" else "c2w"
    looks_like = f"{_POSES[pose]} matrices" if inverted else _AXES[axes]
    if inverted and axes != given.axes:
        looks_like += f" in {_AXES[axes].split(' (')[0]}"
    if given.form == CAMERAS_JSON:
        said = [f'"pose": "{pose}"'] * inverted + [f'"axes": "{axes}"'] * (axes != given.axes)
        named = f", and name the matrices {pose}" if inverted else ""  # by the other name another one may be read
        return looks_like, f"say {' and '.join(said)}{named}"
    steps = [f"invert each {_matrix(given)}"] * inverted
    if axes != given.axes:
        lines = f"{_line(given)}s 1 and 2"
        steps.append(f"then negate {lines}" if steps else f"negate {lines} of each {_matrix(given)}")
    return looks_like, ", ".join(steps)


def in_order(given: Given, signed: Sequence[str]) -> str:
    """The cure of matrices whose columns are these instead, such as ("-1", "-2", "0"); of world-to-camera ones it is
    their rows."""
    line = _line(given)
    lines = ", ".join(f"-{line} {name[1:]}" if name.startswith("-") else f"{line} {name}" for name in signed)
    return f"put {lines} for {line}s 0, 1, 2 of each {_matrix(given)}"


def _line(given: Given) -> str:
    """What belongs to an axis of the camera in such a matrix."""
    return "column" if given.pose == "c2w" else "row"


def _matrix(given: Given) -> str:
    return _MATRICES.get(given.form, given.pose)
