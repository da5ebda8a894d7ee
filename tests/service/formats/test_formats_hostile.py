"""Damaged and hostile files of the quantised formats: refused early with the numbers, in bounded memory."""

from __future__ import annotations

import gzip
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
from damaged_bytes import damaged
from format_cases import by_gsply, moderate, spz_file
from hypothesis import given, settings
from hypothesis import strategies as st
from ply_cases import assert_same

from gapmes.service.errors import FormatError, InputError, PlyError, TooManyGaussians
from gapmes.service.formats.registry import FORMATS, format_of_bytes, format_of_path, inspect_gaussians, read_gaussians

COMPRESSED = FORMATS["compressed.ply"].write(moderate(300, 1, 1)).data
SPLAT = FORMATS["splat"].write(moderate(40, 1, 0)).data
SPZ = FORMATS["spz"].write(moderate(40, 1, 2)).data
BODY = COMPRESSED.index(b"end_header\n") + len(b"end_header\n")
FLOATS = 18 * 4  # bytes of a chunk


def test_a_splat_of_half_a_row_is_refused() -> None:
    with pytest.raises(FormatError, match="1287 bytes are 40 rows of 32 and 7 bytes more") as refusal:
        read_gaussians(SPLAT + b"1234567", format="splat")
    assert refusal.value.index == 40
    assert len(read_gaussians(b"", format="splat")) == 0


@pytest.mark.parametrize(("column", "value"), [(0, np.nan), (2, np.inf), (3, -1.0), (4, np.nan), (5, np.inf)])
def test_a_splat_row_that_is_no_gaussian_is_named_or_dropped(column: int, value: float) -> None:
    rows = np.frombuffer(bytearray(SPLAT), np.uint8).reshape(40, 32).copy()
    rows[7].view("<f4")[column] = value
    with pytest.raises(FormatError, match=r"1 of 40 rows.*first at row 7") as refusal:
        read_gaussians(rows.tobytes(), format="splat")
    assert refusal.value.index == 7
    assert refusal.value.field in ("splat.means", "splat.scales")
    reading, _ = inspect_gaussians(rows.tobytes(), format="splat", drop_invalid=True)
    assert (len(reading.gaussians), sum(reading.invalid.values()), reading.rows) == (39, 1, 40)
    assert reading.notes()[0].startswith("1 of 40 Gaussians dropped")


def test_a_size_of_zero_is_one() -> None:
    rows = np.frombuffer(bytearray(SPLAT), np.uint8).reshape(40, 32).copy()
    rows[7, 12:24] = 0
    assert read_gaussians(rows.tobytes(), format="splat").scales[7].tolist() == [0, 0, 0]


def test_a_zero_rotation_is_no_rotation() -> None:
    rows = np.frombuffer(bytearray(SPLAT), np.uint8).reshape(40, 32).copy()
    rows[3, 28:] = 128
    reading, _ = inspect_gaussians(rows.tobytes(), format="splat")
    assert reading.gaussians.rotations_wxyz[3].tolist() == [1, 0, 0, 0]
    assert reading.notes()[0].startswith("1 of 40 rotations are zero")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (spz_file(magic=0x12345678), "magic number is 0x12345678, need 0x5053474e"),
        (spz_file(version=1), "version 1, versions 2 and 3 are read"),
        (spz_file(version=4), "version 4"),
        (b"NGSP" + bytes(40), "version 4 or later"),
        (spz_file(degree=4), "degree is 4"),
        (spz_file(fraction=25), "fractional bits are 25"),
        (gzip.compress(b"short", mtime=0), "ends after 5 of 16 bytes"),
        (b"\x1f\x8b" + b"\0" * 30, "cannot be decompressed"),
        (spz_file(body=bytes(37)), "ends after 37 of 38 bytes"),
        (SPZ[:-5], "ends"),
        (SPZ[:-8] + bytes(8), "incorrect data check"),
        (SPZ[:60], "ends after"),
    ],
)
def test_a_spz_that_is_none_is_refused(data: bytes, message: str) -> None:
    with pytest.raises(FormatError, match=message) as refusal:
        read_gaussians(data, format="spz")
    assert refusal.value.field == "spz"


