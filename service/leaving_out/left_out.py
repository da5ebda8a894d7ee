"""Pruning of a reconstructed scene, and the report of everything that was left out: counts, errors, bytes.

Rows follow the order of the pipeline: patches and routes that the network's experts skip, then Gaussians.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..document import GAUSSIANS
from ..formats.ply_write import ply_size
from ..gaussians import Gaussians, without_zero_bands
from ..network.model_info import ModelInfo
from ..photographs.masks import FADED, TRANSPARENT
from ..splat import Render, render
from ..viewpoints.scene_views import SceneViews
from .budget import Budget
from .certified import certified_views
from .pruning import largest_change, prune, removal_bound

if TYPE_CHECKING:
    from ..mending.after_network import Unpruned


def leave_out(
    gaussians: Gaussians, may_go: NDArray[np.bool_], scene: SceneViews, budget: Budget, threads: int | None
) -> tuple[Gaussians, list[Render], dict[str, Any]]:
    """Prune `gaussians` within `budget`; only those of the mask `may_go` (N,) are candidates.

    Returns the pruned set, its renders (colour and opacity) from the inputs' cameras, and a report of plain JSON.
    """
    started = time.perf_counter()
    options: dict[str, Any] = {**scene.near_plane, "threads": threads}
    cameras, whole = scene.cameras, gaussians
    asked = [scene.resolve(spec, field="views") for spec in budget.asked]
    views = certified_views(cameras, budget.certify, asked)
    faint = may_go & (gaussians.opacities < budget.min_opacity)
    faint_bound = removal_bound(gaussians, faint, views, **options) if faint.any() else 0.0
    if faint.any():
        gaussians, may_go = gaussians[~faint], may_go[~faint]
    if budget.max_error is None:
        lean, unseen, bound, actual = gaussians, 0, 0.0, 0.0
        pictures = _drawn(lean, cameras, options)
    else:
        found = prune(gaussians, views, budget.max_error, may_go=may_go, pictures=len(cameras), **options)
        lean = without_zero_bands(gaussians[found.keep] if found.dropped else gaussians)
        unseen, bound, actual, pictures = found.unseen, found.bound, found.actual, found.pictures
    if faint.any():
        actual = largest_change(pictures, _drawn(whole, cameras, options))
    between = len(views) - len(cameras) - len(asked)
    bounded = budget.max_error is not None or budget.min_opacity > 0
    report = {
        "max_error": budget.max_error,
        "min_opacity": budget.min_opacity,
        "stride": budget.stride,
        "certified": {"inputs": len(cameras), "between": between, "asked": len(asked)} if bounded else None,
        "elsewhere": "estimate",
        "kept": len(lean),
        "dropped": len(whole) - len(lean),
        "unseen": unseen,
        "faint": int(faint.sum()),
        "bound": bound + faint_bound,
        "faint_bound": faint_bound,
        "actual": actual,
        "bands": [whole.sh_degree, lean.sh_degree],
        "bytes_saved": 0 if lean is whole else ply_size(whole) - ply_size(lean),
        "seconds": round(time.perf_counter() - started, 6),
        "picture_seconds": None if lean is whole else _both_seconds(whole, lean, cameras[0], options),
    }
    return lean, pictures, report


def _drawn(gaussians: Gaussians, cameras: Sequence[Camera], options: Mapping[str, Any]) -> list[Render]:
    return [render(gaussians, camera, outputs=("alpha",), **options) for camera in cameras]


def _both_seconds(whole: Gaussians, lean: Gaussians, camera: Camera, options: Mapping[str, Any]) -> list[float]:
    """Time of one render of each set, s: the smaller of two, in turns, as other work of the machine may delay any."""
    rounds = [[_seconds(each, camera, options) for each in (whole, lean)] for _ in range(2)]
    return [min(pair) for pair in zip(*rounds, strict=True)]


def _seconds(gaussians: Gaussians, camera: Camera, options: Mapping[str, Any]) -> float:
    """Time of one render, s, without the preparation that is done once per set."""
    stages = render(gaussians, camera, outputs=(), **options).stats["seconds"]
    return round(sum(seconds for name, seconds in stages.items() if name != "prepare"), 6)


def table(unpruned: Unpruned, info: ModelInfo, pruned: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Rows {what, count, of, error} from a scene before `leave_out`, and the report `pruned` of that.

    `error` bounds the change of colour in certified views: 0 where nothing changes, None where no bound applies.
    """
    outputs, patch_mask = unpruned.outputs, unpruned.patch_mask
    rows: list[dict[str, Any]] = []

    def row(what: str, count: int, of: int, error: float | None = 0.0) -> None:
        if count:
            rows.append({"what": what, "count": int(count), "of": int(of), "error": error})

    row("patches under a mask", int((~patch_mask).sum()), patch_mask.size, None)
    experts = info.experts
    if "expert_weight" in outputs and experts is not None and not info.keep_all:
        runs = int((outputs["expert_weight"] > 0).sum())
        row("runs of an expert on a patch", patch_mask.size * experts - runs, patch_mask.size * experts)
        idle = experts - len(np.unique(outputs["expert_index"][outputs["expert_weight"] > 0]))
        row("experts that no patch chose", idle, experts)
    total = len(outputs["opacities"]) + unpruned.placed.added
    for reason, count in unpruned.dropped.items():
        row(f"{GAUSSIANS}: {reason}", count, total, 0.0 if reason in (TRANSPARENT, FADED) else None)
    lost = sum(unpruned.dropped.values())
    row(f"{GAUSSIANS} between strides", total - lost - pruned["kept"] - pruned["dropped"], total, None)
    row(f"{GAUSSIANS} below min_opacity", pruned["faint"], total, pruned["faint_bound"])
    row(f"{GAUSSIANS} without weight in the certified views", pruned["unseen"], total)
    within = pruned["dropped"] - pruned["unseen"] - pruned["faint"]
    row(f"{GAUSSIANS} within the budget", within, total, pruned["bound"] - pruned["faint_bound"])
    row("bands of harmonics that are 0", pruned["bands"][0] - pruned["bands"][1], pruned["bands"][0])
    return rows
