"""Our .ply is read back unchanged, whatever the numbers, and has what viewers expect."""

import io
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ply_cases import assert_same, columns, gaussians

from gapmes.service.cameras.camera import Camera
from gapmes.service.errors import PlyError
from gapmes.service.formats.ply import ply_bytes, read_ply, write_ply
from gapmes.service.formats.ply_write import as_stored, ply_size, stored_positions
from gapmes.service.gaussians import Gaussians
from gapmes.service.splat import render

VIEW = Camera.make(64, 48, 60.0, 60.0, 32.0, 24.0, np.eye(4))


@pytest.mark.case("I1")
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("count", [0, 1, 200])
def test_round_trip(count, degree):
    """Means and harmonics to the bit; opacity 1e-7, scale 5e-7 relative, rotation one unit in the last place."""
    before = gaussians(count, 1, degree)
    after = read_ply(ply_bytes(before))
    assert after.means.tobytes() == before.means.tobytes()
    assert after.harmonics.tobytes() == before.harmonics.tobytes()
    assert np.abs(after.opacities - before.opacities).max(initial=0) <= 1e-7
    assert np.abs(after.scales / before.scales - 1).max(initial=0) <= 5e-7
    assert np.abs(after.rotations_wxyz - before.rotations_wxyz).max(initial=0) <= 1.2e-7


@pytest.mark.case("I1")
@pytest.mark.parametrize("seed", range(5))
def test_the_image_survives_the_file(seed):
    """Measured 7e-7 over 40 scenes; on the edge of the alpha cut a flip may move a pixel by 1/255 of a colour of 3."""
    before = gaussians(300, seed)
    after = read_ply(ply_bytes(before))
    difference = np.abs(render(after, VIEW).rgb - render(before, VIEW).rgb).max(axis=2)
    assert np.quantile(difference, 0.995) < 1e-5
    assert difference.max() < 3 / 255


def test_the_bytes_are_always_the_same(tmp_path):
    data = ply_bytes(gaussians(50))
    assert ply_bytes(gaussians(50)) == data
    write_ply(tmp_path / "a.ply", gaussians(50))
    stream = io.BytesIO()
    write_ply(stream, gaussians(50))
    assert (tmp_path / "a.ply").read_bytes() == stream.getvalue() == data
    for source in (tmp_path / "a.ply", str(tmp_path / "a.ply"), data, io.BytesIO(data), bytearray(data)):
        assert_same(read_ply(source), read_ply(data))


def test_the_header_is_the_dialect_of_the_viewers():
    header = ply_bytes(gaussians(2, degree=1)).split(b"end_header\n")[0].decode().splitlines()
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{i}" for i in range(9))]
    names += ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    assert header[:3] == ["ply", "format binary_little_endian 1.0", "element vertex 2"]
    assert header[3:] == [f"property float {name}" for name in names]


@pytest.mark.parametrize("degree", [0, 3])
def test_another_reader_finds_logit_log_and_channel_major(degree):
    ours = gaussians(7, 2, degree)
    table = columns(ply_bytes(ours))
    assert np.allclose(np.stack([table[a] for a in "xyz"], 1), ours.means, atol=0)
    assert np.allclose(1 / (1 + np.exp(-table["opacity"].astype(float))), ours.opacities, atol=1e-7)
    assert np.allclose(np.exp(table["scale_2"].astype(float)), ours.scales[:, 2], rtol=5e-7)
    assert (table["rot_0"] == ours.rotations_wxyz[:, 0]).all()
    assert (table["f_dc_1"] == ours.harmonics[:, 0, 1]).all()
    rest = ours.harmonics.shape[1] - 1
    for channel in range(3 if rest else 0):
        for k in (0, rest - 1):
            assert (table[f"f_rest_{channel * rest + k}"] == ours.harmonics[:, 1 + k, channel]).all()
    assert all((table[name] == 0).all() for name in ("nx", "ny", "nz"))


