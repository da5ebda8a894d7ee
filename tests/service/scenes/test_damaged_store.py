"""Scenes in the store that were damaged from outside: refused by name, not counted, replaced, removed, evicted."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from store_folder import document, names

from gapmes.service.errors import FormatError, SceneNotFound
from gapmes.service.scenes.store import SceneStore

A, B, C = "a" * 32, "b" * 32, "c" * 32


def changed(folder: Path, **members: Any) -> None:
    """Members of the document replaced, or left out if they are None."""
    path = folder / "scene.json"
    new = {**json.loads(path.read_bytes()), **members}
    path.write_text(json.dumps({name: value for name, value in new.items() if members.get(name, 0) is not None}))


DAMAGES: dict[str, Callable[[Path], object]] = {
    "an empty document": lambda folder: (folder / "scene.json").write_bytes(b""),
    "half a document": lambda folder: (folder / "scene.json").write_bytes(b'{"id": "'),
    "a document that is no text": lambda folder: (folder / "scene.json").write_bytes(b'{"id": "\xff"}'),
    "a document that is a list": lambda folder: (folder / "scene.json").write_bytes(b"[]"),
    "a document too deep to read": lambda folder: (folder / "scene.json").write_bytes(b"[" * 100_000),
    "Gaussians that are a list": lambda folder: changed(folder, gaussians=[]),
    "views that are a number": lambda folder: changed(folder, view_cameras=5),
    "views that are numbers": lambda folder: changed(folder, view_cameras=[1]),
    "half a view": lambda folder: changed(folder, view_cameras=[{"width": 64, "height": 48}]),
    "a count below zero": lambda folder: changed(folder, inputs=-3),
    "a count that is none": lambda folder: changed(folder, inputs=True),
    "a depth below zero": lambda folder: changed(folder, near=-1),
    "a depth without end": lambda folder: changed(folder, far=10**400),
    "a number without end": lambda folder: (folder / "scene.json").write_text('{"far": 1e999}'),
    "warnings that are a text": lambda folder: changed(folder, warnings="none"),
    "inputs that are a text": lambda folder: changed(folder, inputs="two"),
    "a depth that is a list": lambda folder: changed(folder, far=[1]),
    "a number that is none": lambda folder: changed(folder, more=float("nan")),
    "the document of another": lambda folder: changed(folder, id=B),
    **{f"no {name}": lambda folder, name=name: changed(folder, **{name: None}) for name in document(A)},
    "no document": lambda folder: (folder / "scene.json").unlink(),
    "a folder for a document": lambda folder: ((folder / "scene.json").unlink(), (folder / "scene.json").mkdir()),
    "empty Gaussians": lambda folder: (folder / "scene.ply").write_bytes(b""),
    "no Gaussians": lambda folder: (folder / "scene.ply").unlink(),
    "nothing in it": lambda folder: (shutil.rmtree(folder), folder.mkdir()),
    "a file in its place": lambda folder: (shutil.rmtree(folder), folder.write_bytes(b"no folder")),
    "nothing left": shutil.rmtree,
}


@pytest.fixture(params=DAMAGES.values(), ids=DAMAGES)
def damaged(tmp_path: Path, request: pytest.FixtureRequest) -> SceneStore:
    """Scene A is damaged from outside, B is older and whole."""
    store = SceneStore(tmp_path / "scenes")
    store.put(B, b"ply", document(B))
    store.put(A, b"ply", document(A), [b"a picture"])
    request.param(store.root / A)
    return store


def test_what_was_damaged_is_refused_by_name_and_counts_as_none(damaged: SceneStore) -> None:
    with pytest.raises((SceneNotFound, FormatError), match=A) as caught:
        damaged.document(A)
    assert caught.value.status in (404, 422)
    assert (caught.value.status == 422) == ((damaged.root / A / "scene.ply").is_file())
    assert not damaged.exists(A)
    assert not damaged.listed(A)
    assert damaged.newest() == B


def test_a_store_with_a_damaged_scene_opens_without_its_index(damaged: SceneStore) -> None:
    for path in damaged.root.glob("index.sqlite*"):
        path.unlink()
    opened = SceneStore(damaged.root)
    assert opened.newest() == B
    assert not opened.exists(A)


def test_what_was_damaged_gives_way_to_the_whole_scene(damaged: SceneStore) -> None:
    damaged.put(A, b"ply", document(A, again=True))
    assert damaged.document(A) == document(A, again=True)
    assert damaged.ply(A) == b"ply"
    assert damaged.newest() == A
    assert names(damaged.root) == {A, B}
    whole = sum(path.stat().st_size for name in (A, B) for path in (damaged.root / name).iterdir())
    assert damaged.totals() == (2, whole)


def test_what_was_damaged_can_be_deleted(damaged: SceneStore) -> None:
    damaged.delete(A)
    assert [row.id for row in damaged.page(9)] == [B]
    assert names(damaged.root) == {B}
    with pytest.raises(SceneNotFound):
        damaged.delete(A)


def test_what_was_damaged_is_evicted_like_others(damaged: SceneStore) -> None:
    damaged.max_bytes = 2 * damaged.totals()[1]
    free = damaged.max_bytes - damaged.totals()[1]
    one_too_many = free + 1 - len(b"ply") - len(json.dumps(document(C, text="")))
    with damaged.reading(B):
        damaged.put(C, b"ply", document(C, text="x" * one_too_many))
    assert names(damaged.root) == {B, C}


def test_empty_gaussians_are_said_to_be_empty(tmp_path: Path) -> None:
    store = SceneStore(tmp_path / "scenes")
    store.put(A, b"ply", document(A))
    (store.root / A / "scene.ply").write_bytes(b"")
    for call in (store.ply, store.gaussians):
        with pytest.raises(FormatError, match=r"scene\.ply holds nothing"):
            call(A)
