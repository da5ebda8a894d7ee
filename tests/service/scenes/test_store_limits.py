"""The store's limits: what is evicted by size or age, and what never is."""

from __future__ import annotations

import fcntl
import json
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from store_folder import CAMERA, document

from gapmes.service.errors import SceneNotFound, StorageFull
from gapmes.service.scenes.scene_index import TOUCH_NS, SceneIndex
from gapmes.service.scenes.store import DAY_NS, SceneStore

IDS = [f"{number:032x}" for number in range(9)]
PLY = b"x" * 1000


def made(scene_id: str) -> dict[str, Any]:
    return document(scene_id, text="y" * 50)


ONE = len(PLY) + len(json.dumps(made(IDS[0])))


def filled(root: Path, count: int, **limits: float) -> SceneStore:
    store = SceneStore(root, **limits)
    for scene_id in IDS[:count]:
        store.put(scene_id, PLY, made(scene_id))
    return store


def aged(store: SceneStore, scene_id: str, days: float) -> None:
    with store.database.write() as connection:
        connection.execute(
            "UPDATE scenes SET used_ns = ? WHERE id = ?", [time.time_ns() - int(days * DAY_NS), scene_id]
        )


def listed(store: SceneStore) -> set[str]:
    found = {row.id for row in store.page(100)}
    assert found == {path.name for path in store.root.iterdir() if len(path.name) == 32}
    return found


def test_totals_are_those_of_the_files(tmp_path: Path) -> None:
    assert filled(tmp_path, 3).totals() == (3, 3 * ONE)


def test_what_was_read_longest_ago_goes_first(tmp_path: Path) -> None:
    store = filled(tmp_path, 4, max_bytes=4 * ONE)
    for age, scene_id in enumerate(IDS[:4]):
        aged(store, scene_id, 10 - age)
    store.ply(IDS[0])  # read now
    store.put(IDS[4], PLY, made(IDS[4]))
    assert listed(store) == {IDS[0], IDS[2], IDS[3], IDS[4]}
    store.put(IDS[5], PLY * 2, made(IDS[5]))
    assert listed(store) == {IDS[0], IDS[4], IDS[5]}
    assert store.totals()[1] <= 4 * ONE


def test_what_is_being_read_never_goes(tmp_path: Path) -> None:
    store = filled(tmp_path, 2, max_bytes=2 * ONE)
    aged(store, IDS[0], 5)
    other = SceneStore(tmp_path, max_bytes=2 * ONE)  # as another process
    with store.reading(IDS[0]) as path:
        other.put(IDS[2], PLY, made(IDS[2]))
        assert path.read_bytes() == PLY
        assert listed(other) == {IDS[0], IDS[2]}
        with store.reading(IDS[2]), pytest.raises(StorageFull, match="are being read") as caught:
            other.put(IDS[3], PLY, made(IDS[3]))
        assert caught.value.status == 507
        assert listed(other) == {IDS[0], IDS[2]}
    other.put(IDS[3], PLY, made(IDS[3]))
    assert listed(other) == {IDS[2], IDS[3]}


def test_a_scene_beyond_the_limit_is_refused_and_takes_no_other_along(tmp_path: Path) -> None:
    store = filled(tmp_path, 2, max_bytes=2 * ONE)
    size = ONE + 9 * len(PLY)
    with pytest.raises(StorageFull, match=rf"the scene has {size} bytes, more than the store's limit of {2 * ONE}"):
        store.put(IDS[5], PLY * 10, made(IDS[5]))
    assert listed(store) == set(IDS[:2])


def test_all_files_of_a_scene_count(tmp_path: Path) -> None:
    """Its document and the pictures of its inputs, too."""
    store = filled(tmp_path, 1, max_bytes=2 * ONE + 9)
    store.put(IDS[1], PLY, made(IDS[1]), [b"x" * 5, b"x" * 4])
    assert listed(store) == {IDS[0], IDS[1]}
    assert store.totals()[1] == store.max_bytes
    store.delete(IDS[0])
    store.put(IDS[2], PLY, document(IDS[2], text="y" * 51))
    assert listed(store) == {IDS[2]}


