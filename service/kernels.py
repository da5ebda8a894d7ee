"""Have the compiled loops ready before somebody waits for them."""

from __future__ import annotations

import functools
import logging

import numpy as np

from .cameras.camera import Camera
from .gaussians import Gaussians
from .matching.plane_kernels import mean_planes, spread_along_rows, spread_down_columns
from .matching.reprojection_kernels import compare_level, compare_pixels, reproject_pixels, sample_bilinear
from .mending.choice.candidates import ABOUT, COUNT, KNOWN
from .mending.choice.network import shipped_choice
from .process.compiler_pages import leave_compiler
from .splat import Definition, leverage, render
from .splat.kernel_cache import ELSEWHERE, not_kept

_log = logging.getLogger("gapmes")


@functools.cache
def warm_up() -> None:
    """Compile or load from the cache what a reconstruction and its pictures need; nothing the second time.

    The loops of the exclusive stop, which other renderers have, compile when they are first asked for. What the process
    no longer needs of the compiler leaves its memory (`leave_compiler`).
    """
    camera = Camera.make(32, 32, 32.0, 32.0, 16.0, 16.0, np.eye(4))
    two = np.ones((2, 3), np.float32)
    gaussians = Gaussians.make(2.0 * two, two, [[1.0, 0.0, 0.0, 0.0]] * 2, [0.5, 0.4], np.zeros((2, 1, 3)))
    for max_entries in (1, 2):  # lists in several batches have a kernel of their own
        render(gaussians, camera, threads=1, definition=Definition(max_entries=max_entries)).rgb8()
    render(gaussians, camera, threads=1, outputs=("peaks", "removed", "alpha"), subset=np.ones(2, np.bool_))
    leverage(gaussians, camera, lambda image: (image.rgb, image.rgb, image.alpha), threads=1)  # and colours alone
    planes, features = np.zeros((1, 2, 2)), np.zeros((2, 2, 1), np.float32)
    mean_planes(planes, 1, planes.copy())
    compare_pixels(features, features, planes[0], planes[0], np.ones((2, 2), np.uint8), 1.0, planes[0].copy())
    rays, lens = np.ones((2, 2, 3)), np.ones(4)
    compare_level(features, features, rays, rays[0, 0], lens, 1.0, 1.0, planes[0].copy())
    spread_along_rows(planes, planes[0, :, :1].copy(), planes.copy())
    spread_down_columns(planes, planes[0, :1], planes.copy())
    seen, place = np.ones((2, 2), np.uint8), planes[0].copy()
    reproject_pixels(planes[0], lens, np.eye(4)[:3], lens, np.eye(4)[:3], lens[:2], place, place, place, seen)
    for values in (features, planes[0][..., None]):
        sample_bilinear(values, place, place, values.copy())
    shipped_choice().preferences(np.zeros((COUNT, KNOWN, 1)), np.zeros((ABOUT, 1)))
    leave_compiler()


def is_warm() -> bool:
    """Whether `warm_up` has returned in this process."""
    return warm_up.cache_info().currsize > 0


def warm_up_with_notice() -> None:
    """`warm_up`, with a line in the log where compiled kernels are not kept in the folder that was named for them, or
    in none."""
    if ELSEWHERE is not None:
        _log.warning("%s", ELSEWHERE)
    warm_up()
    if (why := not_kept()) is not None:
        _log.warning("%s; the next start compiles them again", why)
