"""The store: all or nothing, the first put wins, no path from outside, and a bounded cache."""

import errno
import fcntl
import os
import threading

import numpy as np
import pytest
from store_folder import document, gaussians, names

from gapmes.service.errors import GapmesError, SceneNotFound, StorageFull
from gapmes.service.formats.ply import ply_bytes
from gapmes.service.scenes.store import SceneStore

A, B, C = "a" * 32, "b" * 32, "c" * 32


PLY = ply_bytes(gaussians())


@pytest.fixture
def store(tmp_path):
    return SceneStore(tmp_path / "scenes")


def test_what_is_put_can_be_read(store):
    given = document(A, count=5, text="ä \ud800")  # the last one is what UTF-8 cannot hold
    store.put(A, PLY, given)
    assert store.document(A) == given
    assert store.ply(A) == PLY
    np.testing.assert_allclose(store.gaussians(A).means, gaussians().means, rtol=1e-6)
    assert store.exists(A)
    assert not store.exists(B)
    assert SceneStore(store.root).document(A) == given


@pytest.mark.parametrize("name", [".jobs", ".processes", ".lock", "index.sqlite-wal"])
def test_files_of_the_service_that_root_has_made_are_named(tmp_path, monkeypatch, name):
    """As by a start as root; each request that needs them would fail."""
    SceneStore(tmp_path)
    (tmp_path / name).touch()
    monkeypatch.setattr(os, "access", lambda path, _: path != tmp_path / name)
    with pytest.raises(GapmesError, match=f"{tmp_path / name} cannot be used: Permission denied") as refused:
        SceneStore(tmp_path)
    assert refused.value.cure.endswith(f"(uid {os.getuid()}) may write, and all that the service keeps in it")


def test_a_folder_that_cannot_be_one_is_refused(tmp_path):
    (tmp_path / "file").write_text("no folder")
    for root in (tmp_path / "file", tmp_path / "file" / "scenes"):
        with pytest.raises(GapmesError, match="cannot be used") as caught:
            SceneStore(root)
        assert caught.value.field == "store"
        assert "GAPMES_STORE" in caught.value.cure
        assert f"this user (uid {os.getuid()})" in caught.value.cure


def test_the_first_put_wins(store):
    assert store.put(A, PLY, document(A, n=1))
    assert not store.put(A, b"other", document(A, n=2))
    assert store.document(A) == document(A, n=1)
    assert store.ply(A) == PLY
    assert names(store.root) == {A}


def test_many_threads_put_one_scene(store):
    """Each writes its own document; exactly one is kept, whole, and nobody fails."""
    start, failures = threading.Barrier(8), []

    def put(number):
        start.wait()
        try:
            store.put(A, PLY + bytes([number]), document(A, n=number))
        except Exception as error:
            failures.append(error)

    threads = [threading.Thread(target=put, args=(i,)) for i in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []
    assert store.ply(A) == PLY + bytes([store.document(A)["n"]])
    assert names(store.root) == {A}


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
@pytest.mark.parametrize("file", [1, 2])
def test_a_full_disk_leaves_nothing_behind(store, monkeypatch, number, file):
    calls = []

    def full(handle):
        calls.append(handle)
        if len(calls) == file:
            raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StorageFull, match=r"no space for the scene") as caught:
        store.put(A, PLY, document(A))
    assert caught.value.status == 507
    assert names(store.root) == set()
    monkeypatch.undo()
    store.put(A, PLY, document(A))
    assert store.exists(A)


def test_other_failures_leave_nothing_behind_either(store):
    with pytest.raises(ValueError, match="JSON compliant"):
        store.put(A, PLY, document(A, x=float("nan")))
    assert names(store.root) == set()


def test_leftovers_of_a_crash_are_removed_at_start(store):
    leftover = store.root / ".incoming-abc"
    leftover.mkdir()
    (leftover / "scene.ply").write_bytes(b"half")
    store.put(A, PLY, document(A))
    assert names(SceneStore(store.root).root) == {A}


