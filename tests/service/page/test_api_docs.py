"""The documentation of the HTTP interface: every route can be read and tried, with the key if there is one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from browser_tab import Tab
from format_cases import moderate
from http_requests import camera_object, photograph
from page_service import document_of, serving, write_scene

from gapmes.service.formats.ply import ply_bytes
from gapmes.service.settings import Settings

HEALTH = "[id$=healthz_healthz_get]"
RECONSTRUCT = "[id$=reconstruct_reconstruct_post]"
LOAD = "[id$=load_scene_scenes_post]"
KEY = "open sesame"


@pytest.fixture
def locked(browser: Any, standin_model: Path, tmp_path: Path) -> Iterator[Tab]:
    settings = Settings(model=standin_model, store=tmp_path / "scenes", threads=1, api_key=KEY)
    with serving(settings) as address:
        tab = Tab(browser, address)
        yield tab
        tab.done()


def tried(page: Any, route: str) -> str:
    """The status that the page shows for a request to a route without parameters."""
    page.click(f"{route} .opblock-summary-control")
    page.click(f"{route} .try-out__btn")
    page.click(f"{route} .execute")
    return status(page, route)


def status(page: Any, route: str) -> str:
    return page.inner_text(f"{route} .live-responses-table tr.response .response-col_status").strip()


def test_every_route_is_shown_and_can_be_tried(tab: Tab) -> None:
    tab.page.goto(tab.address + "/docs")
    tab.page.wait_for_selector(HEALTH)
    paths = httpx.get(f"{tab.address}/openapi.json").json()["paths"]
    operations = sum(len(set(methods) - {"head"}) for methods in paths.values())
    assert tab.page.locator(".opblock").count() == operations > 10
    assert tried(tab.page, HEALTH).startswith("200")


def test_a_form_sends_what_is_filled_in_and_defaults(tab: Tab, tmp_path: Path) -> None:
    page = tab.page
    page.goto(tab.address + "/docs")
    page.click(f"{RECONSTRUCT} .opblock-summary-control")
    page.click(f"{RECONSTRUCT} .try-out__btn")
    *photographs, cameras = write_scene(tmp_path, [photograph(90), photograph(91)], camera_object(2))
    for place, path in enumerate(photographs):
        page.click(f"{RECONSTRUCT} [data-property-name=images] .json-schema-form-item-add")
        page.locator(f"{RECONSTRUCT} [data-property-name=images] input[type=file]").nth(place).set_input_files(path)
    page.fill(f"{RECONSTRUCT} [data-property-name=cameras] input", cameras.read_text())
    page.click(f"{RECONSTRUCT} .execute")
    assert status(page, RECONSTRUCT).startswith("201")
    scene = httpx.get(f"{tab.address}/scenes").json()["scenes"][0]["id"]
    document = document_of(tab.address, scene)
    assert (document["depth_range_source"], len(document["view_cameras"])) == ("given", 2)  # by the cameras


def test_a_file_of_gaussians_can_be_loaded(tab: Tab, tmp_path: Path) -> None:
    """The same options are a query beside a raw body, and fields of a form: defaults of both would be refused."""
    page = tab.page
    (tmp_path / "a.ply").write_bytes(ply_bytes(moderate(50, 1, 0)))
    page.goto(tab.address + "/docs")
    page.click(f"{LOAD} .opblock-summary-control")
    page.click(f"{LOAD} .try-out__btn")
    page.set_input_files(f"{LOAD} [data-property-name=file] input[type=file]", tmp_path / "a.ply")
    page.click(f"{LOAD} .execute")
    assert status(page, LOAD).startswith("201")


def test_a_key_is_that_of_the_page_in_the_same_tab(locked: Tab) -> None:
    page = locked.page
    page.goto(locked.address + "/docs")
    page.wait_for_selector("[role=alert]:has-text('this service needs a key')")
    page.click("a:has-text('the page')")
    page.fill("#key", KEY)
    page.click("#key-form button")
    page.wait_for_selector("#view-problem:empty", state="attached")
    page.goto(locked.address + "/docs")
    assert tried(page, "[id$=models_models_get]").startswith("200")
