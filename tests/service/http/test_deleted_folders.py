"""Folders of the store that are deleted under a running service: made again where that can be, and no request fails."""

from __future__ import annotations

import asyncio
import io
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from http_requests import assert_problem, camera_object, photograph, post, wait_until_ready
from PIL import Image
from served_process import until
from starlette.testclient import TestClient
from store_folder import document

from gapmes.service.app import create_app
from gapmes.service.errors import InputsGone
from gapmes.service.http import jobs
from gapmes.service.http.runtime import Runtime
from gapmes.service.http.waiting import ended
from gapmes.service.scenes.store import SceneStore
from gapmes.service.settings import Settings


def all_in(store: Path) -> None:
    for path in store.iterdir():
        shutil.rmtree(path) if path.is_dir() else path.unlink()


def index(store: Path) -> None:
    for path in store.glob("index.sqlite*"):
        path.unlink()


DELETED: dict[str, Callable[[Path], object]] = {
    ".jobs": lambda store: shutil.rmtree(store / ".jobs"),
    ".processes": lambda store: shutil.rmtree(store / ".processes"),
    ".models": lambda store: shutil.rmtree(store / ".models"),
    "the index": index,
    "all in it": all_in,
    "the store": shutil.rmtree,
}
KEEPS_SCENES = [".jobs", ".processes", ".models", "the index"]


@pytest.fixture
def store(tmp_path: Path) -> Path:
    return tmp_path / "scenes"


@pytest.fixture
def served(standin_model: Path, store: Path) -> Iterator[TestClient]:
    settings = Settings(model=standin_model, store=store, threads=1)
    with TestClient(create_app(settings), raise_server_exceptions=False) as client:
        wait_until_ready(client)
        yield client


@pytest.mark.parametrize("what", DELETED)
def test_the_service_goes_on(served: TestClient, store: Path, caplog: pytest.LogCaptureFixture, what: str) -> None:
    scene = post(served)
    assert scene.status_code == 201
    before = scene.json()["links"]
    DELETED[what](store)
    there = what in KEEPS_SCENES
    listed = [row["id"] for row in served.get("/scenes").json()["scenes"]]
    assert listed == ([scene.json()["id"]] if there else [])
    for path in (before["self"], before["ply"], before["files"]["splat"], before["views"][0], before["inputs"][0]):
        answer = served.get(path)
        if there:
            assert answer.status_code == 200, (path, answer.text)
        else:
            assert_problem(answer, 404, "scene_not_found", cured=True)
    assert served.get("/readyz").status_code == 200
    assert served.get("/metrics").status_code == 200
    job = post(served, [photograph(5), photograph(6)], prefer="respond-async").json()
    until(lambda: served.get(job["links"]["self"]).json()["state"] == "done")
    for accept in ("application/json", "application/octet-stream", "application/zip"):
        again = post(served, accept=accept)
        assert again.status_code == (200 if there else 201), again.text
        there = True
    ply = {"file": ("a.ply", io.BytesIO(served.get(before["ply"]).content))}
    loaded = served.post("/scenes", files=ply)
    assert loaded.status_code == 201, loaded.text
    assert len(served.get("/scenes").json()["scenes"]) == 3
    assert served.delete(before["self"]).status_code == 204
    assert [record for record in caplog.records if record.levelname == "ERROR"] == []


def test_temporary_files_have_a_folder_again(
    served: TestClient, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Large uploads, and films while they are made."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    noise = np.random.default_rng(3).integers(0, 256, (700, 700, 3), dtype=np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(noise).save(buffer, "PNG")
    assert len(buffer.getvalue()) > 2**20  # smaller ones stay in memory
    cameras = camera_object(2, width=700, height=700)
    for view in cameras["views"]:
        view["fx"] = view["fy"] = 600.0
    scene = post(served, [buffer.getvalue(), photograph(4, 700, 700)], cameras)
    assert scene.status_code == 201, scene.text
    shutil.rmtree(tmp_path / "tmp")
    film = served.get(f"/scenes/{scene.json()['id']}/preview?frames=4&width=32&height=32")
    assert film.status_code == 200, film.text
    assert [record for record in caplog.records if record.levelname == "ERROR"] == []


def test_a_store_that_cannot_be_made_again_is_refused_until_it_is_back(served: TestClient, store: Path) -> None:
    scene = post(served).json()
    aside = store.rename(store.with_name("aside"))
    store.write_text("no folder")
    for answer in (
        served.get("/scenes"),
        served.get(scene["links"]["self"]),
        served.get("/readyz"),
        served.delete(scene["links"]["self"]),
        post(served, [photograph(5), photograph(6)]),
    ):
        problem = assert_problem(answer, 503, "service_busy", "store", cured=True)
        assert problem["detail"] == "the folder scenes was deleted and cannot be made again: File exists"
    store.unlink()
    aside.rename(store)
    assert served.get("/readyz").status_code == 200
    assert served.get(scene["links"]["self"]).json()["id"] == scene["id"]
    assert post(served, [photograph(5), photograph(6)]).status_code == 201


def test_a_stream_of_a_job_ends_with_a_deleted_index(tmp_path: Path) -> None:
    class Connected:
        async def is_disconnected(self) -> bool:
            return False

    async def streamed() -> list[str]:
        runtime = Runtime(Settings(store=tmp_path / "scenes"))  # it runs no jobs
        runtime.jobs.table.submit("1", "a" * 32)
        found = []
        async for text in jobs._events(Connected(), runtime, "1", 0):  # type: ignore[arg-type]
            found.append(text)
            if len(found) == 2:
                index(tmp_path / "scenes")
        return found

    begin, event = asyncio.run(streamed())
    assert begin.startswith("retry: ")
    assert "queued" in event


def test_who_waits_for_a_job_of_a_deleted_index_is_told(tmp_path: Path) -> None:
    async def gone() -> bool:
        index(tmp_path / "scenes")
        return False

    async def waited() -> None:
        runtime = Runtime(Settings(store=tmp_path / "scenes"))  # it runs no jobs
        await ended(runtime.jobs, runtime.jobs.table.submit("1", "a" * 32), 60.0, gone)

    with pytest.raises(InputsGone, match="the job was deleted, with the index of the store") as caught:
        asyncio.run(waited())
    assert (caught.value.status, caught.value.cure) == (410, "ask for it again")


def test_what_was_deleted_is_said_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    store = SceneStore(tmp_path / "scenes")
    store.put("a" * 32, b"ply", document("a" * 32))
    index(store.root)
    assert [row.id for row in store.page(9)] == ["a" * 32]
    assert store.totals()[0] == 1
    assert caplog.messages == [
        f"{store.root}/index.sqlite was deleted under the service: it is made anew, and its jobs are lost"
    ]