def test_a_spz_is_read_no_further_than_its_header_says() -> None:
    """A bomb of 64 MiB behind two Gaussians costs their memory; one that claims as many as it can hold is counted."""
    bomb = spz_file(2, body=bytes(38) + bytes(2**26))
    tracemalloc.start()
    reading, _ = inspect_gaussians(bomb)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(reading.gaussians) == 2
    assert "what follows the Gaussians was ignored" in reading.notes()
    assert peak < 2**20  # 0.3 MB measured
    assert inspect_gaussians(SPZ + b"\n")[0].notes()[0] == "what follows the Gaussians was ignored"
    assert "an extension behind" in inspect_gaussians(spz_file(2, body=bytes(40), flags=2))[0].notes()[0]
    with pytest.raises(TooManyGaussians, match="has 3000000 Gaussians, the limit is 1000000"):
        inspect_gaussians(spz_file(3_000_000, body=bytes(2**20)), max_count=1_000_000)


@pytest.mark.parametrize(("flags", "told"), [(0, 0), (1, 1), (3, 1), (2, 0)])
def test_a_spz_of_antialiased_splats_says_so(flags: int, told: int) -> None:
    """They are the same Gaussians, and another filter draws them as they were trained."""
    reading, _ = inspect_gaussians(spz_file(version=3, flags=flags))
    assert len(reading.gaussians) == 2
    assert sum("trained with an antialiasing filter" in note for note in reading.notes()) == told


def test_a_count_that_no_such_file_can_hold_is_refused_before_memory_is_taken() -> None:
    with pytest.raises(FormatError, match=r"4294967295 Gaussians need \d+ bytes, a file of \d+ holds \d+ at most"):
        read_gaussians(spz_file(2**32 - 1, body=bytes(1000)))
    huge = COMPRESSED.replace(b"element vertex 300", b"element vertex 256000000000")
    with pytest.raises(PlyError, match="2 chunks for 256000000000 Gaussians"):
        read_gaussians(huge)
    with pytest.raises(PlyError, match="truncated"):
        read_gaussians(huge.replace(b"element chunk 2", b"element chunk 1000000000"))


@pytest.mark.parametrize("name", FORMATS)
def test_a_limit_on_the_count_holds_for_every_format(name: str) -> None:
    data = FORMATS[name].write(moderate(30, 0, 0)).data
    assert len(inspect_gaussians(data, format=name, max_count=30)[0].gaussians) == 30
    with pytest.raises(TooManyGaussians, match="has 30 Gaussians, the limit is 29"):
        inspect_gaussians(data, format=name, max_count=29)


@pytest.mark.parametrize(
    ("old", "new", "field", "message"),
    [
        (b"element chunk 2", b"element chunk 1", "chunk", "1 chunks for 300 Gaussians, need 2"),
        (b"float min_scale_y", b"float least_scale_y", "chunk", "min_scale_y"),
        (b"uint packed_scale", b"int packed_scale", "vertex", "packed_scale"),
        (b"element sh 300", b"element sh 299", "sh", "9 properties and 299 rows, need 9, 24 or 45 and 300"),
        (b"property uchar f_rest_8\n", b"", "sh", "8 properties"),
        (b"uchar f_rest_8", b"char f_rest_8", "sh", "f_rest_8"),
        (b"element vertex", b"property list uchar uchar more\nelement vertex", "chunk", "has list properties"),
        (b"binary_little_endian", b"ascii", "header", r"is ASCII, need binary \(save it as binary\)"),
    ],
)
def test_a_compressed_ply_of_another_layout_is_refused(old: bytes, new: bytes, field: str, message: str) -> None:
    with pytest.raises(PlyError, match=message) as refusal:
        read_gaussians(COMPRESSED.replace(old, new))
    assert refusal.value.field == field


def test_a_usual_ply_with_chunks_of_its_own_is_no_compressed_one() -> None:
    data = FORMATS["ply"].write(moderate(3, 0, 0)).data
    reading, found = inspect_gaussians(data.replace(b"end_header", b"element chunk 1\nproperty float a\nend_header"))
    assert (found.extension, reading.notes()) == ("ply", ["elements ignored: chunk"])
    assert_same(reading.gaussians, read_gaussians(data))


@pytest.mark.parametrize("cut", [1, 3000, 7000])
def test_a_truncated_compressed_ply_says_where(cut: int) -> None:
    with pytest.raises(PlyError, match="is the file truncated"):
        read_gaussians(COMPRESSED[:-cut])


