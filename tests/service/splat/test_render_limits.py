"""Extreme and empty input: a finite image or a refusal by name, and everything left out is counted."""

import sys
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba.core.errors import TypingError
from splat_cases import bits, camera, compare, dots, moved, scene

from gapmes.service.cameras.camera import Camera
from gapmes.service.errors import GaussiansError, InputError
from gapmes.service.gaussians import Gaussians
from gapmes.service.splat import Definition, render, render_reference
from gapmes.service.splat.spans import MAX_SIDE
from gapmes.service.splat.tile_state import bytes_of


def assert_finite(image) -> None:
    assert np.isfinite(image.rgb).all()
    assert np.isfinite(image.depth).all()
    assert (image.rgb >= 0).all()
    assert ((image.alpha >= 0) & (image.alpha <= 1)).all()


@pytest.mark.case("E11")
@pytest.mark.parametrize(("width", "height"), [(1, 1), (1, 37), (37, 1), (17, 33), (15, 16), (4096, 16)])
def test_no_gaussians_is_exactly_the_background(width, height):
    view = Camera.make(width, height, width, height, width / 2, height / 2, np.eye(4))
    image = render(scene(0), view, background=(0.25, 0.5, 1.0))
    assert image.rgb.shape == (height, width, 3)
    assert (image.rgb == np.float32([0.25, 0.5, 1.0])).all()
    assert (image.alpha == 0).all()
    assert (image.depth == 0).all()
    assert image.stats["projected"] == image.stats["entries"] == 0


@pytest.mark.case("E11")
@pytest.mark.parametrize(("width", "height"), [(1, 1), (1, 37), (37, 1), (17, 33), (15, 16), (49, 31)])
def test_odd_sizes_match_the_reference(width, height):
    assert compare(scene(80, 1), camera(width, height, max(width, height) / 2)).smooth < 2e-6


@pytest.mark.case("E4")
@pytest.mark.parametrize("near", [1e-8, 1e-3, 0.2, 1.0])
def test_the_near_plane_is_strict(near):
    depths = [near, near * (1 - 1e-7), near * (1 + 1e-7), 0.0, -0.0, 5e-324, -1e30, 1e30, -near]
    means = np.stack([np.zeros(len(depths)), np.zeros(len(depths)), depths], axis=1)
    image = render(dots(means, np.full(len(depths), 0.5), (1, 1, 1), 1e-12), camera(9, 9, 9.0), near=near)
    assert image.stats["projected"] == 2
    assert image.stats["culled"]["near"] == len(depths) - 2
    assert_finite(image)
    assert image.alpha[4, 4] == pytest.approx(0.75, abs=1e-6)


@pytest.mark.case("E4")
def test_gaussians_that_reach_behind_the_near_plane_are_counted():
    """Three standard deviations along the camera's axis, here of a needle that is turned towards it by 60 degrees."""
    near, size, turn = 0.01, 0.3, np.pi / 3
    reach = 3 * size * np.sin(turn)
    means = [[0, 0, near + share * reach] for share in (0.5, 0.999, 1.001, 2.0)]
    needles = Gaussians.make(
        means, [[size, 0, 0]] * 4, [[np.cos(turn / 2), 0, -np.sin(turn / 2), 0]] * 4, [0.5] * 4, np.zeros((4, 1, 3))
    )
    assert render(needles, camera(), near=near).stats["crossing_near"] == 2


@pytest.mark.case("E12")
def test_every_gaussian_is_drawn_or_counted_with_its_reason():
    means = [[0, 0, 2], [0, 0, -2], [0, 0, 1e38], [0, 0, 2], [0, 0, 2], [50, 0, 2]]
    gaussians = dots(means, [0.5, 0.5, 0.5, 0.003, 0.5, 0.5], (1, 1, 1), 0.01)
    gaussians.scales[4] = np.nan
    stats = render(gaussians, camera()).stats
    assert stats["culled"] == {"near": 1, "far": 1, "faint": 1, "not_finite": 1, "outside": 1}
    assert stats["projected"] == 1
    assert stats["count"] == 6


