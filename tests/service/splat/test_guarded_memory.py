"""Kernels write without bounds checks: the guards around their outputs must stay unchanged."""

import numpy as np
import pytest
from guarded import PATTERN, Guarded
from splat_cases import bits, camera, compare, dots, scene

from gapmes.service.cameras.camera import Camera
from gapmes.service.splat import Definition, render
from gapmes.service.splat.access import BLOCK
from gapmes.service.splat.binning import Grid, tile_lists
from gapmes.service.splat.blend import Canvas, blend
from gapmes.service.splat.leverage import fill_tiles, leverage_tiles
from gapmes.service.splat.leverage_lanes import CHANNELS, SUMS
from gapmes.service.splat.leverage_parts import add_part, list_reaching
from gapmes.service.splat.options import OUTPUTS
from gapmes.service.splat.order import depth_order
from gapmes.service.splat.prepare import DEPTH, EXTENT, RECORD, Workspace, prepared
from gapmes.service.splat.project import project
from gapmes.service.splat.tile_state import tile_floats
from gapmes.service.splat.vectors import ALL_CHANNELS


@pytest.mark.case("E11")
@pytest.mark.parametrize("count", [1, BLOCK - 1, BLOCK, BLOCK + 1, 700])
@pytest.mark.parametrize(("width", "height"), [(1, 1), (1, 37), (37, 1), (17, 33), (64, 64), (4096, 16)])
@pytest.mark.parametrize("max_entries", [1 << 24, 40])
def test_nothing_is_written_beside_the_arrays(count, width, height, max_entries):
    gaussians, view = (
        scene(count, 3, 1, (1e-3, 3.0)),
        Camera(width, height, 45.0, 45.0, width / 2, height / 2, np.eye(4)),
    )
    rule, grid, guarded = Definition(max_entries=max_entries), Grid(width, height), Guarded()
    space = Workspace(
        guarded.array((count, RECORD), np.float64),
        guarded.array((count, EXTENT), np.float64),
        guarded.array((count,), np.uint64),
        guarded.array((count,), np.float64),
        guarded.array((count,), np.int32),
    )
    shape = (height, width)
    planes = [guarded.array(shape, np.float32) for _ in range(4)]
    rgb, peaks = guarded.array((*shape, 3), np.float32), guarded.array((count,), np.float32)
    state = guarded.array((grid.tiles, tile_floats(ALL_CHANNELS)), np.float32)
    canvas = Canvas(rgb, *planes, peaks, state, np.zeros(3, np.float32))
    walked = guarded.array((grid.tiles, tile_floats(CHANNELS)), np.float32)
    members, found = guarded.array((count,), np.int32), guarded.array((count, SUMS), np.float32)
    sums = [guarded.array((count, *more), np.float64) for more in ((), (), (), (3,))]
    cuts = np.array([rule.alpha_max, rule.stop], np.float32)
    subset = np.arange(count) % 2 == 0
    for threads in (1, 2):
        for array in (rgb, *planes, space.records, space.extents, space.depths):
            array.view(np.uint8)[...] = PATTERN
        walked[:] = 0.0
        fill_tiles(np.ones((*shape, 3), np.float32), rgb, np.ones(shape, np.float32), grid.columns, walked)
        peaks[:] = 0.0
        projection = project(prepared(gaussians, threads), view, rule, 1, threads, space)
        order = depth_order(space.depths, projection.drawn, gaussians)
        reaching = list_reaching(projection.drawn, space.boxes, grid.columns, 0, grid.tiles, members, found)
        assert reaching == len(projection.drawn)  # the one part is the whole picture
        marked = projection.drawn[subset[projection.drawn]]
        space.records.view(np.float32)[marked, DEPTH] *= -1
        for number, lists in enumerate(tile_lists(projection, order, grid, max_entries, threads)):
            blend(lists, space.records, canvas, grid, rule, threads, first_batch=number == 0)
            given = lists.offsets, lists.members, space.records, space.records.view(np.float32)
            leverage_tiles(0, grid.tiles, grid.columns, *given, walked, cuts, found)
        add_part(members[:reaching], found, np.ones(count, np.float32), *sums)
        guarded.check()
        # and every pixel was written: the pattern is -2.9e-16 as a float, which no plane holds
        expected = render(gaussians, view, outputs=OUTPUTS, subset=subset)
        names = ("rgb", "alpha", "depth", "median", "removed", "peaks")
        for name, array in zip(names, (rgb, *planes, peaks), strict=True):
            assert array.tobytes() == getattr(expected, name).tobytes(), name


@pytest.mark.case("E11")
def test_a_very_wide_picture_matches_the_reference():
    view = Camera(4096, 16, 900.0, 900.0, 2048.0, 8.0, np.eye(4))
    result = compare(scene(60, 4, 0, (0.02, 1.0)), view)
    assert result.smooth < 2e-6


@pytest.mark.case("E9")
def test_ten_repeats_give_the_same_bits():
    gaussians, view = scene(500, 5, 2), camera(120, 90)
    assert len({bits(render(gaussians, view, threads=1 + number % 3)) for number in range(10)}) == 1


@pytest.mark.case("E12")
def test_minus_zero_is_zero():
    """In every field: positions, scales, rotations, an opacity and all harmonics."""
    means = np.array([[0.0, 0.0, 2.0], [0.1, 0.0, 2.5], [0.0, 0.1, 3.0]])
    plain = dots(means, [0.5, 0.0, 0.7], (0.5, 0.5, 0.5))
    turned = dots(np.where(means == 0, -0.0, means), [0.5, -0.0, 0.7], (0.5, 0.5, 0.5), -0.0)
    turned.rotations_wxyz[:, 1:] = -0.0
    turned.harmonics[:] = -0.0
    assert np.signbit(turned.scales).all()
    assert (render(plain, camera()).alpha > 0.4).any()
    assert bits(render(turned, camera())) == bits(render(plain, camera()))
