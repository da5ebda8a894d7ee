"""Evaluation of one scene: reconstruct, render the targets, compare models and baselines with the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow

from gapmes.model.training.lpips import Lpips
from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.view_checks import Notice
from gapmes.service.errors import GapmesError
from gapmes.service.gaussians import Gaussians
from gapmes.service.mending.fade_passes import DEFAULT_PASSES
from gapmes.service.photographs.images import FittedView
from gapmes.service.pictures import picture_error
from gapmes.service.reconstruct import Reconstructor
from gapmes.service.splat import Render, render
from gapmes.service.viewpoints.scene_views import NEAR_PLANE_SHARE

from .case import Case, LargerTargets
from .covisible import PREDICTED_TOLERANCE, TRUE_TOLERANCE, Mask, covisible
from .metrics import Figures, figures, mean_figures
from .models import Model
from .pixel_splats import drawn_over, pixel_gaussians
from .planes import consistent_plane, nearest_input, plane_blend
from .routing import routes_of
from .scores import (
    NEAREST,
    PLANE,
    SWEEP,
    TRUE_DEPTH,
    TUNED_SWEEP,
    MethodScore,
    ModelScore,
    SceneScore,
    Twice,
    number,
)
from .sweep import filled_from_behind, plainly_swept_depths, swept_depths

F32 = NDArray[np.float32]

HOLE = 0.5  # a pixel with less opacity shows mostly the background


@dataclass(frozen=True, eq=False)
class Measured:
    """The scores of a scene, and the data that they were computed from."""

    score: SceneScore
    pictures: dict[str, list[F32]]  # method -> one (3, H, W) per target
    masks: list[Mask]  # co-visible pixels, per target
    routes: dict[str, dict[str, NDArray]]  # model -> see `routes_of`


@dataclass(frozen=True, eq=False)
class _Reconstruction:
    gaussians: Gaussians
    near: float  # depth range used by the reconstruction; caller's units
    far: float
    routes: dict[str, NDArray]
    seconds: float
    warnings: tuple[Notice, ...]

    def draw(self, camera: Camera, threads: int | None) -> Render:
        return render(self.gaussians, camera, near=NEAR_PLANE_SHARE * self.near, threads=threads)


def measure(
    case: Case,
    models: Sequence[Model],
    *,
    lpips: Lpips | None = None,
    twice: bool = False,
    fade: int = DEFAULT_PASSES,
    threads: int | None = None,
) -> Measured:
    """Scores of all baselines and of `models`, which must have the size of `case`, on one scene.

    `twice` also compares at twice the size, where the case has it; `fade` is that of `reconstruct`. Raises
    `GapmesError` that names the scene.
    """
    try:
        results = {model.label: _reconstruct(case, model, fade) for model in models}
    except GapmesError as error:
        error.message = f"{case.name}: {error.message}"
        raise
    first = next(iter(results.values()))
    renders = {name: [result.draw(t.camera, threads) for t in case.targets] for name, result in results.items()}
    masks = _masks(case, first, next(iter(renders.values())), threads)
    pictures = _baseline_pictures(case, first.near, first.far, threads)
    scores = {name: _score(drawn, case.targets, masks, lpips) for name, drawn in pictures.items()}
    larger = case.at_twice() if twice and case.at_twice else None
    ours = {}
    for name, result in results.items():
        pictures[name] = [_picture(drawn) for drawn in renders[name]]
        score = _score(pictures[name], case.targets, masks, lpips)
        open_pixels = np.stack([drawn.alpha < HOLE for drawn in renders[name]])
        covered = np.stack(masks)
        ours[name] = ModelScore(
            score=score,
            holes=float(open_pixels.mean()),
            holes_covisible=float(open_pixels[covered].mean()) if covered.any() else None,
            seconds=result.seconds,
            twice=_at_twice(larger, result, pictures[name], case.targets, score, threads) if larger else None,
        )
    share = float(np.stack(masks).mean())
    routes = {name: result.routes for name, result in results.items()}
    warnings = (*case.warnings, *first.warnings)
    return Measured(SceneScore(case.name, share, scores, ours, case.photographs, warnings), pictures, masks, routes)


def _reconstruct(case: Case, model: Model, fade: int) -> _Reconstruction:
    # Poses that photographs contradict are measured as they are, and told of.
    scene = case.reconstructed(Reconstructor(model.engine), trust_poses=True, fade=fade)
    near, far = scene.document["near"], scene.document["far"]
    outputs = model.engine.last
    seconds = float(sum(scene.document["timings"].values()))
    return _Reconstruction(scene.gaussians, near, far, routes_of(outputs), seconds, tuple(scene.document["warnings"]))


def _masks(case: Case, ours: _Reconstruction, renders: Sequence[Render], threads: int | None) -> list[Mask]:
    """Co-visibility of each target, from true depth where there is one, else from rendered depth; the same for all
    methods."""
    cameras = [view.camera for view in case.inputs]
    if case.truth is not None:
        surfaces, depths, tolerance = list(case.truth.inputs), list(case.truth.targets), TRUE_TOLERANCE
    else:
        surfaces = [_surface(ours.draw(camera, threads)) for camera in cameras]
        depths, tolerance = [_surface(drawn) for drawn in renders], PREDICTED_TOLERANCE
    return [
        covisible(target.camera, depth, cameras, surfaces, tolerance)
        for target, depth in zip(case.targets, depths, strict=True)
    ]


def _surface(drawn: Render) -> F32:
    """(H, W) rendered depth with holes filled from behind, so that no hole excludes itself from co-visibility."""
    return filled_from_behind(drawn.depth, drawn.alpha > 0)


def _baseline_pictures(case: Case, near: float, far: float, threads: int | None) -> dict[str, list[F32]]:
    cameras = [target.camera for target in case.targets]
    plane = consistent_plane(case.inputs, near, far)
    blended = [plane_blend(case.inputs, camera, plane) for camera in cameras]
    swept = swept_depths(case.inputs, near, far)
    splats = {
        SWEEP: pixel_gaussians(case.inputs, plainly_swept_depths(case.inputs, near, far)),
        TUNED_SWEEP: pixel_gaussians(case.inputs, swept.depths, swept.agreed),
    }
    if case.truth is not None:
        splats[TRUE_DEPTH] = pixel_gaussians(case.inputs, case.truth.input_surfaces())
    pictures = {NEAREST: [nearest_input(case.inputs, camera) for camera in cameras], PLANE: blended}
    for name, gaussians in splats.items():
        pictures[name] = [
            drawn_over(gaussians, camera, behind, NEAR_PLANE_SHARE * near, threads)
            for camera, behind in zip(cameras, blended, strict=True)
        ]
    return pictures


def _score(
    drawn: Sequence[F32], targets: Sequence[FittedView], masks: Sequence[Mask], lpips: Lpips | None
) -> MethodScore:
    whole: list[Figures] = []
    seen: list[Figures] = []
    for picture, target, mask in zip(drawn, targets, masks, strict=True):
        whole.append(figures(picture, target.image, np.ones_like(mask), lpips))
        seen.append(figures(picture, target.image, mask, lpips))
    return MethodScore(mean_figures(whole), mean_figures(seen))


def _at_twice(
    truth: LargerTargets,
    ours: _Reconstruction,
    pictures: Sequence[F32],
    targets: Sequence[FittedView],
    score: MethodScore,
    threads: int | None,
) -> Twice:
    """Compare renders at twice the size, and the `pictures` at the evaluated size upsampled (Lanczos), with `truth`."""
    drawn = [ours.draw(view.camera, threads) for view in truth.views]
    truths, once = [view.image for view in truth.views], number(score.all.psnr)
    psnr = _mean_psnr([_picture(one) for one in drawn], truths)
    alone = _mean_psnr([enlarged(picture) for picture in pictures], truths)
    holes = float(np.mean([(one.alpha < HOLE).mean() for one in drawn]))
    detail = lost_to_detail(pictures, [view.image for view in targets], truths)
    return Twice(psnr, psnr - once, alone - once, detail, holes, truth.side_px)


def _mean_psnr(pictures: Sequence[F32], truths: Sequence[F32]) -> float:
    return float(np.mean([picture_error.psnr(one, truth) for one, truth in zip(pictures, truths, strict=True)]))


def lost_to_detail(pictures: Sequence[F32], targets: Sequence[F32], truths: Sequence[F32]) -> float:
    """dB, at most 0: the change of PSNR from `targets` to `truths` of twice their size if the squared error of the
    upsampled targets were added to that of `pictures`. A mean over pictures.

    Detail beyond the inputs' resolution costs this much however accurate the depths are; correlation between errors of
    the picture and missing detail is neglected.
    """
    own = [picture_error.psnr(*pair) for pair in zip(pictures, targets, strict=True)]
    best = [picture_error.psnr(enlarged(target), truth) for target, truth in zip(targets, truths, strict=True)]
    return float(np.mean([-10 * np.log10(1 + 10 ** ((o - b) / 10)) for o, b in zip(own, best, strict=True)]))


def enlarged(picture: F32) -> F32:
    """(3, 2 H, 2 W) from (3, H, W) by Lanczos resampling, clipped to [0, 1]."""
    size = (2 * picture.shape[2], 2 * picture.shape[1])
    channels = [np.asarray(Pillow.fromarray(one).resize(size, Pillow.Resampling.LANCZOS)) for one in picture]
    return np.clip(np.stack(channels), 0, 1)


def _picture(drawn: Render) -> F32:
    return np.clip(drawn.rgb, 0, 1).transpose(2, 0, 1).astype(np.float32)
