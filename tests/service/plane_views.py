"""The textured plane as the network's inputs, its depths, and Gaussians on it and in front of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from plane_scene import DEPTH, PlaneScene

from gapmes.service.gaussians import Gaussians
from gapmes.service.harmonics import C0
from gapmes.service.photographs.images import FittedView, Photo, fit_view
from gapmes.service.pictures.picture_error import psnr
from gapmes.service.splat import render

SIDE = 64
PATCH = np.s_[24:40, 24:40]


def plane_views(side: int = SIDE) -> list[FittedView]:
    """Three photographs of the plane, `side` px square."""
    scene = PlaneScene.make(np.random.default_rng(5), turn=0.3)
    return [
        fit_view(Photo(image), camera, side, side) for image, camera in zip(scene.images, scene.cameras, strict=True)
    ]


def in_another_world(views: Sequence[FittedView], turn: np.ndarray, shift: np.ndarray, unit: float) -> list[FittedView]:
    """The same photographs where x -> unit turn x + shift."""
    moved = []
    for view in views:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn @ view.camera.rotation, unit * (turn @ view.camera.center) + shift
        moved.append(replace(view, camera=view.camera.posed(pose)))
    return moved


def plane_depths(views: list[FittedView]) -> np.ndarray:
    """(V, H, W) z-depths of the plane."""
    grid = np.stack(np.meshgrid(np.arange(SIDE) + 0.5, np.arange(SIDE) + 0.5), -1).reshape(-1, 2)
    maps = [(DEPTH - v.camera.center[2]) / v.camera.rays(grid)[:, 2] for v in views]
    return np.stack(maps).reshape(len(views), SIDE, SIDE)


def with_wrong_patch(views: list[FittedView], ratio: float) -> np.ndarray:
    """The plane's depths, but for PATCH of the first view, which lies `ratio` times as far."""
    depths = plane_depths(views)
    depths[0][PATCH] *= ratio
    return depths


def on_the_plane(view: FittedView) -> Gaussians:
    """A Gaussian for each pixel of a photograph, where its ray meets the plane."""
    camera = view.camera
    grid = np.stack(np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5), -1).reshape(-1, 2)
    rays = camera.rays(grid)
    depths = (DEPTH - camera.center[2]) / rays[:, 2]
    count = len(grid)
    return Gaussians.make(
        camera.center + rays * depths[:, None],
        np.repeat(0.4 * depths / camera.fx, 3).reshape(-1, 3),
        np.tile([1.0, 0, 0, 0], (count, 1)),
        np.full(count, 0.9),
        ((view.image.reshape(3, -1).T - 0.5) / C0)[:, None],
    )


def joined(*sets: Gaussians) -> Gaussians:
    names = ("means", "scales", "rotations_wxyz", "opacities", "harmonics")
    return Gaussians.make(*(np.concatenate([getattr(one, name) for one in sets]) for name in names))


def floaters(count: int, seed: int = 0) -> Gaussians:
    """Specks of random colours half way between the cameras and the plane."""
    rng = np.random.default_rng(seed)
    means = np.column_stack([rng.uniform(-0.8, 1.2, count), rng.uniform(-0.6, 0.8, count), np.full(count, DEPTH / 2)])
    harmonics = rng.uniform(-1.7, 1.7, (count, 1, 3))
    return Gaussians.make(
        means, np.full((count, 3), 0.03), np.tile([1.0, 0, 0, 0], (count, 1)), np.full(count, 0.8), harmonics
    )


def error(gaussians: Gaussians, view: FittedView) -> float:
    return psnr(np.clip(render(gaussians, view.camera).rgb, 0, 1).transpose(2, 0, 1), view.image)
