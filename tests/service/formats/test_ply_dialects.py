"""Dialects of other writers: certain ones are converted and reported, doubtful ones are read as usual and reported, and
a correct file is never taken for another."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ply_cases import assert_same, binary_file, columns, gaussians

from gapmes.service.errors import PlyError
from gapmes.service.formats.dialect import STANDARD, Dialect
from gapmes.service.formats.ply import inspect_ply, ply_bytes, read_ply
from gapmes.service.gaussians import Gaussians
from gapmes.service.harmonics import C0

COUNT = 5000


def scene(count: int = COUNT, seed: int = 0) -> Gaussians:
    """As a feed-forward network predicts them: a surface two to ten units off, Gaussians of about a pixel's size."""
    rng = np.random.default_rng(seed)
    depth = np.exp(rng.uniform(np.log(2), np.log(10), count))
    means = np.stack([*(rng.uniform(-0.5, 0.5, (2, count)) * depth), depth], axis=1)
    scales = depth[:, None] * np.exp(rng.normal(np.log(0.004), 0.8, (count, 3)))
    opacities = 1 / (1 + np.exp(-rng.normal(0.5, 3.0, count)))
    return Gaussians.make(means, scales, rng.standard_normal((count, 4)), opacities, rng.normal(0, 0.5, (count, 1, 3)))


def foreign(source: Gaussians, **replacement: np.ndarray | None) -> bytes:
    """Our file with some columns replaced, and those that are None left out."""
    table = {**columns(ply_bytes(source)), **replacement}
    kept = {name: column for name, column in table.items() if column is not None}
    return binary_file({name: np.asarray(c, np.float32) if c.dtype == np.float64 else c for name, c in kept.items()})


def linear_opacity(source: Gaussians) -> dict[str, np.ndarray]:
    return {"opacity": source.opacities}


def linear_scales(source: Gaussians) -> dict[str, np.ndarray]:
    return {f"scale_{axis}": source.scales[:, axis] for axis in range(3)}


def swapped_rotation(source: Gaussians) -> dict[str, np.ndarray]:
    """xyzw, the sign such that w is not negative."""
    q = source.rotations_wxyz * np.where(source.rotations_wxyz[:, :1] < 0, -1, 1)
    return {f"rot_{k}": q[:, (k + 1) % 4] for k in range(4)}


def close(found: Gaussians, source: Gaussians) -> None:
    assert np.abs(found.means - source.means.astype(np.float32)).max() == 0
    assert np.abs(found.opacities - source.opacities).max() <= 1e-6
    assert np.abs(np.log(found.scales / source.scales)).max() <= 1e-5
    dots = np.abs((found.rotations_wxyz * source.rotations_wxyz).sum(axis=1))
    assert dots.min() >= 1 - 1e-6


@pytest.mark.parametrize("seed", range(5))
def test_opacities_as_they_are_are_recognised_and_said(seed: int) -> None:
    source = scene(seed=seed)
    reading = inspect_ply(foreign(source, **linear_opacity(source)))
    close(reading.gaussians, source)
    [note] = reading.notes()
    assert "taken as they are, not as logits" in note
    assert "--opacity logit" in note


@pytest.mark.parametrize("seed", range(5))
def test_scales_as_they_are_are_recognised_and_said(seed: int) -> None:
    source = scene(seed=seed)
    reading = inspect_ply(foreign(source, **linear_scales(source)))
    close(reading.gaussians, source)
    [note] = reading.notes()
    assert "scales were taken as they are, not as logarithms" in note


def test_a_writer_of_three_other_ways_at_once_is_read_with_one_option() -> None:
    """The order of a rotation shows nowhere; that w seems to be the last is said."""
    source = scene()
    data = foreign(source, **linear_opacity(source), **linear_scales(source), **swapped_rotation(source))
    notes = " | ".join(inspect_ply(data).notes())
    assert "as if the last were w; rotations were read as wxyz; --rotation xyzw" in notes
    reading = inspect_ply(data, dialect=Dialect(rotation="xyzw"))
    close(reading.gaussians, source)
    assert "rot_3" not in " ".join(reading.notes())
    everything = inspect_ply(data, dialect=Dialect("linear", "linear", "xyzw"))
    assert everything.notes() == []
    assert_same(everything.gaussians, reading.gaussians)


