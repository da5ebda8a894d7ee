"""Comparison of two results by their rendered pictures."""

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
from .graph import SceneInputs


@dataclass(frozen=True)
class PictureAgreement:
    """Agreement of the pictures of two results, from half-way between the first two views."""

    psnr: float  # dB, of all Gaussians
    without_jumps: float  # dB, with jumped Gaussians replaced by the reference's
    jumped: float  # share of jumped Gaussians among those that no changed route affects


def picture_agreement(
    values: Mapping[str, NDArray], reference: Mapping[str, NDArray], untouched: NDArray[np.bool_], case: Case
) -> PictureAgreement:
    """Render both results, and the first once more without jumps (`compare.jumped_rows`).

    `untouched` (G,) masks the Gaussians that no changed route affects (`routes.untouched`): jumps are counted and
    replaced among these alone. All values must be finite.
    """
    near = float(case.inputs.near_far[0])
    jumped = jumped_rows(*comparable(values, reference, near), GAUSSIAN_OUTPUTS) & untouched
    smooth = {name: _replaced(values[name], reference[name], jumped) for name in GAUSSIAN_OUTPUTS}
    camera = halfway_camera(case.inputs)
    truth = _drawn(reference, camera, near)
    whole, rest = (psnr(_drawn(result, camera, near), truth) for result in (values, smooth))
    return PictureAgreement(whole, rest, int(jumped.sum()) / max(1, int(untouched.sum())))


def _replaced(values: NDArray, reference: NDArray, rows: NDArray[np.bool_]) -> NDArray:
    result = values.copy()
    result[rows] = reference[rows]
    return result


def _drawn(result: Mapping[str, NDArray], camera: Camera, near: float) -> NDArray[np.float32]:
    gaussians = Gaussians.make(*(result[name] for name in GAUSSIAN_OUTPUTS))
    return np.clip(render(gaussians, camera, near=NEAR_PLANE_SHARE * near).rgb, 0, 1)


def halfway_camera(inputs: SceneInputs) -> Camera:
    """The first camera, moved half-way towards the second."""
    height, width = inputs.images.shape[-2:]
    k = inputs.intrinsics[0].double().numpy()
    pose = inputs.world_from_cam[0].double().numpy().copy()
    pose[:3, 3] = inputs.world_from_cam[:2, :3, 3].double().mean(0).numpy()
    return Camera.make(width, height, k[0, 0] * width, k[1, 1] * height, k[0, 2] * width, k[1, 2] * height, pose)
