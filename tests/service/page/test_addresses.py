"""What the page's address names: scenes and jobs, also deleted ones, and texts that would lead elsewhere."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import httpx
import pytest
from browser_tab import Tab
from page_service import cancelled, choose_two, made, serving, stored_cloud

from gapmes.service.settings import Settings

GONE = "0" * 32


def shows(page: Any, scene: str) -> None:
    page.wait_for_selector(f"#scenes li.chosen[data-id='{scene}']")
    page.wait_for_selector("#picture[src^='blob:']")
    assert page.is_hidden("#empty")


@pytest.mark.parametrize("kind", ["job", "scene"])
def test_a_link_to_what_is_gone_is_told_beside_the_newest_scene(tab: Tab, kind: str) -> None:
    newest = stored_cloud(tab.address, 11 if kind == "job" else 12)
    page = tab.open(f"/?{kind}={GONE}")
    page.wait_for_selector(f"#{'problem' if kind == 'job' else 'view-problem'}:has-text('no {kind}')")
    shows(page, newest)
    assert "GET /" not in page.inner_text("main")  # which is for those who write requests


@pytest.mark.parametrize("text", ["..", "../scenes/{id}%23", "{id}%2F..", "", "{id}x"])
@pytest.mark.parametrize("kind", ["job", "scene"])
def test_what_is_no_id_never_becomes_a_path(tab: Tab, kind: str, text: str) -> None:
    """A link could else have the page ask for anything, such as to delete a scene when a job is cancelled."""
    newest = stored_cloud(tab.address, 13)
    asked: list[str] = []
    tab.page.on("request", lambda request: asked.append(request.url.removeprefix(tab.address)))
    page = tab.open(f"/?{kind}={text.replace('{id}', newest)}")
    page.wait_for_selector(f"#{'problem' if kind == 'job' else 'view-problem'}:has-text('need 32 hex digits')")
    page.wait_for_selector("#picture[src^='blob:']")
    assert page.is_hidden("#cancel")
    assert "job=" not in page.url
    assert not [path for path in asked if path.startswith("/jobs/")]
    assert httpx.get(f"{tab.address}/scenes/{newest}", timeout=120).status_code == 200


@pytest.mark.parametrize("path", ["/", f"/?job={GONE}", f"/?scene={GONE}"])
def test_only_an_empty_store_has_no_scene_yet(browser: Any, standin_model: Path, tmp_path: Path, path: str) -> None:
    with serving(Settings(model=standin_model, store=tmp_path / "scenes", threads=1)) as address:
        tab = Tab(browser, address)
        page = tab.open(path)
        page.wait_for_selector("#empty:visible")
        scene = stored_cloud(address, 14)
        tab.open(path)
        shows(page, scene)
        tab.done()


def test_beside_a_job_the_newest_scene_is_shown(tab: Tab, tmp_path: Path, held_network: threading.Event) -> None:
    """When the page is loaded in the middle of it, and when it has ended without a scene."""
    newest = stored_cloud(tab.address, 15)
    page = tab.open()
    choose_two(page, tmp_path, seed=110)
    page.click("#go")
    page.wait_for_selector("#stage-name:has-text('network')")
    page.reload()
    page.wait_for_selector("#stage-name:has-text('network')")
    shows(page, newest)
    assert "/?job=" in page.url
    cancelled(page, lambda: page.click("#cancel"))
    held_network.set()
    page.wait_for_selector("#problem:has-text('cancelled')")
    shows(page, newest)
    assert page.url.endswith(f"/?scene={newest}")


def test_back_and_forward_in_the_middle_of_a_job_follow_it_once(
    tab: Tab, tmp_path: Path, held_network: threading.Event
) -> None:
    newest = stored_cloud(tab.address, 16)
    page = tab.open()
    followed: list[str] = []
    page.on("request", lambda request: "/events" in request.url and followed.append(request.url))
    choose_two(page, tmp_path, seed=120)
    before = page.url
    page.click("#go")
    page.wait_for_selector("#stage-name:has-text('network')")
    with page.expect_response(f"**/scenes/{newest}"):
        page.go_back()
    page.go_forward()
    assert "/?job=" in page.url
    shows(page, newest)
    held_network.set()
    made(page, before)
    assert len(followed) == 1


def test_beside_a_list_that_cannot_be_read_a_job_is_followed(
    tab: Tab, tmp_path: Path, held_network: threading.Event
) -> None:
    """What the list is refused by is told at the list, until it is read."""
    stored_cloud(tab.address, 17)
    page = tab.open()
    choose_two(page, tmp_path, seed=130)
    before = page.url
    page.click("#go")
    page.wait_for_selector("#stage-name:has-text('network')")
    busy = {"title": "Service busy", "status": 503, "code": "service_busy", "detail": "try later"}
    page.route("**/scenes?*", lambda route: route.fulfill(status=503, json=busy))
    page.reload()
    page.wait_for_selector("#stage-name:has-text('network')")
    page.wait_for_selector("#shelf-problem:has-text('try later')")
    assert page.inner_text("#view-problem") == ""
    assert page.is_hidden("#empty")  # whether there is a scene is not known
    page.unroute("**/scenes?*")
    held_network.set()
    made(page, before)
    page.wait_for_selector("#shelf-problem:empty", state="attached")


def test_after_a_job_without_a_scene_the_address_names_the_one_on_show(
    tab: Tab, tmp_path: Path, held_network: threading.Event
) -> None:
    """Which is not the newest."""
    older = stored_cloud(tab.address, 18)
    stored_cloud(tab.address, 19)
    page = tab.open(f"/?scene={older}")
    shows(page, older)
    choose_two(page, tmp_path, seed=140)
    page.click("#go")
    page.wait_for_selector("#stage-name:has-text('network')")
    cancelled(page, lambda: page.click("#cancel"))
    held_network.set()
    page.wait_for_selector("#problem:has-text('cancelled')")
    page.wait_for_url(f"{tab.address}/?scene={older}")
    shows(page, older)
