"""The verification cases: inputs, view counts and gate settings on which an exported file is compared with torch."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch

from gapmes.service.cameras.depth_range import depth_range
from gapmes.service.cameras.view_checks import MAX_VIEWS, MIN_VIEWS
from gapmes.service.captures.capture import load_scene_folder
from gapmes.service.photographs.images import decode_image, fit_view
from gapmes.service.shipped import sample_folder

from .gate_settings import GateSetting
from .graph import SceneInputs
from .samples import FLAT, UNDETERMINED, all_patches, hostile_scenes, lenses_scene, random_scene


@dataclass(frozen=True)
class Case:
    """The inputs and gate setting of one comparison of both runtimes."""

    name: str
    gates: GateSetting
    inputs: SceneInputs
    flat: bool = False  # images of one colour, where normalisation amplifies quantisation errors
    undetermined: bool = False  # no depth matches, so that matching amplifies rounding errors

    @property
    def views(self) -> int:
        return self.inputs.images.shape[0]


def verification_cases(height: int, width: int, *, quick: bool = False) -> Iterator[Case]:
    """Random scenes and the sample at every view count; other lenses, degenerate scenes and gate settings at two counts
    each; grouped by gate setting.

    `quick` uses two view counts for the former and one for the latter.
    """
    counts = (MIN_VIEWS, 3) if quick else tuple(range(MIN_VIEWS, MAX_VIEWS + 1))
    for views in counts:
        yield Case("random", "as trained", random_scene(views, height, width, seed=views))
        yield Case("sample", "as trained", sample_scene(views, height, width))
    hostile = (3,) if quick else (2, 3)
    for views in hostile:
        yield Case("lenses", "as trained", lenses_scene(views, height, width, seed=20 + views))
        for name, inputs in hostile_scenes(views, height, width).items():
            yield Case(name, "as trained", inputs, flat=name in FLAT, undetermined=name in UNDETERMINED)
    settings: tuple[GateSetting, ...] = ("all tied", "one expert", "two experts")
    for gates in settings:
        for views in hostile:
            yield Case("random", gates, random_scene(views, height, width, seed=10 + views))


def sample_scene(views: int, height: int, width: int) -> SceneInputs:
    """The first `views` views of the packaged sample scene; poses relative to camera 0, in the scene's own units."""
    folder = load_scene_folder(sample_folder())
    cameras, images = [], []
    for index in range(views):
        photo = decode_image(folder.image_paths[index].read_bytes(), index=index)
        fitted = fit_view(photo, folder.file.views[index].camera, height, width)
        images.append(fitted.image)
        cameras.append(fitted.camera)
    bounds = depth_range(cameras, folder.file.near, folder.file.far)
    poses = np.stack([cameras[0].cam_from_world @ c.world_from_cam for c in cameras])
    return SceneInputs(
        torch.from_numpy(np.stack(images)),
        torch.from_numpy(np.stack([c.normalized_intrinsics for c in cameras]).astype(np.float32)),
        torch.from_numpy(poses.astype(np.float32)),
        torch.tensor([bounds.near, bounds.far], dtype=torch.float32),
        all_patches(views, height, width),
    )
