"""The adapter: Gaussians project to their pixels, and harmonics and rotations rotate with the camera."""

from __future__ import annotations

import pytest
import torch
from small_networks import random_rotation, scene, tiny

from gapmes.model.adapter import footprint, place
from gapmes.model.geometry import matrix_to_quaternion, pixel_grid, quaternion_to_matrix, rigid_inverse
from gapmes.model.harmonics import evaluate, rotate_bands
from gapmes.model.heads import unit_quaternions
from gapmes.service.harmonics import evaluate_basis


def project(points: torch.Tensor, k: torch.Tensor, pose: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Normalised image positions (N, 2) and depth (N,) in float64."""
    camera = rigid_inverse(pose.double()) @ torch.cat([points.double(), torch.ones(len(points), 1)], 1).T
    image = k.double() @ camera[:3]
    return (image[:2] / image[2]).T, camera[2]


@pytest.mark.case("P9")
def test_placed_points_project_to_their_pixels() -> None:
    _, k, poses, _ = scene(1, 3)
    grid = pixel_grid(20, 30, torch.device("cpu"))
    depth = torch.rand(3, 1, 20, 30, generator=torch.Generator().manual_seed(0)) * 9 + 1
    points = place(grid.expand(3, -1, -1, -1), depth, k[0], poses[0])
    for v in range(3):
        back, z = project(points[v], k[0, v], poses[0, v])
        # 1e-6 of the image is 3e-4 px at 256 px; z in units of 10
        torch.testing.assert_close(back, grid.flatten(1).T.double(), atol=1e-6, rtol=0)
        torch.testing.assert_close(z, depth[v].flatten().double(), atol=1e-5, rtol=0)


def test_every_gaussian_of_the_network_lands_within_a_pixel_of_its_own() -> None:
    images, k, poses, near_far = scene(1, 2, 64)
    with torch.no_grad():
        prediction = tiny(backing=False)(images, k, poses, near_far)
    means = prediction.gaussians.means[0].reshape(2, -1, 3)
    centres = pixel_grid(64, 64, torch.device("cpu")).flatten(1).T.double()
    for v in range(2):
        back, z = project(means[v], k[0, v], poses[0, v])
        offset = (back - centres) * 64 - prediction.heads.offset[v].flatten(1).T.double()
        assert float(offset.abs().max()) < 1e-3  # px
        assert float(prediction.heads.offset.abs().max()) <= 1
        torch.testing.assert_close(z, prediction.depth[0, v].flatten().double(), atol=1e-5, rtol=1e-5)


def test_footprint_is_the_side_of_a_pixel() -> None:
    k = torch.tensor([[[0.5, 0, 0.5], [0, 0.5, 0.5], [0, 0, 1]]])
    assert float(footprint(torch.full((1, 1, 1, 1), 8.0), k, 64, 64)) == pytest.approx(8.0 / 32)


@pytest.mark.case("A3")
@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("angle", [1e-6, 0.3, 3.141592])
def test_rotated_harmonics_evaluate_like_the_unrotated_ones_at_turned_directions(degree: int, angle: float) -> None:
    generator = torch.Generator().manual_seed(degree)
    axis = torch.nn.functional.normalize(torch.randn(3, generator=generator, dtype=torch.float64), dim=0)
    x, y, z = axis.tolist()
    skew = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
    rotation = torch.matrix_exp(skew * angle)
    coefficients = torch.randn(1, 5, (degree + 1) ** 2, 3, generator=generator, dtype=torch.float64)
    turned = torch.cat([coefficients[:, :, :1], rotate_bands(coefficients[:, :, 1:], rotation[None])], dim=2)
    directions = torch.nn.functional.normalize(torch.randn(40, 3, generator=generator, dtype=torch.float64), dim=-1)
    for d in directions:
        torch.testing.assert_close(
            evaluate(turned[0], (rotation @ d).expand(5, 3)),
            evaluate(coefficients[0], d.expand(5, 3)),
            atol=1e-12,
            rtol=0,
        )


def test_torch_and_numpy_bases_agree() -> None:
    directions = torch.nn.functional.normalize(
        torch.randn(50, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64), dim=-1
    )
    for index in range(16):
        coefficients = torch.zeros(50, 16, 3, dtype=torch.float64)
        coefficients[:, index] = 1
        ours = evaluate(coefficients, directions)[:, 0] - 0.5
        torch.testing.assert_close(ours, torch.from_numpy(evaluate_basis(directions.numpy(), 3)[:, index]))


def test_moving_all_cameras_rigidly_moves_the_scene_with_them() -> None:
    images, k, poses, near_far = scene(1, 3, 64)
    network = tiny(sh_degree=2)
    generator = torch.Generator().manual_seed(3)
    motion = torch.eye(4, dtype=torch.float64)
    motion[:3, :3] = random_rotation(generator)
    motion[:3, 3] = torch.tensor([0.4, -0.7, 1.1])
    moved_poses = (motion @ poses.double()).float()
    with torch.no_grad():
        still = network(images, k, poses, near_far).gaussians
        moved = network(images, k, moved_poses, near_far).gaussians
    expected = still.means[0].double() @ motion[:3, :3].T + motion[:3, 3]
    error = (moved.means[0].double() - expected).norm(dim=-1)
    # poses are rounded to float32 after moving, 1e-7 of a baseline of 0.15, which matching turns into depth
    assert float(error.median()) < 1e-4
    assert float((error < 2e-2).double().mean()) > 0.999
    rotated = motion[:3, :3] @ quaternion_to_matrix(still.rotations_wxyz[0].double())
    found = quaternion_to_matrix(moved.rotations_wxyz[0].double())
    assert float((rotated - found).abs().flatten(1).amax(1).median()) < 1e-4
    turned = rotate_bands(still.harmonics[:, :, 1:].double(), motion[None, :3, :3])
    assert float((turned - moved.harmonics[:, :, 1:]).abs().median()) < 1e-5
    torch.testing.assert_close(moved.scales.median(), still.scales.median(), rtol=1e-3, atol=0)


def test_camera_rotation_as_quaternion_matches_the_matrix() -> None:
    generator = torch.Generator().manual_seed(4)
    rotations = torch.stack([random_rotation(generator) for _ in range(50)]).float()
    torch.testing.assert_close(quaternion_to_matrix(matrix_to_quaternion(rotations)), rotations, atol=1e-6, rtol=0)


@pytest.mark.case("A1")
@pytest.mark.parametrize("size", [0.0, 1e-45, 1e-30, 1e-6, 1.0, 1e19, 3e38])
def test_head_quaternions_are_units_whatever_their_length(size: float) -> None:
    identity = torch.tensor([1.0, 0, 0, 0]).reshape(1, 4, 1, 1)
    raw = torch.tensor([0.5, -1.0, 0.25, 0.75]).reshape(1, 4, 1, 1) * size
    unit = unit_quaternions(raw, identity)
    torch.testing.assert_close(unit.norm(dim=1), torch.ones(1, 1, 1), atol=2e-6, rtol=0)
    if not raw.any():  # also the smallest denormal, which the processor may flush
        assert torch.equal(unit, identity)
