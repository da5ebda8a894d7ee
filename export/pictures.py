"""What two results look like: both are drawn, and the pictures compared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gapmes.service.cameras.camera import Camera
from gapmes.service.gaussians import Gaussians
from gapmes.service.network.contract import GAUSSIAN_OUTPUTS
from gapmes.service.pictures.picture_error import psnr
from gapmes.service.splat import render
from gapmes.service.viewpoints.scene_views import NEAR_PLANE_SHARE

from .cases import Case
from .compare import comparable, jumped_rows


@dataclass(frozen=True)
class PictureAgreement:
    """How far the pictures of two results agree, at a pose half-way between the first two views."""

    psnr: float  # dB, everything drawn as it is
    without_jumps: float  # dB, with the reference's Gaussians in place of those that jumped
    jumped: float  # share of those, among the Gaussians that no changed route reaches


def picture_agreement(
    values: Mapping[str, NDArray], reference: Mapping[str, NDArray], untouched: NDArray[np.bool_], case: Case
) -> PictureAgreement:
    """Draw the Gaussians of both results, and of the first once more without jumps (`compare.jumped_rows`).

    `untouched` (G,) marks the Gaussians that no changed route reaches (`routes.untouched`): among them alone jumps are
    counted and replaced. All values have to be finite.
    """
    near = float(case.inputs.near_far[0])
    jumped = jumped_rows(*comparable(values, reference, near), GAUSSIAN_OUTPUTS) & untouched
    smooth = {name: _replaced(values[name], reference[name], jumped) for name in GAUSSIAN_OUTPUTS}
    camera = between(case)
    truth = _drawn(reference, camera, near)
    whole, rest = (psnr(_drawn(result, camera, near), truth) for result in (values, smooth))
    return PictureAgreement(whole, rest, float(jumped.sum() / max(1, untouched.sum())))


def _replaced(values: NDArray, reference: NDArray, rows: NDArray[np.bool_]) -> NDArray:
    result = values.copy()
    result[rows] = reference[rows]
    return result


def _drawn(result: Mapping[str, NDArray], camera: Camera, near: float) -> NDArray[np.float32]:
    gaussians = Gaussians.make(*(result[name] for name in GAUSSIAN_OUTPUTS))
    return np.clip(render(gaussians, camera, near=NEAR_PLANE_SHARE * near).rgb, 0, 1)


def between(case: Case) -> Camera:
    """The first camera moved half-way towards the second."""
    height, width = case.inputs.images.shape[-2:]
    k = case.inputs.intrinsics[0].double().numpy()
    pose = case.inputs.world_from_cam[0].double().numpy().copy()
    pose[:3, 3] = case.inputs.world_from_cam[:2, :3, 3].double().mean(0).numpy()
    return Camera.make(width, height, k[0, 0] * width, k[1, 1] * height, k[0, 2] * width, k[1, 2] * height, pose)
