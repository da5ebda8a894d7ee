"""Poses, depths, rotations, harmonics and files at their extremes."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import torch
from mpmath import mp

from gapmes.model.cost_volume import Views
from gapmes.model.heads import unit_quaternions
from gapmes.model.warp import Warp
from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.depth_range import DepthRange
from gapmes.service.cameras.overlap import inverse_depth_steps
from gapmes.service.cameras.rotations import about_axis, matrix_from_quaternion, quaternion_from_matrix
from gapmes.service.cameras.world_frame import WorldFrame
from gapmes.service.formats.ply import ply_bytes, read_ply
from gapmes.service.gaussians import Gaussians, normalized_quaternions
from gapmes.service.harmonics import evaluate_basis, rotate_harmonics
from gapmes.service.leaving_out.pruning import prune
from gapmes.service.splat import render_reference

from . import naive
from .row import Row, larger
from .splatter import cloud, view


def rows() -> Iterator[Row]:
    yield from (relative_poses(), other_lens(), candidates(), quaternions(), harmonics(), half_turns(), ply_file())
    yield removal()


def _posed(rng: np.random.Generator, offset: float) -> Camera:
    pose = np.eye(4)
    pose[:3, :3] = about_axis(np.array([0.6, 0.0, 0.8]), rng.uniform(-0.5, 0.5))
    pose[:3, 3] = offset + rng.uniform(-1, 1, 3)
    return Camera(64, 64, 60.0, 60.0, 32.0, 32.0, pose)


def relative_poses() -> Row:
    mp.dps = 50
    rng, worst, plain = np.random.default_rng(6), 0.0, 0.0
    for offset in (0.0, 1e3, 1e6):
        for _ in range(20):
            cameras = [_posed(rng, offset), _posed(rng, offset)]
            frame = WorldFrame.of(cameras, DepthRange(1.0, 10.0, "given"))
            turned = mp.matrix(cameras[0].rotation.T.tolist())
            centres = zip(cameras[0].center, cameras[1].center, strict=True)
            shift = mp.matrix([mp.mpf(float(b)) - mp.mpf(float(a)) for a, b in centres])
            exact = np.array([float(v) for v in turned * shift])
            worst = larger(worst, float(np.abs(frame.poses(cameras)[1, :3, 3] - exact).max()))
            other = naive.relative_pose(cameras[0].world_from_cam, cameras[1].world_from_cam)
            plain = larger(plain, float(np.abs(other[:3, 3] - exact).max()))
    # float32 of a baseline of up to 2 units: 1.2e-7
    return Row(
        "P6",
        "the way between two views",
        "0 to 1e6 units off the origin",
        "50 digits",
        "units",
        worst,
        2.4e-7,
        plain,
        "float32 inverse",
    )


def other_lens() -> Row:
    rng, worst = np.random.default_rng(7), 0.0
    for ratio in (0.01, 1.0, 100.0):
        narrow = max(ratio, 1.0)  # what a long lens has in its picture
        turn, shift = about_axis(np.array([0.0, 1.0, 0.0]), 0.1 / narrow), np.array([0.2, -0.1, 0.05]) / narrow
        lens = np.array([[0.9 * ratio, 0, 0.5], [0, 1.1 * ratio, 0.45], [0, 0, 1]])
        rays = np.column_stack([rng.uniform(-0.4, 0.4, (200, 2)) / narrow, np.ones(200)])
        inverse = rng.uniform(0.1, 1.0, 200)
        points = (rays / inverse[:, None]) @ turn.T + shift
        exact = (points @ lens.T)[:, :2] / points[:, 2:]
        motion = np.eye(4)
        motion[:3, :3], motion[:3, 3] = turn, shift
        given, depths, *camera = (
            torch.from_numpy(a).float()[None] for a in (rays.T[:, :, None], inverse[:, None], lens, motion)
        )
        grid, inside = Warp.make(given, *camera).positions(depths)
        found = (grid[0, :, 0].numpy() + 1) / 2
        seen = inside[0, :, 0].numpy()
        worst = larger(worst, float(256 * np.abs(found - exact)[seen].max()))
    return Row("P7", "views with other lenses", "focal lengths 1:100 to 100:1", "float64", "px of 256", worst, 1e-3)


def candidates() -> Row:
    mp.dps = 50
    worst = 0.0
    for near, far in ((0.5, 100.0), (1e-3, 1e3), (1.0, 1e6)):
        views = Views.make(torch.eye(3)[None, None], torch.eye(4)[None, None], torch.tensor([[near, far]]))
        network = 1 / views.inverse_depth(torch.linspace(0, 1, 128).reshape(1, 128, 1, 1))[0, :, 0, 0].flip(0)
        for step, depth in [*enumerate(inverse_depth_steps(near, far, 128)), *enumerate(network.tolist())]:
            first, last = 1 / mp.mpf(near), 1 / mp.mpf(far)
            exact = 1 / (first + (last - first) * step / 127)
            worst = larger(worst, abs(float((mp.mpf(float(depth)) - exact) / exact)))
    return Row("P10", "depth candidates", "far/near to 1e6", "50 digits", "relative", worst, 2e-7)


def quaternions() -> Row:
    rng, worst, plain = np.random.default_rng(8), 0.0, 0.0
    for size in (1e-44, 1e-30, 1e-8, 1.0, 1e19, 1e38):
        direction = rng.standard_normal((50, 4))
        raw = (size * direction / np.abs(direction).max(axis=1, keepdims=True)).astype(np.float32)
        identity = torch.tensor([1.0, 0, 0, 0]).reshape(1, 4, 1, 1)
        heads = unit_quaternions(torch.from_numpy(raw.T.copy()).reshape(1, 4, 50, 1), identity)[0, :, :, 0].T.numpy()
        wide = raw.astype(np.float64)
        exact = matrix_from_quaternion(wide / np.linalg.norm(wide, axis=1, keepdims=True))
        ours, others, simple = (
            float(np.abs(matrix_from_quaternion(unit.astype(np.float64)) - exact).max())
            for unit in (normalized_quaternions(raw), heads, naive.unit_quaternion(raw))
        )
        worst, plain = larger(worst, ours, others), larger(plain, simple)
    return Row(
        "A1",
        "quaternions of any length",
        "1e-44 to 1e38",
        "float64",
        "entry",
        worst,
        2e-6,
        plain,
        "q / (length + 1e-8)",
    )


def harmonics() -> Row:
    rng, worst, plain = np.random.default_rng(9), 0.0, 0.0
    directions = rng.standard_normal((100, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for angle in (1e-6, 1e-5, 1e-3, 1e-2, 0.5, 3.1):
        rotation = about_axis(np.array([0.48, -0.6, 0.64]), angle)
        for degree in (1, 2, 3):
            coefficients = rng.normal(0, 0.3, (1, (degree + 1) ** 2, 1))
            turned = rotate_harmonics(coefficients, rotation)
            expected = evaluate_basis(directions, degree) @ coefficients[0]
            found = evaluate_basis(directions @ rotation.T, degree) @ turned[0]
            worst = larger(worst, float(np.abs(found - expected).max()))
        plain = larger(plain, float(np.abs(naive.band_rotation_by_angles(rotation) - rotation).max()))
    return Row(
        "A3",
        "harmonics turned with the world",
        "angles 1e-6 to 3.1, degree 1 to 3",
        "turned direction",
        "colour",
        worst,
        1e-6,
        plain,
        "Euler angles, band 1",
    )


def half_turns() -> Row:
    rng, worst = np.random.default_rng(10), 0.0
    for angle in (0.0, 1e-8, 1.0, np.pi - 1e-8, np.pi):
        for _ in range(20):
            axis = rng.standard_normal(3)
            rotation = about_axis(axis / np.linalg.norm(axis), angle)
            again = matrix_from_quaternion(quaternion_from_matrix(rotation))
            worst = larger(worst, float(np.abs(again - rotation).max()))
    return Row("A4", "rotations to quaternions", "angles 0 to a half turn", "the matrix", "entry", worst, 1e-6)


def ply_file() -> Row:
    opacities = np.array([1e-38, 1e-6, *np.linspace(0.01, 0.99, 50), 1 - 2.0**-24, 1.0], np.float32)
    count = len(opacities)
    scales, turned = np.geomspace(1e-38, 1e38, count), np.tile([1.0, 0, 0, 0], (count, 1))
    columns = np.tile(scales[:, None], (1, 3)), turned, opacities, np.zeros((count, 1, 3))
    back = read_ply(io.BytesIO(ply_bytes(Gaussians.make(np.ones((count, 3)), *columns))))
    worst = float(np.abs(back.opacities - opacities).max())
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        logit = np.log(opacities / (np.float32(1) - opacities))
        plain = float("inf") if not np.isfinite(logit).all() else 0.0
    return Row(
        "I1",
        "opacities through a .ply",
        "1e-38 to 1",
        "what was written",
        "opacity",
        worst,
        1e-7,
        plain,
        "log(o / (1 - o))",
    )


def removal() -> Row:
    """The change of a colour by pruning in excess of its bound: random scenes, both pictures in float64."""
    worst, dropped = -math.inf, 0
    for seed in range(12):
        scene = cloud(120, seed, (0.02, 0.3), (1.0, 6.0))
        faint = replace(scene, opacities=scene.opacities ** np.float32(3))
        found = prune(faint, [view()], 0.3, worth=0)
        before, after = (render_reference(some, view()).rgb for some in (faint, faint[found.keep]))
        worst = larger(worst, float(np.abs(before - after).max()) - found.bound)
        dropped += found.dropped - found.unseen
    if dropped == 0:
        raise ValueError("nothing with weight was left out")
    return Row(
        "S1",
        "change by leaving out, beyond its bound",
        "12 scenes",
        "float64, brute force",
        "colour",
        max(worst, 0.0),
        0.0,
    )
