"""Replacing files: completely or not at all, also if IN is OUT or the disk is full."""

from __future__ import annotations

import errno
import json
import os
import signal
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from capture_scenes import arc, write_cameras_json
from cli_runs import run
from clouds import cloud
from full_disk import LIMIT, contents, full_disk

from gapmes.service import write_gaussians, write_ply
from gapmes.service.pictures.film import FilmShape, write_film
from gapmes.service.process.disk import replace_file, replacing, write_file

# Under nohup the signal would be ignored.
COMMAND = """
import signal
signal.signal(signal.SIGHUP, signal.SIG_DFL)
from gapmes.service.cli import main
main()
"""


def write_gif(path: Path) -> None:
    write_film(
        path, FilmShape("gif", 64, 64, 2, 0.5), np.random.default_rng(0).integers(0, 256, (2, 64, 64, 3), np.uint8)
    )


WRITERS: dict[str, Callable[[Path], object]] = {
    "bytes": lambda path: replace_file(path, bytes(2000)),
    "film": write_gif,
    "ply": lambda path: write_ply(path, cloud(60, 1, degree=0)),
    "splat": lambda path: write_gaussians(path, cloud(60, 1, degree=0), format="splat"),
}


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
@pytest.mark.parametrize("before", [{}, {"file": b"as it was"}])
def test_a_write_that_fails_changes_nothing(
    tmp_path: Path, write: Callable[[Path], object], before: dict[str, bytes]
) -> None:
    for name, data in before.items():
        (tmp_path / name).write_bytes(data)
    with full_disk(), pytest.raises(OSError, match="large") as failure:
        write(tmp_path / "file")
    assert failure.value.errno == errno.EFBIG
    assert contents(tmp_path) == before
    write(tmp_path / "file")
    assert list(contents(tmp_path)) == ["file"]
    assert (tmp_path / "file").stat().st_size > LIMIT


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
@pytest.mark.parametrize("mode", [0o600, 0o640, 0o444, 0o666])
def test_a_file_that_is_replaced_keeps_its_permissions(
    tmp_path: Path, write: Callable[[Path], object], mode: int
) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "file").chmod(mode)
    write(tmp_path / "file")
    write(tmp_path / "new")
    assert (tmp_path / "file").stat().st_size > 0
    assert stat.S_IMODE((tmp_path / "file").stat().st_mode) == mode
    (tmp_path / "plain").touch()
    assert (tmp_path / "new").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_nobody_else_reads_what_becomes_a_private_file(tmp_path: Path) -> None:
    (tmp_path / "file").touch(0o600)
    with replacing(tmp_path / "file") as part:
        write_file(part, b"private")
        assert stat.S_IMODE(part.stat().st_mode) == 0o600


def test_what_is_raised_inside_ends_it(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"as it was")

    def interrupted() -> None:
        with replacing(tmp_path / "file") as part:
            part.write_bytes(b"half of")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert contents(tmp_path) == {"file": b"as it was"}


def test_a_folder_that_is_not_there_is_named_by_the_file_that_was_asked_for(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as caught:
        replace_file(tmp_path / "no" / "x.ply", b"")
    assert caught.value.filename == str(tmp_path / "no" / "x.ply")
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(NotADirectoryError):
        replace_file(tmp_path / "file" / "x.ply", b"")


def test_a_link_stays_one_and_a_long_name_is_no_trouble(tmp_path: Path) -> None:
    file = tmp_path / ("n" * 255)
    link = tmp_path / "link"
    link.symlink_to(file)
    replace_file(link, b"new")
    assert link.is_symlink()
    assert file.read_bytes() == b"new"


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
def test_a_pipe_is_written_to_and_stays_one_also_behind_a_link(tmp_path: Path, write: Callable[[Path], object]) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to(tmp_path / "pipe")
    write(tmp_path / "file")
    for name in ("pipe", "link"):
        found: list[bytes] = []
        reader = threading.Thread(target=lambda out=found: out.append((tmp_path / "pipe").read_bytes()), daemon=True)
        reader.start()
        write(tmp_path / name)
        reader.join(120)
        assert found == [(tmp_path / "file").read_bytes()]
        assert (tmp_path / "pipe").is_fifo()
    assert (tmp_path / "link").is_symlink()
    assert sorted(os.listdir(tmp_path)) == ["file", "link", "pipe"]


def test_a_pipe_hears_nothing_of_what_fails(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ValueError, match="1 frames, the film has 2"):  # opening the pipe would wait for a reader
        write_film(tmp_path / "pipe", FilmShape("gif", 8, 8, 2, 0.5), np.zeros((1, 8, 8, 3), np.uint8))
    assert (tmp_path / "pipe").is_fifo()


@pytest.mark.parametrize("ending", [signal.SIGTERM, signal.SIGHUP])
def test_a_command_that_is_told_to_end_leaves_no_half_of_a_file(folder: Path, ending: signal.Signals) -> None:
    there = contents(folder)
    words = [sys.executable, "-c", COMMAND, *RENDER, "film.gif", "--seconds", "600", "-q"]
    with subprocess.Popen(words, cwd=folder) as process:
        deadline = time.monotonic() + 120
        while not list(folder.glob(".gapmes-*")):
            assert time.monotonic() < deadline
            time.sleep(0.05)
        process.send_signal(ending)
        assert process.wait(120) == -ending
    assert contents(folder) == there


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_cameras_json(tmp_path, arc(2))
    write_ply(tmp_path / "scene.ply", cloud(300, 3, degree=0))
    return tmp_path


RENDER = ("render", "scene.ply", "--cameras", "cameras.json", "-o")


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("convert", "scene.ply", "scene.ply", "--measure", "off"), "scene.ply: "),
        (("convert", "scene.ply", "scene.splat", "--measure", "off"), "scene.splat: "),
        ((*RENDER, "pictures"), "pictures/view_0.png: "),
        ((*RENDER, "sheet.png", "--sheet"), "sheet.png: "),
        ((*RENDER, "film.gif", "--seconds", "0.2", "--fps", "10"), "film.gif: "),
        (("reconstruct", ".", "-o", "scene.ply", "--near", "2", "--far", "8", "--trust-poses"), "scene.ply: "),
    ],
    ids=["convert-in-place", "convert", "pictures", "sheet", "film", "reconstruct"],
)
def test_commands_on_a_full_disk_lose_nothing(
    folder: Path, standin_model: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str],
    arguments: tuple[str, ...], named: str,
) -> None:  # fmt: skip
    monkeypatch.chdir(folder)
    more = ("--model", standin_model) if arguments[0] == "reconstruct" else ()
    assert run(*arguments, *more, "-q", "--threads", 1) == 0  # kernels are compiled, and there is something to lose
    before = contents(folder)
    with full_disk():
        assert run(*arguments, *more, "-q", "--threads", 1, "--json") == 1
    out, err = capfd.readouterr()
    error = json.loads(out)["error"]
    assert (error["code"], error["cure"]) == ("storage_error", "is there room, and permission to read and write there?")
    assert error["detail"] == f"{named}File too large"
    assert err == f"error: {error['detail']} ({error['cure']})\n"
    assert contents(folder) == before
