"""The service writes temporary files into TMPDIR or nowhere, and says at its start where that is impossible."""

from __future__ import annotations

import errno
import os
import tempfile
from pathlib import Path

import pytest

from gapmes.service.errors import InputError, ServiceBusy
from gapmes.service.process.temporary_folder import temporary_files, use_temporary_folder


@pytest.fixture
def undecided(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", None)


@pytest.mark.usefixtures("undecided")
def test_no_other_folder_takes_the_place_of_one_that_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path / "volume" / "tmp"))
    use_temporary_folder()

    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "open", full)
    assert tempfile.gettempdir() == str(tmp_path / "volume" / "tmp")


@pytest.mark.usefixtures("undecided")
def test_a_folder_that_cannot_be_written_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(os, "access", lambda path, _: path != str(tmp_path))
    with pytest.raises(PermissionError, match=str(tmp_path)):
        use_temporary_folder()


@pytest.mark.usefixtures("undecided")
def test_without_any_folder_the_error_names_the_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TMPDIR", raising=False)
    monkeypatch.setattr(tempfile, "_candidate_tempdir_list", lambda: ["/proc/none"])
    with pytest.raises(
        InputError, match=r"is not set, and there is no usable temporary directory found in \['/proc/none'\]"
    ):
        use_temporary_folder()


def test_a_folder_that_was_deleted_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "volume" / "tmp"
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    with temporary_files("the upload"), tempfile.TemporaryFile() as file:
        file.write(b"large")
    folder.rmdir()
    folder.write_text("no folder")
    with (
        pytest.raises(ServiceBusy, match="the folder tmp was deleted and cannot be made again: File exists") as caught,
        temporary_files("the upload"),
    ):
        pass
    assert caught.value.field == "TMPDIR"
