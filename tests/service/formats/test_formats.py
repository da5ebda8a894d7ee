"""Every format always writes the same bytes and reads them to the same numbers; gsply reads the same as we do."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from format_cases import ROUNDING, by_gsply, moderate, rotation_distance, there_and_back, to_gsply
from gsply import plywrite
from gsply.spz import write_spz
from hypothesis import given, settings
from hypothesis import strategies as st
from ply_cases import assert_same, gaussians

from gapmes.service.cameras.camera import Camera
from gapmes.service.errors import FormatError
from gapmes.service.formats.compressed_ply import CHUNK
from gapmes.service.formats.dialect import Dialect
from gapmes.service.formats.morton import morton_order
from gapmes.service.formats.registry import FORMATS, inspect_gaussians, read_gaussians, write_gaussians
from gapmes.service.formats.smallest_three import join, split
from gapmes.service.gaussians import Gaussians
from gapmes.service.harmonics import C0, evaluate_basis
from gapmes.service.splat import render

COARSE = [name for name in FORMATS if name != "ply"]


@pytest.mark.parametrize("name", COARSE)
def test_the_same_bytes_always_and_a_second_round_trip_stays_near(name: str) -> None:
    """Coarse numbers are read to the same coarse numbers; only chunk bounds and fractional bits may move them again."""
    source = moderate(600, 5, 1)
    data = FORMATS[name].write(source).data
    assert FORMATS[name].write(moderate(600, 5, 1)).data == data
    once = read_gaussians(data, format=name)
    again, twice = there_and_back(once, name)
    assert np.abs(twice.opacities - again.opacities).max() <= ROUNDING
    if name == "splat":
        assert twice.means.tobytes() == again.means.tobytes()
        assert np.abs(twice.harmonics - again.harmonics).max() <= ROUNDING
    if name == "spz":
        assert np.abs(twice.harmonics - again.harmonics).max() <= ROUNDING
        assert np.abs(np.log(twice.scales / again.scales)).max() <= ROUNDING


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_gsply_reads_our_compressed_ply_as_we_do(tmp_path: Path, degree: int) -> None:
    """Opacities pass through its logit, which it ends at +-10; its highest bytes of harmonics are half a step off."""
    data = FORMATS["compressed.ply"].write(moderate(700, 1, degree)).data
    ours, theirs = read_gaussians(data), by_gsply(tmp_path / "a.compressed.ply", data)
    assert np.abs(ours.means - theirs.means).max() <= ROUNDING
    assert np.abs(np.log(ours.scales / theirs.scales)).max() <= 2e-6
    assert rotation_distance(ours.rotations_wxyz, theirs.rotations_wxyz).max() <= ROUNDING
    assert np.abs(ours.opacities - theirs.opacities).max() <= 5e-5
    assert np.abs(ours.harmonics - theirs.harmonics).max() <= ROUNDING


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_gsply_reads_our_spz_as_we_do(tmp_path: Path, degree: int) -> None:
    """It leaves the frame as it is in the file, right-up-back, and so do we where we are told."""
    data = FORMATS["spz"].write(moderate(700, 1, degree)).data
    theirs = by_gsply(tmp_path / "a.spz", data)
    ours = read_gaussians(data, dialect=Dialect(axes="rdf"))
    assert ours.means.tobytes() == theirs.means.tobytes()
    assert np.abs(np.log(ours.scales / theirs.scales)).max() <= ROUNDING
    assert rotation_distance(ours.rotations_wxyz, theirs.rotations_wxyz).max() <= ROUNDING
    assert np.abs(ours.opacities - theirs.opacities).max() <= 2e-6
    assert np.abs(ours.harmonics - theirs.harmonics).max() <= ROUNDING


def test_a_splat_is_what_its_definition_says_row_by_row() -> None:
    """Read with nothing but the layout: six floats, then colour, opacity and rotation as bytes."""
    source = moderate(50, 6, 0)
    data = FORMATS["splat"].write(source).data
    assert len(data) == 50 * 32
    for row, values in enumerate(struct.iter_unpack("<6f8B", data)):
        assert np.abs(np.array(values[:3]) - source.means[row]).max() == 0
        assert np.abs(np.array(values[3:6]) - source.scales[row]).max() == 0
        colour = np.clip(0.5 + C0 * source.harmonics[row, 0].astype(float), 0, 1)
        assert np.abs(np.array(values[6:9]) / 255 - colour).max() <= 0.5001 / 255
        assert abs(values[9] / 255 - source.opacities[row]) <= 0.5001 / 255
        turned = (np.array(values[10:]) - 128) / 128
        assert np.abs(turned - source.rotations_wxyz[row]).max() <= 1 / 128


@pytest.mark.parametrize("degree", [0, 3])
@pytest.mark.parametrize("name", ["ply", "compressed.ply", "spz"])
def test_we_read_what_gsply_writes(tmp_path: Path, name: str, degree: int) -> None:
    """The source within the format's own steps, which its truncation may double for harmonics."""
    source, path = moderate(300, 2, degree), tmp_path / f"theirs.{name}"
    if name == "spz":
        write_spz(path, to_gsply(source))
    else:
        plywrite(path, to_gsply(source), compressed=name == "compressed.ply")
    reading, found = inspect_gaussians(path, dialect=Dialect(axes="rdf"))
    ours = reading.gaussians
    assert found.extension == name
    assert np.abs(ours.means - source.means).max() <= 4e-3  # 1/4096 of a unit, or 4 units in 1023 steps
    assert np.abs(np.log(ours.scales / source.scales)).max() <= 1 / 32 + ROUNDING
    assert rotation_distance(ours.rotations_wxyz, source.rotations_wxyz).max() <= 4e-3
    assert np.abs(ours.opacities - source.opacities).max() <= 1 / 255
    assert np.abs(ours.harmonics - source.harmonics).max() <= 1 / 32