@pytest.mark.parametrize(("column", "value"), [(0, np.nan), (4, np.inf), (9, np.nan), (10, 3e38), (12, np.nan)])
def test_bounds_that_are_no_numbers_are_refused_or_their_chunk_dropped(column: int, value: float) -> None:
    data = bytearray(COMPRESSED)
    at = BODY + FLOATS + 4 * column
    data[at : at + 4] = np.float32(value).tobytes()
    with pytest.raises(FormatError, match=r"first at row 25[6-9]|first at row 2[67]"):
        read_gaussians(bytes(data))
    reading, _ = inspect_gaussians(bytes(data), drop_invalid=True)
    assert 256 <= len(reading.gaussians) < 300
    assert sum(reading.invalid.values()) >= 300 - len(reading.gaussians)


@pytest.mark.parametrize("bits", [0x7F800001, 0xFFBFFFFF, 0x7F7FFFFF, 0xFF7FFFFF, 0x7F800000], ids=hex)
@pytest.mark.parametrize("column", range(18))
def test_bounds_of_any_bits_are_read_or_refused_and_nothing_else_is_said(column: int, bits: int) -> None:
    """Signalling NaNs, the largest float32, infinity: numpy's own warnings are errors in these tests."""
    data = bytearray(COMPRESSED)
    at = BODY + 4 * column
    data[at : at + 4] = bits.to_bytes(4, "little")
    reading, _ = inspect_gaussians(bytes(data), drop_invalid=True)
    assert len(reading.gaussians) == 300 - max(reading.invalid.values(), default=0)


def test_what_nobody_reads_of_a_compressed_ply_is_told() -> None:
    """Further properties of Gaussians and chunks, and further elements, as of any other .ply."""
    chunks, vertices = BODY + 2 * FLOATS, BODY + 2 * FLOATS + 300 * 16
    header = COMPRESSED[:BODY].replace(b"element vertex", b"property float weight\nelement vertex")
    header = header.replace(b"packed_color\n", b"packed_color\nproperty uchar label\x1b[2J\n")
    header = header.replace(b"end_header", b"element camera 2\nproperty int id\nend_header")
    tables = b"".join(COMPRESSED[BODY + FLOATS * i : BODY + FLOATS * (i + 1)] + bytes(4) for i in range(2))
    tables += b"".join(COMPRESSED[chunks + 16 * i : chunks + 16 * (i + 1)] + b"7" for i in range(300))
    reading, found = inspect_gaussians(header + tables + COMPRESSED[vertices:] + bytes(8))
    assert found.extension == "compressed.ply"
    assert reading.notes() == ["properties ignored: weight, label\\x1b[2J", "elements ignored: camera"]
    assert_same(reading.gaussians, read_gaussians(COMPRESSED))
    assert inspect_gaussians(COMPRESSED)[0].notes() == []


@pytest.mark.parametrize("name", ["compressed.ply", "splat"])
def test_a_position_beyond_float32_is_named(name: str) -> None:
    source = moderate(300, 1, 0)
    source.means[[123, 200], 1] = 1e39
    said = r"2 of 300 positions do not fit float32, which ends at 3\.403e\+38, first at index 123: \[.*1e\+39"
    with pytest.raises(FormatError, match=said) as refusal:
        FORMATS[name].write(source)
    assert (refusal.value.field, refusal.value.index) == ("means", 123)
    assert refusal.value.cure


def test_positions_without_fractional_bits_are_read_and_never_written(tmp_path: Path) -> None:
    """Another reader takes 1 to 24, so that what such a file alone could hold is refused."""
    data = spz_file(1, fraction=0, body=bytes([255, 255, 127, 0, 0, 128, 5, 0, 0]) + bytes(10))
    assert read_gaussians(data).means.tolist() == [[8388607.0, 8388608.0, -5.0]]
    with pytest.raises(ValueError, match="fractional_bits 0"):
        by_gsply(tmp_path / "a.spz", data)
    with pytest.raises(FormatError, match="one fractional bit"):
        FORMATS["spz"].write(read_gaussians(data))


@pytest.mark.parametrize("far", [1e39, 1.7e308])
def test_a_position_that_is_too_far_for_a_spz_is_named(far: float) -> None:
    source = moderate(300, 1, 0)
    source.means[123, 1] = far
    with pytest.raises(
        FormatError, match=r"is farther from the origin than the 4\.1943e.* one fractional bit"
    ) as refusal:
        FORMATS["spz"].write(source)
    assert (refusal.value.field, refusal.value.index) == ("means", 123)