@pytest.mark.case("I1")
@pytest.mark.parametrize("opacity", [0.0, 1e-38, 0.5, 1 - 2.0**-24, 1.0])
@pytest.mark.parametrize("scale", [0.0, 1e-45, 1e-38, 1.0, 1e38, 3.4e38])
def test_extreme_numbers_come_back(opacity, scale):
    other = gaussians(9, 3, 0)
    before = Gaussians.make(
        other.means, np.full((9, 3), scale), other.rotations_wxyz, np.full(9, opacity), other.harmonics
    )
    data = ply_bytes(before)
    assert all(np.isfinite(column).all() for column in columns(data).values())
    after = read_ply(data)
    assert np.abs(after.opacities - before.opacities).max() <= 1e-7
    if scale == 0:
        assert after.scales.max() <= 1.0001e-12  # every scale is zero here: there is no median to go by
    elif scale > 1e-40:
        # half a step of float32 at a logarithm of 87.5 is 3.8e-6
        assert np.abs(after.scales.astype(float) / before.scales - 1).max() <= (5e-7 if scale == 1 else 4e-6)


@pytest.mark.case("I1")
@pytest.mark.parametrize("scale", [3.40282e38, float(np.finfo(np.float32).max)])
def test_the_largest_sizes_are_written_as_what_can_be_read(scale):
    """Their logarithms round to a float32 whose exponential is beyond float32; the one below is a step of 7.6e-6."""
    base = gaussians(9, 3, 0)
    before = Gaussians.make(base.means, np.full((9, 3), scale), base.rotations_wxyz, base.opacities, base.harmonics)
    assert np.abs(read_ply(ply_bytes(before)).scales.astype(float) / scale - 1).max() <= 7.7e-6


def test_a_size_that_is_refused_is_told_from_the_limit_by_its_digits():
    base = gaussians(2, 3, 0)
    data = ply_bytes(base).replace(np.float32(np.log(base.scales[1, 2])).tobytes(), np.float32(88.72284).tobytes())
    with pytest.raises(PlyError, match=r"first at row 1: 88\.72284, need at most 88\.72283, the logarithm"):
        read_ply(data)


@pytest.mark.case("I1")
def test_a_zero_scale_is_far_below_the_others():
    before = gaussians(9, 4, 0)
    before.scales[0] = 0.0
    after = read_ply(ply_bytes(before))
    assert after.scales[0].max() < 1.1e-12 * np.median(before.scales[1:])
    assert np.abs(render(after, VIEW).rgb - render(before, VIEW).rgb).max() < 1e-5


def test_the_page_says_at_which_ends_a_ply_holds_no_float32():
    page = (Path(__file__).parents[3] / "docs" / "formats.md").read_text(encoding="utf-8")
    lowest, share = (
        float(found[1])
        for found in (re.search(r"from ([\d.e-]+) to 1 - ", page), re.search(r"size of 0 as ([\d.e-]+) of", page))
        if found
    )
    before = gaussians(4, 4, 0)
    before.opacities[:3] = 0.0, 1e-45, 1.0
    before.scales[0] = 0.0
    after = read_ply(ply_bytes(before))
    assert after.opacities[:2] == pytest.approx(lowest, rel=2e-3)
    assert after.opacities[2] == np.float32(1 - lowest) < 1
    assert after.scales[0] == pytest.approx(share * np.median(before.scales[1:]), rel=1e-4)


@settings(max_examples=40)
@given(st.integers(0, 2**31), st.integers(1, 8), st.integers(0, 3))
def test_a_second_round_trip_changes_nothing_that_matters(seed, count, degree):
    once = read_ply(ply_bytes(gaussians(count, seed, degree)))
    twice = read_ply(ply_bytes(once))
    assert twice.means.tobytes() == once.means.tobytes()
    assert twice.harmonics.tobytes() == once.harmonics.tobytes()
    assert twice.rotations_wxyz.tobytes() == once.rotations_wxyz.tobytes()
    assert np.abs(twice.opacities - once.opacities).max() <= 1.2e-7
    assert np.abs(twice.scales / once.scales - 1).max() <= 5e-7


def shifted(count: int, offset: float) -> Gaussians:
    base = gaussians(count, 5, 0)
    rng = np.random.default_rng(0)
    return Gaussians.make(
        base.means + offset * np.array([1.0, 0.7, -0.3]) + 1e-9 * rng.standard_normal((count, 3)),
        base.scales, base.rotations_wxyz, base.opacities, base.harmonics,
    )  # fmt: skip


