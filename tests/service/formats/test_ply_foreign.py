"""Files of other writers are read correctly; broken and hostile ones are refused with the place and the numbers."""

import io
import tracemalloc
import warnings

import numpy as np
import pytest
from damaged_bytes import damaged
from hypothesis import given, settings
from hypothesis import strategies as st
from ply_cases import assert_same, binary_file, columns, gaussians
from plyfile import PlyData, PlyElement

from gapmes.service.errors import PlyError
from gapmes.service.formats.ply import inspect_ply, ply_bytes, read_ply

OURS = ply_bytes(gaussians(6, 1, 1))
TABLE = columns(OURS)
EXPECTED = read_ply(OURS)


def changed(**replacement) -> dict[str, np.ndarray]:
    """The columns with some replaced, and those set to None left out."""
    table = {**TABLE, **replacement}
    return {name: column for name, column in table.items() if column is not None}


def by_plyfile(*, text: bool, byte_order: str = "<", faces: bool = False) -> bytes:
    """Our vertices written by plyfile, optionally after a table of faces."""
    rows = PlyData.read(io.BytesIO(OURS))["vertex"].data
    elements = [PlyElement.describe(rows, "vertex")]
    if faces:
        table = np.empty(3, [("vertex_indices", object), ("flags", "u1")])
        table["vertex_indices"] = [np.arange(n, dtype=np.int32) for n in (3, 0, 4)]
        table["flags"] = 7
        elements.insert(0, PlyElement.describe(table, "face"))
    stream = io.BytesIO()
    PlyData(elements, text=text, byte_order=byte_order).write(stream)
    return stream.getvalue()


@pytest.mark.case("I2")
@pytest.mark.parametrize("faces", [False, True])
@pytest.mark.parametrize(("text", "byte_order"), [(True, "="), (False, "<"), (False, ">")])
def test_every_format_with_comments_and_other_elements(text, byte_order, faces):
    data = by_plyfile(text=text, byte_order=byte_order, faces=faces)
    # The UTF-8 of these letters holds bytes that latin-1 takes for line ends.
    comments = "comment Å 1 …\ncomment end_header is near\nobj_info any\nelement vertex".encode()
    assert_same(read_ply(data.replace(b"element vertex", comments)), EXPECTED)


@pytest.mark.case("I2")
def test_other_property_order_extra_properties_and_types():
    table = dict(reversed(TABLE.items()))
    table["x"] = table["x"].astype(np.float64)
    table = {"label": np.arange(6, dtype=np.int32), **table, "red": np.full(6, 255, np.uint8)}
    assert_same(read_ply(binary_file(table)), EXPECTED)
    assert_same(read_ply(binary_file(table, order=">")), EXPECTED)


def test_elements_without_lists_and_trailing_bytes_are_passed_over():
    header = "element camera 2\nproperty float x\nproperty uchar y\nelement empty 9999999999\nobj_info any\n"
    assert_same(read_ply(binary_file(TABLE, before=b"\0" * 10, before_header=header) + b"trailing"), EXPECTED)


def test_line_ends_of_other_systems():
    head, body = OURS.split(b"end_header\n", 1)
    for end in (b"\r\n", b"\r"):
        assert_same(read_ply(head.replace(b"\n", end) + b"end_header" + end + body), EXPECTED)
    # A body that starts with a line feed belongs to the body.
    table = changed(x=np.frombuffer(b"\n\0\x80\x3f" * 6, "<f4"))
    data = binary_file(table)
    head, body = data.split(b"end_header\n", 1)
    assert body[:1] == b"\n"
    assert read_ply(head.replace(b"\n", b"\r") + b"end_header\r" + body).means[0, 0] == table["x"][0]


def test_no_normals_and_no_higher_harmonics():
    names = ["nx", "ny", "nz", *(f"f_rest_{i}" for i in range(9))]
    result = read_ply(binary_file(changed(**dict.fromkeys(names))))
    assert result.sh_degree == 0
    assert (result.harmonics == EXPECTED.harmonics[:, :1]).all()


@pytest.mark.case("I2")
def test_infinite_logits_and_logarithms_mean_zero_and_one():
    opacity = np.array([np.inf, -np.inf, 800, -800, 17, 0], np.float32)
    scale = np.array([-np.inf, -800, 0, 0, 0, 88.7], np.float32)
    result = read_ply(binary_file(changed(opacity=opacity, scale_1=scale)))
    assert result.opacities[:4].tolist() == [1, 0, 1, 0]
    assert result.scales[:2, 1].tolist() == [0, 0]
    assert np.isfinite(result.scales).all()


