"""No question to the store's index holds the event loop, which all other requests need."""

from __future__ import annotations

import asyncio
import sqlite3
import traceback
from pathlib import Path

import pytest
from http_requests import photograph, post, wait_until_ready
from loading import load_raw
from starlette.testclient import TestClient

from gapmes.service.app import create_app
from gapmes.service.scenes.database import Database
from gapmes.service.settings import Settings


@pytest.fixture
def held(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Where the index was asked in a thread with a running loop. An index that somebody has deleted is made again by
    who asks first, which takes seconds for a large store, or as long as another process has its lock."""
    found: list[str] = []
    original = Database._connection

    def watched(self: Database) -> sqlite3.Connection:
        try:
            asyncio.get_running_loop()
        except RuntimeError:
            return original(self)
        found.append("".join(traceback.format_stack(limit=6)))
        return original(self)

    monkeypatch.setattr(Database, "_connection", watched)
    return found


def test_requests_ask_the_index_on_threads(settings: Settings, tmp_path: Path, held: list[str]) -> None:
    application = create_app(settings.model_copy(update={"store": tmp_path / "scenes"}))
    with TestClient(application, raise_server_exceptions=False) as client:
        wait_until_ready(client)
        new = post(client, [photograph(0), photograph(1)])
        assert new.status_code == 201, new.text
        assert post(client, [photograph(0), photograph(1)]).status_code == 200
        job = post(client, [photograph(2), photograph(3)], prefer="respond-async").json()
        with client.stream("GET", job["links"]["events"]) as stream:
            assert "done" in "".join(stream.iter_text())
        scene = new.json()["links"]["self"]
        ply = client.get(f"{scene}.ply")
        asked = [client.get(path) for path in (job["links"]["self"], scene, "/scenes", "/render?view=0", "/metrics")]
        asked += [load_raw(client, ply.content), client.delete(job["links"]["self"])]
        assert [answer.status_code for answer in asked] == [200, 200, 200, 200, 200, 201, 200]
        assert client.delete(scene).status_code == 204
    assert held == []
