"""Invalid rows: dropped and counted by property on request."""

import numpy as np
import pytest
from ply_cases import assert_same, binary_file, columns, gaussians

from gapmes.service.cameras.camera import Camera
from gapmes.service.errors import PlyError
from gapmes.service.formats.dialect import Dialect
from gapmes.service.formats.ply import inspect_ply, ply_bytes, read_ply
from gapmes.service.formats.reading import DROP_CURE
from gapmes.service.splat import render

COUNT = 40
TABLE = columns(ply_bytes(gaussians(COUNT, 1)))
USED = sorted(name for name in TABLE if name not in ("nx", "ny", "nz"))
CAMERA = Camera.make(32, 32, 32.0, 32.0, 16.0, 16.0, np.eye(4))


@pytest.mark.case("E12", "I2")
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300, np.float32(88.72284)])
@pytest.mark.parametrize("name", USED)
def test_every_property_and_value_is_a_number_or_one_row_less(name, value):
    """What stays is what a file without the row gives, and draws no NaN."""
    table = {key: column.astype(np.float64) for key, column in TABLE.items()}
    table[name][7] = value
    means = (name == "opacity" and not np.isnan(value)) or (name.startswith("scale") and value == -np.inf)
    finite = np.isfinite(value)
    fits = finite and (name in ("x", "y", "z") or (value < 1e30 and not name.startswith("scale")))
    reading = inspect_ply(binary_file(table), drop_invalid=True)
    if means or fits:
        assert (reading.invalid, len(reading.gaussians)) == ({}, COUNT)
    else:
        assert reading.invalid == {name: 1}
        rest = {key: np.delete(column, 7) for key, column in TABLE.items()}
        assert_same(reading.gaussians, read_ply(binary_file(rest)))
        [note] = reading.notes()
        assert note == f"1 of {COUNT} Gaussians dropped, invalid in {name} (1)"
    assert np.isfinite(render(reading.gaussians, CAMERA).rgb).all()


@pytest.mark.parametrize(("kind", "form"), [("opacity", "linear"), ("scales", "linear")])
def test_a_form_that_most_rows_speak_against_is_to_be_left_out(kind, form):
    """Dropping such rows would leave hardly any of a file that is well."""
    with pytest.raises(PlyError) as caught:
        inspect_ply(ply_bytes(gaussians(COUNT, 1)), dialect=Dialect(**{kind: form}))
    assert caught.value.cure == f"these are no {form} numbers: leave out --{kind} {form}, {kind}={form} over HTTP"
    table = {key: column.copy() for key, column in TABLE.items()}
    table["opacity"] = 1 / (1 + np.exp(-table["opacity"].astype(np.float64)))
    table["scale_0"], table["scale_1"], table["scale_2"] = (np.exp(table[f"scale_{axis}"]) for axis in range(3))
    name = "opacity" if kind == "opacity" else "scale_0"
    table[name][3] = -1.0
    with pytest.raises(PlyError) as caught:
        inspect_ply(binary_file(table), dialect=Dialect("linear", "linear"))
    assert (caught.value.index, caught.value.cure) == (3, DROP_CURE)
    for count, cure in ((COUNT // 2, f"these are no {form} numbers"), (COUNT // 2 - 1, DROP_CURE)):
        table[name][:count] = -1.0
        with pytest.raises(PlyError) as caught:
            inspect_ply(binary_file(table), dialect=Dialect("linear", "linear"))
        assert caught.value.cure.startswith(cure)
        table[name][:] = 0.5
    table[name][:] = np.nan  # speaks for no other form
    with pytest.raises(PlyError) as caught:
        inspect_ply(binary_file(table), dialect=Dialect("linear", "linear"))
    assert caught.value.cure == DROP_CURE


@pytest.mark.parametrize(
    ("name", "value", "fits"),
    [
        ("opacity", 0.0, True),
        ("opacity", 1.0, True),
        ("opacity", -1e-45, False),
        ("opacity", 1 + 2.0**-23, False),
        ("scale_1", 0.0, True),
        ("scale_1", -1e-45, False),
        ("scale_1", np.finfo(np.float32).max, True),
    ],
)
def test_numbers_as_they_are_end_at_0_and_1(name, value, fits):
    table = TABLE | {key: np.full(COUNT, 0.5, np.float32) for key in ("opacity", "scale_0", "scale_1", "scale_2")}
    table[name][3] = value
    reading = inspect_ply(binary_file(table), dialect=Dialect("linear", "linear"), drop_invalid=True)
    assert reading.invalid == ({} if fits else {name: 1})


@pytest.mark.case("E12")
def test_rows_are_counted_once_and_under_each_of_their_properties():
    table = {key: column.copy() for key, column in TABLE.items()}
    table["x"][[1, 2]] = np.nan
    table["rot_0"][[2, 5, 6]] = np.inf
    reading = inspect_ply(binary_file(table), drop_invalid=True)
    assert (reading.rows, len(reading.gaussians)) == (COUNT, COUNT - 4)
    assert reading.invalid == {"x": 2, "rot_0": 3}
    assert reading.notes()[0].startswith(f"4 of {COUNT} Gaussians dropped")


@pytest.mark.case("E12")
def test_a_file_of_nothing_else_is_an_empty_scene():
    table = TABLE | {"y": np.full(COUNT, np.nan, np.float32)}
    reading = inspect_ply(binary_file(table), drop_invalid=True)
    assert (len(reading.gaussians), reading.invalid, reading.zero_rotations) == (0, {"y": COUNT}, 0)
    assert (render(reading.gaussians, CAMERA, background=(0.25, 0.5, 1.0)).rgb == [0.25, 0.5, 1.0]).all()


def test_numbers_that_nobody_reads_may_be_anything():
    table = TABLE | {"nx": np.full(COUNT, np.nan, np.float32), "label": np.full(COUNT, np.inf, np.float32)}
    assert_same(read_ply(binary_file(table)), read_ply(binary_file(TABLE)))
    assert inspect_ply(binary_file(table), drop_invalid=True).invalid == {}
