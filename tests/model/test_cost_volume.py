"""Matching: correlating before sampling equals sampling features, and a textured wall is found at its depth."""

from __future__ import annotations

import pytest
import torch
import torch.nn.functional as F
from small_networks import scene

from gapmes.model.cost_volume import PatchDescriptor, Views, local_matching, sweep
from gapmes.model.geometry import camera_rays, other_views, pixel_grid
from gapmes.model.warp import Warp


def direct_sweep(features: torch.Tensor, views: Views, planes: int) -> torch.Tensor:
    """The usual plane sweep: sample the source features, multiply, average over the views that see the point."""
    n, _, h, w = features.shape
    volume = torch.zeros(n, planes, h, w)
    poses = views.world_from_cam.reshape(-1, 4, 4)
    intrinsics = views.intrinsics.reshape(-1, 3, 3)
    for b in range(n // views.count):
        for i in range(views.count):
            r = b * views.count + i
            rays = camera_rays(pixel_grid(h, w, features.device)[None], intrinsics[r : r + 1]).flatten(2)
            inverse = views.inverse_depth(torch.linspace(0, 1, planes).reshape(1, planes, 1, 1))[r, :, 0, 0]
            total, seen = torch.zeros(h * w, planes), torch.zeros(h * w, planes)
            for j in range(views.count):
                if j == i:
                    continue
                s = b * views.count + j
                motion = torch.linalg.inv(poses[s]) @ poses[r]
                warp = Warp.make(rays.unsqueeze(3), intrinsics[s : s + 1], motion[None])
                grid, inside = warp.positions(inverse.expand(1, 1, planes))
                sampled = F.grid_sample(features[s : s + 1], grid, align_corners=False)[0]
                total += (features[r].flatten(1)[:, :, None] * sampled).sum(0) * inside[0]
                seen += inside[0]
            volume[r] = (total / seen.clamp(min=1)).T.reshape(planes, h, w)
    return volume


@pytest.mark.case("P11")
@pytest.mark.parametrize("views", [2, 3])
def test_correlation_first_equals_direct_sampling(views: int) -> None:
    _, intrinsics, poses, near_far = scene(2, views)
    cameras = Views.make(intrinsics, poses, near_far)
    features = F.normalize(torch.randn(2 * views, 12, 10, 12, generator=torch.Generator().manual_seed(0)), dim=1)
    (volume,), _ = sweep([features], cameras, 9)
    # sampling is linear, so only the order of float32 sums differs: measured 1.3e-6 at values up to 1
    torch.testing.assert_close(volume, direct_sweep(features, cameras, 9), atol=3e-6, rtol=0)


@pytest.mark.case("P11")
def test_local_matching_at_the_planes_equals_the_sweep() -> None:
    _, intrinsics, poses, near_far = scene(1, 3)
    cameras = Views.make(intrinsics, poses, near_far)
    features = F.normalize(torch.randn(3, 12, 8, 8, generator=torch.Generator().manual_seed(1)), dim=1)
    (volume,), seen = sweep([features], cameras, 5)
    candidates = torch.linspace(0, 1, 5).reshape(1, 5, 1, 1).expand(3, 5, 8, 8)
    (scores,), local_seen = local_matching([features], candidates, cameras)
    torch.testing.assert_close(scores, volume, atol=3e-6, rtol=0)
    torch.testing.assert_close(local_seen, seen)


def test_local_matching_equals_direct_sampling_of_each_feature_map() -> None:
    """Two scenes of three views that are not square, two feature maps of other widths, candidates of every pixel."""
    _, intrinsics, poses, near_far = scene(2, 3)
    cameras = Views.make(intrinsics, poses, near_far)
    generator = torch.Generator().manual_seed(2)
    features = [F.normalize(torch.randn(6, width, 10, 14, generator=generator), dim=1) for width in (5, 12)]
    candidates = torch.rand(6, 4, 10, 14, generator=generator)
    found, seen = local_matching(features, candidates, cameras)
    k, motion = intrinsics.reshape(-1, 3, 3), poses.reshape(-1, 4, 4)
    inverse = cameras.inverse_depth(candidates).flatten(2)  # (6, K, P)
    for r in range(6):
        rays = camera_rays(pixel_grid(10, 14, candidates.device)[None], k[r : r + 1]).flatten(2)
        totals, count = [torch.zeros(140, 4) for _ in features], torch.zeros(140, 4)
        for s in (s for s in range(r // 3 * 3, r // 3 * 3 + 3) if s != r):
            there = (torch.linalg.inv(motion[s]) @ motion[r])[None]
            grid, inside = Warp.make(rays.unsqueeze(3), k[s : s + 1], there).positions(inverse[r].T[None])
            count += inside[0]
            for total, feature in zip(totals, features, strict=True):
                sampled = F.grid_sample(feature[s : s + 1], grid, align_corners=False)[0]
                total += (feature[r].flatten(1)[:, :, None] * sampled).sum(0) * inside[0]
        for total, score in zip(totals, found, strict=True):
            expected = (total / count.clamp(min=1)).T.reshape(4, 10, 14)
            torch.testing.assert_close(score[r], expected, atol=3e-6, rtol=0)
        torch.testing.assert_close(seen[r], (count / 2).T.reshape(4, 10, 14))


def test_other_views_of_a_batch_stay_within_their_scene() -> None:
    values = torch.arange(6).reshape(2, 3, 1)
    assert other_views(values)[1].flatten().tolist() == [4, 5, 3, 5, 3, 4]


@pytest.mark.case("P1")
@pytest.mark.parametrize("depth", [1.6, 2.5, 5.0])
def test_a_textured_wall_is_matched_at_its_depth(depth: float) -> None:
    """A fronto-parallel wall seen by two cameras side by side: the best plane is the nearest one."""
    size, planes, baseline, focal = 64, 33, 0.5, 1.0
    texture = F.interpolate(
        torch.rand(1, 1, 32, 32, generator=torch.Generator().manual_seed(3)), size=(384, 384), mode="bicubic"
    )
    pixels = pixel_grid(4 * size, 4 * size, torch.device("cpu"))

    def view(offset: float) -> torch.Tensor:
        x = (pixels[0] - 0.5) / focal * depth + offset
        y = (pixels[1] - 0.5) / focal * depth
        reach = 0.6 * depth + baseline
        grid = torch.stack([x, y], -1)[None] / reach
        return F.avg_pool2d(F.grid_sample(texture, grid, align_corners=False), 2)

    grey = torch.cat([view(0.0), view(baseline)]) * 2 - 1
    features = PatchDescriptor()(grey)
    poses = torch.eye(4).repeat(1, 2, 1, 1)
    poses[0, 1, 0, 3] = baseline
    k = torch.tensor([[focal, 0, 0.5], [0, focal, 0.5], [0, 0, 1]]).repeat(1, 2, 1, 1)
    near, far = 1.0, 10.0
    (volume,), seen = sweep([features], Views.make(k, poses, torch.tensor([[near, far]])), planes)
    truth = (1 / depth - 1 / far) / (1 / near - 1 / far) * (planes - 1)
    for view in range(2):
        inner = seen[view].min(0).values > 0
        error = (volume[view].argmax(0)[inner].float() - truth).double()
        inliers = error[error.abs() <= 1.5]
        assert len(error) > 200
        # a 4x4 patch alone is ambiguous for a tenth of the pixels: measured 0.81 to 0.90 within a plane and a half
        assert len(inliers) > 0.8 * len(error)
        # what must hold is that the vote is not shifted: measured 0.07 at most; centres half a cell off give 0.48
        assert abs(float(inliers.mean())) < 0.2
