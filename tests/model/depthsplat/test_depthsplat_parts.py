"""Parts of DepthSplat against brute force: windows, masks, neighbours, positions and the plane sweep."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F
from facing_cameras import facing_poses
from torch import Tensor

from gapmes.model.cost_volume import Views
from gapmes.model.depthsplat.config import PLAIN, Compatibility
from gapmes.model.depthsplat.neighbours import nearest_views, neighbour_rows
from gapmes.model.depthsplat.sweep import plane_sweep
from gapmes.model.depthsplat.transformer import (
    BLOCKED,
    from_windows,
    mask_for_views,
    shift_mask,
    to_windows,
    window_positions,
)
from gapmes.model.depthsplat.vit import POSITION_OFFSET
from gapmes.model.geometry import rigid_inverse
from gapmes.model.vit import resampled_positions


def cameras(batch: int, count: int, seed: int = 0) -> Tensor:
    """(B, V, 4, 4) poses that look along z, rotated a little."""
    generator = torch.Generator().manual_seed(seed)
    poses = torch.eye(4).repeat(batch, count, 1, 1)
    angle = 0.1 * torch.randn(batch, count, generator=generator)
    poses[..., 0, 0], poses[..., 0, 2] = angle.cos(), angle.sin()
    poses[..., 2, 0], poses[..., 2, 2] = -angle.sin(), angle.cos()
    poses[..., :3, 3] = 0.3 * torch.randn(batch, count, 3, generator=generator)
    return poses


def test_windows_are_undone_and_hold_neighbouring_cells() -> None:
    grid = torch.arange(2 * 8 * 12 * 3.0).reshape(2, 8, 12, 3)
    windows = to_windows(grid)
    assert windows.shape == (2, 4, 24, 3)
    assert torch.equal(windows[1, 3].reshape(4, 6, 3), grid[1, 4:, 6:])
    assert torch.equal(from_windows(windows, 8, 12), grid)


def test_the_mask_lets_only_cells_together_that_were_neighbours_before_the_shift() -> None:
    height, width = 8, 8
    index = torch.arange(height * width).reshape(1, height, width, 1)
    shifted = torch.roll(index, (-2, -2), dims=(1, 2))
    cells = to_windows(shifted)[0, :, :, 0]
    mask = shift_mask(height, width)
    rows, columns = cells // width, cells % width
    # a shifted window that wraps holds cells from both ends; those that did not wrap lie within one window's size
    together = (rows[:, :, None] - rows[:, None]).abs() < 4
    together &= (columns[:, :, None] - columns[:, None]).abs() < 4
    assert torch.equal(mask == 0, together)
    assert set(mask.unique().tolist()) == {0.0, BLOCKED}


def test_every_view_has_the_same_mask_unless_it_is_tiled_as_the_authors_do() -> None:
    mask = shift_mask(4, 4)
    cells = mask.shape[-1]
    right = mask_for_views(mask, 2, tiled=False)
    assert torch.equal(right[..., :cells], mask)
    assert torch.equal(right[..., cells:], mask)
    # theirs: keys list the views of a cell together, the mask its columns one view after the other
    theirs = mask.repeat(1, 1, 2).reshape(*mask.shape[:2], cells, 2).transpose(2, 3).flatten(2)
    assert torch.equal(mask_for_views(mask, 2, tiled=True), theirs)
    assert torch.equal(mask_for_views(mask, 1, tiled=True), mask)
    assert not torch.equal(right, theirs)


def test_positions_are_sines_of_a_full_turn_over_the_window() -> None:
    position = window_positions(8, 4, 6)
    y, x, period = 3, 2, 10_000 ** (2 / 4)
    angles = [(y + 1) / (4 + 1e-6) * 2 * math.pi, (x + 1) / (6 + 1e-6) * 2 * math.pi]
    expected = [f(a / p) for a in angles for p in (1, period) for f in (math.sin, math.cos)]
    torch.testing.assert_close(position[0, :, y, x], torch.tensor(expected), atol=1e-6, rtol=0)


@pytest.mark.parametrize("count", [2, 3, 4, 6])
@pytest.mark.parametrize("as_listed", [False, True])
def test_neighbours_are_the_nearest_others(count: int, as_listed: bool) -> None:
    poses = cameras(3, count, seed=count)
    found = nearest_views(poses, as_listed=as_listed)
    for b in range(3):
        for v in range(count):
            distance = (poses[b, :, :3, 3] - poses[b, v, :3, 3]).norm(dim=-1).tolist()
            others = sorted((i for i in range(count) if i != v), key=lambda i: distance[i])
            if as_listed and count <= 3:
                others.sort()
            assert found[b, v].tolist() == others[:2]


def test_cameras_in_one_place_are_neighbours_by_index_and_never_of_themselves() -> None:
    poses = torch.eye(4).repeat(1, 5, 1, 1)
    assert nearest_views(poses, as_listed=False)[0].tolist() == [[1, 2], [0, 2], [0, 1], [0, 1], [0, 1]]


def brute_force(
    features: Tensor,
    inverse: Tensor,
    views: Views,
    neighbours: Tensor,
    *,
    shift: float,
    own_k: bool,
    clamped: bool = False,
) -> Tensor:
    """Every cell, plane and neighbour in float64: unproject, project, sample by hand."""
    n, c, h, w = features.shape
    size = torch.tensor([w, h], dtype=torch.float64)
    out = torch.zeros(n, inverse.shape[1], h, w, dtype=torch.float64)
    k, poses = (x.reshape(n, *x.shape[2:]).double() for x in (views.intrinsics, views.world_from_cam))
    flat = features.double()
    for v in range(n):
        chosen = neighbour_rows(neighbours).reshape(n, -1)[v].tolist()
        for other in chosen:
            motion = rigid_inverse(poses[other]) @ poses[v]
            target = k[v] if own_k else k[other]
            for y in range(h):
                for x in range(w):
                    at = (torch.tensor([x, y], dtype=torch.float64) + shift) / size
                    ray = torch.linalg.inv(k[v]) @ torch.tensor([*at, 1.0], dtype=torch.float64)
                    for d in range(inverse.shape[1]):
                        z = 1 / inverse[v, d, y % inverse.shape[2], x % inverse.shape[3]].double()
                        p = target @ (motion[:3, :3] @ (ray * z) + motion[:3, 3])
                        if p[2] <= 0 and not clamped:
                            continue
                        column, row = (p[:2] / p[2].clamp(min=1e-3 if clamped else 0) * size - shift).tolist()
                        x0, y0 = math.floor(column), math.floor(row)
                        for dx in (0, 1):
                            for dy in (0, 1):
                                if 0 <= x0 + dx < w and 0 <= y0 + dy < h:
                                    weight = (1 - abs(column - x0 - dx)) * (1 - abs(row - y0 - dy))
                                    product = flat[v, :, y, x] @ flat[other, :, y0 + dy, x0 + dx]
                                    out[v, d, y, x] += weight * product / c**0.5 / len(chosen)
    return out


@pytest.mark.parametrize("per_cell", [False, True])
@pytest.mark.parametrize(
    "compatibility",
    [
        PLAIN,
        Compatibility(corner_pixels=True),
        Compatibility(reference_intrinsics=True),
        Compatibility(clamped_depths=True),  # nothing lies behind a camera
    ],
)
def test_the_sweep_is_the_mean_correlation_at_each_depth(per_cell: bool, compatibility: Compatibility) -> None:
    generator = torch.Generator().manual_seed(1)
    count, h, w, planes = 3, 4, 6, 3
    features = torch.randn(count, 5, h, w, generator=generator)
    intrinsics = torch.tensor([[0.9, 0, 0.5], [0, 1.1, 0.5], [0, 0, 1]]).repeat(1, count, 1, 1)
    intrinsics[0, 1, 0, 0] = 1.3  # another lens
    views = Views.make(intrinsics, cameras(1, count), torch.tensor([[1.0, 10.0]]))
    shape = (count, planes, h, w) if per_cell else (count, planes, 1, 1)
    inverse = 0.1 + 0.9 * torch.rand(shape, generator=generator)
    neighbours = nearest_views(views.world_from_cam, as_listed=False)
    found = plane_sweep(features, inverse, views, neighbours, compatibility)
    shift = 0.0 if compatibility.corner_pixels else 0.5
    expected = brute_force(features, inverse, views, neighbours, shift=shift, own_k=compatibility.reference_intrinsics)
    # float32 positions of up to 6 cells: measured 1.1e-6
    torch.testing.assert_close(found.double(), expected, atol=3e-6, rtol=0)
    assert float(expected.abs().max()) > 0.5


@pytest.mark.parametrize("switch", [None, "reference_intrinsics", "corner_pixels"])
@pytest.mark.parametrize("per_cell", [False, True])
@pytest.mark.parametrize(("depth", "ahead"), [(5.0, -2.0), (5.0, 0.0005), (100.0, 0.005)])
def test_what_lies_behind_the_other_camera_matches_nothing_unless_its_depth_is_clamped(
    depth: float, ahead: float, per_cell: bool, switch: str | None
) -> None:
    """Behind it, in front of it by less than the clamp, and by more but too little for the plain sweep to divide by."""
    count, h, w = 2, 4, 8  # whose cells' centres float32 holds exactly; all else is float64
    shift, own_k = 0.0 if switch == "corner_pixels" else 0.5, switch == "reference_intrinsics"
    one, other = (torch.tensor([[f, 0, 0.5], [0, 1.1, 0.45], [0, 0, 1]], dtype=torch.float64) for f in (0.9, 1.3))
    poses = facing_poses(one, one if own_k else other, ((2 + shift) / w, (1 + shift) / h), depth, ahead)
    views = Views.make(torch.stack([one, other])[None], poses, torch.tensor([[1.0, 200.0]], dtype=torch.float64))
    neighbours = nearest_views(poses, as_listed=False)
    features = torch.randn(count, 5, h, w, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    planes = torch.tensor([1 / depth, 0.7 / depth, 0.5], dtype=torch.float64).reshape(1, 3, 1, 1)
    inverse = planes.expand(count, -1, h, w) if per_cell else planes.expand(count, -1, -1, -1)
    plain = Compatibility(**{switch: True}) if switch else PLAIN
    found = plane_sweep(features, inverse, views, neighbours, replace(plain, clamped_depths=True))
    expected = brute_force(features, inverse, views, neighbours, shift=shift, own_k=own_k, clamped=True)
    # a depth of 0.001 magnifies the rounding of positions: measured 3e-12
    torch.testing.assert_close(found, expected, atol=1e-10, rtol=0)
    assert abs(float(found[0, 0, 1, 2])) > 0.1
    assert float(plane_sweep(features, inverse, views, neighbours, plain)[0, 0, 1, 2]) == 0


def test_a_table_of_positions_in_its_own_size_is_left_as_it_is() -> None:
    table = torch.randn(1, 1 + 9, 4)
    assert resampled_positions(table, 3, 3, POSITION_OFFSET) is table
    assert torch.equal(resampled_positions(table, 2, 5, POSITION_OFFSET)[:, :1], table[:, :1])
    assert resampled_positions(table, 2, 5, POSITION_OFFSET).shape == (1, 11, 4)


def test_resampled_positions_are_read_as_far_apart_as_the_offset_says() -> None:
    side, cells = 37, 18
    ramp = torch.arange(side, dtype=torch.float32).reshape(1, side, 1).expand(side, side, 1).reshape(1, -1, 1)
    table = torch.cat([torch.zeros(1, 1, 1), ramp], dim=1)
    found = resampled_positions(table, cells, cells, POSITION_OFFSET)[0, 1:, 0].reshape(cells, cells)[9]
    step = side / (cells + 0.1)
    expected = (torch.arange(cells) + 0.5) * step - 0.5
    inner = slice(2, -2)  # where the cubic does not reach over a border; it gives a straight line back up to 0.05
    torch.testing.assert_close(found[inner], expected[inner], atol=0.06, rtol=0)
    assert float((expected + 0.5 - (torch.arange(cells) + 0.5) * side / cells).abs()[inner].max()) > 0.15


def test_an_interpolated_embedding_is_bicubic() -> None:
    table = torch.randn(1, 1 + 16, 2)
    grid = table[:, 1:].reshape(1, 4, 4, 2).permute(0, 3, 1, 2)
    expected = F.interpolate(grid, scale_factor=(3.1 / 4, 5.1 / 4), mode="bicubic", align_corners=False)
    found = resampled_positions(table, 3, 5, POSITION_OFFSET)[:, 1:].reshape(1, 3, 5, 2).permute(0, 3, 1, 2)
    assert torch.equal(found, expected)