def test_a_scene_that_a_crash_left_unlisted_is_listed_when_it_is_met_again(tmp_path: Path) -> None:
    store = filled(tmp_path, 2)
    with store.database.write() as connection:
        connection.execute("DELETE FROM scenes")
    store.put(IDS[0], b"other", document(IDS[0]))
    assert store.listed(IDS[1])
    assert not store.listed(IDS[2])
    assert listed(store) == set(IDS[:2])
    assert store.ply(IDS[0]) == PLY


@pytest.mark.parametrize("files", [{}, {"scene.json": b""}, {"scene.json": b"{", "scene.ply": PLY}, {"scene.ply": PLY}])
def test_what_a_power_cut_may_leave_does_not_keep_the_store_from_opening(
    tmp_path: Path, files: dict[str, bytes], caplog: pytest.LogCaptureFixture
) -> None:
    filled(tmp_path, 1)
    (tmp_path / IDS[3]).mkdir()
    for name, content in files.items():
        (tmp_path / IDS[3] / name).write_bytes(content)
    assert [row.id for row in SceneStore(tmp_path).page(9)] == [IDS[0]]
    assert IDS[3] in caplog.text


def test_reading_goes_on_where_the_last_use_cannot_be_noted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = filled(tmp_path, 1)
    aged(store, IDS[0], 3)

    def full(*_: object) -> None:
        raise StorageFull("no space for the index")

    monkeypatch.setattr(store.database, "write", full)
    assert store.ply(IDS[0]) == PLY


def test_what_nobody_reads_for_days_goes(tmp_path: Path) -> None:
    store = filled(tmp_path, 3, max_days=2.0)
    assert store.evict_old() == 0
    for scene_id in IDS[:2]:
        aged(store, scene_id, 2.5)
    with store.reading(IDS[1]):
        assert store.evict_old() == 1
    assert listed(store) == {IDS[1], IDS[2]}
    assert store.evict_old() == 0  # reading it made it young
    assert filled(tmp_path, 3).evict_old() == 0  # without a limit


def test_a_limit_that_was_lowered_holds_before_anything_is_stored(tmp_path: Path) -> None:
    store = filled(tmp_path, 4)
    for age, scene_id in enumerate(IDS[:4]):
        aged(store, scene_id, 10 - age)
    with store.reading(IDS[0]), store.reading(IDS[1]):  # which makes them the youngest
        lowered = SceneStore(tmp_path, max_bytes=ONE)
        assert lowered.evict_old() == 2
        assert listed(store) == set(IDS[:2])
    assert lowered.evict_old() == 1


@pytest.mark.parametrize("read", [SceneStore.document, lambda store, scene_id: store.input(scene_id, 0)])
def test_who_reads_anything_of_a_scene_reads_it(tmp_path: Path, read: Callable[[SceneStore, str], object]) -> None:
    store = SceneStore(tmp_path, max_days=1.0)
    for scene_id in IDS[:2]:
        store.put(scene_id, PLY, made(scene_id), [b"a picture"])
        aged(store, scene_id, 2)
    read(store, IDS[0])
    store.evict_old()
    assert listed(store) == {IDS[0]}