@pytest.mark.case("A1", "I2")
def test_unnormalised_and_zero_rotations():
    table = changed(**{f"rot_{k}": TABLE[f"rot_{k}"] * np.float32(k != 9) * 37 for k in range(4)})
    for k in range(4):
        table[f"rot_{k}"][2] = 0
    result = read_ply(binary_file(table))
    assert np.abs(result.rotations_wxyz[0] - EXPECTED.rotations_wxyz[0]).max() < 2e-7
    assert result.rotations_wxyz[2].tolist() == [1, 0, 0, 0]
    reading = inspect_ply(binary_file(table))
    assert (reading.zero_rotations, reading.invalid) == (1, {})
    [note] = reading.notes()
    assert note.startswith(f"1 of {len(EXPECTED)} rotations are zero")
    assert inspect_ply(binary_file(TABLE)).notes() == []


@pytest.mark.case("A1", "I2")
def test_rotations_in_double_that_are_too_short_for_float32_are_no_zeros():
    table = changed(**{f"rot_{k}": TABLE[f"rot_{k}"].astype(np.float64) * 1e-200 for k in range(4)})
    reading = inspect_ply(binary_file(table))
    assert reading.zero_rotations == 0
    assert np.abs(reading.gaussians.rotations_wxyz - EXPECTED.rotations_wxyz).max() < 2e-7


@pytest.mark.case("I2")
@pytest.mark.parametrize("missing", ["x", "z", "f_dc_2", "opacity", "scale_2", "rot_3"])
def test_a_missing_property_is_named(missing):
    with pytest.raises(PlyError, match=f"1 of 14 properties are missing: {missing}"):
        read_ply(binary_file(changed(**{missing: None})))


def test_a_mesh_is_told_from_a_splat():
    with pytest.raises(PlyError, match="mesh"):
        read_ply(binary_file({axis: TABLE[axis] for axis in "xyz"}))


@pytest.mark.case("I2")
@pytest.mark.parametrize(("drop", "message"), [([8], "there are 8"), ([0, 1, 2], "there are 6")])
def test_a_wrong_number_of_harmonics(drop, message):
    with pytest.raises(PlyError, match=message):
        read_ply(binary_file(changed(**{f"f_rest_{i}": None for i in drop})))


@pytest.mark.case("I2")
def test_a_gap_in_the_harmonics():
    with pytest.raises(PlyError, match="index 3 is missing"):
        read_ply(binary_file(changed(f_rest_3=None, f_rest_9=TABLE["f_rest_3"])))


@pytest.mark.case("I2")
@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("x", np.nan), ("y", np.inf), ("f_dc_0", np.nan), ("f_rest_8", -np.inf), ("opacity", np.nan),
        ("scale_0", np.nan), ("scale_1", np.inf), ("scale_2", 89.0), ("rot_0", np.nan), ("rot_3", np.inf),
    ],
)  # fmt: skip
def test_a_bad_number_is_named_with_its_row(name, value):
    column = TABLE[name].copy()
    column[[2, 4]] = value
    with pytest.raises(PlyError, match=r"2 of 6 values.*first at row 2") as refusal:
        read_ply(binary_file(changed(**{name: column})))
    assert refusal.value.field == f"vertex.{name}"
    assert refusal.value.index == 2


def test_a_signalling_nan_is_refused_without_a_warning():
    bits = TABLE["x"].astype(np.float32).view(np.uint32)
    bits[3] = 0x7FA00000
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(PlyError, match="first at row 3"):
            read_ply(binary_file(changed(x=bits.view(np.float32))))


def test_a_double_that_does_not_fit_float32_is_refused():
    with pytest.raises(PlyError, match="f_dc_1"):
        read_ply(binary_file(changed(f_dc_1=np.full(6, 1e300))))


@pytest.mark.case("I2")
@pytest.mark.parametrize("cut", [1, 90, 200])
def test_a_truncated_body_says_how_much_is_there(cut):
    row = 4 * len(TABLE)
    with pytest.raises(
        PlyError, match=f"6 rows of {row} bytes need {6 * row} bytes, the file has {6 * row - cut} left"
    ):
        read_ply(OURS[:-cut])
    text = by_plyfile(text=True).splitlines(keepends=True)
    with pytest.raises(PlyError, match="6 rows are declared, the file has 5"):
        read_ply(b"".join(text[:-1]))


def test_a_huge_count_is_refused_before_memory_is_taken():
    for data in (OURS, by_plyfile(text=True)):
        with pytest.raises(PlyError, match="truncated"):
            read_ply(data.replace(b"element vertex 6", b"element vertex 900000000000"))


