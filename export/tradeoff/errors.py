"""The errors of a row: pictures against another setting's, against held-out truth, and against float64."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from gapmes.model.checkpoint import shipped_checkpoint
from gapmes.model.training.lpips import Lpips
from gapmes.service.cameras.camera import Camera
from gapmes.service.gaussians import Gaussians
from gapmes.service.leaving_out.pruning import colour_range, reaches
from gapmes.service.network.contract import GAUSSIAN_OUTPUTS
from gapmes.service.network.engine import Engine
from gapmes.service.photographs.images import FittedView
from gapmes.service.pictures.picture_error import psnr, ssim
from gapmes.service.splat import Definition, render, render_reference
from gapmes.service.viewpoints.scene_views import NEAR_PLANE_SHARE

from ..cases import sample_scene
from ..graph import evaluated
from ..pictures import halfway_camera
from ..variant import load_variant
from .files import ModelFile
from .schema import Bound, ModelError, Rounding, SettingError

Pictures = list[NDArray[np.float32]]  # (3, H, W) in [0, 1]
EQUAL_DB = 200.0
WINDOW = 48  # px of the picture that brute force draws
CUT_WINDOW = 64  # the same, where what is beyond it has the shape of the whole picture: up to 541 px wide


def drawn(gaussians: Gaussians, cameras: Sequence[Camera], near: float) -> Pictures:
    """As `gapmes render` draws them, clipped."""
    return [
        np.clip(render(gaussians, camera, near=near, outputs=()).rgb, 0, 1).transpose(2, 0, 1) for camera in cameras
    ]


def setting_error(pictures: Pictures, exact: Pictures) -> SettingError:
    """Largest and mean change of a colour, and PSNR of all pictures together."""
    differences = [np.abs(a.astype(np.float64) - b) for a, b in zip(pictures, exact, strict=True)]
    squared = float(np.mean([np.square(d).mean() for d in differences]))
    return SettingError(
        largest=max(float(d.max()) for d in differences),
        p99=float(np.quantile(np.concatenate([d.ravel() for d in differences]), 0.99)),
        mean=float(np.mean([d.mean() for d in differences])),
        psnr=EQUAL_DB if squared == 0 else min(EQUAL_DB, -10 * math.log10(squared)),
    )


def model_error(pictures: Pictures, truth: Sequence[FittedView], lpips: Lpips | None) -> ModelError:
    """Means over all pictures, and the spread of their PSNR."""
    values = [psnr(picture, view.image) for picture, view in zip(pictures, truth, strict=True)]
    everywhere = np.ones(pictures[0].shape[1:], bool)
    return ModelError(
        psnr=float(np.mean(values)),
        psnr_spread=float(np.std(values)),
        ssim=float(
            np.mean(
                [ssim(a.astype(np.float64), b.image.astype(np.float64)) for a, b in zip(pictures, truth, strict=True)]
            )
        ),
        lpips=None
        if lpips is None
        else float(np.mean([lpips.distance(a, b.image, everywhere) for a, b in zip(pictures, truth, strict=True)])),
        pictures=len(values),
    )


def network_rounding(file: ModelFile, threads: int | None) -> Rounding:
    """The file's pictures of the sample scene against those of the same network in float64, from half way between its
    views."""
    inputs = sample_scene(2, file.size, file.size)
    engine = Engine(file.path, threads=threads)
    values = engine.run(*(tensor.numpy() for tensor in inputs.tensors()))
    network = load_variant(shipped_checkpoint("tiny"), file.variant).network
    exact = evaluated(network, inputs, torch.float64)
    camera = halfway_camera(inputs)
    near = NEAR_PLANE_SHARE * float(inputs.near_far[0])
    pictures = [
        drawn(Gaussians.make(*(result[name] for name in GAUSSIAN_OUTPUTS)), [camera], near)[0]
        for result in (values, exact)
    ]
    difference = np.abs(pictures[0].astype(np.float64) - pictures[1])
    return _rounding(difference)


def splatter_rounding(gaussians: Gaussians, camera: Camera, near: float) -> Rounding:
    """The middle of a picture against brute force in float64, of all Gaussians that reach it."""
    window = _middle(camera, WINDOW)
    rule = Definition(near=near)
    there = gaussians[reaches(gaussians, window, np.ones((WINDOW, WINDOW), bool), rule)]
    true = render_reference(there, window, definition=rule)
    return _rounding(np.abs(render(there, window, definition=rule).rgb - true.rgb))


def cut_bound(gaussians: Gaussians, camera: Camera, exact: Definition, cut: Definition) -> Bound:
    """What the larger `alpha_min` or smaller `cut_radius` of `cut` changes at most, in the middle of a square picture,
    beside `exact`, which is otherwise the same: the range of colours times the weight of the layers that only `exact`
    has and both early stops, as in `pruning.py`; beside it the largest change there. All in float64."""
    window = _middle(camera, CUT_WINDOW)
    # splats beyond the picture's edge keep the shape that they have in the whole picture
    margin = ((1 + exact.fov_margin) * camera.width - CUT_WINDOW) / CUT_WINDOW
    exactly, coarsely = (replace(rule, fov_margin=margin) for rule in (exact, cut))
    there = gaussians[reaches(gaussians, window, np.ones((CUT_WINDOW, CUT_WINDOW), bool), exactly)]
    whole = render_reference(there, window, definition=exactly, faint=cut.alpha_min, beyond=cut.cut_radius)
    changed = np.abs(whole.rgb - render_reference(there, window, definition=coarsely).rgb)
    most = colour_range(there) * (float(whole.removed.max()) + 2 * exactly.stop)
    return Bound.of([most], [float(changed.max())])


def _middle(camera: Camera, side: int) -> Camera:
    return camera.cropped((camera.width - side) // 2, (camera.height - side) // 2, side, side)


def _rounding(difference: NDArray[np.floating]) -> Rounding:
    p99 = float(np.quantile(difference, 0.99))
    return Rounding(largest=float(difference.max()), p99=p99, mean=float(difference.mean()))