@pytest.mark.case("E12")
@pytest.mark.parametrize("field", ["means", "scales", "rotations_wxyz", "opacities", "harmonics"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_bad_number_is_refused_at_the_border_and_harmless_behind_it(field, value):
    """There is no option to drop such rows: a set with one is refused, and the count says how many there are."""
    good = scene(50, 2)
    arrays = {name: getattr(good, name).copy() for name in Gaussians.__dataclass_fields__}
    arrays[field].reshape(50, -1)[31, 0] = value
    with pytest.raises(GaussiansError, match="first at index 31") as refusal:
        Gaussians.make(**arrays)
    assert (refusal.value.field, refusal.value.index, refusal.value.extra["count"]) == (field, 31, 1)
    with np.errstate(all="ignore"):
        assert_finite(render(Gaussians(**arrays), camera()))


@pytest.mark.case("E12")
@pytest.mark.parametrize(
    ("field", "value", "need"),
    [
        ("scales", -1e-45, "at least 0"),
        ("opacities", -1e-45, r"in \[0, 1\]"),
        ("opacities", 1.0000001, r"in \[0, 1\]"),
        ("scales", 1e39, "a finite number within float32"),
        ("harmonics", -1e300, "a finite number within float32"),
    ],
)
def test_a_number_out_of_range_is_refused_at_the_border(field, value, need):
    arrays = {name: getattr(scene(50, 2), name).astype(float) for name in Gaussians.__dataclass_fields__}
    for row in (31, 40):
        arrays[field].reshape(50, -1)[row, -1] = value
    with pytest.raises(
        GaussiansError, match=f"2 of 50 rows are outside the range, first at index 31: .*need {need}"
    ) as refusal:
        Gaussians.make(**arrays)
    assert (refusal.value.field, refusal.value.index, refusal.value.extra["count"]) == (field, 31, 2)


number = st.one_of(
    st.floats(-(2.0**126), 2.0**126, width=32),
    st.floats(-3, 3, width=32),
    st.sampled_from([0.0, -0.0, 1e-45, 3.4e38, -3.4e38]),
)


@pytest.mark.case("E4", "E12")
@settings(max_examples=60)
@given(st.lists(st.tuples(*[number] * 14), min_size=1, max_size=6), st.sampled_from([0.0, 1e-8, 0.01]))
def test_any_finite_numbers_give_a_finite_image(rows, near):
    table = np.array(rows, np.float32)
    gaussians = Gaussians.make(
        table[:, :3],
        np.abs(table[:, 3:6]),
        table[:, 6:10],
        np.abs(np.clip(table[:, 10], -1, 1)),
        table[:, None, 11:14],
    )
    image = render(gaussians, camera(20, 18, 19.0), near=near)
    assert_finite(image)
    stats = image.stats
    assert stats["projected"] + sum(stats["culled"].values()) == len(rows)


@pytest.mark.case("E13")
def test_a_colour_equal_to_the_background_is_invisible():
    """Weights and transmittance sum to 1; measured 3e-7."""
    gaussians = scene(400, 3)
    gaussians = moved(gaussians, harmonics=np.full((400, 1, 3), (0.7 - 0.5) / 0.28209479177387814, np.float32))
    assert np.abs(render(gaussians, camera(), background=(0.7, 0.7, 0.7)).rgb - 0.7).max() < 1e-6


@pytest.mark.case("E6")
def test_opacity_zero_draws_nothing():
    image = render(dots([[0, 0, 2]], [0.0], (1, 1, 1)), camera())
    assert (image.alpha == 0).all()
    assert image.stats["culled"]["faint"] == 1


@pytest.mark.case("E1")
@pytest.mark.parametrize("length", [1e19, 1e36, 1e37, 3e38])
def test_a_needle_as_long_as_float32_holds_is_drawn_whole(length):
    """It is a line from 1e15 px on: steps along it that are denormal leave out no block."""
    view = camera(40, 40, 40.0)
    for turn in ([0.9, 0.1, 0.2, 0.3], [0.9, -0.1, 0.2, 2.0], [1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 1.0]):
        for x in (0.0, 0.1, -0.31):
            needles = [
                Gaussians.make([[x, 0.2, 1.0]], [[size, 1e-38, 0.0]], [turn], [0.9], np.zeros((1, 1, 3)))
                for size in (1e17, length)
            ]
            line, image = (render(needle, view).alpha for needle in needles)
            assert (line > 0).sum() >= 40
            assert np.abs(image - line).max() < 1e-6


@pytest.mark.case("E10")
def test_huge_gaussians_in_bounded_batches():
    """20,000 faint sheets over 64 tiles are 1.28 million entries, 5 MB; 8,192 at a time hold 128 sheets each."""
    rng = np.random.default_rng(5)
    count = 20_000
    means = np.stack([*rng.uniform(-1, 1, (2, count)), rng.uniform(1, 5, count)], axis=1)
    sheets = dots(means, np.full(count, 0.01), rng.uniform(0, 1, (count, 3)), 1e3)
    view = camera(256, 256, 200.0)
    whole, split = Definition(), Definition(max_entries=8192)
    image = render(sheets, view, definition=split)
    assert bits(image) == bits(render(sheets, view, definition=whole))
    assert render(sheets, view, definition=whole).stats["entries"] == 64 * count
    # 0.99^917 falls below the stop: the eighth batch ends every pixel, and what lies behind is never binned.
    assert image.stats["batches"] == 8
    assert image.stats["entries"] == 8 * 8192
    peaks = []
    for rule in (whole, split):
        tracemalloc.start()
        render(sheets, view, definition=rule)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    # Lists of 5.1 MB against 33 kB; the batches need 64 tile states of 20 kB, and 16 bytes per sheet to be planned.
    assert peaks[0] - peaks[1] > 2.5e6


@pytest.mark.case("S2")
def test_lower_bands_are_drawn_alone():
    gaussians = scene(100, 6, 3)
    flat = moved(gaussians, harmonics=np.ascontiguousarray(gaussians.harmonics[:, :4]))
    assert bits(render(gaussians, camera(), sh_degree=1)) == bits(render(flat, camera()))
    assert bits(render(flat, camera(), sh_degree=3)) == bits(render(flat, camera()))
    assert (
        np.abs(
            render_reference(gaussians, camera(), sh_degree=0).rgb - render(flat[:], camera(), sh_degree=0).rgb
        ).max()
        < 1e-5
    )


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"background": (1, 2)}, "background"),
        ({"background": (0, 0, np.nan)}, "background"),
        ({"sh_degree": 4}, "sh_degree"),
        ({"sh_degree": -1}, "sh_degree"),
        ({"threads": 0}, "threads"),
        ({"near": -1.0}, "near"),
        ({"near": np.nan}, "near"),
        ({"background": "red"}, "background"),
        ({"background": [[1, 2], [3]]}, "background"),
        ({"threads": 1.5}, "threads"),
    ],
)
def test_senseless_options_are_refused_by_name(options, field):
    with pytest.raises(InputError) as refusal:
        render(scene(3), camera(), **options)
    assert refusal.value.field == field


