"""Paths that a command of `gapmes` is given: without a name, not to be read or written, of the wrong kind."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest
from cli_runs import assert_refusal, run


@pytest.mark.parametrize(
    "arguments",
    [
        ("render", "a.ply", "--cameras", "cameras.json", "-o"),
        ("reconstruct", "capture", "-o"),
        ("convert", "a.ply", "--to", "spz"),
        ("demo", "-o"),
        ("evaluate", "missing", "-o"),
    ],
    ids=lambda arguments: arguments[0],
)
@pytest.mark.parametrize(("output", "why"), [("", "is empty"), ("-", "does not stand for stdout")])
def test_an_output_without_a_name_is_refused(
    arguments: tuple[str, ...],
    output: str,
    why: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """An empty one would mean the working folder, and - a file or folder of that name."""
    monkeypatch.chdir(tmp_path)
    assert run(*arguments, output) == 2
    assert why in " ".join(capfd.readouterr().err.split())


def test_who_may_not_write_is_told_as_whom_that_was(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """In a container that is a number, which the folder of a host must belong to."""

    def refused(path: Path, *_: object, **__: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(Path, "mkdir", refused)
    monkeypatch.setenv("TMPDIR", "/data/tmp")
    assert run("serve") == 1
    cure = f"is there room, and permission to read and write there as uid {os.getuid()}?"
    assert capfd.readouterr().err == f"error: /data/tmp: Permission denied ({cure})\n"


@pytest.mark.parametrize(
    "arguments",
    [
        ("convert", "file", "file"),
        ("reconstruct", "file", "-o", "file"),
        ("reconstruct", "missing", "-o", "missing", "--model", "file"),
        ("render", "file", "--cameras", "file", "-o", "file"),
        ("demo", "-o", "file", "--keep"),
        ("evaluate", "file", "--model", "file", "-o", "file", "--lpips", "file"),
    ],
    ids=" ".join,
)
def test_files_are_looked_at_by_the_commands_and_not_as_usage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], arguments: tuple[str, ...]
) -> None:
    """What may not be read is refused as the system says, and what may be written alone is no wrong usage."""
    (tmp_path / "file").touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("GAPMES_PORT", "none, so that no service starts")
    monkeypatch.setattr(os, "access", lambda _, mode, **__: mode != os.R_OK)
    assert run(*arguments, "--json") == 1
    assert_refusal(capfd, "error: ")


@pytest.mark.parametrize(
    ("number", "cure"),
    [
        (errno.ENAMETOOLONG, "give it a shorter name"),
        (errno.EISDIR, "a folder has that name: move it away, or write elsewhere"),
        (errno.ENOSPC, "is there room, and permission to read and write there?"),
    ],
)
def test_a_cure_is_for_what_the_system_refuses(
    number: int, cure: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def refused(path: Path) -> bytes:
        raise OSError(number, os.strerror(number), str(path))

    (tmp_path / "in.ply").touch()
    monkeypatch.setattr(Path, "read_bytes", refused)
    assert run("convert", tmp_path / "in.ply", tmp_path / "out.ply", "--json") == 1
    assert assert_refusal(capfd, f"{os.strerror(number)} ({cure})")["cure"] == cure


def test_a_file_that_may_not_be_read_is_refused_as_the_system_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def refused(path: Path) -> bytes:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    (tmp_path / "in.ply").touch()
    monkeypatch.setattr(os, "access", lambda _, mode, **__: mode != os.R_OK)
    monkeypatch.setattr(Path, "read_bytes", refused)
    assert run("convert", tmp_path / "in.ply", tmp_path / "in.ply", "--json") == 1
    assert assert_refusal(capfd, "in.ply: Permission denied (is there room, ")["code"] == "storage_error"


@pytest.mark.parametrize("name", ["film.avi", "one.png", "one.JPG", ".webp", ".png"])
def test_pictures_do_not_go_into_a_folder_that_is_named_as_a_file(
    name: str, scene_dir: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run("render", tmp_path / "none.ply", "--cameras", scene_dir, "-o", tmp_path / name, "--json") == 1
    assert_refusal(capfd, f"output: '{name}' names a file, and pictures go into a folder")
    assert not (tmp_path / name).exists()