def test_a_scene_that_cannot_be_listed_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is refused leaves nothing behind; one that was there before stays."""
    store = filled(tmp_path, 1)

    def full(*_: object) -> None:
        raise StorageFull("no space for the list")

    monkeypatch.setattr(SceneIndex, "add", full)
    for scene_id in IDS[:2]:
        with pytest.raises(StorageFull, match="for the list"):
            store.put(scene_id, PLY, made(scene_id))
    assert listed(store) == {IDS[0]}


def test_a_store_can_be_written_while_a_process_that_starts_sweeps_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, write = SceneStore(tmp_path), Path.write_bytes

    def swept(path: Path, content: bytes) -> None:
        write(path, content)
        SceneStore(tmp_path)

    monkeypatch.setattr(Path, "write_bytes", swept)
    assert store.writable()


def test_reading_is_noted_to_a_minute(tmp_path: Path) -> None:
    store = filled(tmp_path, 1)
    before = store.page(1)[0].used_ns
    store.ply(IDS[0])
    assert store.page(1)[0].used_ns == before
    aged(store, IDS[0], 1.5 * TOUCH_NS / DAY_NS)
    store.ply(IDS[0])
    assert store.page(1)[0].used_ns > before


def test_a_last_use_that_lies_ahead_is_set_right(tmp_path: Path) -> None:
    """A clock that was fast has noted it: by who reads, when the store is opened, and when it is tidied."""
    store = filled(tmp_path, 2)
    for set_right in (lambda: store.ply(IDS[0]), lambda: SceneStore(tmp_path), store.evict_old):
        aged(store, IDS[0], -3)
        set_right()
        assert {row.used_ns <= time.time_ns() for row in store.page(9)} == {True}


def test_what_a_fast_clock_has_stored_is_evicted_in_its_turn(tmp_path: Path) -> None:
    store = filled(tmp_path, 2, max_bytes=2 * ONE)
    aged(store, IDS[0], -3)
    store.evict_old()
    aged(store, IDS[1], -0.5 * TOUCH_NS / DAY_NS)  # read a moment later
    store.put(IDS[2], PLY, made(IDS[2]))
    assert listed(store) == {IDS[1], IDS[2]}


def test_a_clock_that_has_not_been_set_yet_makes_no_stamp_old(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Set right by it, all scenes would be too old once it is set."""
    store = filled(tmp_path, 2, max_days=1.0)
    monkeypatch.setattr(time, "time_ns", lambda: 10**15)  # 1970
    SceneStore(tmp_path)
    store.ply(IDS[0])
    assert store.evict_old() == 0
    monkeypatch.undo()
    assert store.evict_old() == 0


@pytest.mark.parametrize("days", [-3, 3])
def test_the_newest_is_what_was_stored_last_whatever_the_clock_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, days: float
) -> None:
    """Also for another process, and after the list was lost."""
    store, other = SceneStore(tmp_path), SceneStore(tmp_path)
    true = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: true() + int(days * DAY_NS))
    store.put(IDS[8], PLY, made(IDS[8]))
    monkeypatch.undo()
    for scene_id in (IDS[5], IDS[3]):
        other.put(scene_id, PLY, made(scene_id))
        assert store.newest() == scene_id
    (tmp_path / "index.sqlite").unlink()
    assert [row.id for row in SceneStore(tmp_path).page(9)] == [IDS[3], IDS[5], IDS[8]]


def test_a_file_from_the_far_future_does_not_keep_the_store_from_opening(tmp_path: Path) -> None:
    filled(tmp_path, 2)
    os.utime(tmp_path / IDS[0] / "scene.json", (2**34, 2**34))  # the year 2514, beyond what 64 bits hold in nanoseconds
    (tmp_path / "index.sqlite").unlink()
    store = SceneStore(tmp_path)
    assert store.newest() == IDS[0]
    store.put(IDS[2], PLY, made(IDS[2]))
    assert store.newest() == IDS[2]


def test_any_number_of_days_is_a_limit(tmp_path: Path) -> None:
    store = filled(tmp_path, 2, max_days=1e9)  # before 1970
    aged(store, IDS[0], 300)
    assert store.evict_old() == 0


