"""A store in a process that may open no further file: a fault of the moment, and none of the disk."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest
from open_files import no_file_left

from gapmes.service.errors import ServiceBusy
from gapmes.service.scenes.database import Database
from gapmes.service.scenes.scene_files import SceneFiles


def test_a_thread_that_finds_no_file_left_may_try_again(tmp_path: Path) -> None:
    """Its connection is its own; another that is open already serves on."""
    database = Database(tmp_path / "index.sqlite")
    told: list[BaseException | None] = []

    def ask() -> None:
        try:
            database.rows("SELECT 1")
            told.append(None)
        except BaseException as error:
            told.append(error)

    def ask_elsewhere() -> None:
        thread = threading.Thread(target=ask)
        thread.start()
        thread.join()

    with no_file_left():
        ask_elsewhere()
        ask()
    ask_elsewhere()
    assert isinstance(told[0], ServiceBusy)
    assert told[1:] == [None, None]


def test_whether_it_can_be_written_is_not_known_then(tmp_path: Path) -> None:
    database, files = Database(tmp_path / "index.sqlite"), SceneFiles(tmp_path)
    with no_file_left(but=1), pytest.raises(ServiceBusy, match="may open no further file now"):
        database.writable()  # its file can be opened then, and its log cannot
    with no_file_left():
        for part in (database, files):
            with pytest.raises(ServiceBusy, match="may open no further file now"):
                part.writable()
    assert database.writable()
    assert files.writable()
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".incoming")] == []


def test_a_log_that_cannot_be_opened_is_no_lack_of_files(tmp_path: Path) -> None:
    """Such as one that belongs to another user, or is a folder."""
    database = Database(tmp_path / "index.sqlite")
    (tmp_path / "index.sqlite-wal").unlink()
    (tmp_path / "index.sqlite-wal").mkdir()
    assert not database.writable()
