"""Moving pixels' Gaussians to other depths: they keep their pixels and their size in the picture, and all else."""

from __future__ import annotations

import numpy as np
from plane_scene import PlaneScene

from gapmes.service.cameras.depth_range import DepthRange
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.cameras.world_frame import WorldFrame
from gapmes.service.matching.coarse_views import pixel_grid

EXTRA = 5  # Gaussians that belong to no pixel


def test_at_depths_moves_along_the_rays() -> None:
    rng = np.random.default_rng(0)
    scene = PlaneScene.make(rng).moved(about_axis(np.array([0.0, 0.6, 0.8]), 1.1), np.array([900.0, -40.0, 7.0]), 30.0)
    cameras, shape = scene.cameras, (scene.cameras[0].height, scene.cameras[0].width)
    depths = DepthRange(scene.near, scene.far, "given")
    frame = WorldFrame.of(cameras, depths)
    np.testing.assert_allclose(frame.near_far(depths), [1.0, scene.far / scene.near], rtol=1e-6)
    depth = rng.uniform(1, 4, (len(cameras), *shape)).astype(np.float32)
    poses, pixels = frame.poses(cameras).astype(np.float64), pixel_grid(shape)
    rays = [camera.rays(pixels) @ frame.rotation for camera in cameras]
    means = [pose[:3, 3] + ray * z.reshape(-1, 1) for pose, ray, z in zip(poses, rays, depth, strict=True)]
    count = depth.size + EXTRA
    outputs = {
        "means": np.concatenate([*means, rng.normal(size=(EXTRA, 3))]).astype(np.float32),
        "scales": rng.uniform(0.01, 0.1, (count, 3)).astype(np.float32),
        "opacities": rng.random(count, dtype=np.float32),
        "depth": depth,
    }
    before = frame.depths(outputs)
    assert np.abs(before / (scene.near * depth.astype(np.float64)) - 1).max() < 1e-12
    wanted = np.where(rng.random(depth.shape) < 0.5, before, before * rng.uniform(0.6, 1.5, depth.shape))
    wanted[:, 0] = 2 * before[:, 0]
    moved = frame.at_depths(outputs, cameras, wanted)
    assert np.abs(frame.depths(moved) / wanted - 1).max() < 1e-6  # float32
    stays = np.concatenate([(wanted == before).ravel(), np.ones(EXTRA, bool)])
    for name in ("means", "scales", "opacities"):
        assert moved[name].dtype == np.float32
        assert (moved[name][stays] == outputs[name][stays]).all()
    ratio = moved["scales"][: depth.size] / outputs["scales"][: depth.size]
    assert np.abs(ratio / (wanted / before).reshape(-1, 1) - 1).max() < 1e-6
    world = frame.origin + (moved["means"].astype(np.float64) @ frame.rotation.T) * frame.unit
    for index, camera in enumerate(cameras):
        at, z = camera.project(world[: depth.size].reshape(len(cameras), -1, 3)[index])
        assert np.abs(at - pixels).max() < 1e-3  # px; found: 1e-4
        assert np.abs(z / wanted[index].ravel() - 1).max() < 2e-6
