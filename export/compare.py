"""Numbers of one comparison: how far one runtime's outputs are from the reference's, and whether routes agree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# A route may legitimately differ where the deciding logits are closer than rounding can tell apart (numerics R2).
AMBIGUOUS_GAP = 2e-5
# Rounding stays below this share of an output's range; what is above it was tipped over an edge of the definition.
JUMP = 2e-4


@dataclass(frozen=True)
class Deviation:
    """Error of one output against the reference, in units of the reference's largest magnitude."""

    maximum: float
    p99: float
    mean: float
    jumps: float  # share of elements whose error is above `JUMP`
    scale: float  # largest magnitude of the reference
    finite: bool


@dataclass(frozen=True)
class RouteAgreement:
    """Patches whose experts or leading task differ, split by whether the logits decide."""

    patches: int
    flipped: int
    flipped_unambiguous: int


def deviation(value: NDArray, reference: NDArray) -> Deviation:
    """Raises `ValueError` when the shapes differ: a graph that baked in a view count must not pass by broadcasting."""
    if value.shape != reference.shape:
        raise ValueError(f"shape is {value.shape}, need {reference.shape}")
    if value.size == 0:
        return Deviation(0.0, 0.0, 0.0, 0.0, 0.0, True)
    finite = bool(np.isfinite(value).all())
    error = np.abs(value.astype(np.float64) - reference.astype(np.float64))
    error = np.where(np.isfinite(error), error, np.inf).ravel()
    scale = float(np.abs(reference).max())
    error /= scale if scale > 0 else 1.0
    return Deviation(
        float(error.max()),
        float(np.quantile(error, 0.99)),
        float(error.mean()),
        float((error > JUMP).mean()),
        scale,
        finite,
    )


def quaternions_aligned(value: NDArray, reference: NDArray) -> NDArray:
    """`value` with each quaternion's sign turned to the reference's: q and -q are the same rotation."""
    sign = np.sign((value * reference).sum(-1, keepdims=True))
    return value * np.where(sign == 0, 1, sign)


def ambiguous_routes(expert_logits: NDArray, task_logits: NDArray, top_k: int) -> NDArray[np.bool_]:
    """(M,) patches where a deciding gap is below `AMBIGUOUS_GAP` of the largest logit."""
    ordered = -np.sort(-expert_logits, axis=-1)
    gaps = (ordered[:, :-1] - ordered[:, 1:])[:, :top_k].min(axis=-1)
    tasks = -np.sort(-task_logits, axis=-1)
    task_gap = tasks[:, 0] - tasks[:, 1]
    limit = AMBIGUOUS_GAP * np.maximum(np.abs(expert_logits).max(-1), np.abs(task_logits).max(-1))
    return (gaps <= limit) | (task_gap <= limit)


def route_agreement(
    index: NDArray,
    reference_index: NDArray,
    task_weight: NDArray,
    reference_task_weight: NDArray,
    ambiguous: NDArray[np.bool_],
    kept: NDArray[np.bool_],
) -> RouteAgreement:
    """Compare routes of kept patches; the leading task is the one of largest weight."""
    k = index.shape[-1]
    differs = (index.reshape(-1, k) != reference_index.reshape(-1, k)).any(-1)
    tasks = task_weight.reshape(-1, task_weight.shape[-1]).argmax(-1)
    differs |= tasks != reference_task_weight.reshape(-1, task_weight.shape[-1]).argmax(-1)
    differs &= kept.ravel()
    return RouteAgreement(int(kept.sum()), int(differs.sum()), int((differs & ~ambiguous).sum()))
