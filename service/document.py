"""The scene document: what was computed, from what, how long it took, and what was left out. Plain JSON values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .cameras.camera import Camera
from .cameras.camera_file import camera_document
from .gaussians import Gaussians
from .photographs.rolled import turned_patches

if TYPE_CHECKING:
    from .inputs import Inputs
    from .mending.after_network import Unpruned
    from .network.engine import Engine

GAUSSIANS = "Gaussians"  # how those rows of `left_out` begin that count them
TASKS = ("mean", "opacity", "covariance", "colour")  # order of the four task weights
MAPPED = 36  # experts that a map can tell apart: one digit each


def scene_document(
    *,
    engine: Engine,
    cameras: Sequence[Camera],
    detail: int,
    inputs: Inputs,
    unpruned: Unpruned,
    gaussians: Gaussians,
    left_out: Sequence[Mapping[str, Any]],
    pruned: Mapping[str, Any],
    check: Mapping[str, Any],
    warnings: Sequence[Mapping[str, Any]],
    timings: Mapping[str, float],
) -> dict[str, Any]:
    """Depths, scales and camera centres are in the caller's units; `timings` in seconds per stage."""
    info, depths, views = engine.info, inputs.depths, inputs.photos.shown
    return {
        "model": {**info.document(), "threads": engine.threads, "engine": engine.made_by.document()},
        "near": depths.near,
        "far": depths.far,
        "depth_range_source": depths.source,
        "detail": detail,
        "cameras": [camera_document(camera) for camera in cameras],
        "view_cameras": [camera_document(view.camera) for view in views],
        "crop": [
            {"kept_share": round(view.kept_share, 6), "turned_degrees": 90 * turn}
            for view, turn in zip(views, inputs.turns, strict=True)
        ],
        "gaussians": {"count": len(gaussians), "sh_degree": gaussians.sh_degree, "added": unpruned.placed.added},
        "dropped": [{"reason": reason, "count": count} for reason, count in unpruned.dropped.items()],
        "left_out": [dict(row) for row in left_out],
        "pruning": dict(pruned),
        "fading": unpruned.fading.document(),
        "routing": routing_summary(unpruned.outputs, inputs.turns, info.height // info.patch),
        "check": dict(check),
        "warnings": [dict(warning) for warning in warnings],
        "timings": {stage: round(seconds, 6) for stage, seconds in timings.items()},
    }


def gaussians_left_out(document: Mapping[str, Any]) -> int:
    """Of all that the network gave or that was added, how many are not in the scene."""
    return sum(row["count"] for row in document["left_out"] if row["what"].startswith(GAUSSIANS))


def routing_summary(outputs: Mapping[str, NDArray], turns: Sequence[int], rows: int) -> dict[str, Any]:
    """How many patches each expert worked on (weight above 0), the mean weight of each task, and as `maps` the heaviest
    expert and task of each patch, a string per view: a digit of base 36 per patch, row by row (`rows` of them), of the
    photographs as they came: the network had each after so many `turns` (`rolled.py`).

    A network without experts or without a task gate has nothing to say about them, and one whose patches went to more
    experts than there are digits has no map of them.
    """
    summary: dict[str, Any] = {}
    maps: dict[str, list[str]] = {}
    back = [-turn for turn in turns]
    if "expert_index" in outputs:
        index, weight = outputs["expert_index"], outputs["expert_weight"]
        experts = np.bincount(index[weight > 0].ravel(), minlength=int(index.max(initial=-1)) + 1)
        summary["patches"] = int(index.shape[0] * index.shape[1])
        summary["patches_per_expert"] = {str(expert): int(count) for expert, count in enumerate(experts)}
        heaviest = np.take_along_axis(index, weight.argmax(-1)[..., None], -1)[..., 0]
        if len(experts) <= MAPPED:
            maps["experts"] = [_digits(view) for view in turned_patches(heaviest, back, rows)]
    if "task_weight" in outputs:
        tasks = outputs["task_weight"].reshape(-1, len(TASKS)).mean(axis=0)
        summary["mean_task_weight"] = {n: round(float(v), 6) for n, v in zip(TASKS, tasks, strict=True)}
        maps["tasks"] = [_digits(view) for view in turned_patches(outputs["task_weight"].argmax(-1), back, rows)]
    if maps:
        summary["maps"] = maps
    return summary


def _digits(numbers: NDArray[np.integer]) -> str:
    """One character for each of up to `MAPPED` kinds."""
    return "".join(np.base_repr(int(number), MAPPED) for number in numbers)
