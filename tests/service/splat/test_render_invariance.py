"""What must not change the image: threads, input order, batches, units, tile borders, the world's origin."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from splat_cases import bits, camera, compare, dots, moved, rotation, scene

from gapmes.service.cameras.camera import Camera
from gapmes.service.gaussians import Gaussians
from gapmes.service.splat import Definition, render
from gapmes.service.splat.binning import Grid, TileLists, count_range, fill_rows, tile_lists
from gapmes.service.splat.blend import blend, blend_tiles
from gapmes.service.splat.options import OUTPUTS
from gapmes.service.splat.order import depth_order, radix_pass, settle_equals
from gapmes.service.splat.prepare import Workspace, prepare_range, prepared
from gapmes.service.splat.project import project, project_range
from gapmes.service.splat.render import new_canvas


@pytest.mark.case("E9")
def test_threads_and_repeats_give_the_same_bits():
    gaussians, view = scene(3000, 3, 2), camera(130, 70, 90.0)
    first = bits(render(gaussians, view, threads=1))
    for threads in (1, 2, 3, 7):
        assert bits(render(gaussians, view, threads=threads)) == first


@pytest.mark.case("E16")
@settings(max_examples=25)
@given(seed=st.integers(0, 2**31), degree=st.integers(0, 3))
def test_a_permuted_input_gives_the_same_bits(seed, degree):
    gaussians = scene(60, seed, degree)
    order = np.random.default_rng(seed).permutation(60)
    assert bits(render(gaussians[order], camera())) == bits(render(gaussians, camera()))


@pytest.mark.case("E7")
@pytest.mark.parametrize("count", [1, 2, 100, 3000, 10_000])
def test_coplanar_gaussians_in_any_order_give_the_same_bits(count):
    """Ties are always broken by content; there is no mode in which the order of the input decides."""
    rng = np.random.default_rng(count)
    means = np.concatenate([rng.uniform(-1, 1, (count, 2)), np.full((count, 1), 2.0)], axis=1)
    wall = dots(means, rng.uniform(0.3, 1, count), rng.uniform(0, 1, (count, 3)), 0.08)
    # A second layer at the very same places: only colour and opacity are left to order by.
    twins = dots(means[: count // 2], rng.uniform(0.3, 1, count // 2), rng.uniform(0, 1, (count // 2, 3)), 0.08)
    both = Gaussians(*(np.concatenate([getattr(wall, f), getattr(twins, f)]) for f in Gaussians.__dataclass_fields__))
    first = bits(render(both, camera()))
    for _ in range(3):
        assert bits(render(both[rng.permutation(len(both))], camera())) == first
    duplicated = both[np.concatenate([np.arange(len(both)), np.arange(len(both))])]
    first = bits(render(duplicated, camera()))
    assert bits(render(duplicated[rng.permutation(len(duplicated))], camera())) == first


@pytest.mark.case("E7")
@pytest.mark.parametrize("field", ["scales", "rotations_wxyz", "opacities", "harmonics"])
def test_twins_that_differ_in_one_field_alone_are_ordered_by_it(field):
    """A hundred pairs in a place each, equal but for that field, in its last number where it has several."""
    rng = np.random.default_rng(2)
    means = np.concatenate([rng.uniform(-1, 1, (100, 2)), np.full((100, 1), 2.0)], axis=1)
    wall = Gaussians.make(
        means, [[0.1, 0.05, 0.02]] * 100, rng.standard_normal((100, 4)), [0.6] * 100, rng.uniform(-1, 1, (100, 4, 3))
    )
    values = getattr(wall, field).copy()
    last = values if values.ndim == 1 else values[..., -1] if values.ndim == 2 else values[:, -1, -1]
    last += rng.choice([-0.3, 0.3], 100).astype(np.float32)
    other = moved(wall, **{field: values})
    both = Gaussians(*(np.concatenate([getattr(wall, f), getattr(other, f)]) for f in Gaussians.__dataclass_fields__))
    first = bits(render(both, camera()))
    assert first != bits(render(wall, camera()))
    for _ in range(5):
        assert bits(render(both[rng.permutation(200)], camera())) == first


def projected(gaussians, view):
    return project(prepared(gaussians, 1), view, Definition(), 0, 1, Workspace.of(len(gaussians)))


@pytest.mark.case("E10")
@pytest.mark.parametrize("max_entries", [1, 7, 100, 300])
def test_batches_give_the_same_bits_and_bound_the_lists(max_entries):
    gaussians, view = scene(200, 4), camera(70, 50)
    whole = render(gaussians, view)
    split = render(gaussians, view, definition=Definition(max_entries=max_entries), threads=2)
    assert bits(split) == bits(whole)
    assert split.stats["entries"] == whole.stats["entries"]
    assert split.stats["batches"] >= whole.stats["entries"] // max(max_entries, split.stats["tiles"])
    projection = projected(gaussians, view)
    order = depth_order(projection.space.depths, projection.drawn, gaussians)
    grid = Grid(view.width, view.height)
    for lists in tile_lists(projection, order, grid, max_entries, 1):
        assert len(lists.members) <= max(max_entries, grid.tiles)


def drawn_by(lists, projection, grid):
    """The planes of one batch, as bytes."""
    view = camera(grid.width, grid.height)
    canvas = new_canvas(view, OUTPUTS, len(projection.space.records), 0, np.zeros(3, np.float32))
    blend(lists, projection.space.records, canvas, grid, Definition(), 1, first_batch=True)
    planes = (canvas.rgb, canvas.alpha, canvas.depth, canvas.median, canvas.peaks)
    return [plane.tobytes() for plane in planes]


@pytest.mark.case("E15", "S2")
def test_tile_lists_leave_nothing_out():
    """Every Gaussian in every tile gives the same bits, so the lists are exact skips."""
    for seed, scales in ((1, (0.02, 0.3)), (2, (1e-9, 3.0)), (3, (1e-4, 1e3))):
        gaussians, view = scene(200, seed, 0, scales), camera(70, 50)
        grid, rule = Grid(view.width, view.height), Definition()
        projection = projected(gaussians, view)
        order = depth_order(projection.space.depths, projection.drawn, gaussians)
        (lists,) = tile_lists(projection, order, grid, rule.max_entries, 1)
        everything = TileLists(np.arange(grid.tiles + 1) * len(order), np.tile(order, grid.tiles), True)
        assert drawn_by(lists, projection, grid) == drawn_by(everything, projection, grid)
        assert len(lists.members) < len(everything.members)


@pytest.mark.case("E9")
@pytest.mark.parametrize(("left", "top"), [(5, 0), (0, 9), (7, 3), (16, 16)])
def test_tile_borders_do_not_show(left, top):
    """A window of the image, cut at another place than the tiles; float32 starts from other corners.

    The splatter has one size of tiles, so that moving their borders stands for changing it.
    """
    gaussians, view = scene(200, 6), camera(80, 64)
    # The projection is clamped relative to the image border, so only centres well inside compare.
    x, y = view.project(gaussians.means)[0].T
    gaussians = gaussians[(x > 20) & (x < 60) & (y > 20) & (y < 50)]
    window = render(gaussians, view.cropped(left, top, 80 - left, 64 - top))
    whole = render(gaussians, view)
    difference = np.abs(window.rgb - whole.rgb[top:, left:]).max(axis=2)
    assert np.quantile(difference, 0.999) < 2e-6
    assert difference.max() < 2 / 255


@pytest.mark.case("E18")
@pytest.mark.parametrize("power", [-20, -3, 5, 20])
def test_units_of_a_power_of_two_give_the_same_bits(power):
    unit = 2.0**power
    gaussians, view = scene(200, 7, 1), camera()
    other = moved(gaussians, means=gaussians.means * unit, scales=gaussians.scales * np.float32(unit))
    ours, scaled = render(gaussians, view, near=0.01), render(other, view, near=0.01 * unit)
    assert ours.rgb.tobytes() == scaled.rgb.tobytes()
    assert ours.alpha.tobytes() == scaled.alpha.tobytes()
    assert (ours.depth * np.float32(unit)).tobytes() == scaled.depth.tobytes()


@pytest.mark.case("E18")
def test_any_unit_gives_the_same_image_up_to_jumps():
    gaussians, view = scene(200, 7, 1), camera()
    for unit in (1e-6, 1e6):
        other = moved(gaussians, means=gaussians.means * unit, scales=gaussians.scales * np.float32(unit))
        difference = np.abs(render(other, view, near=0.01 * unit).rgb - render(gaussians, view).rgb).max(axis=2)
        assert np.quantile(difference, 0.99) < 1e-5
        assert difference.max() < 1e-3  # jumps


@pytest.mark.case("E19")
@pytest.mark.parametrize("offset", [1e3, 1e6, 1e7])
def test_a_far_off_world_costs_nothing(offset):
    """Positions are float64 and taken relative to the camera: at 1e6 they are exact to 1e-10, at 1e7 to 2e-9."""
    gaussians, view = scene(200, 9, 1), camera()
    shift = offset * np.array([1.0, -0.7, 0.4])
    pose = view.world_from_cam.copy()
    pose[:3, 3] += shift
    far = render(moved(gaussians, means=gaussians.means + shift), view.posed(pose))
    difference = np.abs(far.rgb - render(gaussians, view).rgb).max(axis=2)
    assert np.quantile(difference, 0.99) < 1e-5
    assert difference.max() < 2 / 255


@pytest.mark.case("E17")
def test_a_rigid_motion_of_the_world_gives_the_same_image_up_to_jumps():
    rng = np.random.default_rng(10)
    gaussians, view = scene(200, 10), camera()
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = rotation(rng), rng.standard_normal(3)
    w = 0.5 * np.sqrt(1.0 + np.trace(motion[:3, :3]))
    r = motion[:3, :3]
    v = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]) / (4 * w)
    qw, qv = gaussians.rotations_wxyz[:, :1].astype(float), gaussians.rotations_wxyz[:, 1:].astype(float)
    rotated = np.concatenate([w * qw - qv @ v[:, None], w * qv + qw * v + np.cross(v, qv)], axis=1)
    other = moved(gaussians, means=gaussians.means @ r.T + motion[:3, 3], rotations_wxyz=rotated.astype(np.float32))
    difference = np.abs(render(other, view.posed(motion @ view.world_from_cam)).rgb - render(gaussians, view).rgb).max(
        axis=2
    )
    assert np.quantile(difference, 0.99) < 1e-5
    assert -10 * np.log10((difference**2).mean()) > 85
    assert difference.max() < 2 / 255


def test_strided_and_read_only_arrays_are_drawn_alike_by_the_same_kernels():
    gaussians = scene(100, 11, 2)
    frozen = replace(gaussians)
    for field in Gaussians.__dataclass_fields__:
        getattr(frozen, field).flags.writeable = False
    assert bits(render(frozen[::2], camera())) == bits(render(frozen[np.arange(0, 100, 2)], camera()))
    for kernel in (prepare_range, project_range, radix_pass, settle_equals, count_range, fill_rows):
        assert len(kernel.signatures) == 1  # nothing is compiled while a request waits
    assert len(blend_tiles.signatures) <= 6  # one for each choice of planes and stopping rule


@pytest.mark.case("E14")
def test_a_lens_of_unequal_focal_lengths_and_a_far_principal_point():
    gaussians = scene(150, 12, 1)
    for fx, fy, cx, cy in ((4.0, 4000.0, 20.0, 20.0), (45.0, 30.0, -40.0, 60.0), (60.0, 50.0, 80.0, -36.0)):
        result = compare(gaussians, Camera(40, 36, fx, fy, cx, cy, np.eye(4)))  # beyond what `Camera.make` takes
        assert result.smooth < 2e-6
