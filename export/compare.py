"""Error statistics of one runtime's outputs against a reference."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Rounding errors are below this share of an output's range; larger ones cross a discontinuity of the definition.
JUMP = 2e-4


@dataclass(frozen=True)
class Deviation:
    """Error of one output against the reference, in units of the reference's largest magnitude."""

    maximum: float
    p99: float
    mean: float
    jumps: float  # share of elements whose error is above `JUMP`
    scale: float  # largest magnitude of the reference
    finite: bool  # both, the value and the reference


def deviation(value: NDArray, reference: NDArray, mask: NDArray[np.bool_] | None = None) -> Deviation:
    """Error statistics over the elements that `mask`, of the leading axes, keeps; infinite where a value is not finite
    or nothing is kept.

    Raises `ValueError` when the shapes differ: a graph with a fixed view count must not pass by broadcasting.
    """
    if value.shape != reference.shape:
        raise ValueError(f"shape is {value.shape}, need {reference.shape}")
    finite = bool(np.isfinite(value).all() and np.isfinite(reference).all())
    scale = float(np.abs(reference).max(initial=0.0)) if finite else np.inf
    if mask is not None:
        value, reference = value[mask], reference[mask]
    if not finite or value.size == 0:
        return Deviation(np.inf, np.inf, np.inf, 1.0, scale, finite)
    error = np.abs(value.astype(np.float64) - reference.astype(np.float64)).ravel() / (scale if scale > 0 else 1.0)
    return Deviation(
        float(error.max()),
        float(np.quantile(error, 0.99)),
        float(error.mean()),
        float((error > JUMP).mean()),
        scale,
        finite,
    )


def image_units(outputs: Mapping[str, NDArray], near: float) -> dict[str, NDArray]:
    """The outputs in units proportional to their effect in a picture, in which far geometry has small errors.

    Depth becomes near / z, means m become near * m / |m|^2 (direction and inverse distance), scales become angular
    sizes s / |m|. In world units the farthest point would determine the scale, and errors of the foreground would not
    be noticed.
    """
    changed = dict(outputs)
    distance = np.linalg.norm(outputs["means"].astype(np.float64), axis=-1, keepdims=True)
    distance = np.maximum(distance, 1e-6 * near)
    changed["means"] = near * outputs["means"] / distance**2
    changed["scales"] = outputs["scales"] / distance
    changed["depth"] = near / outputs["depth"]
    return changed


def comparable(
    values: Mapping[str, NDArray], reference: Mapping[str, NDArray], near: float
) -> tuple[dict[str, NDArray], dict[str, NDArray]]:
    """Both results in image units, the first's quaternions with signs aligned to the second's."""
    ours, theirs = image_units(values, near), image_units(reference, near)
    ours["rotations_wxyz"] = quaternions_aligned(ours["rotations_wxyz"], theirs["rotations_wxyz"])
    return ours, theirs


def jumped_rows(
    values: Mapping[str, NDArray], reference: Mapping[str, NDArray], names: Iterable[str]
) -> NDArray[np.bool_]:
    """(G,) mask of rows with an error above `JUMP`, or a value that is not finite, in any of the outputs `names`."""
    rows = []
    for name in names:
        theirs = reference[name].astype(np.float64)
        scale = float(np.abs(theirs).max(initial=0.0))
        close = np.abs(values[name] - theirs) <= JUMP * (scale if scale > 0 else 1.0)
        rows.append(~close.reshape(len(close), -1).all(1))
    jumped: NDArray[np.bool_] = np.any(rows, axis=0)
    return jumped


def quaternions_aligned(value: NDArray, reference: NDArray) -> NDArray:
    """`value` (..., 4) with the sign of each quaternion aligned to `reference`: q and -q are the same rotation."""
    sign = np.sign((value * reference).sum(-1, keepdims=True))
    return value * np.where(sign == 0, 1, sign)
