"""Chromium, driven by Playwright, with a service over the stand-in network; skipped if either is missing."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from browser_tab import CHROMIUM, Tab, launched
from http_requests import camera_object, photograph
from page_service import serving

from gapmes.service.reconstruct import Reconstructor
from gapmes.service.settings import Settings


@pytest.fixture(scope="module")  # its event loop runs in the main thread: no test of others could have one there
def playwright() -> Iterator[Any]:
    sync_api = pytest.importorskip("playwright.sync_api", reason="the page is tested by Playwright")
    if CHROMIUM is None:
        pytest.skip("the page is tested in Chromium, which is not installed")
    with sync_api.sync_playwright() as running:
        yield running


@pytest.fixture(scope="module")
def browser(playwright: Any) -> Iterator[Any]:
    browser = launched(playwright)
    yield browser
    browser.close()


@pytest.fixture(scope="module")
def address(standin_model: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    store = tmp_path_factory.mktemp("page") / "scenes"
    with serving(Settings(model=standin_model, store=store, threads=1)) as address:
        yield address


@pytest.fixture(scope="module")
def scene(address: str) -> str:
    """A scene of the stand-in network: a textured wall."""
    files = [("images", (f"{k}.png", photograph(60 + k), "image/png")) for k in range(2)]
    answer = httpx.post(
        f"{address}/reconstruct",
        files=[*files, ("cameras", ("cameras.json", json.dumps(camera_object(2)).encode()))],
        timeout=120,
    )
    assert answer.status_code in (200, 201), answer.text
    return answer.json()["id"]


@pytest.fixture
def held_network(monkeypatch: pytest.MonkeyPatch) -> Iterator[threading.Event]:
    """The network waits until the event is set."""
    go, run = threading.Event(), Reconstructor.run_network

    def held(self: Reconstructor, *arguments: Any) -> Any:
        assert go.wait(600)
        return run(self, *arguments)

    monkeypatch.setattr(Reconstructor, "run_network", held)
    yield go
    go.set()


@pytest.fixture
def tab(browser: Any, address: str) -> Iterator[Tab]:
    tab = Tab(browser, address)
    yield tab
    tab.done()