def test_a_spz_is_the_scene_turned_by_half_a_turn_about_x(tmp_path: Path) -> None:
    """The file's own frame, seen by a camera that is turned with it, gives the same picture."""
    data = FORMATS["spz"].write(moderate(300, 4, 3)).data
    upright, turned = read_gaussians(data), read_gaussians(data, dialect=Dialect(axes="rdf"))
    camera = Camera.make(48, 48, 45.0, 45.0, 24.0, 24.0, np.eye(4))
    flipped = camera.posed(np.diag([1.0, -1.0, -1.0, 1.0]))
    assert np.abs(turned.means - upright.means * [1, -1, -1]).max() == 0
    difference = np.abs(render(upright, camera).rgb - render(turned, flipped).rgb)
    assert render(upright, camera).alpha.max() > 0.9
    assert np.quantile(difference, 0.995) < 1e-5
    directions = np.random.default_rng(0).standard_normal((50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    here, there = evaluate_basis(directions, 3), evaluate_basis(directions * [1, -1, -1], 3)
    assert np.abs(here @ upright.harmonics[0] - there @ turned.harmonics[0]).max() <= 1e-6


@settings(max_examples=60)
@given(st.integers(0, 2**31), st.integers(1, 40))
def test_smallest_three_are_exact_before_they_are_rounded(seed: int, count: int) -> None:
    q = np.random.default_rng(seed).standard_normal((count, 4))
    q[0] = np.eye(4)[seed % 4] * (-1) ** seed
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    index, others = split(q)
    assert (np.abs(others) <= np.sqrt(0.5) + 1e-12).all()
    assert rotation_distance(join(index, others), q).max() <= 1e-7


def test_morton_order_is_a_permutation_that_keeps_neighbours_together() -> None:
    points = np.random.default_rng(0).uniform(-5, 5, (4096, 3))
    order = morton_order(points)
    assert sorted(order.tolist()) == list(range(4096))
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], float)
    assert morton_order(corners).tolist() == list(range(8))  # x is the fastest, z the slowest
    assert morton_order(np.zeros((5, 3))).tolist() == list(range(5))

    def extent(rows: np.ndarray) -> float:
        return float(np.mean([np.ptp(rows[i : i + CHUNK], axis=0).mean() for i in range(0, 4096, CHUNK)]))

    assert extent(points[order]) < 0.6 * extent(points)  # 16 chunks of a cube measure 0.4 of its side on the mean


@pytest.mark.parametrize("far", [1e300, 1.7e308])
def test_morton_order_of_far_points(far: float) -> None:
    assert morton_order(np.array([[far, 0, 0], [-far, 0, 0]])).tolist() == [1, 0]


@pytest.mark.parametrize("name", FORMATS)
def test_a_path_and_its_bytes_and_a_name_say_the_same(tmp_path: Path, name: str) -> None:
    path = tmp_path / f"A scene.{name.upper()}"
    encoded = write_gaussians(path, moderate(20))
    assert path.read_bytes() == encoded.data
    reading, found = inspect_gaussians(path)
    assert found.extension == name
    assert_same(reading.gaussians, inspect_gaussians(encoded.data, name=f"x.{name}")[0].gaussians)
    with path.open("rb") as file:
        assert_same(reading.gaussians, read_gaussians(file, format=f".{name}"))


