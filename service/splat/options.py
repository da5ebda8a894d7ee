"""Checks of the arguments of `render`: definition, background, size, outputs, harmonic degree."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..arguments import listed, of_type, real_number, shown, whole_number
from ..cameras.camera import Camera
from ..errors import InputError
from ..gaussians import GAUSSIANS_CURE, Gaussians
from .binning import Grid
from .definition import COMPATIBLE, Definition
from .spans import MAX_SIDE

OUTPUTS = ("alpha", "depth", "median", "removed", "peaks", "pairs")  # optional outputs beside the colours
ANALYSIS = ("median", "removed", "peaks", "pairs")  # these are computed together


def check_types(gaussians: Gaussians, camera: Camera) -> None:
    """Raises `InputError` for a scene or a camera of another type."""
    of_type(gaussians, Gaussians, "gaussians", GAUSSIANS_CURE)
    of_type(camera, Camera, "camera", "use Camera.make")


def checked_definition(definition: Definition | None, near: float | None, compatibility: str | None) -> Definition:
    """The definition given as such or by the name of a renderer, else the default; `near` replaces its own.

    Raises `InputError` for an unknown name, for both at once and for a `near` out of range.
    """
    if compatibility is not None:
        if compatibility not in COMPATIBLE:
            raise InputError(f"is {compatibility!r}, need one of {', '.join(COMPATIBLE)}", field="compatibility")
        if definition is not None:
            raise InputError("goes without a definition, which it is", field="compatibility")
        definition = COMPATIBLE[compatibility]
    if definition is None:
        definition = Definition()
    of_type(definition, Definition, "definition", "name a renderer by compatibility, or leave it out for the default")
    if near is None:
        return definition
    plane = real_number(near)
    if plane is None:
        raise InputError(f"is {shown(near)}, need a number", field="near")
    if not 0 <= plane <= definition.far:
        raise InputError(f"is {plane:g}, need 0 to {definition.far:g}", field="near")
    return replace(definition, near=plane)


def checked_background(background: Sequence[float] | None) -> NDArray[np.float32]:
    """(3,) background colour; None is black. Raises `InputError` unless it is three finite numbers."""
    try:  # a copy in C order: kernels take no strides, and numba would compile them again for a read-only array
        value = np.array((0, 0, 0) if background is None else background, dtype=np.float32, order="C")
    except (TypeError, ValueError):
        value = np.empty(0, np.float32)
    if value.shape != (3,) or not np.isfinite(value).all():
        raise InputError(f"is {shown(background)}, need three finite numbers", field="background")
    return value


def checked_size(camera: Camera) -> Grid:
    """The tile grid of the camera's picture. Raises `InputError` for a side above MAX_SIDE."""
    side = max(camera.width, camera.height)
    if side > MAX_SIDE:
        raise InputError(
            f"{camera.width} x {camera.height} px, at most {MAX_SIDE} per side can be drawn",
            field="camera.size",
            cure="draw it in parts, each by a cropped camera",
        )
    return Grid(camera.width, camera.height)


def checked_outputs(outputs: Collection[str]) -> list[str]:
    """The requested outputs, also those of an iterator. Raises `InputError` for unknown ones."""
    names = listed(outputs, "outputs")
    for name in names:
        if name not in OUTPUTS:
            raise InputError(f"{shown(name)} is unknown, need some of {', '.join(OUTPUTS)}", field="outputs")
    return names


def checked_subset(
    outputs: Collection[str], subset: NDArray[np.bool_] | None, gaussians: Gaussians
) -> NDArray[np.bool_] | None:
    """`subset` as a mask (N,) where "removed" is among `outputs`, else None.

    Raises `InputError` for a subset without that output or the reverse.
    """
    if ("removed" in outputs) != (subset is not None):
        cure = "give one" if subset is None else "ask for 'removed' or leave it out"
        raise InputError(f"goes with the output 'removed': {cure}", field="subset")
    if subset is None:
        return None
    chosen = np.asarray(subset)
    if chosen.shape != (len(gaussians),) or chosen.dtype != bool:
        need = f"need ({len(gaussians)},) of bool"
        raise InputError(f"is {chosen.shape} of {chosen.dtype}, {need}", field="subset")
    return chosen


def checked_degree(sh_degree: int | None, gaussians: Gaussians) -> int:
    """The harmonic degree to evaluate: `sh_degree`, at most that of the set. Raises `InputError`."""
    if sh_degree is None:
        return gaussians.sh_degree
    degree = whole_number(sh_degree)
    if degree not in (0, 1, 2, 3):
        raise InputError(f"is {shown(sh_degree)}, need 0, 1, 2 or 3", field="sh_degree")
    return min(degree, gaussians.sh_degree)
