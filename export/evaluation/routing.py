"""Routing statistics on a test set: share of each expert, mean and deviation of task weights over patches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gapmes.service.document import TASKS
from gapmes.service.network.engine import Arrays


@dataclass(frozen=True)
class RoutingStatistics:
    """Over all patches of all inputs; empty for a gate that the network does not have."""

    patches: int
    expert_share: list[float]  # of the top-k choices, per expert; sums to 1
    task_mean: dict[str, float]
    task_deviation: dict[str, float]  # standard deviation over patches; 0 would be a constant gate
    lambdas: Mapping[str, float] | None  # of Eq. 11


def routes_of(outputs: Arrays) -> Arrays:
    """The outputs that the statistics need, with one row per patch."""
    names = ("expert_index", "task_weight")
    return {name: outputs[name].reshape(-1, outputs[name].shape[-1]) for name in names if name in outputs}


def routing_statistics(
    routes: Sequence[Arrays], experts: int | None, lambdas: Mapping[str, float] | None
) -> RoutingStatistics | None:
    """Statistics over the patches of several scenes; None for a network without gates, no shares without `experts`."""
    if not routes or not routes[0]:
        return None
    pooled = {name: np.concatenate([scene[name] for scene in routes]) for name in routes[0]}
    share: list[float] = []
    if "expert_index" in pooled and experts is not None:
        counts = np.bincount(pooled["expert_index"].ravel(), minlength=experts)
        share = [float(value) for value in counts / counts.sum()]
    mean, deviation = {}, {}
    if "task_weight" in pooled:
        weights = pooled["task_weight"].astype(np.float64)
        mean = {task: float(v) for task, v in zip(TASKS, weights.mean(axis=0), strict=True)}
        deviation = {task: float(v) for task, v in zip(TASKS, weights.std(axis=0), strict=True)}
    return RoutingStatistics(len(next(iter(pooled.values()))), share, mean, deviation, lambdas)