@pytest.mark.parametrize("forms", list(product(["logit", "linear"], ["log", "linear"], ["wxyz", "xyzw"])))
def test_every_combination_of_options_is_read_as_it_says(forms: tuple[str, str, str]) -> None:
    """With so few rows nothing is recognised: the options alone decide."""
    source = gaussians(40, 2, 1)
    replaced: dict[str, np.ndarray] = {}
    for form, usual, change in zip(
        forms, ("logit", "log", "wxyz"), (linear_opacity, linear_scales, swapped_rotation), strict=True
    ):
        replaced |= change(source) if form != usual else {}
    reading = inspect_ply(foreign(source, **replaced), dialect=Dialect(*forms))  # type: ignore[arg-type]
    close(reading.gaussians, source)
    assert reading.notes() == []


# Right files, some of them odd: what `opacity` and the scales hold, with COUNT rows unless it says otherwise.
RNG = np.random.default_rng(11)
RIGHT_OPACITIES = {
    "trained": RNG.normal(-1, 3, COUNT),
    "one Gaussian": np.array([0.5]),
    "one that is nearly opaque": np.array([0.9999]),
    "two, at the ends": np.array([0.0, 1.0]),
    "all one half": np.zeros(COUNT),
    "all the same": np.full(COUNT, 0.7),
    "all logit 1": np.ones(COUNT),
    "even between 0 and 1": RNG.uniform(0, 1, COUNT),
    "an even ramp": np.linspace(0, 1, COUNT),
    "a ramp of few": np.linspace(0, 1, 50),
    "clamped to 0 and 1": np.clip(RNG.normal(0.5, 0.6, COUNT), 0, 1),
    "only the ends": RNG.integers(0, 2, COUNT).astype(float),
    "narrow": RNG.normal(0.5, 0.1, COUNT).clip(0.01, 0.99),
    "near 0 only": np.abs(RNG.normal(0, 0.1, COUNT)),
    "near 1 only": 1 - np.abs(RNG.normal(0, 0.1, COUNT)),
    "many, even": RNG.uniform(0, 1, 200_000),
    "one outside": np.append(1 / (1 + np.exp(-RNG.normal(0, 3, COUNT))), 1.0000001),
}


@pytest.mark.parametrize("case", RIGHT_OPACITIES)
def test_no_right_logit_is_taken_for_an_opacity(case: str) -> None:
    values = RIGHT_OPACITIES[case].astype(np.float32)
    data = foreign(scene(len(values)), opacity=values)
    reading = inspect_ply(data)
    assert_same(reading.gaussians, inspect_ply(data, dialect=STANDARD).gaussians)
    assert np.abs(reading.gaussians.opacities - 1 / (1 + np.exp(-values.astype(float)))).max() <= 1e-7
    doubtful = (values >= 0).all() and (values <= 1).all()
    read_as = "read as logits, from {:.3g} to {:.3g}".format(*1 / (1 + np.exp([-values.min(), -values.max()])))
    assert [(read_as in note, "--opacity linear" in note) for note in reading.notes()] == (
        [(True, True)] if doubtful else []
    )