def test_a_compressed_ply_without_colour_bounds_has_colours_from_0_to_1() -> None:
    """The older layout: twelve properties of a chunk."""
    header, body = COMPRESSED[:BODY], COMPRESSED[BODY:]
    lines = [line for line in header.splitlines(keepends=True) if line.split()[-1][4:] not in (b"r", b"g", b"b")]
    chunks = b"".join(body[FLOATS * i : FLOATS * i + 48] for i in range(2))
    older = read_gaussians(b"".join(lines) + chunks + body[2 * FLOATS :])
    newer = read_gaussians(COMPRESSED)
    assert older.means.tobytes() == newer.means.tobytes()
    assert older.harmonics[:, 0].min() >= -0.5 / 0.2820948 - 1e-5
    assert older.harmonics[:, 0].max() <= 0.5 / 0.2820948 + 1e-5


def test_the_bytes_say_more_than_the_name_and_what_nothing_says_is_asked_for() -> None:
    assert format_of_bytes(COMPRESSED, "x.ply").extension == "compressed.ply"
    assert format_of_bytes(SPZ, "x.splat").extension == "spz"
    assert format_of_path("a.b.COMPRESSED.PLY").extension == "compressed.ply"
    for name in ("scene.ksplat", "splat", "../../etc/passwd"):
        with pytest.raises(InputError, match=r"ends in none of ply, compressed\.ply, splat, spz"):
            format_of_bytes(SPLAT, name)
    for name in ("", None):
        with pytest.raises(
            InputError, match=r"no \.ply or \.spz, and there is no name to tell .*ply, compressed\.ply, splat"
        ):
            format_of_bytes(SPLAT, name)
    with pytest.raises(InputError, match="0 bytes"):
        format_of_bytes(b"", None)
    with pytest.raises(InputError, match="is no format of Gaussians"):
        read_gaussians(SPLAT, format="obj")
    with pytest.raises(PlyError, match="read_gaussians reads"):
        FORMATS["ply"].read(COMPRESSED, None, False, None)  # type: ignore[arg-type]


@pytest.mark.parametrize("mark", [b"\x1f\x8b\x08\x00", b"\x1f\x8b\x08\xe0", b"\x1f\x8b\x12?", b"ply?"])
def test_a_splat_may_begin_with_any_number(mark: bytes) -> None:
    """Three bytes of its first position may look like the mark of another format."""
    data = mark + SPLAT[4:]
    assert format_of_bytes(data, "x.SPLAT").extension == "splat"
    assert len(read_gaussians(data, format=format_of_bytes(data, "x.splat").extension)) == 40


def test_what_is_named_a_splat_and_is_none_is_what_it_is() -> None:
    for data in (SPZ, COMPRESSED, FORMATS["ply"].write(moderate(3, 0, 0)).data):
        rows = data + bytes(-len(data) % 32)
        assert format_of_bytes(rows, "x.splat").extension == format_of_bytes(data).extension != "splat"
    assert format_of_bytes(b"\x1f\x8b\x08\x00" + bytes(28), "x.spz").extension == "spz"
    assert format_of_bytes(b"\x1f\x8b\x08\x00" + bytes(29), "x.splat").extension == "spz"  # no whole row
    for other in (b"\x1f\x8b\x07\x00", b"\x1f\x8b\x08\x20", b"\x1f\x8b\x08"):  # no gzip
        with pytest.raises(InputError, match=r"those of no \.ply or \.spz"):
            format_of_bytes(other)


@settings(max_examples=250)
@given(st.data())
def test_damaged_files_are_read_or_refused(data: st.DataObject) -> None:
    """Flip, cut or insert bytes anywhere: finite Gaussians or one of our refusals, nothing else."""
    name, source = data.draw(st.sampled_from([("compressed.ply", COMPRESSED), ("splat", SPLAT), ("spz", SPZ)]))
    inside = name == "spz" and data.draw(st.booleans())  # the damage is under the gzip, whose checksum would tell
    raw = damaged(data, zlib.decompress(source, 31) if inside else source)
    try:
        result = read_gaussians(gzip.compress(raw) if inside else raw, format=name)
    except InputError:
        return
    assert all(np.isfinite(getattr(result, field)).all() for field in ("means", "scales", "opacities", "harmonics"))
