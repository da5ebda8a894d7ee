"""Supersampling: rendered larger and averaged, with the low-pass filter of the final pixels."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arguments import shown, whole_number
from ..cameras.camera import Camera
from ..errors import InputError
from ..gaussians import Gaussians
from .definition import MAX_DILATION
from .options import check_types, checked_definition, checked_outputs
from .render import Render, render

AVERAGED = ("alpha", "depth")  # outputs that can be averaged


def render_supersampled(gaussians: Gaussians, camera: Camera, factor: int, **options: Any) -> Render:
    """`render` averaged over factor x factor samples per pixel: colour, opacity, and depth weighted by opacity.

    The dilation is scaled with the size, so that splats keep their footprint and only the sampling is finer. Time grows
    with the square of the factor. `stats` are those of the larger image. Raises `InputError` for a factor that is no
    whole number from 1 on or takes the dilation beyond MAX_DILATION, and for outputs other than AVERAGED.
    """
    check_types(gaussians, camera)
    outputs = checked_outputs(options.pop("outputs", AVERAGED))
    others = sorted(set(outputs) - set(AVERAGED))
    if others:
        raise InputError(f"{others[0]!r} has no mean over samples, need some of {', '.join(AVERAGED)}", field="outputs")
    rule = checked_definition(*(options.pop(name, None) for name in ("definition", "near", "compatibility")))
    times, most = whole_number(factor), math.isqrt(int(MAX_DILATION / rule.dilation))
    if times is None or not 1 <= times <= most:
        need = f"need a whole number from 1 to {most}, by which dilation {rule.dilation:g} px^2 stays in its range"
        raise InputError(f"is {shown(factor)}, {need}", field="factor")
    rule = replace(rule, dilation=rule.dilation * times * times)
    larger = camera.resized(times * camera.width, times * camera.height)
    needed = {*outputs, "alpha"} if "depth" in outputs else outputs
    image = render(gaussians, larger, definition=rule, outputs=needed, **options)
    alpha = depth = image.depth[:0, :0]
    if "depth" in outputs:
        weight = averaged(image.alpha, times)
        total = averaged(image.alpha * image.depth, times)
        depth = np.divide(total, weight, out=np.zeros_like(total), where=weight > 0)
    if "alpha" in outputs:
        alpha = averaged(image.alpha, times)
    return Render(averaged(image.rgb, times), alpha, depth, image.stats)


def averaged(plane: NDArray[np.floating], factor: int) -> NDArray[np.float32]:
    """(H, W, ...) means over squares of factor x factor samples of (factor H, factor W, ...)."""
    height, width, *rest = plane.shape
    squares = plane.reshape(height // factor, factor, width // factor, factor, *rest)
    return squares.mean(axis=(1, 3), dtype=np.float64).astype(np.float32)
