"""Matching at its limits: walls of known depth, no parallax, one plane, points behind, lenses 1:100, plain pictures."""

from __future__ import annotations

import math

import mpmath as mp
import numpy as np
import onnx
import onnxruntime
import pytest
import torch
import torch.nn.functional as F
from onnx import TensorProto, helper
from small_networks import scene, tiny

from gapmes.model.cost_volume import Views, sweep
from gapmes.model.evidence import matching_evidence
from gapmes.model.geometry import camera_rays, pixel_grid
from gapmes.model.warp import Warp
from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.depth_range import DepthRange
from gapmes.service.cameras.overlap import inverse_depth_steps
from gapmes.service.photographs.images import FittedView
from gapmes.service.self_check import self_check
from gapmes.service.splat import Render

CPU = torch.device("cpu")


def two_views(motion: torch.Tensor, near: float = 1.0, far: float = 8.0, focal: float = 1.0) -> Views:
    """A camera at the origin and one at `motion` (4, 4), square pictures."""
    k = torch.tensor([[focal, 0, 0.5], [0, focal, 0.5], [0, 0, 1]]).expand(1, 2, 3, 3)
    return Views.make(k, torch.stack([torch.eye(4), motion])[None], torch.tensor([[near, far]]))


def aside(baseline: float) -> torch.Tensor:
    motion = torch.eye(4)
    motion[0, 3] = baseline
    return motion


def wall(size: int, focal: float, depth: float, baselines: tuple[float, ...], seed: int) -> torch.Tensor:
    """(V, 3, size, size) of a fronto-parallel wall of waves of 4 to 16 px, drawn at the pixel centres, in float64."""
    rng = np.random.default_rng(seed)
    waves = rng.uniform(4.0, 16.0, (3, 12))
    turn, phase = rng.uniform(0, 2 * np.pi, (2, 3, 12))
    pixels = np.arange(size) + 0.5
    images = []
    for baseline in baselines:
        x, y = np.meshgrid(pixels + baseline * focal * size / depth, pixels)
        angle = (
            2 * np.pi / waves[..., None, None] * (np.cos(turn)[..., None, None] * x + np.sin(turn)[..., None, None] * y)
            + phase[..., None, None]
        )
        images.append(0.5 + np.cos(angle).sum(axis=1) / (2 * 12**0.5) / 2)
    return torch.from_numpy(np.stack(images).clip(0, 1)).float()