@pytest.mark.parametrize("field", ["dilation", "alpha_min", "alpha_max", "stop", "far", "fov_margin", "max_entries"])
def test_a_definition_outside_its_range_is_refused(field):
    with pytest.raises(InputError, match="need"):
        Definition(**{field: -1})


def test_eight_bit_image_rounds_and_clips():
    image = render(dots([[0, 0, 2]], [0.99], (2.0, 0.5, 0.0), 1.0), camera(3, 3, 3.0))
    assert image.rgb8()[1, 1].tolist() == [255, round(0.495 * 255), 0]


def test_a_view_of_far_off_centre_lens_is_a_camera():
    view = Camera.make(16, 16, 20.0, 20.0, -16.0, 32.0, np.eye(4))
    assert_finite(render(scene(50, 1), view))


def test_a_side_whose_tiles_cannot_be_numbered_is_refused():
    gaussians = dots([[0.9, 0.0, 2.0]], [0.9], (1, 1, 1))
    largest = Camera(MAX_SIDE, 1, 1000.0, 1000.0, 0.0, 0.5, np.eye(4))
    assert render(gaussians, largest).alpha[0, 450] > 0.5
    with pytest.raises(InputError, match=f"at most {MAX_SIDE} per side"):
        render(gaussians, Camera(MAX_SIDE + 1, 1, 1000.0, 1000.0, 0.0, 0.5, np.eye(4)))


@pytest.mark.parametrize(("module", "step"), [("sight", "project"), ("render", "new_canvas")])
def test_a_picture_that_memory_has_no_room_for_is_refused_by_its_size(monkeypatch, module, step):
    """Whatever does not fit, its planes or the counts of its tiles."""

    def full(*_):
        raise MemoryError

    monkeypatch.setattr(sys.modules[f"gapmes.service.splat.{module}"], step, full)
    with pytest.raises(InputError, match="48 x 40 px do not fit into the memory that is free") as caught:
        render(scene(10), camera(48, 40, 30.0))
    assert caught.value.field == "camera.size"


def test_a_background_in_any_layout_is_the_same_background():
    gaussians, view = scene(20, 1), camera()
    expected = bits(render(gaussians, view, background=(0.5, 0.25, 0.75)))
    for behind in (
        np.array([0.75, 0.25, 0.5])[::-1],
        np.array([0.5, 9, 0.25, 9, 0.75, 9], np.float32)[::2],
        np.frombuffer(np.array([0.5, 0.25, 0.75], np.float32).tobytes(), np.float32),  # read-only
    ):
        assert bits(render(gaussians, view, background=behind)) == expected


def test_kernels_take_no_strided_array():
    with pytest.raises(TypingError, match="need C order"):
        bytes_of(np.zeros(6, np.float32)[::2], np.zeros(3, np.uint8))
