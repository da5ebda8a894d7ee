"""How far every output is from torch's, and where that is too far: whether rounding in float32 explains it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from gapmes.model.architectures import Network
from gapmes.service.contract import GAUSSIAN_OUTPUTS, IMAGE_OUTPUTS

from .cases import Case
from .compare import Deviation, comparable, deviation
from .graph import SceneInputs, evaluated
from .routes import flipped_patches, untouched

Outputs = Mapping[str, NDArray]
LEFT = 0.5  # of the elements of every kind: what a smaller part says, it does not say of all
# Inputs beside those of an undetermined case. One run of float32 is a poor measure there: images moved by one step of
# float32 take torch's own distance from float64 from 2.2e-4 to 9.5e-4 (p99 of means, 64 x 64 px, range of 1 to 1e6).
NEIGHBOURS = 4
UNKNOWN = Deviation(np.inf, np.inf, np.inf, 1.0, np.inf, finite=False)


@dataclass(frozen=True)
class BesideFloat64:
    """One output of the exported file and of torch in float32, each against torch in float64; of several runs of torch
    the largest of every number."""

    exported: Deviation
    torch: Deviation


def untouched_elements(flipped: NDArray[np.bool_], reference: Outputs) -> dict[str, NDArray[np.bool_]]:
    """Which elements of each kind of output no flipped patch reaches (`routes.untouched`)."""
    height, width = reference["depth"].shape[-2:]
    return untouched(flipped, height, width, len(reference["means"]))


def deviations(values: Outputs, reference: Outputs, flipped: NDArray[np.bool_], case: Case) -> dict[str, Deviation]:
    """Of every output but the indices, in the units of a picture, outside what `flipped` (V, P) patches reach."""
    ours, theirs = comparable(values, reference, float(case.inputs.near_far[0]))
    masks = untouched_elements(flipped, reference)
    kinds = dict.fromkeys(GAUSSIAN_OUTPUTS, "gaussian") | dict.fromkeys(IMAGE_OUTPUTS, "pixel")
    return {
        name: deviation(ours[name], theirs[name], masks[kinds.get(name, "patch")])
        for name in reference
        if name != "expert_index"
    }


def beside_float64(values: Outputs, reference: Outputs, network: Network, case: Case) -> dict[str, BesideFloat64]:
    """Both results of float32 against torch in float64, outside what a patch reaches that took another route in
    any; infinitely far where float64 is not finite, or where less than LEFT is left to compare. Where matching is
    undetermined torch runs on NEIGHBOURS of the inputs too. The network is in float32 again afterwards."""
    try:
        exact = evaluated(network, case.inputs, torch.float64)
    finally:
        network.float()
    near = _neighbours(case.inputs) if case.undetermined else ()
    singles = [reference, *(evaluated(network, inputs, torch.float32) for inputs in near)]
    kept = case.inputs.patch_mask.numpy()
    flipped = np.logical_or.reduce([flipped_patches(result, exact, kept) for result in (values, *singles)])
    exported, *others = (deviations(result, exact, flipped, case) for result in (values, *singles))
    if min(mask.mean() for mask in untouched_elements(flipped, exact).values()) < LEFT:
        return {name: BesideFloat64(UNKNOWN, UNKNOWN) for name in exported}
    return {name: BesideFloat64(exported[name], _largest([other[name] for other in others])) for name in exported}


def _neighbours(inputs: SceneInputs) -> Iterator[SceneInputs]:
    """The inputs with every number of the images one step of float32 up, down or as it is, within [0, 1]."""
    for seed in range(NEIGHBOURS):
        steps = torch.randint(-1, 2, inputs.images.shape, generator=torch.Generator().manual_seed(seed))
        moved = torch.nextafter(inputs.images, inputs.images + steps).clamp(0, 1)
        yield replace(inputs, images=moved)


def _largest(found: Sequence[Deviation]) -> Deviation:
    """Of every number; finite where all are."""
    first, *_ = found
    most = {what: max(getattr(one, what) for one in found) for what in ("maximum", "p99", "mean", "jumps")}
    return replace(first, **most, finite=all(one.finite for one in found))
