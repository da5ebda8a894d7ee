"""A running application with a stand-in model; requests are in `http_requests`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from http_requests import MAX_UPLOAD, post, stored, wait_until_ready
from starlette.testclient import TestClient

from gapmes.service.app import create_app
from gapmes.service.settings import Settings


@pytest.fixture(scope="session")
def settings(standin_model: Path, tmp_path_factory: pytest.TempPathFactory) -> Settings:
    store = tmp_path_factory.mktemp("service") / "scenes"
    return Settings(model=standin_model, store=store, threads=1, max_upload_bytes=MAX_UPLOAD)


@pytest.fixture(scope="session")
def client(settings: Settings) -> Iterator[TestClient]:
    with TestClient(create_app(settings), raise_server_exceptions=False) as client:
        wait_until_ready(client)
        yield client


@pytest.fixture
def unharmed(client: TestClient, settings: Settings) -> Iterator[None]:
    """Wraps a test: a good request works afterwards, and the store has nothing new."""
    good = post(client)
    before = stored(settings)
    yield
    assert stored(settings) == before
    again = post(client)
    assert again.status_code == 200
    assert again.json()["id"] == good.json()["id"]


@pytest.fixture
def no_scene_stays(client: TestClient) -> Iterator[None]:
    """Other tests look at the list of the same service."""
    before = {row["id"] for row in client.get("/scenes").json()["scenes"]}
    yield
    for row in client.get("/scenes").json()["scenes"]:
        if row["id"] not in before:
            client.delete(row["links"]["self"])
