"""An index that is made anew: nobody reads it before it is filled, and one that could not be is filled later."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from store_folder import document

from gapmes.service.errors import StorageFull
from gapmes.service.process.file_lock import shared
from gapmes.service.scenes.database import Database
from gapmes.service.scenes.store import SceneStore

ADD = "INSERT INTO scenes VALUES ('x', 1, 1, 1, '{}')"
ASK = "SELECT id FROM scenes"


def deleted(folder: Path) -> None:
    for path in folder.glob("index.sqlite*"):
        if not path.name.endswith(".lock"):
            path.unlink()


def add(database: Database) -> None:
    with database.write() as connection:
        connection.execute(ADD)


@pytest.mark.parametrize("object_", ["the same", "another"])
def test_who_asks_while_it_is_filled_waits(tmp_path: Path, object_: str) -> None:
    """Another object stands for another process."""
    database = Database(tmp_path / "index.sqlite")
    asked = database if object_ == "the same" else Database(tmp_path / "index.sqlite")
    with ThreadPoolExecutor(1) as threads:
        assert threads.submit(asked.rows, ASK).result(60) == []  # that thread has a connection to the deleted file

        def fill() -> None:
            found = threads.submit(asked.rows, ASK)
            with pytest.raises(TimeoutError):
                found.result(0.3)
            add(database)
            answers.append(found)

        answers: list = []
        database.fill = fill
        deleted(tmp_path)
        assert [row["id"] for row in database.rows(ASK)] == ["x"]
        (found,) = answers
        assert [row["id"] for row in found.result(60)] == ["x"]


def test_one_that_could_not_be_filled_is_filled_at_the_next_request(tmp_path: Path) -> None:
    database = Database(tmp_path / "index.sqlite")
    found: list[list[str]] = []

    def full() -> None:
        add(database)
        raise StorageFull("no space for the index", field="store", cure="delete scenes")

    database.fill = full
    deleted(tmp_path)
    for _ in range(2):
        with pytest.raises(StorageFull):
            database.rows(ASK)
        deleted(tmp_path)
    with pytest.raises(StorageFull):
        database.rows(ASK)
    database.fill = lambda: found.append([row["id"] for row in database.rows(ASK)])
    assert [row["id"] for row in database.rows(ASK)] == ["x"]
    assert found == [["x"]]  # what an interrupted one has listed is there, too


def test_one_that_is_deleted_while_it_is_filled_is_made_once_more(tmp_path: Path) -> None:
    database = Database(tmp_path / "index.sqlite")
    filled: list[bool] = []

    def fill() -> None:
        filled.append(True)
        if len(filled) == 1:
            deleted(tmp_path)
        add(database)

    database.fill = fill
    deleted(tmp_path)
    database.ensure_there()
    assert [row["id"] for row in database.rows(ASK)] == ["x"]
    assert len(filled) == 2


def test_a_process_that_starts_without_an_index_lists_all_though_another_writes_to_the_store(tmp_path: Path) -> None:
    ids = {name * 32 for name in "abc"}
    one = SceneStore(tmp_path)
    for scene_id in ids:
        one.put(scene_id, b"ply", document(scene_id))
    deleted(tmp_path)
    with shared(tmp_path / ".lock"):
        two = SceneStore(tmp_path)
        for store in (two, one):
            assert {row.id for row in store.page(9)} == ids


def test_a_running_process_waits_for_one_that_starts_to_fill_it(tmp_path: Path) -> None:
    running = Database(tmp_path / "index.sqlite")
    deleted(tmp_path)
    with ThreadPoolExecutor(1) as threads:
        answers: list = []

        def fill(starting: Database) -> None:
            found = threads.submit(running.rows, ASK)
            with pytest.raises(TimeoutError):
                found.result(0.3)
            add(starting)
            answers.append(found)

        Database(tmp_path / "index.sqlite", fill)
        (found,) = answers
        assert [row["id"] for row in found.result(60)] == ["x"]


def test_one_that_is_deleted_while_a_process_starts_on_it_does_not_hold_it_up(tmp_path: Path) -> None:
    filled: list[bool] = []

    def fill(starting: Database) -> None:
        filled.append(True)
        if len(filled) == 1:
            deleted(tmp_path)
        add(starting)

    database = Database(tmp_path / "index.sqlite", fill)
    assert [row["id"] for row in database.rows(ASK)] == ["x"]
    assert len(filled) == 2