def test_the_index_follows_the_folders(tmp_path: Path) -> None:
    store = filled(tmp_path, 3)
    store.put(IDS[8], PLY, document(IDS[8], created="then", gaussians={"count": 7}, view_cameras=[CAMERA, CAMERA]))
    for scene_id in IDS[:2]:
        for file in (tmp_path / scene_id).iterdir():
            file.unlink()
        (tmp_path / scene_id).rmdir()
    (tmp_path / "index.sqlite").unlink()
    again = SceneStore(tmp_path)
    assert listed(again) == {IDS[2], IDS[8]}
    assert again.page(1)[0].summary == {"id": IDS[8], "created": "then", "gaussians": 7, "views": 2, "file": None}
    assert again.totals() == (2, again.totals()[1])


def test_an_index_that_was_kept_follows_folders_that_came_and_went(tmp_path: Path) -> None:
    """Under a root whose own folder is missing, too, as on a new volume."""
    root, other = tmp_path / "new" / "scenes", tmp_path / "other"
    filled(root, 3)
    SceneStore(other).put(IDS[5], PLY, made(IDS[5]))
    (root / IDS[1]).rename(tmp_path / "taken")
    (other / IDS[5]).rename(root / IDS[5])
    assert listed(SceneStore(root)) == {IDS[0], IDS[2], IDS[5]}


def test_a_scene_that_is_listed_but_gone_is_not_the_newest(tmp_path: Path) -> None:
    store = filled(tmp_path, 2)
    (tmp_path / IDS[1]).rename(tmp_path.parent / "taken")
    assert store.newest() == IDS[0]
    (tmp_path / IDS[0]).rename(tmp_path.parent / "too")
    with pytest.raises(SceneNotFound):
        store.newest()


def test_a_limit_holds_while_many_write_and_read(tmp_path: Path) -> None:
    """Four writers of different scenes and a reader; nothing half is ever seen."""
    store, failures = SceneStore(tmp_path, max_bytes=3 * ONE), []

    def write(number: int) -> None:
        for step in range(25):
            scene_id = f"{number:016x}{step:016x}"
            try:
                store.put(scene_id, PLY, made(scene_id))
                assert store.ply(scene_id) == PLY
            except (SceneNotFound, StorageFull):  # another writer's scene took its place, or all are being read
                continue
            except Exception as error:
                failures.append(error)

    threads = [threading.Thread(target=write, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []
    assert 1 <= len(listed(store)) <= 3


def test_a_store_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = filled(tmp_path, 1)
    assert store.writable()

    def full(*_: object) -> int:
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(Path, "write_bytes", full)
    assert not store.writable()
    assert listed(store) == {IDS[0]}


def test_a_store_whose_index_takes_nothing_cannot_be_written(tmp_path: Path) -> None:
    store = filled(tmp_path, 1)
    with store.database.write() as connection:
        connection.execute("DROP TABLE waits")
    assert not store.writable()


def test_a_delete_does_not_wait_for_a_reader(tmp_path: Path) -> None:
    store = filled(tmp_path, 1)
    handle = os.open(tmp_path / IDS[0] / "scene.ply", os.O_RDONLY)
    fcntl.flock(handle, fcntl.LOCK_SH)
    store.delete(IDS[0])
    assert os.read(handle, 10) == PLY[:10]
    os.close(handle)
    assert listed(store) == set()


def test_days_are_of_24_hours_and_reading_counts_after_two_minutes(tmp_path: Path) -> None:
    store = filled(tmp_path, 3, max_days=1.0)
    hour, now = 3600 * 10**9, time.time_ns()
    with store.database.write() as connection:
        for scene_id, hours in zip(IDS, (23, 25, 2 / 60), strict=False):
            connection.execute("UPDATE scenes SET used_ns = ? WHERE id = ?", [now - int(hours * hour), scene_id])
    store.ply(IDS[2])
    assert {row.id: row.used_ns >= now for row in store.page(9)}[IDS[2]]
    assert store.evict_old() == 1
    assert listed(store) == {IDS[0], IDS[2]}
