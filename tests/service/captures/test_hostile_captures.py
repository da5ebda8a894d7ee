"""Captures that mean harm or are damaged: refused early, with both numbers, and never with anything but our errors."""

from __future__ import annotations

import io
import stat
import struct
import tracemalloc
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from capture_scenes import WRITERS, arc, llff_rows, realestate10k_text, write_cameras_json, write_colmap, zipped
from hypothesis import given, settings
from hypothesis import strategies as st

from gapmes.service.captures import archive
from gapmes.service.captures.archive import ZipFiles
from gapmes.service.captures.capture import Capture, open_capture
from gapmes.service.captures.files import FolderFiles, read_bounded
from gapmes.service.captures.recognise import recognised, table_of_bytes
from gapmes.service.captures.select import Wish
from gapmes.service.errors import CameraError, CaptureError, GapmesError


def archive_of(*members: tuple[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as made:
        for name, data in members:
            made.writestr(zipfile.ZipInfo(name), data, method)
    return buffer.getvalue()


@contextmanager
def peak_below(limit: int) -> Iterator[None]:
    """What is allocated inside at one time stays below so many bytes."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < limit
    finally:
        tracemalloc.stop()


def opened(data: bytes, **options: int) -> ZipFiles:
    return ZipFiles(io.BytesIO(data), **options)


@pytest.mark.parametrize(
    "name",
    [
        "../cameras.json",
        "/etc/passwd",
        "a/../../b",
        "a\\..\\b",
        "C:/x",
        "./a",
        "a//b",
        "a/./b",
        "..",
        "\\a",
        "C:\\x",
        "..\\x",
    ],
)
def test_paths_that_leave_the_zip(name: str) -> None:
    with pytest.raises(CaptureError, match="paths must stay inside the zip"):
        opened(archive_of((name, b"x")))


@pytest.mark.parametrize("name", ["more.zip", "a/MORE.ZIP", "x.tar.gz", "x.7z"])
def test_archives_in_archives(name: str) -> None:
    with pytest.raises(CaptureError, match="is another archive"):
        opened(archive_of((name, b"x")))


def test_encrypted_members() -> None:
    data = bytearray(archive_of(("a.txt", b"hello")))
    place = data.rfind(b"PK\x01\x02")
    data[place + 8] |= 1
    with pytest.raises(CaptureError, match=r"'a\.txt' is encrypted"):
        opened(bytes(data))


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_other_compressions(method: int) -> None:
    with pytest.raises(CaptureError, match=f"compressed by method {method}, need 0 .* or 8"):
        opened(archive_of(("a.txt", b"hello"), method=method))


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_a_link_is_no_file() -> None:
    """What it holds is the name of another one."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as made:
        link = zipfile.ZipInfo("images/000.png")
        link.external_attr = (stat.S_IFLNK | 0o777) << 16
        made.writestr(link, b"../photographs/000.png")
    with pytest.raises(CaptureError, match=r"'images/000\.png' is a symbolic link") as refusal:
        opened(buffer.getvalue())
    assert refusal.value.cure == "zip without -y"


def test_a_file_that_is_there_twice() -> None:
    with pytest.raises(CaptureError, match="is there twice"):
        opened(archive_of(("a.txt", b"x"), ("a.txt", b"y")))


def test_too_many_files(monkeypatch: pytest.MonkeyPatch) -> None:
    data = archive_of(*((f"{index}.txt", b"") for index in range(30)))
    assert len(opened(data).files("")) == 30
    monkeypatch.setattr(archive, "MAX_MEMBERS", 29)
    with pytest.raises(CaptureError, match="holds 30 files, the limit is 29"):
        opened(data)


def test_a_list_of_files_too_long_to_read_is_not_read() -> None:
    """The last record says that a million of entries follow each other in 40 MB: refused before one is parsed."""
    entry = struct.pack("<4s6H3I5H2I", b"PK\x01\x02", 20, 20, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0)
    listed = entry * (40_000_000 // len(entry))
    end = struct.pack("<4s4H2IH", b"PK\x05\x06", 0, 0, 3, 3, len(listed), 0, 0)
    stream = io.BytesIO(listed + end)
    del listed
    words = f"its list of files has {stream.getbuffer().nbytes - len(end)} bytes, the limit is 8388608"
    with peak_below(1_000_000), pytest.raises(CaptureError, match=words):
        ZipFiles(stream)


def test_a_zip64_record_is_held_to_the_same_bounds() -> None:
    record = struct.pack("<4sQ2H2I4Q", b"PK\x06\x06", 44, 45, 45, 0, 0, 2**40, 2**40, 2**50, 0)
    locator = struct.pack("<4sIQI", b"PK\x06\x07", 0, 0, 1)
    end = struct.pack("<4s4H2IH", b"PK\x05\x06", 0, 0, 1, 1, 46, 0, 0)
    with pytest.raises(CaptureError, match=f"holds {2**40} files"):
        opened(record + locator + end)
    with pytest.raises(CaptureError, match="zip64 record is not where it should be: at byte 24, its locator says 0"):
        opened(b"\0" * 80 + locator + end)


ENTRY = struct.pack("<4s6H3I5H2I", b"PK\x01\x02", 20, 20, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0) + b"a"


def last_record(count: int, bytes_: int, offset: int, comment: bytes = b"") -> bytes:
    """Of a zip: `count` files in a list of `bytes_` at `offset`."""
    return struct.pack("<4s4H2IH", b"PK\x05\x06", 0, 0, count, count, bytes_, offset, len(comment)) + comment


def last_records64(count: int, bytes_: int, offset: int, located: int) -> bytes:
    """Of a zip64, whose own record is said to be at `located`."""
    record = struct.pack("<4sQ2H2I4Q", b"PK\x06\x06", 44, 45, 45, 0, 0, count, count, bytes_, offset)
    return record + struct.pack("<4sIQI", b"PK\x06\x07", 0, located, 1) + last_record(0xFFFF, 2**32 - 1, 2**32 - 1)


def test_a_second_zip64_record_is_not_believed() -> None:
    """A harmless record lies where the locator says, one of many files directly before it, where `zipfile` looks."""
    harmless, listed = last_records64(1, len(ENTRY), 56, 0)[:56], ENTRY * 100_000
    place = len(harmless) + len(listed)
    stream = io.BytesIO(harmless + listed + last_records64(100_000, len(listed), len(harmless), located=0))
    words = f"zip64 record is not where it should be: at byte {place}, its locator says 0"
    with peak_below(1_000_000), pytest.raises(CaptureError, match=words):
        ZipFiles(stream)


def test_counts_that_lie_are_noticed_before_an_entry_is_made() -> None:
    """`zipfile` reads as many entries as the bytes of the list hold, whatever the last record counts."""
    most = archive.MAX_DIRECTORY // len(ENTRY)
    data = ENTRY * most + last_record(1, most * len(ENTRY), 0)
    words = f"its list has {most} files, its last record says 1"
    with peak_below(12_000_000), pytest.raises(CaptureError, match=words):  # measured: 8.5 MB; by `zipfile` 66 MB
        opened(data)
    data = ENTRY * 2 + last_records64(1, 2 * len(ENTRY), 0, located=2 * len(ENTRY))
    with pytest.raises(CaptureError, match="its list has 2 files, its last record says 1"):
        opened(data)


def test_a_zip64_archive_that_tells_the_truth_is_read() -> None:
    assert list(opened(ENTRY + last_records64(1, len(ENTRY), 0, located=len(ENTRY))).files("")) == ["a"]


def test_the_record_in_a_comment_is_the_one_that_is_bounded() -> None:
    """It is the one that `zipfile` reads: the last."""
    many = ENTRY * 100_000
    of_many, of_none = last_record(1, len(many), 0), last_record(0, 0, len(many) + 22)
    with pytest.raises(CaptureError, match="its list of files starts at byte 22, its last record says 0"):
        opened(many + last_record(0, 0, len(many), comment=of_many))
    stream = io.BytesIO(many + last_record(0xFFFF, len(many), 0, comment=of_none))
    with peak_below(1_000_000):
        files = ZipFiles(stream)
    assert not files.files("")


@pytest.mark.parametrize("prefix", [b"#!/bin/sh\n", archive_of(("b.txt", b"y"))])
def test_what_is_put_before_an_archive_is_not_passed_over(prefix: bytes) -> None:
    data = archive_of(("a.txt", b"x"))
    place = data.rfind(b"PK\x01\x02")
    words = f"its list of files starts at byte {place + len(prefix)}, its last record says {place}"
    with pytest.raises(CaptureError, match=words) as refusal:
        opened(prefix + data)
    assert refusal.value.cure == "zip the photographs and cameras anew"


def test_what_was_parsed_is_counted_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Should `zipfile` ever find another list than the one that was bounded."""
    monkeypatch.setattr(archive, "_check_directory", lambda _: 1)
    with pytest.raises(CaptureError, match="2 files were read of its list of 1"):
        opened(archive_of(("a.txt", b"x"), ("b.txt", b"y")))


def test_a_bomb_is_refused_by_what_it_says_of_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    data = archive_of(("images.txt", bytes(3_000_000)))
    assert len(data) < 4000
    monkeypatch.setattr(archive, "MAX_MEMBER_BYTES", 2_999_999)
    with pytest.raises(CaptureError, match="unpacks to 3000000 bytes, the limit is 2999999"):
        opened(data)
    monkeypatch.undo()
    with pytest.raises(CaptureError, match=r"images\.txt has 3000000 bytes or more, the limit is 1000"):
        read_bounded(opened(data), "images.txt", 1000)


def test_a_bomb_that_lies_is_stopped_while_it_unpacks() -> None:
    """Its list says 10 bytes where 3 MB come: no more than the 10 are handed on, and the checksum gives it away."""
    data = bytearray(archive_of(("images.txt", bytes(3_000_000))))
    struct.pack_into("<I", data, data.rfind(b"PK\x01\x02") + 24, 10)
    with peak_below(1_000_000), pytest.raises(CaptureError, match="cannot be unpacked"):
        read_bounded(opened(bytes(data)), "images.txt", 100)


def test_all_that_is_unpacked_counts_together() -> None:
    files = opened(archive_of(*((f"{index}.txt", bytes(400)) for index in range(3))), max_bytes=1000)
    assert read_bounded(files, "0.txt", 400) == read_bounded(files, "1.txt", 400) == bytes(400)
    with pytest.raises(CaptureError, match="unpacks to more than 1000 bytes"):
        read_bounded(files, "2.txt", 400)


@pytest.mark.parametrize("data", [b"", b"PK\x03\x04", b"PK\x05\x06" + bytes(10), b"PK\x03\x04" + bytes(500)])
def test_what_is_no_zip(data: bytes) -> None:
    with pytest.raises(CaptureError, match="is not a readable zip"):
        opened(data)


def test_an_empty_zip_has_no_cameras() -> None:
    with pytest.raises(CaptureError, match="holds no cameras, only nothing"):
        Capture.of(opened(archive_of()))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """A small zip of every format."""
    made = {}
    for name, write in WRITERS.items():
        folder = tmp_path_factory.mktemp("whole")
        write(folder, arc(2))
        made[name] = zipped(folder)
    return made


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_damaged_zips_are_read_or_refused(whole: dict[str, bytes], data: st.DataObject) -> None:
    """Bytes flipped anywhere, ends cut off: our errors or a scene, nothing else."""
    harmed = bytearray(whole[data.draw(st.sampled_from(sorted(whole)))])
    for place in data.draw(st.lists(st.integers(0, len(harmed) - 1), max_size=4)):
        harmed[place] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, 40))
    with suppress(GapmesError):
        found = Capture.of(opened(bytes(harmed[: len(harmed) - cut]))).choose(Wish())
        for place in range(len(found.paths)):
            found.read(place)


def test_every_way_to_cut_a_binary_model_short(tmp_path: Path) -> None:
    """But for rigs and frames cut to nothing at all, each of the files says how far it goes."""
    write_colmap(tmp_path, arc(2))
    folder = tmp_path / "sparse/0"
    for name in ("cameras.bin", "images.bin", "rigs.bin", "frames.bin"):
        kept = (folder / name).read_bytes()
        for size in range(len(kept)):
            (folder / name).write_bytes(kept[:size])
            with pytest.raises(CameraError, match=rf"{name} ends after {size} bytes"):
                recognised(FolderFiles(tmp_path))
        (folder / name).write_bytes(kept)
    recognised(FolderFiles(tmp_path))


@pytest.mark.parametrize(
    ("name", "place", "value", "words"),
    [
        ("cameras.bin", 0, 2**63, f"it has {2**63} cameras, the limit is 20000"),
        ("images.bin", 0, 2**40, f"it has {2**40} images, the limit is 20000"),
        ("rigs.bin", 0, 2**40, "rigs, the limit is 20000"),
        ("rigs.bin", 12, 2**31, f"it has {2**31 + 1} sensors|it has .* sensors"),
        ("frames.bin", 0, 2**40, "frames, the limit is 20000"),
    ],
)
def test_counts_that_nothing_can_have(tmp_path: Path, name: str, place: int, value: int, words: str) -> None:
    write_colmap(tmp_path, arc(2))
    path = tmp_path / "sparse/0" / name
    data = bytearray(path.read_bytes())
    struct.pack_into("<Q" if place == 0 else "<I", data, place, value)
    path.write_bytes(data)
    with pytest.raises(CameraError, match=words):
        open_capture(tmp_path)


def test_points_are_passed_over_without_being_held(tmp_path: Path) -> None:
    """Four million points of one photograph in a zip of 100 kB."""
    write_colmap(tmp_path, arc(2))
    path = tmp_path / "sparse/0/images.bin"
    model = path.read_bytes()
    name = model.index(b"png\0") + 4
    points = struct.unpack_from("<Q", model, name)[0]
    rest = model[name + 8 + 24 * points :]
    data = archive_of(
        ("cameras.bin", (tmp_path / "sparse/0/cameras.bin").read_bytes()),
        ("images.bin", model[:name] + struct.pack("<Q", 4_000_000) + bytes(96_000_000) + rest),
    )
    files = opened(data)
    with peak_below(8_000_000):  # 5.3 MB: zlib's output and the pieces of 1 MiB
        table = recognised(files)[1]
    assert len(table.names) == 2


def npy(header: str) -> bytes:
    text = header.encode("latin1") + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (
            npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000, 17)}"),
            "has 0 bytes of numbers",
        ),
        (npy("{'descr': '<f8', 'fortran_order': False, 'shape': (0, 17)}"), "lists 0 views"),
        (npy("{'descr': '<f8', 'fortran_order': False, 'shape': (2, 15)}") + bytes(240), r"shape \(2, 15\), need"),
        (npy("{'descr': '|O', 'fortran_order': False, 'shape': (2, 17)}") + bytes(272), "holds object of shape"),
        (npy("{'descr': '<c16', 'fortran_order': False, 'shape': (1, 17)}") + bytes(272), "holds complex128"),
        (npy("__import__('os').system('true')"), "is not a readable .npy file"),
        (npy("{'descr': '<f8'"), "is not a readable .npy file"),
        (b"\x93NUMPY\x09\x00" + bytes(30), "is not a readable .npy file"),
        (b"\x93NUMPY", "is not a readable .npy file"),
    ],
)
def test_arrays_that_are_none(data: bytes, words: str) -> None:
    with pytest.raises(CameraError, match=words):
        table_of_bytes(data, "poses_bounds.npy")


def test_arrays_in_other_orders_and_precisions() -> None:
    rows = llff_rows(arc(3))
    for array in (rows, np.asfortranarray(rows), rows.astype(">f8"), rows.astype(np.float32)):
        stream = io.BytesIO()
        np.save(stream, array)
        cameras = table_of_bytes(stream.getvalue(), "x.npy").parse(range(3), None).cameras
        for one, two in zip(arc(3), cameras, strict=True):
            np.testing.assert_allclose(one.world_from_cam, two.world_from_cam, atol=1e-6)


def test_a_text_of_too_many_lines() -> None:
    line = realestate10k_text(arc(1)).splitlines()[1]
    with pytest.raises(CameraError, match="lists 20001 views, need 1 to 20000"):
        table_of_bytes("\n".join([line] * 20_001).encode(), "clip.txt")


def test_a_photograph_that_unpacks_to_too_much(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_cameras_json(tmp_path, arc(2))
    capture = Capture.of(opened(zipped(tmp_path)))
    found = capture.choose(Wish())
    monkeypatch.setattr("gapmes.service.captures.photographs.MAX_PHOTOGRAPH_BYTES", 100)
    with pytest.raises(CaptureError, match=r"view 0000\.png has \d+ bytes or more, the limit is 100"):
        found.read(0)


def test_a_checksum_that_does_not_hold(tmp_path: Path) -> None:
    name, text = "cameras.json", b'{"views": []}'
    data = archive_of((name, text), method=zipfile.ZIP_STORED)
    with pytest.raises(CaptureError, match="cannot be unpacked: Bad CRC-32"):
        Capture.of(opened(data.replace(text, b'{"views": 7} ')))
    assert zlib.crc32(text) != zlib.crc32(b'{"views": 7} ')


def test_folders_are_counted_before_one_of_them_is_read() -> None:
    """Cameras that cost 30 times their size to parse, in several folders."""
    heavy = b"[" + b"[]," * 300_000 + b"[]]"
    files = opened(archive_of(*((f"{name}/cameras.json", heavy) for name in "abcdef")))
    with peak_below(1_000_000), pytest.raises(CaptureError, match="holds 6 captures: a, b, c, d, e"):
        recognised(files)


def test_a_camera_file_in_a_zip_is_bounded_as_the_caller_says() -> None:
    heavy = b"[" + b"[]," * 300_000 + b"[]]"
    with peak_below(2_000_000), pytest.raises(CaptureError, match=rf"{len(heavy)} bytes.*limit.*65536"):
        recognised(opened(archive_of(("cameras.json", heavy))), max_bytes=65536)


def test_a_file_that_grows_while_it_is_read_is_said_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.txt").write_bytes(bytes(20))
    files = FolderFiles(tmp_path)
    monkeypatch.setattr(files, "size", lambda _: 10)
    with pytest.raises(CaptureError, match=r"a\.txt has more bytes than the 10 that it is listed with"):
        read_bounded(files, "a.txt", 100)
