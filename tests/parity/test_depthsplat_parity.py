"""DepthSplat against the authors' code, in float64 with random weights in the published layout.

Needs checkouts of both repositories, which are no part of the project: GAPMES_DEPTHSPLAT_REPO (cvg/depthsplat) and
GAPMES_DINOV2_REPO (facebookresearch/dinov2), and their libraries einops, jaxtyping and e3nn.
"""

from __future__ import annotations

import os
import runpy
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from facing_cameras import facing_poses
from torch import Tensor, nn

from gapmes.export.samples import random_scene
from gapmes.model.cost_volume import Views
from gapmes.model.depthsplat.checkpoint import load_depthsplat
from gapmes.model.depthsplat.config import Compatibility
from gapmes.model.depthsplat.neighbours import nearest_views
from gapmes.model.depthsplat.sweep import plane_sweep

REPOSITORIES = ("GAPMES_DEPTHSPLAT_REPO", "GAPMES_DINOV2_REPO")
VITS = {"small": "vits", "base": "vitb"}
# Of each field's largest value, depth relative to itself. Parts of both codes stay in float32 (positions, grids):
# measured at most 4.8e-5 for depths of 1 to 20, 2.2e-5 for the rest. In float32 throughout both differ by 4e-4 of a
# depth of 20 where its inverse has 2e-5 of its range: rounding before a softmax over 128 planes.
TOLERANCE = 1e-4


@pytest.fixture(scope="module")
def repositories() -> Iterator[tuple[Path, Path]]:
    if missing := [name for name in REPOSITORIES if not os.environ.get(name)]:
        warnings.warn(f"parity with the authors' DepthSplat not checked: {', '.join(missing)} not set", stacklevel=1)
        pytest.skip(f"{', '.join(missing)} not set")
    before = torch.Tensor.float
    yield Path(os.environ[REPOSITORIES[0]]), Path(os.environ[REPOSITORIES[1]])
    torch.Tensor.float = before  # type: ignore[method-assign]


def randomised(theirs: nn.Module) -> None:
    generator = torch.Generator().manual_seed(0)
    for name, value in theirs.named_parameters():
        noise = torch.randn(value.shape, generator=generator)
        if value.dim() > 1:
            value.data = noise * (0.7 / value[0].numel() ** 0.5)
        else:
            scale = "norm" in name or "gamma" in name or name.endswith(".0.weight")
            value.data = float(scale) + 0.1 * noise


def in_float64(theirs: nn.Module) -> nn.Module:
    """Their code casts with `.float()` on the way, and keeps a type in one module."""
    torch.Tensor.float = torch.Tensor.double  # type: ignore[method-assign]
    for module in theirs.modules():
        if type(module).__name__ == "UNetModel":
            module.dtype = torch.float64
    return theirs.double()


def far_apart(views: int, height: int, width: int) -> list[Tensor]:
    """A scene whose cameras' order by distance is not that of their numbers."""
    images, intrinsics, poses, near_far, _ = random_scene(views, height, width, seed=views).tensors()
    for v in range(views):
        poses[v, :3, 3] += torch.tensor([0.3 * (v * 7 % 5), 0.1 * (v * 3 % 4), 0.0])
    return [value.double().unsqueeze(0) for value in (images, intrinsics, poses, near_far)]


# The published networks: those for 256x256 px match first at 1/4 resolution, those for larger pictures at 1/8, two of
# them with smaller Gaussians.
@pytest.mark.parametrize(
    ("vit", "scales", "coarsest", "scale_max"),
    [("small", 1, 4, 3.0), ("base", 2, 4, 3.0), ("small", 1, 8, 0.1), ("base", 2, 8, 0.1)],
)
@pytest.mark.parametrize(("height", "width"), [(256, 256), (256, 448)])
@pytest.mark.parametrize("views", [2, 4])
def test_the_authors_code_gives_the_same_gaussians(
    repositories: tuple[Path, Path],
    tmp_path: Path,
    vit: str,
    scales: int,
    coarsest: int,
    scale_max: float,
    height: int,
    width: int,
    views: int,
) -> None:
    from authors_code import encoder

    theirs = encoder(*repositories, VITS[vit], scales, coarsest, scale_max)
    randomised(theirs)
    path = tmp_path / "random.pth"
    torch.save({"state_dict": {f"encoder.{name}": value for name, value in theirs.state_dict().items()}}, path)
    ours = load_depthsplat(path, Compatibility.authors(), scale_max)[0].double()
    images, intrinsics, poses, near_far = far_apart(views, height, width)
    context = {
        "image": images,
        "intrinsics": intrinsics.clone(),
        "extrinsics": poses,
        "near": near_far[:, :1].expand(1, views),
        "far": near_far[:, 1:].expand(1, views),
    }
    raw: dict[str, Tensor] = {}
    with torch.no_grad():
        expected = in_float64(theirs)(context, 0, visualization_dump=raw)
        found = ours(images, intrinsics, poses, near_far)
    assert float(((found.depth - expected["depths"]) / expected["depths"]).abs().max()) < TOLERANCE
    g, h = found.gaussians, expected["gaussians"]
    xyzw = raw["rotations"]
    pairs = {
        "means": (g.means, h.means),
        "opacities": (g.opacities, h.opacities),
        "harmonics": (g.harmonics.transpose(2, 3), h.harmonics),
        "scales": (g.scales, raw["scales"]),
        "rotations": (g.rotations_wxyz, torch.cat([xyzw[..., 3:], xyzw[..., :3]], dim=-1)),
    }
    errors = {name: float((a - b).abs().max() / b.abs().max()) for name, (a, b) in pairs.items()}
    assert max(errors.values()) < TOLERANCE, errors


@pytest.mark.parametrize(("depth", "ahead"), [(5.0, -2.0), (5.0, 0.0005), (100.0, 0.005)])
def test_the_authors_warp_matches_what_lies_behind_a_camera_alike(
    repositories: tuple[Path, Path], depth: float, ahead: float
) -> None:
    """Which no scene of the other test has: one cell of the first view meets the picture of the second by the clamp."""
    warp = runpy.run_path(str(repositories[0] / "src/model/encoder/unimatch/matching.py"))
    torch.Tensor.float = torch.Tensor.double  # type: ignore[method-assign]
    count, h, w = 2, 4, 8
    k = torch.tensor([[0.9, 0, 0.5], [0, 1.1, 0.45], [0, 0, 1]], dtype=torch.float64)
    poses = facing_poses(k, k, (2 / w, 1 / h), depth, ahead)
    views = Views.make(k.repeat(1, count, 1, 1), poses, torch.tensor([[1.0, 200.0]], dtype=torch.float64))
    features = torch.randn(count, 5, h, w, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    inverse = (
        torch.tensor([1 / depth, 0.7 / depth, 0.5], dtype=torch.float64).reshape(1, 3, 1, 1).repeat(count, 1, 1, 1)
    )
    found = plane_sweep(features, inverse, views, nearest_views(poses, as_listed=True), Compatibility.authors())
    pixels = torch.diag(torch.tensor([w, h, 1], dtype=torch.float64)) @ k
    motion = torch.linalg.inv(poses[:, 1]) @ poses[:, 0]
    depths = (1 / inverse[:1]).expand(1, -1, h, w)
    warped = warp["warp_with_pose_depth_candidates"](features[1:], pixels[None], motion, depths)
    expected = (features[0, :, None] * warped[0]).sum(0) / features.shape[1] ** 0.5
    torch.testing.assert_close(found[0], expected, atol=1e-10, rtol=0)
    assert abs(float(expected[0, 1, 2])) > 0.1
