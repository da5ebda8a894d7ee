"""A scene is not evicted while its picture, film, zip or file is being made or waits to be."""

from __future__ import annotations

import asyncio
import io
import zipfile
from collections.abc import Iterator
from typing import Any

import pytest
from http_requests import assert_problem, photograph, post, wait_until_ready
from starlette.requests import ClientDisconnect
from starlette.testclient import TestClient

from gapmes.service.app import create_app
from gapmes.service.http import bundle, drawing
from gapmes.service.http.concurrency import WorkQueue
from gapmes.service.scenes.store import SceneStore
from gapmes.service.settings import Settings

PHOTOGRAPHS = [photograph(120), photograph(121)]
VIEWS = "0,1,0.5"


@pytest.fixture(scope="module")
def alone(settings: Settings, tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    """With a store of its own, of which everything may go."""
    own = settings.model_copy(update={"store": tmp_path_factory.mktemp("evicted") / "scenes"})
    with TestClient(create_app(own), raise_server_exceptions=False) as client:
        wait_until_ready(client)
        yield client


@pytest.fixture
def crowded(alone: TestClient, monkeypatch: pytest.MonkeyPatch) -> SceneStore:
    """As another process, which evicts what nobody reads: before each turn of a queue, and after each picture."""
    other = SceneStore(alone.app.state.runtime.store.root, max_days=1e-9)
    turn, draw = WorkQueue.run_in_steps, drawing.effort_draw

    async def crowded_turn(*arguments: Any) -> Any:
        other.evict_old()
        return await turn(*arguments)

    def crowded_draw(*arguments: Any, **options: Any) -> Any:
        drawn = draw(*arguments, **options)
        other.evict_old()
        return drawn

    monkeypatch.setattr(WorkQueue, "run_in_steps", crowded_turn)
    monkeypatch.setattr(drawing, "effort_draw", crowded_draw)
    return other


@pytest.mark.parametrize("kind", ["views", "preview", "sheet", "spz", "viewer"])
def test_a_scene_is_kept_until_what_is_asked_of_it_is_made(alone: TestClient, crowded: SceneStore, kind: str) -> None:
    links = post(alone, PHOTOGRAPHS).json()["links"]
    links |= {"spz": links["files"]["spz"], "views": links["views"][1], "viewer": f"{links['self']}/viewer.ply"}
    answer = alone.get(links[kind])
    assert answer.status_code == 200
    assert alone.get(links["self"]).status_code == 200
    assert crowded.evict_old() == 1  # nobody reads it any more
    assert_problem(alone.get(links["self"]), 404, "scene_not_found")


@pytest.mark.parametrize("there", [False, True])
def test_a_scene_is_kept_until_its_answer_is_made(alone: TestClient, crowded: SceneStore, there: bool) -> None:
    if there:
        post(alone, PHOTOGRAPHS, views=VIEWS)
    answer = post(alone, PHOTOGRAPHS, accept="application/zip", views=VIEWS)
    assert answer.status_code == (200 if there else 201)
    with zipfile.ZipFile(io.BytesIO(answer.content)) as packed:
        assert len(packed.namelist()) == 5
    assert crowded.evict_old() == 1


def test_a_loaded_scene_is_answered_whatever_becomes_of_it(
    alone: TestClient, crowded: SceneStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    ply = alone.get(post(alone, PHOTOGRAPHS).json()["links"]["ply"]).content
    put = SceneStore.put

    def evicted(*arguments: Any) -> bool:
        new = put(*arguments)
        crowded.evict_old()
        return new

    monkeypatch.setattr(SceneStore, "put", evicted)
    answer = alone.post("/scenes", content=ply, headers={"Content-Type": "application/octet-stream"})
    assert answer.status_code == 201, answer.text


def test_what_fails_while_a_scene_is_kept_is_not_taken_for_its_absence(
    alone: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    links = post(alone, PHOTOGRAPHS).json()["links"]

    def broken(*_: Any, **__: Any) -> None:
        raise FileNotFoundError("no folder of temporary files")

    monkeypatch.setattr(drawing, "effort_draw", broken)
    assert_problem(alone.get(links["views"][0]), 500, "internal_error")


def test_a_zip_is_drawn_in_steps_for_as_long_as_somebody_waits(
    alone: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    runtime = alone.app.state.runtime
    document = post(alone, PHOTOGRAPHS).json()
    taken: list[int] = []
    draw, packed = drawing.effort_draw, bundle._packed

    def watched_draw(*arguments: Any, **options: Any) -> Any:
        taken.append(runtime.pictures.limit.taken)
        return draw(*arguments, **options)

    def watched_pack(*arguments: Any) -> bytes:
        taken.append(runtime.pictures.limit.taken)
        return packed(*arguments)

    monkeypatch.setattr(drawing, "effort_draw", watched_draw)
    monkeypatch.setattr(bundle, "_packed", watched_pack)

    async def zipped(pictures: int) -> bytes:
        async def gone() -> bool:
            return len(taken) >= pictures

        with await bundle.zip_bundle(runtime, document, VIEWS.split(","), gone) as file:
            return file.read()

    with pytest.raises(ClientDisconnect):
        asyncio.run(zipped(2))
    assert taken == [1, 1]
    taken.clear()
    assert asyncio.run(zipped(99)).startswith(b"PK")
    assert taken == [1, 1, 1, 0]  # it is packed while others draw
