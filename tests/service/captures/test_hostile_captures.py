"""Hostile or damaged captures, except archives: truncated models, invalid arrays, too much of everything."""

from __future__ import annotations

import io
import json
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
from capture_scenes import arc, llff_rows, photograph, realestate10k_text, write_cameras_json, write_colmap, zipped
from hostile import archive_of, opened, peak_below

from gapmes.service.captures.capture import Capture, open_capture
from gapmes.service.captures.files import FolderFiles, read_bounded
from gapmes.service.captures.recognise import recognised, table_of_bytes
from gapmes.service.captures.select import ViewSelection
from gapmes.service.errors import CameraError, CaptureError, PoseError


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
        ("rigs.bin", 12, 2**31, f"it has {2**31} sensors, the limit is 20000"),
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


def test_a_frame_at_an_infinite_place_is_refused_and_nothing_else_is_said(tmp_path: Path) -> None:
    """numpy's own warnings are errors in these tests."""
    write_colmap(tmp_path, arc(2))
    path = tmp_path / "sparse/0/frames.bin"
    data = bytearray(path.read_bytes())
    struct.pack_into("<d", data, 8 + 4 + 4 + 32, np.inf)
    path.write_bytes(data)
    with pytest.raises(PoseError, match="NaN or infinite"):
        open_capture(tmp_path).choose(ViewSelection())


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


@pytest.mark.parametrize("line", [b"#\n", b"\n"])
@pytest.mark.parametrize("name", ["cameras.txt", "images.txt", "rigs.txt", "frames.txt"])
def test_a_text_of_comments_and_empty_lines_is_not_read_to_its_end(name: str, line: bytes) -> None:
    """A gigabyte of them comes in a zip of one megabyte, and took minutes."""
    whole = {"cameras.txt": b"", "images.txt": b"", "rigs.txt": b"", "frames.txt": b""}
    with pytest.raises(CameraError, match=f"^cameras: {name} has more than 80000 lines"):
        recognised(opened(archive_of(*(whole | {name: line * 80_001}).items())))
    with pytest.raises(CameraError, match=r"images\.txt lists 0 views"):
        recognised(opened(archive_of(*(whole | {name: line * 80_000}).items())))


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
        (npy("{'descr': '<f8', 'fortran_order': False, 'shape': (17,)}") + bytes(136), r"shape \(17,\), need"),
        (
            npy("{'descr': '<f8', 'fortran_order': False, 'shape': (2, 17, 1)}") + bytes(272),
            r"shape \(2, 17, 1\), need",
        ),
        (npy("{'descr': '|O', 'fortran_order': False, 'shape': (2, 17)}") + bytes(272), "holds object of shape"),
        (npy("{'descr': '<c16', 'fortran_order': False, 'shape': (1, 17)}") + bytes(272), "holds complex128"),
        (npy("__import__('os').system('true')"), "is not a readable .npy file"),
        (npy("{'descr': '<f8'"), "is not a readable .npy file"),
        (b"\x93NUMPY\x09\x00" + bytes(30), r"is not a readable .npy file: .*version.*\(9, 0\)"),
        (b"\x93NUMPY\x03\x00" + bytes(30), r"is not a readable .npy file: its version is \(3, 0\)"),
        (b"\x93NUMPY", "is not a readable .npy file"),
    ],
)
def test_arrays_that_are_none(data: bytes, words: str) -> None:
    with pytest.raises(CameraError, match=words):
        table_of_bytes(data, "poses_bounds.npy")


def test_arrays_in_other_orders_and_precisions() -> None:
    rows, second = llff_rows(arc(3)), (2, 0)  # a version for longer headers
    arrays = [rows, np.asfortranarray(rows), rows.astype(">f8"), rows.astype(np.float32)]
    for array, version in [*((array, (1, 0)) for array in arrays), (rows, second)]:
        stream = io.BytesIO()
        np.lib.format.write_array(stream, array, version)
        cameras = table_of_bytes(stream.getvalue(), "x.npy").parse(range(3), None).cameras
        for one, two in zip(arc(3), cameras, strict=True):
            np.testing.assert_allclose(one.world_from_cam, two.world_from_cam, atol=1e-6)


def test_an_array_of_a_single_row_is_a_camera() -> None:
    stream = io.BytesIO()
    np.save(stream, llff_rows(arc(1)) / [*[1] * 15, 4, 1])
    assert table_of_bytes(stream.getvalue(), "x.npy").parse([0], None).near == 0.5


def test_a_text_of_too_many_lines() -> None:
    line = realestate10k_text(arc(1)).splitlines()[1]
    assert len(table_of_bytes("\n".join([line] * 20_000).encode(), "clip.txt").names) == 20_000
    with pytest.raises(CameraError, match="lists 20001 views, need 1 to 20000"):
        table_of_bytes("\n".join([line] * 20_001).encode(), "clip.txt")


def test_names_that_no_file_has() -> None:
    """They are compared with those of the photographs, each with each, after steps that take time with the square of
    a name's length: minutes for one of a megabyte, in which no other thread runs."""
    for length, listed in ((1024, True), (1025, False)):
        views = [{"image": "a.png"}, {"image": "x" * length}]
        for data in (
            json.dumps({"views": views}),
            json.dumps({"frames": [{"file_path": view["image"]} for view in views]}),
            "".join(realestate10k_text(arc(2)).splitlines(keepends=True)[:2]) + "x" * length + " 0" * 18,
        ):
            if listed:
                assert len(table_of_bytes(data.encode(), "cameras.json").names[1] or "") == length
                continue
            words = f"cameras.json has a name of {length} characters, 'x{{50}}'..., need at most 1024"
            with pytest.raises(CameraError, match=words) as refusal:
                table_of_bytes(data.encode(), "cameras.json")
            assert refusal.value.index == 1


def test_the_size_of_one_photograph_of_many_views_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Thousands of views may name one file, whose header may be long."""
    (tmp_path / "a.png").write_bytes(photograph(0))
    frames = [{"file_path": "a.png", "transform_matrix": np.eye(4).tolist()}] * 5
    (tmp_path / "transforms.json").write_text(json.dumps({"fl_x": 60, "frames": frames}))
    opened_paths, files = [], FolderFiles(tmp_path)
    open_file = files.open
    monkeypatch.setattr(files, "open", lambda path: (opened_paths.append(path), open_file(path))[1])
    assert len(Capture.of(files).cameras(range(5)).cameras) == 5
    assert opened_paths.count("a.png") == 1


def test_a_photograph_that_unpacks_to_too_much(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_cameras_json(tmp_path, arc(2))
    capture = Capture.of(opened(zipped(tmp_path)))
    found = capture.choose(ViewSelection())
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