def test_one_band_that_is_left_out_is_no_range() -> None:
    assert "harmonics of degree 1 are left out" in FORMATS["splat"].write(gaussians(10, 0, 1)).notes[0]


def test_what_a_format_cannot_hold_is_said() -> None:
    source = gaussians(100, 0, 2)
    source.scales[3] = 0
    source.scales[4] = 1e9
    source.harmonics[5, 0] = 40.0
    source.harmonics[6, 3] = -40.0
    said = {name: " | ".join(FORMATS[name].write(source).notes) for name in FORMATS}
    assert said["ply"] == ""
    assert "harmonics of degree 1 to 2 are left out" in said["splat"]
    assert "colour values are outside 0 to 1" in said["splat"]
    assert "6 of 300 scales are outside 4.54e-05 to" in said["spz"]
    assert "higher harmonics are outside -1 to 0.9922" in said["spz"]
    assert "3 of 300 colour coefficients are outside -3.333 to 3.333" in said["spz"]
    assert "6 of 300 scales are outside" in said["compressed.ply"]
    assert "3 of 2400 higher harmonics are outside -4 to 4" in said["compressed.ply"]
    for name in FORMATS:
        assert FORMATS[name].write(moderate(100, 0, 0)).notes == ()


def test_a_colour_far_outside_is_said_to_coarsen_those_of_its_chunk() -> None:
    """In the largest of three channels; by as much as they move, and not where half a step is 1/255 or less."""
    source = moderate(300, 0, 0)
    first = source[morton_order(source.means)]
    first.harmonics[7, 0, 1] = 300.0
    encoded = FORMATS["compressed.ply"].write(first)
    [note] = encoded.notes
    assert note.startswith("256 of 300 colours move by up to 0.16")
    moved = C0 * np.abs(read_gaussians(encoded.data).harmonics - first.harmonics)
    assert 0.15 < moved.max() < 0.17
    for colour, noted in ((1.0 / C0, False), (2.5 / C0, True)):
        first.harmonics[7, 0, 1] = first.harmonics[:256, 0, 1].min() + colour
        assert bool(FORMATS["compressed.ply"].write(first).notes) == noted


@pytest.mark.parametrize("name", COARSE)
@pytest.mark.parametrize(
    ("opacity", "count", "noted"), [(1.4, 10, True), (1.4, 9, False), (0.9, 500, False), (1.6, 500, False)]
)
def test_faint_gaussians_that_become_dots_are_counted(name: str, opacity: float, count: int, noted: bool) -> None:
    """From a hundredth of a scene on: hundreds behind each other are seen, 300 of such opacities by 0.38."""
    source = moderate(1000, 0, 0)
    opacities = np.full(1000, 0.5)
    opacities[:count] = opacity / 255
    source = replace(source, opacities=opacities.astype(np.float32))
    notes = [note for note in FORMATS[name].write(source).notes if "opacities" in note]
    assert [note.split(" have opacities")[0] for note in notes] == ["10 of 1000 Gaussians"] * noted
    kept = read_gaussians(FORMATS[name].write(source).data, format=name)
    assert (np.sort(kept.opacities)[:count] <= 1 / 255 + 1e-7).all() == (opacity < 1.5)
    assert not any("opacities" in note for other in COARSE for note in FORMATS[other].write(kept).notes)


@pytest.mark.parametrize("name", COARSE)
def test_positions_far_from_the_origin_are_said_to_move(name: str) -> None:
    base = gaussians(200, 5, 0)
    moved = Gaussians.make(base.means + 1e6, base.scales, base.rotations_wxyz, base.opacities, base.harmonics)
    [note] = [note for note in FORMATS[name].write(moved).notes if "positions" in note]
    assert note.startswith("positions move by up to")
    assert not any("positions" in note for note in FORMATS[name].write(base).notes)


def test_a_refused_position_is_that_of_the_source() -> None:
    """Not as it would be in the file's own axes."""
    far = gaussians(3, degree=0)
    means = far.means.astype(np.float64)
    means[2] = [-24218330.0, -11945084.0, 4756529.0]
    with pytest.raises(FormatError, match=r"position \[-24218330\.0, -11945084\.0, 4756529\.0\] is farther") as caught:
        FORMATS["spz"].write(replace(far, means=means))
    assert caught.value.index == 2
    assert caught.value.__notes__ == ["index: 2"]
