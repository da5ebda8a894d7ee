"""Evaluation cases: inputs and held-out targets of a scene, from a capture of photographs or from the generator."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapmes.model.training.generated_views import exact_views, generated_view
from gapmes.model.training.scenes import SceneBatch, SceneSampler
from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.view_checks import Notice
from gapmes.service.photographs.images import FittedView, Photo, fit_view
from gapmes.service.photographs.whole import view_shapes
from gapmes.service.reconstruct import Reconstructor, Scene

from .labels import shortest_names
from .scene_views import Photographs, scene_views

F32 = NDArray[np.float32]

# Not the seed of the validation during training: no weights were selected on these scenes. Steps and limits of the
# mending were, on the first 24 to 40 of them (docs/fading-figures.md); with other seeds nothing was selected, except
# for the few that docs/evaluation.md names.
GENERATED_SEED = 700_003
WIDE = (0.18, 0.5)  # range of baselines, in units of the scene's median depth
GENERATED_TARGETS = 2


@dataclass(frozen=True, eq=False)
class TrueDepth:
    """z-depths at pixel centres, in the cameras' units; infinite where there is background."""

    inputs: F32  # (V, H, W)
    targets: F32  # (T, H, W)
    far: float  # depth at which splats of the background are placed

    def input_surfaces(self) -> F32:
        """(V, H, W) `inputs` with the background at `far`."""
        return np.where(np.isinf(self.inputs), np.float32(self.far), self.inputs)


@dataclass(frozen=True, eq=False)
class LargerTargets:
    """The targets at twice the evaluated size."""

    views: tuple[FittedView, ...]
    side_px: int  # shorter side of the smallest photograph's crop, or as rendered; larger views were upsampled


@dataclass(frozen=True, eq=False)
class Case:
    """One scene: the inputs of a reconstruction and the targets that it is compared with."""

    name: str
    photos: tuple[Photo, ...]  # inputs at their own size
    cameras: tuple[Camera, ...]  # of `photos`
    inputs: tuple[FittedView, ...]  # at the evaluated size
    targets: tuple[FittedView, ...]
    near: float | None
    far: float | None
    truth: TrueDepth | None = None
    at_twice: Callable[[], LargerTargets] | None = None  # computed on demand
    whole: bool = False  # whether photographs are used beyond the aspect of the network
    photographs: Photographs | None = None  # None of generated scenes
    numbers: tuple[int, ...] | None = None  # what warnings call the inputs
    warnings: tuple[Notice, ...] = ()  # about the capture

    def reconstructed(self, service: Reconstructor, **options: Any) -> Scene:
        """The scene of the inputs, without predicting any from the others; `options` as for `reconstruct`."""
        given = {"near": self.near, "far": self.far, "whole": self.whole, "numbers": self.numbers, "leave_one_out": 0}
        return service.reconstruct(self.photos, self.cameras, **{**given, **options})


def photograph_case(
    path: Path, inputs: int, height: int, width: int, name: str | None = None, *, whole: bool = False
) -> Case:
    """The inputs and targets of a capture (`scene_views`), centre-cropped and resampled to `height` x `width` px, or
    `whole` to the shape that a scene by a network of this size has (`view_shapes`); `name` defaults to that of the
    folder.

    Raises `NoSuchViews`, and `InputError` for what is no capture, missing views, and photographs that cannot be decoded
    or have transparent pixels.
    """
    views = scene_views(path, inputs)
    given, held_out = (
        [views.photograph(chosen, place) for place in range(len(chosen.indices))]
        for chosen in (views.inputs, views.targets)
    )
    if whole:
        cameras = [camera for _, camera in given]
        height, width = view_shapes(cameras, [0] * len(cameras), (height, width))[0]
    return Case(
        name=name or shortest_names([path])[0],
        photos=tuple(photo for photo, _ in given),
        cameras=tuple(camera for _, camera in given),
        inputs=tuple(fit_view(*view, height, width) for view in given),
        targets=tuple(fit_view(*view, height, width) for view in held_out),
        near=views.inputs.file.near,
        far=views.inputs.file.far,
        at_twice=partial(_resampled, held_out, 2 * height, 2 * width),
        whole=whole,
        photographs=views.said,
        numbers=views.inputs.indices,
        warnings=views.warnings,
    )


def _resampled(photos: Sequence[tuple[Photo, Camera]], height: int, width: int) -> LargerTargets:
    views = tuple(fit_view(*view, height, width) for view in photos)
    scale = min(min(photo.height / height, photo.width / width) for photo, _ in photos)
    return LargerTargets(views, round(scale * min(height, width)))


def generated_cases(count: int, inputs: int, height: int, width: int, seed: int = GENERATED_SEED) -> Iterator[Case]:
    """`count` scenes of wide baselines with exact depth; inputs have exposure errors and noise, targets have not."""
    for index in range(count):
        batch = _generated(seed, index, inputs, height, width)
        yield _of_batch(batch, f"generated {index:03d}", partial(_drawn_again, seed, index, batch))


def _generated(seed: int, index: int, inputs: int, height: int, width: int) -> SceneBatch:
    sampler = SceneSampler(seed, "validation", first=index)
    return sampler.batch(1, inputs, GENERATED_TARGETS, (height, width), baseline=WIDE)


def _drawn_again(seed: int, index: int, batch: SceneBatch) -> LargerTargets:
    """Scene `index` rendered again at twice the size; its world frame differs, which does not affect pictures."""
    height, width = (2 * side for side in batch.images.shape[-2:])
    larger = _generated(seed, index, batch.inputs, height, width).images[0]
    intrinsics, poses = batch.intrinsics[0], batch.world_from_cam[0]
    views = [generated_view(*parts) for parts in zip(larger, intrinsics, poses, strict=True)][batch.inputs :]
    return LargerTargets(tuple(views), min(height, width))


def _of_batch(batch: SceneBatch, name: str, at_twice: Callable[[], LargerTargets]) -> Case:
    """The case of a batch of one scene; inputs are rounded to 8 bits, as in a file."""
    v = batch.inputs
    depths = np.where(batch.background[0], np.float32(np.inf), batch.depths[0])
    views = exact_views(batch)
    photos = tuple(
        Photo.from_array(np.rint(view.image.transpose(1, 2, 0) * 255).astype(np.uint8)) for view in views[:v]
    )
    cameras = tuple(view.camera for view in views[:v])
    return Case(
        name=name,
        photos=photos,
        cameras=cameras,
        inputs=tuple(fit_view(p, c, c.height, c.width) for p, c in zip(photos, cameras, strict=True)),
        targets=tuple(views[v:]),
        near=float(batch.near_far[0, 0]),
        far=float(batch.near_far[0, 1]),
        truth=TrueDepth(depths[:v], depths[v:], float(batch.near_far[0, 1])),
        at_twice=at_twice,
    )
