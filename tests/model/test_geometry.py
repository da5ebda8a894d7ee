"""Geometry in torch against float64 and against definitions: quaternions, pair gathers, warps."""

from __future__ import annotations

import math

import pytest
import torch
from small_networks import random_rotation

from gapmes.model.geometry import (
    camera_rays,
    matrix_to_quaternion,
    other_views,
    pixel_grid,
    quaternion_product,
    quaternion_to_matrix,
    rigid_inverse,
)
from gapmes.model.warp import Warp


def axis_angle(axis: torch.Tensor, angle: float) -> torch.Tensor:
    x, y, z = (axis / axis.norm()).tolist()
    skew = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
    return torch.matrix_exp(skew * angle)


@pytest.mark.case("A4")
@pytest.mark.parametrize("angle", [0.0, 1e-6, 0.5, math.pi / 2, math.pi - 1e-6, math.pi])
def test_matrix_to_quaternion_and_back(angle: float) -> None:
    generator = torch.Generator().manual_seed(0)
    axes = [*torch.eye(3, dtype=torch.float64), *torch.randn(30, 3, generator=generator, dtype=torch.float64)]
    matrices = torch.stack([axis_angle(a, angle) for a in axes])
    back = quaternion_to_matrix(matrix_to_quaternion(matrices.float()))
    # float32 in and out: measured 3.3e-7; q and -q are the same rotation, so rotations are compared
    torch.testing.assert_close(back.double(), matrices, atol=1e-6, rtol=0)


def test_product_is_composition() -> None:
    generator = torch.Generator().manual_seed(1)
    a, b = random_rotation(generator), random_rotation(generator)
    q = quaternion_product(matrix_to_quaternion(a[None]), matrix_to_quaternion(b[None]))
    torch.testing.assert_close(quaternion_to_matrix(q)[0], a @ b, atol=1e-12, rtol=0)


@pytest.mark.parametrize("views", [2, 3, 6])
def test_other_views_lists_all_others_in_order(views: int) -> None:
    values = torch.arange(views).reshape(1, views, 1)
    expected = [[[j] for j in range(views) if j != v] for v in range(views)]
    assert other_views(values)[0].tolist() == expected


def test_rigid_inverse() -> None:
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3], pose[:3, 3] = random_rotation(torch.Generator().manual_seed(2)), torch.tensor([1.0, -2.0, 3.0])
    torch.testing.assert_close(rigid_inverse(pose) @ pose, torch.eye(4, dtype=torch.float64), atol=1e-14, rtol=0)


def warp_case(translation: list[float]) -> tuple[torch.Tensor, ...]:
    k = torch.tensor([[[1.1, 0, 0.47], [0, 0.9, 0.52], [0, 0, 1]]])
    source_k = torch.tensor([[[0.7, 0, 0.55], [0, 0.8, 0.5], [0, 0, 1]]])  # another lens than the reference
    rays = camera_rays(pixel_grid(8, 10, torch.device("cpu"))[None], k).flatten(2)
    motion = torch.eye(4)[None].clone()
    motion[0, :3, :3] = axis_angle(torch.tensor([0.2, 1.0, 0.1], dtype=torch.float64), 0.15).float()
    motion[0, :3, 3] = torch.tensor(translation)
    inverse = torch.linspace(0.0, 1.0, 7).reshape(1, 1, 7).expand(1, 80, 7)
    return rays, inverse, source_k, motion


@pytest.mark.case("P7")
def test_warp_follows_a_point_through_both_lenses() -> None:
    rays, inverse, source_k, motion = warp_case([0.3, -0.1, 0.2])
    grid, inside = Warp.make(rays.unsqueeze(3), source_k, motion).positions(inverse)
    d = inverse.double().unsqueeze(-1)
    point = (motion[0, :3, :3].double() @ rays[0].double()).T[None, :, None] + motion[0, :3, 3].double() * d
    x = source_k[0, 0, 0].double() * point[..., 0] / point[..., 2] + source_k[0, 0, 2].double()
    y = source_k[0, 1, 1].double() * point[..., 1] / point[..., 2] + source_k[0, 1, 2].double()
    expected = torch.stack([x, y], -1) * 2 - 1
    near = (expected.abs() < 4).all(-1)
    # 1e-6 of the image half-width is 1e-4 px at 256 px
    torch.testing.assert_close(grid[near].double(), expected[near], atol=1e-6, rtol=0)
    assert torch.equal(inside, (expected.abs() < 1).all(-1))


def test_rays_and_depths_broadcast_either_way_round() -> None:
    rays, inverse, source_k, motion = warp_case([0.3, -0.1, 0.2])
    grid, inside = Warp.make(rays.unsqueeze(3), source_k, motion).positions(inverse)
    assert grid.shape == (1, 80, 7, 2)
    shared = inverse[:, :1]  # every ray has the same depths here
    for depths, turned in ((shared, False), (shared.transpose(1, 2), True), (inverse.transpose(1, 2), True)):
        other, within = Warp.make(rays.unsqueeze(2 if turned else 3), source_k, motion).positions(depths)
        assert torch.equal(other.transpose(1, 2) if turned else other, grid)
        assert torch.equal(within.transpose(1, 2) if turned else within, inside)


@pytest.mark.case("P4")
def test_points_behind_the_source_are_never_sampled() -> None:
    rays, inverse, source_k, motion = warp_case([0.0, 0.0, -3.0])
    grid, inside = Warp.make(rays.unsqueeze(3), source_k, motion).positions(inverse)
    behind = (motion[0, :3, :3] @ rays[0]).T[None, :, None, 2] + motion[0, 2, 3] * inverse <= 0
    assert behind.any()
    assert not inside[behind].any()
    assert (grid[behind] == 4).all()
    assert torch.isfinite(grid).all()