@pytest.mark.case("E19", "I1")
@pytest.mark.parametrize(("offset", "word"), [(0.0, b"float"), (1e3, b"float"), (1e6, b"double"), (1e9, b"double")])
def test_positions_far_from_the_origin_are_stored_as_double(offset, word):
    before = shifted(200, offset)
    data = ply_bytes(before)
    assert b"property " + word + b" x\n" in data
    after = read_ply(data)
    if word == b"double":
        assert after.means.tobytes() == before.means.tobytes()
        assert columns(data)["x"].dtype == np.float64
    pose = np.eye(4)
    pose[:3, 3] = offset * np.array([1.0, 0.7, -0.3])
    difference = np.abs(render(after, VIEW.posed(pose)).rgb - render(before, VIEW.posed(pose)).rgb).max(axis=2)
    # At 1e3 float32 rounds positions by up to 3e-5 of a world whose Gaussians measure 0.05.
    assert np.quantile(difference, 0.99) < (2e-3 if offset == 1e3 else 1e-5)


@pytest.mark.parametrize(
    ("size", "extent", "word"),
    [
        (1.0, 1000.0, b"float"),
        (0.999, 1000.0, b"double"),  # although this is little beside the extent
        (0.0, 1.01, b"float"),  # where all sizes are zero, a ten thousandth of the extent takes the place of an eighth
        (0.0, 0.99, b"double"),
    ],
)
def test_positions_are_stored_as_double_from_an_eighth_of_the_typical_size_on(size, extent, word):
    """Of the median without zeros. Lengths are in eighths of a size, of which float32 rounds one away beside 1."""
    step, base = 2.0**-25, gaussians(3, 5, 0)
    means = np.array([[1 + step, 0, 0], [1, 0, 0], [1, np.float32(1e4 * step * extent), 0]])
    scales = np.array([[0, 0, 0], [0, 0, 0], [8 * step * size, 0, 0]])
    data = ply_bytes(Gaussians.make(means, scales, base.rotations_wxyz, base.opacities, base.harmonics))
    assert b"property " + word + b" x\n" in data


def test_the_position_type_can_be_chosen():
    before = shifted(20, 1e6)
    assert b"property float x\n" in ply_bytes(before, positions="float32")
    assert b"property double x\n" in ply_bytes(gaussians(3), positions="float64")
    with pytest.raises(PlyError, match="float16"):
        ply_bytes(before, positions="float16")
    before.means[7, 1] = 1e39
    with pytest.raises(PlyError, match=r"first at index 7.*float64"):
        ply_bytes(before, positions="float32")
    assert read_ply(ply_bytes(before)).means[7, 1] == 1e39


@pytest.mark.parametrize("degree", [0, 2])
@pytest.mark.parametrize(("offset", "positions"), [(1e3, "float32"), (1e6, "float64")])
def test_the_size_of_a_file_is_known_before_it_is_written(offset, positions, degree):
    """Of what is stored, which is written exactly."""
    moved, base = shifted(30, offset), gaussians(30, 5, degree)
    stored = as_stored(Gaussians.make(moved.means, base.scales, base.rotations_wxyz, base.opacities, base.harmonics))
    assert stored_positions(stored) == positions
    data = ply_bytes(stored, positions=positions)
    assert ply_size(stored) == len(data) - data.index(b"end_header\n") - len(b"end_header\n")
    assert read_ply(data).means.tobytes() == stored.means.tobytes()


def test_dots_alone_do_not_force_double():
    before = gaussians(20, 6, 0)
    before.scales[:] = 0
    before.means[:] += 1e-10
    assert b"property float x\n" in ply_bytes(before)


def test_one_number_selects_no_set() -> None:
    some = gaussians(3)
    assert len(some[1:2]) == len(some[np.array([1])]) == 1
    for number in (1, np.int64(1), np.array(1), True, None):
        with pytest.raises(TypeError, match="selects no set"):
            some[number]
