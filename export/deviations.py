"""Errors of every output against torch, and whether errors beyond a limit are explained by float32 rounding."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from gapmes.model.architectures import Network
from gapmes.service.network.contract import GAUSSIAN_OUTPUTS, IMAGE_OUTPUTS

from .cases import Case
from .compare import Deviation, comparable, deviation
from .graph import evaluated
from .routes import flipped_patches, untouched

Outputs = Mapping[str, NDArray]
LEFT = 0.5  # least share of elements of each kind that must be left for a meaningful comparison
UNKNOWN = Deviation(np.inf, np.inf, np.inf, 1.0, np.inf, finite=False)


@dataclass(frozen=True)
class Float64Comparison:
    """One output of the exported file and of torch in float32, each against torch in float64."""

    exported: Deviation
    torch: Deviation


def untouched_elements(flipped: NDArray[np.bool_], reference: Outputs) -> dict[str, NDArray[np.bool_]]:
    """Masks of the elements of each kind of output that no flipped patch affects (`routes.untouched`)."""
    height, width = reference["depth"].shape[-2:]
    return untouched(flipped, height, width, len(reference["means"]))


def share_left(flipped: NDArray[np.bool_], reference: Outputs) -> float:
    """The smallest share of untouched elements over all kinds; below `LEFT` a comparison is not meaningful."""
    return float(min(mask.mean() for mask in untouched_elements(flipped, reference).values()))


def deviations(values: Outputs, reference: Outputs, flipped: NDArray[np.bool_], case: Case) -> dict[str, Deviation]:
    """Errors of every output but the indices, in image units, excluding elements that `flipped` (V, P) affects."""
    ours, theirs = comparable(values, reference, float(case.inputs.near_far[0]))
    masks = untouched_elements(flipped, reference)
    kinds = dict.fromkeys(GAUSSIAN_OUTPUTS, "gaussian") | dict.fromkeys(IMAGE_OUTPUTS, "pixel")
    return {
        name: deviation(ours[name], theirs[name], masks[kinds.get(name, "patch")])
        for name in reference
        if name != "expert_index"
    }


def beside_float64(values: Outputs, reference: Outputs, network: Network, case: Case) -> dict[str, Float64Comparison]:
    """Errors of both float32 results against torch in float64, excluding elements affected by a patch that took another
    route in either; infinite where float64 is not finite or a share of less than LEFT remains. The network is returned
    to float32."""
    try:
        exact = evaluated(network, case.inputs, torch.float64)
    finally:
        network.float()
    kept = case.inputs.patch_mask.numpy()
    flipped = flipped_patches(values, exact, kept) | flipped_patches(reference, exact, kept)
    exported, single = (deviations(result, exact, flipped, case) for result in (values, reference))
    if share_left(flipped, exact) < LEFT:
        return {name: Float64Comparison(UNKNOWN, UNKNOWN) for name in exported}
    return {name: Float64Comparison(exported[name], single[name]) for name in exported}
