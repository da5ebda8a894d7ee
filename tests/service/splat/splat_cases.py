"""Scenes, cameras and comparisons for the splatter's tests."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gapmes.service.cameras.camera import Camera
from gapmes.service.gaussians import Gaussians
from gapmes.service.splat import Definition, Render, render, render_reference

SH_C0 = 0.28209479177387814


def camera(width: int = 48, height: int = 40, focal: float = 45.0, pose: np.ndarray | None = None) -> Camera:
    """A centred pinhole at the origin unless posed."""
    return Camera.make(width, height, focal, focal, width / 2, height / 2, np.eye(4) if pose is None else pose)


def rotation(rng: np.random.Generator) -> np.ndarray:
    """A random rotation matrix."""
    q, r = np.linalg.qr(rng.standard_normal((3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else q[:, ::-1]


def scene(
    count: int = 150, seed: int = 0, degree: int = 0, scales: tuple[float, float] = (0.02, 0.3), near_far=(1.0, 6.0)
) -> Gaussians:
    """Gaussians in front of `camera()`, log-uniform in scale and depth, some out of view."""
    rng = np.random.default_rng(seed)
    z = np.exp(rng.uniform(*np.log(near_far), count))
    means = np.concatenate([rng.uniform(-0.7, 0.7, (count, 2)) * z[:, None], z[:, None]], axis=1)
    harmonics = rng.normal(0.0, 0.15, (count, (degree + 1) ** 2, 3))
    harmonics[:, 0] = rng.uniform(-1.7, 1.7, (count, 3))
    return Gaussians.make(
        means,
        np.exp(rng.uniform(*np.log(scales), (count, 3))),
        rng.standard_normal((count, 4)),
        rng.uniform(0.0, 1.0, count),
        harmonics,
    )


def dots(means, opacities, colours, scale: float = 0.0) -> Gaussians:
    """Isotropic Gaussians of one scale and given colours in [0, 1]."""
    count = len(means)
    colours = np.broadcast_to(np.asarray(colours, float), (count, 3))
    harmonics = ((colours - 0.5) / SH_C0)[:, None, :]
    return Gaussians.make(means, np.full((count, 3), scale), np.tile([1.0, 0, 0, 0], (count, 1)), opacities, harmonics)


def moved(gaussians: Gaussians, **fields) -> Gaussians:
    """The same Gaussians with some fields replaced, without checks."""
    return replace(gaussians, **fields)


def bits(image: Render) -> bytes:
    """All three planes as bytes."""
    return image.rgb.tobytes() + image.alpha.tobytes() + image.depth.tobytes()


@dataclass(frozen=True)
class Comparison:
    """Largest differences to the float64 reference, apart from pixels on the edge of a cut."""

    smooth: float  # colour and opacity, pixels off the edge
    depth: float  # depth times opacity, relative to the reference's depth, pixels off the edge
    jump: float  # colour, pixels on an edge
    on_edge: float  # share of pixels on an edge


@dataclass(frozen=True)
class Edges:
    """How far cuts are nudged, as shares of themselves; scenes that nobody looked for have none between these and those
    of docs/splatting.md."""

    alpha_min: float = 1e-5
    stop: float = 1e-5
    squared_radius: float = 2e-5

    def nudged(self, rule: Definition) -> list[Definition]:
        """The definition with each of its cuts a little lower and a little higher."""
        found = []
        for sign in (-1, 1):
            found.append(replace(rule, alpha_min=rule.alpha_min * (1 + sign * self.alpha_min)))
            if rule.stop > 0:
                found.append(replace(rule, stop=rule.stop * (1 + sign * self.stop)))
            if np.isfinite(rule.cut_radius):
                found.append(replace(rule, cut_radius=rule.cut_radius * (1 + sign * self.squared_radius) ** 0.5))
        return found


def compare(
    gaussians: Gaussians, view: Camera, definition: Definition | None = None, edges: Edges | None = None, **options
) -> Comparison:
    """Render and reference; a pixel is on an edge where nudging a cut by its `edges` changes the reference."""
    rule = definition or Definition()
    ours = render(gaussians, view, definition=rule, **options)
    true = render_reference(gaussians, view, definition=rule, **options)
    edge = np.zeros(true.alpha.shape, bool)
    for other in (edges or Edges()).nudged(rule):
        edge |= render_reference(gaussians, view, definition=other, **options).alpha != true.alpha
    colour = np.maximum(np.abs(ours.rgb - true.rgb).max(axis=2), np.abs(ours.alpha - true.alpha))
    depth = np.abs(ours.depth - true.depth) * true.alpha / np.where(true.depth > 0, true.depth, 1.0)
    return Comparison(
        float(colour[~edge].max(initial=0.0)),
        float(depth[~edge].max(initial=0.0)),
        float(colour[edge].max(initial=0.0)),
        float(edge.mean()),
    )