HEADER = OURS.split(b"end_header\n")[0]


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "starts with"),
        (b"PK\x03\x04", "starts with"),
        (b"ply\n" + b"comment x\n" * 20000 + b"end_header\n", "no end_header"),
        (HEADER, "no end_header"),
        (b"ply\nelement vertex 0\nend_header\n", "no format line"),
        (b"ply\nformat binary_little_endian 1.0\nend_header\n", "need one named vertex"),
        (b"ply\nformat ascii 1.0\nelement vertex 0\nelement vertex 0\nend_header\n", "need one named vertex"),
        (b"ply\nformat binary_middle_endian 1.0\nend_header\n", "line 2 is not understood"),
        (b"ply\nformat ascii 1.0\nelement vertex -1\nend_header\n", "line 3 is not understood"),
        (b"ply\nformat ascii 1.0\nelement vertex " + b"9" * 5000 + b"\nend_header\n", "line 3 is not understood"),
        (b"ply\nformat ascii 1.0\nelement vertex 1 of 2\nend_header\n", "line 3 is not understood"),
        (b"ply\nformat ascii 1.0\nproperty float x\nend_header\n", "line 3 is not understood"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty half x\nend_header\n", "line 4 is no known property"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty list float int x\nend_header\n", "line 4 is no known"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar int x\nend_header\n", "list properties"),
        (HEADER + b"property float x\nend_header\n", "'x' is declared 2 times"),
    ],
)
def test_a_header_that_is_not_understood_is_refused(data, message):
    with pytest.raises(PlyError, match=message):
        read_ply(data)


def test_lists_of_other_elements_are_bounded_by_the_file():
    lists = "element face 2\nproperty list int double v\n"
    for before, message in (
        (np.array([-1], "<i4").tobytes(), "length -1"),
        (np.array([2**31 - 1], "<i4").tobytes(), "needs 17179869176 bytes"),
    ):
        with pytest.raises(PlyError, match=message):
            read_ply(binary_file(TABLE, before=before, before_header=lists))


@pytest.mark.parametrize(("old", "new", "message"), [(b"\n", b" 1\n", "numbers, need"), (b"0", b"zero", "not made of")])
def test_a_bad_line_of_text_is_named(old, new, message):
    head, body = by_plyfile(text=True).split(b"end_header\n", 1)
    lines = body.splitlines(keepends=True)
    lines[3] = lines[3].replace(old, new, 1)
    with pytest.raises(PlyError, match=message) as refusal:
        read_ply(head + b"end_header\n" + b"".join(lines))
    assert refusal.value.index == 3


@pytest.mark.case("I2")
@settings(max_examples=300)
@given(st.data())
def test_damaged_files_are_read_or_refused(data):
    """Flip, cut or insert bytes anywhere: a value or a PlyError, nothing else."""
    source = damaged(data, data.draw(st.sampled_from([OURS, by_plyfile(text=True, faces=True)])))
    try:
        result = read_ply(source)
    except PlyError:
        return
    assert all(np.isfinite(getattr(result, name)).all() for name in ("means", "scales", "opacities", "harmonics"))


def test_endless_lists_before_the_vertices_are_refused_at_once():
    """A byte each, walked one by one by what is no machine code."""
    start, body = OURS.index(b"element vertex"), OURS.index(b"end_header\n") + 11
    one = b"property list uchar int %d\n"
    many_rows = b"element face 5000000\n" + one % 0
    many_lists = b"element face 500000\n" + b"".join(one % place for place in range(10))
    many_tables = b"".join(b"element t%d 500000\n" % place + one % place for place in range(10))
    for head in (many_rows, many_lists, many_tables):
        with pytest.raises(PlyError, match="5000000 lists stand before it, at most 200000"):
            read_ply(OURS[:start] + head + OURS[start:body] + bytes(5_000_000))


def test_endless_lines_before_the_vertices_are_refused_at_once():
    text = by_plyfile(text=True)
    for count, told in (
        (1_000_000, "rows are declared"),
        (1_000_001, "1000001 lines stand before it, at most 1000000"),
    ):
        with pytest.raises(PlyError, match=told):
            read_ply(text.replace(b"element vertex", b"element a %d\nproperty int b\nelement vertex" % count))


@pytest.mark.parametrize("behind", [True, False])
def test_text_around_the_vertices_costs_nothing(behind):
    text, more = by_plyfile(text=True), b"0\n" * 500_000
    start, body = text.index(b"element vertex"), text.index(b"end_header\n") + 11
    junk = b"element junk 500000\nproperty int a\n"
    file = text + more if behind else text[:start] + junk + text[start:body] + more + text[body:]
    tracemalloc.start()
    found = read_ply(file)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert_same(found, read_ply(text))
    assert peak < 5_000_000  # every line as an object would be 30 MB


@pytest.mark.parametrize("end", [b"\n", b"\r\n", b"\r"])
def test_every_end_of_a_line_is_one(end):
    head, body = by_plyfile(text=True).split(b"end_header\n")
    lines = body.splitlines()
    spaced = end.join([b"", *lines[:2], b"  ", *lines[2:], b""])
    assert_same(read_ply(head + b"end_header\n" + spaced), read_ply(head + b"end_header\n" + body))
