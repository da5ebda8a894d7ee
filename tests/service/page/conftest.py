"""Chromium, driven by Playwright, over a service with the stand-in network; skipped where there is none of the two."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from browser_tab import CHROMIUM, Tab, launched
from page_service import serving

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


@pytest.fixture
def tab(browser: Any, address: str) -> Iterator[Tab]:
    tab = Tab(browser, address)
    yield tab
    tab.done()