@pytest.mark.parametrize("seed", range(40))
def test_even_logits_of_any_number_are_never_taken_for_opacities(seed: int) -> None:
    """Six standard deviations: chance does not do it."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1000, 4000))
    reading = inspect_ply(foreign(scene(count, seed), opacity=rng.uniform(0, 1, count)))
    assert "read as logits" in reading.notes()[0]


RIGHT_SCALES = {
    "trained": RNG.normal(-4, 1, (COUNT, 3)),
    "in millimetres": RNG.normal(2.5, 0.5, (COUNT, 3)).clip(0.1),
    "one Gaussian": np.array([[0.1, 0.2, 0.01]]),
    "all one unit": np.zeros((COUNT, 3)),
    "all the same": np.full((COUNT, 3), 0.05),
    "fog": RNG.uniform(0, 1, (COUNT, 3)),
    "thick fog": RNG.uniform(0, 0.3, (COUNT, 3)),
    "few": np.abs(RNG.normal(0, 0.01, (500, 3))),
    "one below 1": np.vstack([np.abs(RNG.normal(0.01, 0.005, (COUNT, 3))), [[-0.001, 0.01, 0.01]]]),
}


@pytest.mark.parametrize("case", RIGHT_SCALES)
def test_no_right_logarithm_is_taken_for_a_size(case: str) -> None:
    values = RIGHT_SCALES[case].astype(np.float32)
    data = foreign(scene(len(values)), **{f"scale_{axis}": values[:, axis] for axis in range(3)})
    reading = inspect_ply(data)
    assert_same(reading.gaussians, inspect_ply(data, dialect=STANDARD).gaussians)
    doubtful = (values >= 0).all()
    assert [("read as logarithms" in note, "--scales linear" in note) for note in reading.notes()] == (
        [(True, True)] if doubtful else []
    )


def test_small_sizes_in_a_world_of_wide_distances_are_not_recognised() -> None:
    """A unit is no large Gaussian where neighbours are a unit apart."""
    source = scene()
    wide = Gaussians.make(source.means * 100, source.scales, source.rotations_wxyz, source.opacities, source.harmonics)
    reading = inspect_ply(foreign(wide, **linear_scales(source)))
    assert ["read as logarithms" in note for note in reading.notes()] == [True]


@settings(max_examples=60)
@given(st.integers(0, 2**31), st.integers(1, 3000), st.floats(-6, 6), st.floats(0.05, 4))
def test_our_own_files_are_read_as_they_were_written(seed: int, count: int, middle: float, width: float) -> None:
    """Whatever the logits are like: the dialect that we write is the one that is read."""
    source, rng = scene(count, seed), np.random.default_rng(seed)
    source.opacities[:] = 1 / (1 + np.exp(-rng.normal(middle, width, count)))
    data = ply_bytes(source)
    assert_same(read_ply(data), inspect_ply(data, dialect=STANDARD).gaussians)


def test_a_dialect_that_the_numbers_contradict_is_refused_with_the_row() -> None:
    source = scene(50)
    for column, dialect in (("opacity", Dialect(opacity="linear")), ("scale_1", Dialect(scales="linear"))):
        with pytest.raises(PlyError, match=r"need (in \[0, 1\]|a size from 0 on)") as refusal:
            inspect_ply(ply_bytes(source), dialect=dialect)
        assert refusal.value.field in (f"vertex.{column}", "vertex.scale_0")


@pytest.mark.parametrize(("kind", "full"), [(np.uint8, 255), (np.float32, 1.0)])
def test_red_green_and_blue_stand_in_for_the_constant_band(kind: type, full: float) -> None:
    source = scene(100)
    names = ("red", "green", "blue")
    levels = {name: np.clip(np.linspace(0, full, 100), 0, full).astype(kind) for name in names}
    without = {f"f_dc_{k}": None for k in range(3)}
    reading = inspect_ply(foreign(source, **without, **levels))
    colour = 0.5 + C0 * reading.gaussians.harmonics[:, 0].astype(float)
    assert np.abs(colour - np.stack([levels[n] / full for n in names], axis=1)).max() <= 1e-6
    kept = "uchar" if kind is np.uint8 else "float"
    assert f"colours were taken from red, green and blue ({kept})" in reading.notes()[0]
    both = inspect_ply(foreign(source, **levels))
    assert both.notes() == ["properties ignored: red, green, blue"]


def test_colours_beyond_their_range_and_half_a_constant_band_are_refused() -> None:
    source = scene(10)
    without = {f"f_dc_{k}": None for k in range(3)}
    levels = {name: np.full(10, 200.0, np.float32) for name in ("red", "green", "blue")}
    with pytest.raises(PlyError, match="need from 0 to 1"):
        inspect_ply(foreign(source, **without, **levels))
    with pytest.raises(PlyError, match="1 of 14 properties are missing: f_dc_1"):
        inspect_ply(foreign(source, f_dc_1=None, **levels))


def test_rows_that_are_dropped_have_no_say_in_the_dialect() -> None:
    """Each of them alone would show that opacities are logits and sizes logarithms."""
    source = scene()
    table = columns(foreign(source, **linear_opacity(source), **linear_scales(source)))
    spoilt = {name: column.copy() for name, column in table.items()}
    spoilt["opacity"][7] = np.nan
    spoilt["scale_1"][8] = np.nan
    spoilt["x"][9], spoilt["opacity"][9], spoilt["scale_0"][9] = np.nan, -3.0, -4.0
    spoilt["f_dc_1"][10], spoilt["opacity"][10], spoilt["scale_2"][10] = np.inf, 5.0, -5.0
    bad = [7, 8, 9, 10]
    reading = inspect_ply(binary_file(spoilt), drop_invalid=True)
    assert_same(reading.gaussians, inspect_ply(binary_file({n: np.delete(c, bad) for n, c in table.items()})).gaussians)
    close(reading.gaussians, source[[row for row in range(COUNT) if row not in bad]])
    assert reading.notes()[0].startswith("opacities were taken as they are")
    assert reading.notes()[-1].startswith(f"4 of {COUNT} Gaussians dropped")


def test_rows_that_an_option_makes_invalid_have_no_say_in_the_rest() -> None:
    source = scene()
    opacity, sizes = linear_opacity(source)["opacity"].copy(), linear_scales(source)
    opacity[7], sizes["scale_0"][7] = -3.0, -4.0
    data = foreign(source, opacity=opacity, **sizes)
    reading = inspect_ply(data, dialect=Dialect(opacity="linear"), drop_invalid=True)
    close(reading.gaussians, source[[row for row in range(COUNT) if row != 7]])
    assert reading.invalid == {"opacity": 1, "scale_0": 1}


def test_a_row_that_one_dialect_alone_takes_decides() -> None:
    """A logit of -3 is no opacity, and 100 no logarithm of a size."""
    source = scene()
    opacity, sizes = linear_opacity(source)["opacity"].copy(), linear_scales(source)
    opacity[7], sizes["scale_0"][8] = -3.0, 100.0
    reading = inspect_ply(foreign(source, opacity=opacity, **sizes), drop_invalid=True)
    assert reading.gaussians.opacities.min() == pytest.approx(1 / (1 + np.exp(3.0)))
    assert "opacities" not in " ".join(reading.notes())
    assert (reading.invalid, reading.rows - len(reading.gaussians)) == ({}, 0)


def test_other_elements_and_properties_and_infinite_logits_are_said() -> None:
    """As a writer has it that appends its camera to the file and does not clamp."""
    source = scene(20)
    opacity = columns(ply_bytes(source))["opacity"].copy()
    opacity[:3] = [np.inf, -np.inf, np.inf]
    table = columns(ply_bytes(source)) | {"opacity": opacity, "filter_3D": np.ones(20, np.float32)}
    extra = "element extrinsic 16\nproperty float extrinsic\n"
    data = binary_file(table).replace(b"end_header", extra.encode() + b"end_header") + bytes(64)
    reading = inspect_ply(data)
    assert reading.gaussians.opacities[:3].tolist() == [1, 0, 1]
    assert reading.notes() == [
        "properties ignored: filter_3D",
        "elements ignored: extrinsic",
        "3 of 20 opacities are infinite logits and were taken as 0 or 1",
    ]


def test_read_ply_logs_what_it_took(caplog: pytest.LogCaptureFixture) -> None:
    source = scene()
    read_ply(foreign(source, **linear_opacity(source)))
    assert "taken as they are" in caplog.text


def test_colours_of_a_type_without_a_white_are_refused() -> None:
    levels = {name: np.full(10, 200, np.int32) for name in ("red", "green", "blue")}
    data = foreign(scene(10), f_dc_0=None, f_dc_1=None, f_dc_2=None, **levels)
    with pytest.raises(PlyError, match="is of type int, need uchar, ushort, float or double") as caught:
        inspect_ply(data)
    assert caught.value.field == "vertex.red"
