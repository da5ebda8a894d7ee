"""The whole network: one Gaussian per pixel in the frame of the poses, masks, and the effect of each compatibility
switch."""

from __future__ import annotations

from dataclasses import fields, replace

import pytest
import torch
from random_checkpoint import randomised

from gapmes.export.samples import random_scene, rotation_y
from gapmes.model.depthsplat.config import SCALE_MAX, Compatibility, DepthSplatConfig
from gapmes.model.depthsplat.network import DepthSplat
from gapmes.model.geometry import quaternion_product
from gapmes.model.prediction import Prediction

SIZE = 64


@pytest.fixture(scope="module")
def network() -> DepthSplat:
    return randomised(DepthSplat(DepthSplatConfig("small", 1)))


def scene(views: int) -> list[torch.Tensor]:
    return [value.unsqueeze(0) for value in random_scene(views, SIZE, SIZE, seed=views).tensors()]


def predict(network: DepthSplat, inputs: list[torch.Tensor], switches: Compatibility = Compatibility()) -> Prediction:  # noqa: B008 - a frozen value
    network.config = replace(network.config, compatibility=switches)
    network.depth_predictor.config = network.config
    with torch.no_grad():
        return network(*inputs)


@pytest.mark.parametrize(("scales", "coarsest"), [(1, 8), (2, 8), (2, 4)])
def test_every_published_layout_has_a_part_for_each_pixel(scales: int, coarsest: int) -> None:
    config = DepthSplatConfig("small", scales, coarsest=coarsest, scale_max=0.02)
    found = predict(randomised(DepthSplat(config)), scene(2))
    assert found.gaussians.means.shape == (1, 2 * SIZE * SIZE, 3)
    # one confidence for each cell of the finest matched resolution
    cells = found.confidence.reshape(2, SIZE // config.upsample_factor, config.upsample_factor, -1)
    assert torch.equal(cells, cells[:, :, :1].expand_as(cells))
    assert len(cells[0, :, 0].unique(dim=0)) == SIZE // config.upsample_factor
    assert float(found.depth.std()) > 0.01
    assert float(found.gaussians.scales.max()) == pytest.approx(0.02)  # found without it: 0.03


@pytest.mark.parametrize("views", [2, 3, 4])
def test_one_gaussian_per_pixel_within_its_ranges(network: DepthSplat, views: int) -> None:
    inputs = scene(views)
    found = predict(network, inputs)
    g = found.gaussians
    assert g.means.shape == (1, views * SIZE * SIZE, 3)
    assert g.harmonics.shape == (1, views * SIZE * SIZE, 9, 3)
    for value in (g.means, g.scales, g.rotations_wxyz, g.opacities, g.harmonics, found.depth, found.confidence):
        assert torch.isfinite(value).all()
    near, far = inputs[3][0].tolist()
    assert near * 0.9999 <= float(found.depth.min())
    assert float(found.depth.max()) <= far * 1.0001
    assert float(found.depth.std()) > 0.01  # random weights, but no part without effect
    assert float(g.scales.min()) > 0
    assert float(g.scales.max()) <= SCALE_MAX
    torch.testing.assert_close(g.rotations_wxyz.norm(dim=-1), torch.ones(1, g.means.shape[1]), atol=1e-5, rtol=0)


def test_moving_the_world_moves_the_gaussians_and_nothing_else(network: DepthSplat) -> None:
    inputs = scene(3)
    turn = torch.eye(4)
    turn[:3, :3], turn[:3, 3] = rotation_y(0.7), torch.tensor([0.4, -0.3, 0.9])
    before = predict(network, inputs).gaussians
    inputs[2] = turn @ inputs[2]
    after = predict(network, inputs).gaussians
    moved = before.means @ turn[:3, :3].T + turn[:3, 3]
    # float32, once more through a matrix; measured 7.6e-6, 9e-9, 6e-8 and, of the rotations, 9e-7
    torch.testing.assert_close(after.means, moved, atol=3e-5, rtol=0)
    torch.testing.assert_close(after.scales, before.scales, atol=0, rtol=5e-6)
    torch.testing.assert_close(after.opacities, before.opacities, atol=1e-6, rtol=0)
    half = torch.tensor(0.35)
    q = torch.tensor([half.cos(), 0.0, half.sin(), 0.0])
    expected = quaternion_product(q, before.rotations_wxyz)
    aligned = expected * (expected * after.rotations_wxyz).sum(-1, keepdim=True).sign()
    torch.testing.assert_close(after.rotations_wxyz, aligned, atol=5e-6, rtol=0)


def test_left_out_patches_have_opacity_exactly_zero(network: DepthSplat) -> None:
    inputs = scene(2)
    full = predict(network, inputs).gaussians.opacities.reshape(2, SIZE, SIZE)
    inputs[4] = inputs[4].clone()
    inputs[4][0, 0, 5] = False
    masked = predict(network, inputs).gaussians.opacities.reshape(2, SIZE, SIZE)
    assert (masked[0, 16:32, 16:32] == 0).all()
    assert int((masked == 0).sum()) == 256
    assert torch.equal(masked[masked > 0], full[masked > 0])


# What each switch may change, by field; with views of one lens `reference_intrinsics` changes nothing.
REACH = {
    "reference_intrinsics": {"depth", "means", "scales", "rotations_wxyz", "opacities", "harmonics"},
    "corner_pixels": {"depth", "means", "scales", "rotations_wxyz", "opacities", "harmonics"},
    "clamped_depths": set(),  # nothing lies behind a camera here
    "tiled_mask": {"depth", "means", "scales", "rotations_wxyz", "opacities", "harmonics"},
    "camera_rotations": {"rotations_wxyz"},
    "foreign_harmonics": {"harmonics"},
}


@pytest.mark.parametrize("switch", [field.name for field in fields(Compatibility)])
def test_a_switch_changes_what_it_is_about_and_nothing_else(network: DepthSplat, switch: str) -> None:
    inputs = scene(3)
    inputs[1] = inputs[1].clone()
    inputs[1][0, 1, 0, 0] *= 1.2  # another lens
    plain, other = predict(network, inputs), predict(network, inputs, Compatibility.named(switch))
    changed = {
        name
        for name in REACH["corner_pixels"] - {"depth"}
        if not torch.equal(getattr(plain.gaussians, name), getattr(other.gaussians, name))
    }
    changed |= set() if torch.equal(plain.depth, other.depth) else {"depth"}
    assert changed == REACH[switch]


def test_with_one_lens_two_views_and_no_rotation_the_authors_differ_by_the_pixel_corner_alone(
    network: DepthSplat,
) -> None:
    inputs = scene(2)
    inputs[2] = inputs[2].clone()
    inputs[2][..., :3, :3] = torch.eye(3)
    ours = predict(network, inputs, Compatibility(corner_pixels=True))
    theirs = predict(network, inputs, Compatibility.authors())
    torch.testing.assert_close(ours.gaussians.means, theirs.gaussians.means, atol=0, rtol=0)
    torch.testing.assert_close(ours.gaussians.rotations_wxyz, theirs.gaussians.rotations_wxyz, atol=1e-6, rtol=0)
    torch.testing.assert_close(ours.gaussians.harmonics, theirs.gaussians.harmonics, atol=1e-6, rtol=0)
