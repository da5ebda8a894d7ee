"""The scene generator: endless posed views of random worlds, with depth, for training and for validation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .camera_paths import camera_poses
from .layouts import make_world, near_occluder
from .objects import Paint
from .primitives import ROOM, World, pack
from .rotations import uniform_rotation
from .textures import Split, load_atlas
from .trace import trace

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Rng = np.random.Generator

PROBE = 16  # px; side of a depth map that is rendered first, for the median depth and for what is hit
LEAST_COVER = 0.35  # share of the probe that must hit something, else the world is drawn again
LEAST_INPUT_COVER = 0.1  # the same for each input's own view
CLEARANCE = 0.12  # in units of the scene depth: no solid comes nearer to a camera


@dataclass(frozen=True, eq=False)
class SceneBatch:
    """B scenes of V inputs and T targets, inputs first.

    Every scene has its own random world frame and unit of length. Depth at pixels that show only background is `far`.
    """

    images: F32  # (B, V + T, 3, H, W) in [0, 1]
    depths: F32  # (B, V + T, H, W) z-depth at the pixel centre
    background: NDArray[np.bool_]  # (B, V + T, H, W), True where the ray through the pixel centre hits nothing
    world_from_cam: F64  # (B, V + T, 4, 4)
    intrinsics: F64  # (B, V + T, 3, 3) normalised by width and height
    near_far: F64  # (B, 2)
    inputs: int


@dataclass(frozen=True, eq=False)
class _Sample:
    world: World
    poses: F64  # (V + T, 4, 4) canonical frame
    lens: F64  # (4,) fx, fy, cx, cy, normalised
    rng: Rng  # for exposure, noise, depth range and world frame


class SceneSampler:
    """Draws scene after scene from number `first` on; scene i depends on seed, split and i alone, not on batches or
    threads. The two splits share neither textures nor random numbers.
    """

    def __init__(self, seed: int, split: Split, first: int = 0) -> None:
        self._atlas = load_atlas()
        self._key = (seed, ("train", "validation").index(split))
        self._split: Split = split
        self._next = first

    def batch(
        self,
        scenes: int,
        inputs: int,
        targets: int,
        size: int | tuple[int, int],
        *,
        baseline: tuple[float, float] = (0.06, 0.8),
        field_of_view: tuple[float, float] = (38.0, 78.0),
        close_share: float = 0.0,
        aside: float = 0.0,
        supersample: int = 2,
    ) -> SceneBatch:
        """The next `scenes` scenes at `size` px, or (height, width).

        The length of the path from the first to the last input is log-uniform in `baseline`, in units of the median
        depth seen from the origin. Then positions are jittered by 6 % of it, and in rooms all cameras are moved towards
        the origin until they are inside. The horizontal field of view is uniform in `field_of_view`, degrees. A share
        `close_share` of the scenes has a near occluder at the edge of one input's picture, mostly outside of the
        others'. `aside` displaces targets from the path, as `camera_poses` says. Only input views have the small
        exposure errors and the noise of a real camera.
        """
        height, width = (size, size) if isinstance(size, int) else size
        samples = []
        for _ in range(scenes):
            rng = np.random.default_rng((*self._key, self._next))
            drawn = self._draw(rng, inputs, targets, width / height, baseline, field_of_view, close_share, aside)
            samples.append(drawn)
            self._next += 1
        worlds = pack([sample.world for sample in samples])
        cameras = np.stack([_camera_rows(sample.poses, sample.lens, height, width) for sample in samples])
        images, depths = trace(self._atlas, worlds, cameras, height, width, supersample)
        background = np.isinf(depths)
        views = inputs + targets
        poses, intrinsics = np.empty((scenes, views, 4, 4)), np.zeros((scenes, views, 3, 3))
        near_far = np.empty((scenes, 2))
        for b, sample in enumerate(samples):
            _develop(sample.rng, images[b], inputs)
            near_far[b] = _depth_range(sample.rng, depths[b, :inputs])
            depths[b][background[b]] = near_far[b, 1]
            poses[b], unit = _moved(sample.rng, sample.poses)
            depths[b] *= unit
            near_far[b] *= unit
            intrinsics[b, :, [0, 1, 0, 1, 2], [0, 1, 2, 2, 2]] = np.array([*sample.lens, 1.0])[:, None]
        return SceneBatch(images, depths, background, poses, intrinsics, near_far, inputs)

    def _draw(
        self,
        rng: Rng,
        inputs: int,
        targets: int,
        aspect: float,
        baseline: tuple[float, float],
        field_of_view: tuple[float, float],
        close_share: float,
        aside: float,
    ) -> _Sample:
        half_width = math.tan(math.radians(rng.uniform(*field_of_view)) / 2)
        fx = 0.5 / half_width
        fy = fx * aspect * (math.exp(rng.uniform(-0.1, 0.1)) if rng.random() < 0.3 else 1.0)
        centre = 0.5 + (rng.uniform(-0.08, 0.08, 2) if rng.random() < 0.3 else np.zeros(2))
        lens = np.array([fx, fy, *centre])
        paint = Paint.of(rng, self._atlas, self._split)
        while True:
            world = make_world(rng, paint, half_width)
            depth = self._probe(world, np.eye(4)[None], lens)
            if np.isfinite(depth).mean() < LEAST_COVER:
                continue
            middle = float(np.median(depth[np.isfinite(depth)]))
            length = middle * math.exp(rng.uniform(*np.log(baseline)))
            poses = camera_poses(rng, inputs, targets, length, middle, half_width, aside)
            world, poses = _cleared(world, poses, CLEARANCE * middle)
            if close_share and rng.random() < close_share:
                near = near_occluder(rng, paint, poses[rng.integers(inputs)], half_width, middle)
                world, poses = _cleared(world.with_more(near), poses, CLEARANCE * middle)
            seen = np.isfinite(self._probe(world, poses[:inputs], lens)).mean(axis=(1, 2))
            if seen.min() >= LEAST_INPUT_COVER:
                return _Sample(world, poses, lens, rng)

    def _probe(self, world: World, poses: F64, lens: F64) -> F32:
        """(V, PROBE, PROBE) depths, infinite where nothing is hit."""
        cameras = _camera_rows(poses, lens, PROBE, PROBE)[None]
        return trace(self._atlas, pack([world]), cameras, PROBE, PROBE, 1)[1][0]


def _cleared(world: World, poses: F64, margin: float) -> tuple[World, F64]:
    """Move the cameras towards the origin until all are inside the room, then remove solids that are close to one."""
    for room in (item for item in world.primitives if item.kind == ROOM):
        for _ in range(20):
            if room.contains(poses[:, :3, 3], margin).all():
                break
            poses = poses.copy()
            poses[:, :3, 3] *= 0.8
    kept = [item for item in world.primitives if item.kind == ROOM or not item.contains(poses[:, :3, 3], margin).any()]
    return World(tuple(kept), world.light, world.background), poses


def _camera_rows(poses: F64, lens: F64, height: int, width: int) -> F64:
    """(V, 16) as the ray caster reads cameras."""
    pixels = np.broadcast_to(lens * [width, height, width, height], (len(poses), 4))
    return np.concatenate([poses[:, :3, :3].reshape(-1, 9), poses[:, :3, 3], pixels], axis=1)


def _develop(rng: Rng, images: F32, inputs: int) -> None:
    """In place: one gamma per scene; small exposure and white-balance errors and noise on the inputs alone."""
    np.clip(images, 0, 1, out=images)
    brightness = min(max(float(images.mean()), 0.01), 0.99)
    gamma = math.log(rng.uniform(0.3, 0.6)) / math.log(brightness)  # like automatic exposure, within limits
    np.power(images, np.float32(min(max(gamma, 0.6), 1.6)), out=images)
    for view in images[:inputs]:
        if rng.random() < 0.5:
            view *= (1 + rng.normal(0, 0.02) + rng.normal(0, 0.006, (3, 1, 1))).astype(np.float32)
        if rng.random() < 0.5:
            view += np.float32(rng.uniform(0, 0.012)) * rng.standard_normal(view.shape, np.float32)
    np.clip(images, 0, 1, out=images)


def _depth_range(rng: Rng, depths: F32) -> F64:
    """(2,) near and far as a user would give them: the range of the inputs' depths, extended by up to 2 and 7 times."""
    near, far = np.percentile(depths[np.isfinite(depths)], (1, 99))
    return np.array(
        [near * math.exp(rng.uniform(math.log(0.5), 0)), 1.01 * far * math.exp(rng.uniform(0, math.log(7)))]
    )


def _moved(rng: Rng, poses: F64) -> tuple[F64, float]:
    """The poses after a random rigid motion of the world and a log-uniform change of unit in 0.1..10, and that unit."""
    unit = math.exp(rng.uniform(math.log(0.1), math.log(10)))
    motion = np.eye(4)
    motion[:3, :3] = uniform_rotation(rng)
    motion[:3, 3] = rng.normal(0, 3, 3) * unit
    scaled = poses.copy()
    scaled[:, :3, 3] *= unit
    return motion @ scaled, unit
