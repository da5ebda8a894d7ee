"""What a reconstruction tells about its own error: the inputs drawn again, and what could not be measured at all.

None of it needs a truth. A scene that does not show its own inputs well points to an error; one that does may still be
wrong where nothing was measured, so the shares of such pixels stand beside it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .cameras.camera import pixel_grid
from .cameras.depth_range import DepthRange
from .cameras.overlap import inverse_depth_steps
from .gaussians import Gaussians
from .matching.plane_means import plane_means
from .matching.window_match import contrast
from .network.contract import AMBIGUOUS_MARGIN
from .network.model_info import ModelInfo
from .photographs.images import FittedView
from .pictures.picture_error import psnr, ssim
from .splat import Render, render

TEXTURE = 2 / 255  # standard deviation of grey in 7 x 7 px below which a window is as good as flat after 8-bit noise
PARALLAX_PX = 0.25  # shift between near and far below which matching says nothing about depth
GRID = 16  # rays per side on which parallax is looked at
DEPTHS = 64  # depths at which a ray is looked for in the other views
HOLE = 0.5  # opacity


def self_check(
    views: Sequence[FittedView],
    depths: DepthRange,
    info: ModelInfo,
    drawn: Sequence[Render],
    compared: Sequence[FittedView],
) -> dict[str, Any]:
    """Plain JSON values; `drawn` are the scene's pictures, with their opacity, from the cameras of `compared`: `views`,
    which are on the scene's grid with `detail` 1, or the same with more pixels.

    `input_views`: PSNR in dB, SSIM and share of holes of every input drawn again, over the pixels that its mask keeps
    (None where it keeps none; windows of SSIM at its edge see pixels beyond). `depth_step`: half a step between the
    network's depth candidates as a share of the depth, at near, at far, and at the geometric mean of both (None where
    the model does not tell how many there are). Shares are of the pixels that the masks keep, or of rays through them.
    """
    return {
        "input_views": [drawn_again(image, view) for image, view in zip(drawn, compared, strict=True)],
        "textureless_share": _share([_flat(view) for view in views]),
        "no_parallax_share": _share([~has_parallax(views, index, depths) for index in range(len(views))]),
        "depth_step": depth_steps(depths, info),
    }


def drawn_again(image: Render, view: FittedView, *, covered_only: bool = False) -> dict[str, float | None]:
    """PSNR, SSIM and share of holes over what the mask keeps; PSNR and SSIM `covered_only` where there is no hole."""
    picture = np.clip(image.rgb, 0.0, 1.0).transpose(2, 0, 1)
    kept = view.kept
    hole = image.alpha < HOLE
    holes = float(hole[kept].mean()) if kept.any() else math.nan
    compared = kept & ~hole if covered_only else kept
    values = {"psnr": psnr(picture, view.image, compared), "ssim": ssim(picture, view.image, compared), "holes": holes}
    return {name: None if math.isnan(value) else round(value, 6) for name, value in values.items()}


def from_others(
    gaussians: Gaussians, owner: NDArray[np.integer], views: Sequence[FittedView], **options: Any
) -> list[dict[str, float | None]] | None:
    """Each input drawn from the Gaussians of the other inputs' pixels alone, where they cover it; None for two views.

    `owner` (N,) is the view whose pixel a Gaussian belongs to, len(views) for one that belongs to none; `options` are
    keywords of `render`. The network has seen the input, so that this tells of agreement between the views alone.
    """
    if len(views) < 3:
        return None
    rows = []
    for index, view in enumerate(views):
        others = gaussians[(owner != index) & (owner < len(views))]
        image = render(others, view.camera, outputs=("alpha",), **options)
        rows.append(drawn_again(image, view, covered_only=True))
    return rows


def ambiguous_routes(outputs: Mapping[str, NDArray], patch_mask: NDArray[np.bool_]) -> float | None:
    """Share of the kept patches whose route rounding may decide; None where the model does not tell."""
    if "route_margin" not in outputs:
        return None
    return _share([outputs["route_margin"][patch_mask] <= AMBIGUOUS_MARGIN])


def _flat(view: FittedView) -> NDArray[np.bool_]:
    """(N,) of the kept pixels, whether the window around each lacks texture."""
    return (contrast(view.grey, view.kept, plane_means) < TEXTURE)[view.kept]


def has_parallax(views: Sequence[FittedView], index: int, depths: DepthRange) -> NDArray[np.bool_]:
    """For each ray of a grid that the view's mask keeps, whether some other view that has it in its picture sees it
    move by a quarter pixel or more between the near depth and the far one."""
    camera = views[index].camera
    pixels = pixel_grid((GRID, GRID)) / GRID * (camera.width, camera.height)
    column, row = pixels.astype(np.intp).T
    pixels = pixels[views[index].kept[row, column]]
    found = np.zeros(len(pixels), bool)
    for other in (view.camera for position, view in enumerate(views) if position != index):
        tracks, inside = [], np.zeros(len(pixels), bool)
        for depth in inverse_depth_steps(depths.near, depths.far, DEPTHS):
            at, z = other.project(camera.unproject(pixels, np.full(len(pixels), depth)))
            inside |= other.shows(at, z)
            tracks.append(at)
        moved = np.linalg.norm(np.nan_to_num(tracks[0] - tracks[-1], nan=np.inf), axis=1)  # behind it: far from it
        found |= inside & (moved >= PARALLAX_PX)
    return found


def depth_steps(depths: DepthRange, info: ModelInfo) -> dict[str, float | None]:
    """`half_step` of the network's planes at three depths; None where the model does not tell how many there are."""
    planes = info.depth_planes
    at = {"near": depths.near, "middle": math.sqrt(depths.near * depths.far), "far": depths.far}
    return {name: None if planes is None else round(depths.half_step(planes, z), 6) for name, z in at.items()}


def _share(masks: Sequence[NDArray[np.bool_]]) -> float | None:
    joined = np.concatenate([mask.ravel() for mask in masks])
    return round(float(joined.mean()), 6) if joined.size else None