def test_what_another_process_is_writing_is_left_alone(store):
    (store.root / ".incoming-abc").mkdir()
    handle = os.open(store.root / ".lock", os.O_RDWR)  # a second open file is a second holder, as in another process
    fcntl.flock(handle, fcntl.LOCK_SH)
    SceneStore(store.root)
    assert ".incoming-abc" in names(store.root)
    os.close(handle)
    SceneStore(store.root)
    assert ".incoming-abc" not in names(store.root)


BAD_IDS = [
    "",
    "..",
    "../" + A,
    A + "/..",
    A.upper(),
    A[:-1],
    A + "0",
    "a" * 31 + "\n",
    A + "\n",
    "/etc/passwd",
    "%2e%2e",
    "a\0" + A,
]


@pytest.mark.parametrize("scene_id", BAD_IDS)
def test_what_is_no_id_never_becomes_a_path(store, scene_id):
    (store.root.parent / "scene.json").write_text("{}")
    for call in (store.document, store.ply, store.gaussians, store.delete, lambda i: store.put(i, PLY, document(i))):
        with pytest.raises(SceneNotFound) as caught:
            call(scene_id)
        assert caught.value.status == 404
    assert not store.exists(scene_id)
    assert names(store.root) == set()


def test_unknown_ids_are_not_found(store):
    for call in (store.document, store.ply, store.gaussians, store.delete):
        with pytest.raises(SceneNotFound, match=A):
            call(A)


def test_newest_first_and_stable(store):
    with pytest.raises(SceneNotFound, match="holds no scene"):
        store.newest()
    for scene_id in (B, A, C):  # put faster than a file system's clock ticks
        store.put(scene_id, PLY, document(scene_id))
    assert [row.id for row in store.page(10)] == [C, A, B]
    assert store.newest() == C
    store.put(B, PLY, document(B))  # already there: it does not become newer
    assert SceneStore(store.root).newest() == C
    for scene_id in (A, B):
        os.utime(store.root / scene_id / "scene.json", ns=(10**18, 10**18))
    (store.root / "index.sqlite").unlink()  # listed anew from the folders
    anew = SceneStore(store.root)
    assert [row.id for row in anew.page(10)] == [C, A, B]  # same instant: by id
    first = anew.page(1)[0]
    assert [row.id for row in anew.page(1, (first.created_ns, first.id))] == [A]
    assert [row.id for row in anew.page(9, (10**18, A))] == [B]


def test_delete_forgets_everywhere(store):
    store.put(A, PLY, document(A))
    store.gaussians(A)
    store.delete(A)
    assert not store.exists(A)
    assert list(store.page(10)) == []
    with pytest.raises(SceneNotFound):
        store.gaussians(A)
    store.put(A, PLY, document(A, again=True))
    assert store.document(A)["again"]


def test_ids_depend_on_everything_and_only_on_that():
    images, cameras, options = [b"one", b"two"], {"near": 1, "views": [{"fx": 2.5, "fy": 3}]}, {"near": None}
    base = SceneStore.scene_id("model", images, cameras, options)
    assert len(base) == 32
    assert base == SceneStore.scene_id(
        "model", tuple(images), {"views": ({"fy": 3.0, "fx": 2.5},), "near": 1.0}, options
    )
    others = [
        SceneStore.scene_id("model2", images, cameras, options),
        SceneStore.scene_id("model", [b"onet", b"wo"], cameras, options),  # same bytes, cut elsewhere
        SceneStore.scene_id("model", [b"two", b"one"], cameras, options),
        SceneStore.scene_id("model", [b"onetwo"], cameras, options),
        SceneStore.scene_id("model", images, {**cameras, "near": 1.5}, options),
        SceneStore.scene_id("model", images, cameras, {"near": 1.0}),
        SceneStore.scene_id("model", images, cameras, {"near": True}),
        SceneStore.scene_id("model", images, cameras, {}),
    ]
    assert len({base, *others}) == len(others) + 1
