"""Hostile or damaged zips: refused early, with both numbers, and only with our own errors."""

from __future__ import annotations

import io
import stat
import struct
import zipfile
from contextlib import suppress
from pathlib import Path

import pytest
from capture_scenes import WRITERS, arc, zipped
from hostile import archive_of, opened, peak_below
from hypothesis import given, settings
from hypothesis import strategies as st
from open_files import open_below

from gapmes.service.captures import archive
from gapmes.service.captures.archive import ZipFiles
from gapmes.service.captures.capture import Capture, open_capture
from gapmes.service.captures.files import FolderFiles, read_bounded
from gapmes.service.captures.select import ViewSelection
from gapmes.service.errors import CaptureError, GapmesError


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


@pytest.mark.parametrize("name", ["a/" * 33 + "x", "a/" * 33, "é" * 1025, "a/" * 30_000 + "x"])
def test_paths_that_are_too_long_or_too_deep(name: str) -> None:
    """Each folder of a path is an entry with its whole path: those of one file in a zip of 60 kB took 900 MB."""
    length, folders = len(name), name.rstrip("/").count("/")
    words = f"{length} characters in {folders} folders, need at most 1024 in 32"
    data = archive_of((name, b"x"))
    if folders == 32:
        assert opened(data).folders("") == ["a"]
        return
    with peak_below(1_000_000), pytest.raises(CaptureError, match=words) as refusal:
        opened(data)
    assert len(refusal.value.message) < 300


def test_a_path_as_long_and_as_deep_as_any_is_read() -> None:
    name = "a/" * 31 + "b" * 960 + "/" + "x"
    assert len(name) == 1024
    assert opened(archive_of((name, b"x"))).has(name)


def test_folders_of_many_paths_together() -> None:
    """Each path has few, and 8 MiB of paths had 240,000, which took 225 MB and two seconds."""
    deep = "/b" * 31 + "/x"
    listed = archive_of(*((f"{place}{deep}", b"") for place in range(645)))
    assert len(opened(listed).folders("")) == 645
    more = archive_of(*((f"{place}{deep}", b"") for place in range(646)))
    with pytest.raises(CaptureError, match="has more than 20000 folders with folders in them"):
        opened(more)


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
    """Its content is the name of another file."""
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
    """In case `zipfile` ever reads another list than the one that was bounded."""
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
    with pytest.raises(CaptureError, match="is not a readable zip: it has no list of files at its end; is it complete"):
        opened(data)


@pytest.mark.parametrize("packed", [False, True])
def test_what_file_managers_add_is_not_listed(tmp_path: Path, packed: bool) -> None:
    added = ("__MACOSX/images/a.png", ".git/images/a.png", "images/.DS_Store", "images/Thumbs.db", "images/.x/a.png")
    for name in (*added, "images/a.png", "images/b/c.png"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"x")
    names = [path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()]
    files = opened(archive_of(*((name, b"x") for name in names))) if packed else FolderFiles(tmp_path)
    assert (files.folders(""), files.files("")) == (["images"], [])
    assert (files.folders("images"), files.files("images")) == (["b"], ["a.png"])
    if packed:  # nothing else is unpacked
        assert [name for name in added if files.has(name)] == []


def test_an_empty_zip_has_no_cameras() -> None:
    with pytest.raises(CaptureError, match="is empty"):
        Capture.of(opened(archive_of()))


@pytest.mark.parametrize("data", [b"PK\x03\x04", archive_of()])
def test_a_zip_that_is_refused_is_closed(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "capture.zip").write_bytes(data)
    with pytest.raises(CaptureError) as refused:  # whose traceback keeps what it names
        open_capture(tmp_path / "capture.zip")
    assert (open_below(tmp_path), refused.value.field) == (0, "capture")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """A small zip of every format."""
    made = {}
    for name, write in WRITERS.items():
        folder = tmp_path_factory.mktemp("whole")
        write(folder, arc(2))
        made[name] = zipped(folder)
    return made


@settings(max_examples=150)
@given(data=st.data())
def test_damaged_zips_are_read_or_refused(whole: dict[str, bytes], data: st.DataObject) -> None:
    """Bytes flipped anywhere, ends cut off: our errors or a scene, nothing else."""
    harmed = bytearray(whole[data.draw(st.sampled_from(sorted(whole)))])
    for place in data.draw(st.lists(st.integers(0, len(harmed) - 1), max_size=4)):
        harmed[place] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, 40))
    with suppress(GapmesError):
        found = Capture.of(opened(bytes(harmed[: len(harmed) - cut]))).choose(ViewSelection())
        for place in range(len(found.paths)):
            found.read(place)