@pytest.mark.case("P1")
@pytest.mark.parametrize("focal", [0.7, 1.5])
@pytest.mark.parametrize("baseline", [0.3, 0.6])
@pytest.mark.parametrize("planes", [9, 17])
def test_a_wall_is_found_within_half_a_step(focal: float, baseline: float, planes: int) -> None:
    """The truth lies on a plane, or nearly half a step off one: the best plane is the nearest.

    Where a step is more than about 3 px wide, a wave of 4 px may fit a wrong plane better than none (seen at 4.7 px).
    """
    size, near, far = 48, 1.0, 8.0
    pixels = baseline * focal * size  # of shift at depth 1
    step = (1 / near - 1 / far) / (planes - 1)
    for index, share in ((planes // 4, 0.0), (planes // 2, -0.4)):
        inverse = 1 / far + (index + share) * step
        images = wall(size, focal, 1 / inverse, (0.0, baseline), planes)
        evidence = matching_evidence(images, two_views(aside(baseline), near, far, focal), planes)
        seen = evidence[0, :, 6:-6, min(math.ceil(pixels / near) + 6, size - 10) : -6].argmax(0)
        if share == 0 or pixels * step <= 3:
            assert (seen == index).all()


@pytest.mark.case("P2")
@pytest.mark.parametrize("kind", ["no step", "1e-6", "1e-4", "turned"])
def test_without_parallax_the_evidence_says_nothing_about_depth(kind: str) -> None:
    """The spread along depth is that of rounding, and grows with the step; such cameras are refused before matching."""
    baseline = {"no step": 0.0, "1e-6": 1e-6, "1e-4": 1e-4, "turned": 0.0}[kind]
    motion = aside(baseline)
    if kind == "turned":
        c, s = math.cos(0.1), math.sin(0.1)
        motion[:3, :3] = torch.tensor([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    images = torch.rand(2, 3, 24, 24, generator=torch.Generator().manual_seed(0))
    views = two_views(motion)
    features = F.normalize(torch.randn(2, 12, 24, 24, generator=torch.Generator().manual_seed(1)), dim=1)
    (volume,), _ = sweep([features], views, 16)
    evidence = matching_evidence(images, views, 16)
    spread = [float((v.amax(1) - v.amin(1)).max()) for v in (volume, evidence)]
    wide = matching_evidence(images, two_views(aside(0.3)), 16)
    assert max(spread) <= 40 * baseline  # measured 28 times the step, and exactly 0 without one
    assert (wide.amax(1) - wide.amin(1)).max() > 0.2


@pytest.mark.case("P3")
@pytest.mark.parametrize("planes", [1, 2])
def test_one_plane_and_two_planes_are_swept(planes: int) -> None:
    """One plane lies at far; no step between planes is formed, so that nothing is divided by zero."""
    images, views = torch.rand(2, 3, 16, 16, generator=torch.Generator().manual_seed(0)), two_views(aside(0.3))
    (volume,), seen = sweep([images * 2 - 1], views, planes)
    evidence = matching_evidence(images, views, planes)
    many = matching_evidence(images, views, 9)
    assert volume.shape == seen.shape == evidence.shape == (2, planes, 16, 16)
    assert torch.isfinite(volume).all()
    torch.testing.assert_close(evidence[:, 0], many[:, 0], atol=1e-6, rtol=0)
    torch.testing.assert_close(evidence[:, -1], many[:, -1 if planes > 1 else 0], atol=1e-6, rtol=0)


@pytest.mark.case("P10")
@pytest.mark.parametrize(("near", "far"), [(1.0, 8.0), (0.5, 100.0), (1e-3, 1e3), (1.0, 1.0001), (1e-6, 1e6)])
@pytest.mark.parametrize("planes", [2, 9, 64, 128])
def test_candidates_run_from_far_to_near(near: float, far: float, planes: int) -> None:
    views = two_views(aside(0.1), near, far)
    found = views.inverse_depth(torch.linspace(0, 1, planes).reshape(1, -1, 1, 1))[0, :, 0, 0].double().numpy()
    # the range itself comes in float32
    near, far = (float(np.float32(v)) for v in (near, far))
    with mp.workdps(40):
        low, high = 1 / mp.mpf(far), 1 / mp.mpf(near)
        exact = np.array([float(low + (high - low) * mp.mpf(i) / (planes - 1)) for i in range(planes)])
        depths = np.array([float(1 / (high + (low - high) * mp.mpf(i) / (planes - 1))) for i in range(planes)])
    relative = np.abs(found / exact - 1)
    assert relative.max() < 2e-7  # measured 1.6e-7
    assert np.abs(inverse_depth_steps(near, far, planes) / depths - 1).max() < 1e-15 * max(4, far / near)


@pytest.mark.case("P10")
def test_depths_of_the_network_lie_in_the_range() -> None:
    """Up to the step in front of near that the head may take: inverse depth ends at 1.4 of its range, not at 1."""
    images, k, poses, near_far = scene(1, 2, 64)
    with torch.no_grad():
        depth = tiny()(images, k, poses, near_far).depth
    near, far = near_far[0].tolist()
    assert near / 1.4 < float(depth.min()) <= float(depth.max()) <= far * (1 + 2e-7)


def sampled(picture: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(C, ...) of (C, h, w) at positions in px, pixel i centred at i + 0.5; bilinear, zeros outside; float64."""
    h, w = picture.shape[1:]
    x, y = x - 0.5, y - 0.5
    total = 0.0
    for dx in (0, 1):
        for dy in (0, 1):
            column, row = np.floor(x) + dx, np.floor(y) + dy
            weight = (1 - np.abs(x - column)) * (1 - np.abs(y - row))
            inside = (column >= 0) & (column < w) & (row >= 0) & (row < h)
            values = picture[:, row.clip(0, h - 1).astype(int), column.clip(0, w - 1).astype(int)]
            total = total + np.where(inside, weight, 0.0) * values
    return total


@pytest.mark.case("P11")
@pytest.mark.parametrize("seed", [0, 1])
def test_the_cost_volume_equals_brute_force_in_float64(seed: int) -> None:
    """Three views, other lenses each, features of length 1; points on the very border of a picture are left out."""
    generator = torch.Generator().manual_seed(seed)
    h, w, planes, near, far = 10, 14, 9, 1.0, 10.0
    features = F.normalize(torch.randn(3, 12, h, w, generator=generator), dim=1)
    k = torch.tensor([[0.9, 0, 0.5], [0, 1.1, 0.48], [0, 0, 1]]).repeat(3, 1, 1)
    k[:, 0, 0] += torch.tensor([0.0, 0.3, -0.2])
    poses = scene(1, 3)[2][0]
    (volume,), _ = sweep([features], Views.make(k[None], poses[None], torch.tensor([[near, far]])), planes)
    pictures, lenses, frames = (v.double().numpy() for v in (features, k, poses))
    columns, rows = np.meshgrid((np.arange(w) + 0.5) / w, (np.arange(h) + 0.5) / h)
    expected, border = np.zeros((3, planes, h, w)), np.zeros((3, planes, h, w), bool)
    for r in range(3):
        rays = np.linalg.solve(lenses[r], np.stack([columns, rows, np.ones_like(rows)]).reshape(3, -1))
        for d in range(planes):
            depth = 1 / (1 / far + d / (planes - 1) * (1 / near - 1 / far))
            world = frames[r, :3, :3] @ (rays * depth) + frames[r, :3, 3:]
            total, seen = np.zeros((h, w)), np.zeros((h, w))
            for s in range(3):
                if s == r:
                    continue
                point = lenses[s] @ (frames[s, :3, :3].T @ (world - frames[s, :3, 3:]))
                x, y = (point[:2] / point[2]).reshape(2, h, w) * np.array([w, h])[:, None, None]
                inside = (x > 0) & (x < w) & (y > 0) & (y < h) & (point[2].reshape(h, w) > 0)
                edge = np.minimum.reduce([np.abs(x), np.abs(x - w), np.abs(y), np.abs(y - h)]) < 1e-4
                border[r, d] |= edge
                total += np.where(inside, (pictures[r] * sampled(pictures[s], x, y)).sum(0), 0.0)
                seen += inside
            expected[r, d] = total / np.maximum(seen, 1)
    error = np.abs(volume.double().numpy() - expected)[~border]
    assert border.mean() < 0.01
    assert error.max() < 1e-5 * np.abs(expected).max()  # measured 1.4e-6 of it


@pytest.mark.case("P7")
@pytest.mark.parametrize(("reference", "source"), [(0.2, 20.0), (20.0, 0.2), (1.0, 1.0)])
def test_lenses_of_one_to_a_hundred(reference: float, source: float) -> None:
    """Positions in px of a picture of 256 px against float64; with one lens for both they would be off by a picture."""
    lens = torch.tensor([[[reference, 0, 0.47], [0, 0.9 * reference, 0.52], [0, 0, 1]]])
    other = torch.tensor([[[source, 0, 0.55], [0, 1.1 * source, 0.5], [0, 0, 1]]])
    window = min(1.0, 2 * reference / source)  # of the reference, to be in the picture of the other
    positions = window * (torch.rand(1, 2, 1024, generator=torch.Generator().manual_seed(0)) - 0.5)
    positions = positions + torch.tensor([0.47, 0.52]).reshape(1, 2, 1)
    rays = camera_rays(positions, lens)
    motion = torch.eye(4)[None].clone()
    c, s = math.cos(0.01 / max(1.0, source)), math.sin(0.01 / max(1.0, source))
    motion[0, :3, :3] = torch.tensor([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    motion[0, :3, 3] = torch.tensor([0.02, -0.01, 0.03]) / max(1.0, source)
    inverse = torch.linspace(0.1, 1.0, 7).reshape(1, 1, 7).expand(1, 1024, 7)
    grid, inside = Warp.make(rays.unsqueeze(3), other, motion).positions(inverse)
    pixels = positions[0].double()
    l64 = lens[0].double()
    exact = torch.stack([(pixels[0] - l64[0, 2]) / l64[0, 0], (pixels[1] - l64[1, 2]) / l64[1, 1], torch.ones(1024)])
    point = motion[0, :3, :3].double() @ exact
    point = point.T[:, None] + motion[0, :3, 3].double() * inverse[0].double()[..., None]
    o64 = other[0].double()
    x = o64[0, 0] * point[..., 0] / point[..., 2] + o64[0, 2]
    y = o64[1, 1] * point[..., 1] / point[..., 2] + o64[1, 2]
    within = inside[0]
    error = torch.stack([grid[0, ..., 0].double() - (2 * x - 1), grid[0, ..., 1].double() - (2 * y - 1)])
    error = error[:, within].abs() * 128  # grid units to px
    assert within.double().mean() > 0.1
    assert error.max() < 1e-3  # measured 2.8e-5


def onnx_grid_sample() -> onnxruntime.InferenceSession:
    node = helper.make_node(
        "GridSample", ["picture", "grid"], ["out"], mode="linear", padding_mode="zeros", align_corners=0
    )
    given = [
        helper.make_tensor_value_info("picture", TensorProto.FLOAT, [1, "c", "h", "w"]),
        helper.make_tensor_value_info("grid", TensorProto.FLOAT, [1, "a", "b", 2]),
    ]
    out = helper.make_tensor_value_info("out", TensorProto.FLOAT, [1, "c", "a", "b"])
    graph = helper.make_graph([node], "sample", given, [out])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=9)
    onnx.checker.check_model(model)
    return onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])


@pytest.mark.case("P4")
@pytest.mark.parametrize(("height", "width"), [(9, 12), (1, 7), (6, 1), (1, 1)])
@pytest.mark.parametrize("value", [0.0, -0.0, 1e-45, 1e-4, 1e10, -1e10, 3e38, math.inf, -math.inf, math.nan])
def test_any_point_is_sampled_alike_by_both_runtimes(height: int, width: int, value: float) -> None:
    """Points in front, on the plane z = 0, behind, and of extreme numbers, in each component of the motion in turn."""
    generator = torch.Generator().manual_seed(0)
    picture = torch.rand(1, 3, height, width, generator=generator)
    lens = torch.tensor([[[1.1, 0, 0.47], [0, 0.9, 0.52], [0, 0, 1]]])
    rays = camera_rays(pixel_grid(height, width, CPU)[None], lens).flatten(2)
    inverse = torch.linspace(0.0, 1.0, 5).reshape(1, 1, 5).expand(1, height * width, 5)
    session = onnx_grid_sample()
    for place in ((0, 3), (1, 3), (2, 3), (2, 2), (0, 0)):
        motion = torch.eye(4)[None].clone()
        motion[0, *place] = value
        grid, inside, depth = Warp.make(rays.unsqueeze(3), lens, motion).points(inverse)
        assert torch.isfinite(grid).all()
        assert torch.isfinite(depth).all()
        point = (motion[0, :3, :3] @ rays[0]).T[:, None] + motion[0, :3, 3] * inverse[0, :, :, None]
        behind = ~(point[None, ..., 2] > 0)
        assert not inside[behind].any()
        assert (grid[behind] == 4).all()
        ours = F.grid_sample(picture, grid, mode="bilinear", padding_mode="zeros", align_corners=False)
        (theirs,) = session.run(None, {"picture": picture.numpy(), "grid": grid.numpy()})
        x, y = (grid[0].double().numpy().transpose(2, 0, 1) + 1) / 2 * np.array([width, height])[:, None, None]
        exact = sampled(picture[0].double().numpy(), x, y)
        # measured 4.0e-7 between the two and 5.3e-7 to float64: positions of up to 12 px are rounded by 5e-7
        assert np.abs(ours[0].numpy() - theirs[0]).max() < 5e-7
        assert np.abs(ours[0].numpy() - exact).max() < 1e-6
        assert np.abs(theirs[0] - exact).max() < 1e-6
        assert not ours[0][:, behind[0]].any()


@pytest.mark.case("P8")
@pytest.mark.parametrize("kind", ["black", "white", "grey", "noise"])
def test_plain_and_noisy_pictures_have_a_finite_depth_and_say_what_they_lack(kind: str) -> None:
    images, k, poses, near_far = scene(1, 2, 64)
    plain = {"black": 0.0, "white": 1.0, "grey": 0.5}
    if kind in plain:
        images = torch.full_like(images, plain[kind])
    with torch.no_grad():
        prediction = tiny()(images, k, poses, near_far)
    near, far = near_far[0].tolist()
    assert torch.isfinite(prediction.depth).all()
    assert near / 1.4 < float(prediction.depth.min()) <= float(prediction.depth.max()) <= far * (1 + 2e-7)
    # the probability of the best of 64 planes: at least that of an even vote
    assert ((prediction.confidence >= 1 / 64 - 1e-6) & (prediction.confidence <= 1)).all()
    cameras = [Camera.make(64, 64, 58, 61, 32, 31, pose.double().numpy()) for pose in poses[0]]
    views = [FittedView(image.numpy(), None, camera, 1.0) for image, camera in zip(images[0], cameras, strict=True)]
    nothing = np.zeros((64, 64, 3), np.float32)
    drawn = [Render(nothing, nothing[..., 0], nothing[..., 0], {})] * 2
    info = type("Info", (), {"depth_planes": 64})
    check = self_check(views, DepthRange(near, far, "given"), info, drawn, views)
    assert check["textureless_share"] == (0.0 if kind == "noise" else 1.0)
