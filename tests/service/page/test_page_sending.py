"""Uploads: they can be cancelled at any moment, and a job is not lost to a user who looks elsewhere."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import pytest
from browser_tab import Tab
from http_requests import camera_object, photograph
from page_service import cancelled, choose_two, cloud, made, stored_cloud, until, write_scene

from gapmes.service.formats.registry import FORMATS

FOCUS = "document.activeElement.id || document.activeElement.tagName"
STARTING = {"title": "Starting", "status": 503, "detail": "the network is prepared", "state": "starting"}


def held_back(page: Any, path: str) -> None:
    """Requests that send something there find a line on which nothing goes on."""
    page.route(path, lambda route: None if route.request.method == "POST" else route.continue_())


@pytest.mark.parametrize("way", ["cancel", "clear"])
def test_sending_is_shown_and_can_be_given_up(tab: Tab, tmp_path: Path, way: str) -> None:
    page = tab.open()
    choose_two(page, tmp_path, seed=150)
    before = page.url
    held_back(page, "**/reconstruct")
    with page.expect_request("**/reconstruct") as begun:
        page.click("#go")
    page.wait_for_selector("#stage-name:has-text('Sending 3 files')")
    assert page.is_visible("#bar")
    with page.expect_event("requestfailed", lambda request: request == begun.value):
        page.click(f"#{way}")
    page.wait_for_selector("#progress", state="hidden")
    assert page.is_hidden("#cancel")
    assert page.inner_text("#problem") == ""
    assert page.url == before
    assert page.is_enabled("#go") == (way == "cancel")
    assert page.evaluate(FOCUS) == ("go" if way == "cancel" else "files")
    page.unroute("**/reconstruct")
    if way == "cancel":
        page.click("#go")
        made(page, before)


@pytest.mark.parametrize("way", ["cancel", "clear"])
def test_loading_is_shown_and_can_be_given_up(tab: Tab, tmp_path: Path, way: str) -> None:
    stored_cloud(tab.address, 151)
    path = tmp_path / "cloud.splat"
    path.write_bytes(FORMATS["splat"].write(cloud(152 if way == "cancel" else 153)).data)
    page = tab.open()
    before = page.url
    held_back(page, "**/scenes")
    with page.expect_request("**/scenes") as begun:
        page.set_input_files("#files", path)
    page.wait_for_selector("#stage-name:has-text('Loading cloud.splat')")
    with page.expect_event("requestfailed", lambda request: request == begun.value):
        page.click(f"#{way}")
    page.wait_for_selector("#progress", state="hidden")
    assert page.inner_text("#problem") == ""
    assert page.url == before
    page.unroute("**/scenes")
    if way == "cancel":
        page.click("#go:text('Load')")
        made(page, before)
    else:
        assert page.is_hidden("#chosen")


def test_a_check_ends_with_what_is_chosen(tab: Tab, tmp_path: Path) -> None:
    page = tab.open()
    held_back(page, "**/check")
    with page.expect_request("**/check") as begun:
        page.set_input_files("#files", write_scene(tmp_path, [photograph(0), photograph(1)], camera_object(2)))
    with page.expect_event("requestfailed", lambda request: request == begun.value):
        page.click("#clear")
    assert page.inner_text("#understood") == ""
    assert page.inner_text("#problem") == ""


def test_a_job_stays_in_the_address_beside_another_scene(
    tab: Tab, tmp_path: Path, held_network: threading.Event
) -> None:
    """Reload and Back lead to it, and when it is done its scene is offered to who looks at another one."""
    other, newest = (stored_cloud(tab.address, seed) for seed in (154, 155))
    page = tab.open()
    choose_two(page, tmp_path, seed=156)
    page.click("#go")
    page.wait_for_selector("#stage-name:has-text('network')")
    alone = page.url
    page.click(f"li[data-id='{other}'] button >> nth=0")
    page.wait_for_url(lambda url: f"/?scene={other}&job=" in url)
    both = page.url
    page.go_back()
    page.wait_for_url(alone)
    assert page.is_visible("#progress")
    page.go_forward()
    page.wait_for_url(both)
    page.reload()
    page.wait_for_selector("#stage-name:has-text('network')")
    page.wait_for_selector(f"#scenes li.chosen[data-id='{other}']")
    held_network.set()
    page.wait_for_selector("#offer:has-text('The new scene is ready')")
    page.wait_for_url(f"**/?scene={other}")
    assert page.locator("#scenes li.chosen").get_attribute("data-id") == other
    before = page.url
    page.click("#offer button")
    assert made(page, before) not in (other, newest)
    page.wait_for_selector("#offer", state="hidden")
    assert page.evaluate(FOCUS) == "stage"


def test_a_job_that_begins_while_another_scene_is_chosen_stands_beside_it(
    tab: Tab, tmp_path: Path, held_network: threading.Event
) -> None:
    other, _ = (stored_cloud(tab.address, seed) for seed in (157, 158))
    page = tab.open()
    choose_two(page, tmp_path, seed=159)
    waiting: list[Any] = []
    page.route("**/reconstruct", lambda route: waiting.append(route))
    page.click("#go")
    page.wait_for_selector("#stage-name:has-text('Sending')")
    page.click(f"li[data-id='{other}'] button >> nth=0")
    page.wait_for_url(f"**/?scene={other}")
    until(page, lambda: waiting)
    waiting[0].continue_()
    page.wait_for_url(lambda url: f"/?scene={other}&job=" in url)
    page.wait_for_selector("#stage-name:has-text('network')")
    cancelled(page, lambda: page.click("#cancel"))
    held_network.set()
    page.wait_for_selector("#problem:has-text('cancelled')")
    page.wait_for_url(f"**/?scene={other}")


def test_files_chosen_while_the_service_starts_are_looked_at_then(tab: Tab, tmp_path: Path) -> None:
    page = tab.page
    for path in ("**/readyz", "**/check"):
        page.route(path, lambda route: route.fulfill(status=503, json=STARTING))
    page.goto(tab.address)
    page.wait_for_selector("#state:has-text('prepared')")
    page.set_input_files("#files", write_scene(tmp_path, [photograph(0), photograph(1)], camera_object(2)))
    page.wait_for_selector("#problem:has-text('prepared')")
    for path in ("**/check", "**/readyz"):
        page.unroute(path)
    page.wait_for_selector("#go:text('Reconstruct'):not([disabled])")
    assert page.inner_text("#problem") == ""


@pytest.mark.parametrize("status", [0, 429, 503])
def test_files_that_got_no_answer_can_be_checked_again(tab: Tab, tmp_path: Path, status: int) -> None:
    """Without being chosen once more; what was refused cannot."""
    page = tab.open()
    page.route("**/check", lambda route: route.fulfill(status=status, json=STARTING) if status else route.abort())
    page.set_input_files("#files", write_scene(tmp_path, [photograph(0), photograph(1)], camera_object(2)))
    page.wait_for_selector("#go:text('Check again'):not([disabled])")
    page.unroute("**/check")
    page.press("#go", "Enter")
    page.wait_for_selector("#go:text('Reconstruct'):not([disabled]):focus")
    assert page.inner_text("#problem") == ""
    page.set_input_files("#files", write_scene(tmp_path, [photograph(0)], {})[1:])
    page.wait_for_selector("#problem strong")
    assert page.is_disabled("#go")
    assert page.inner_text("#go") == "Reconstruct"


def test_the_focus_goes_with_the_work(tab: Tab, tmp_path: Path, held_network: threading.Event) -> None:
    """To what can be pressed while it runs, to the scene when it is done, to the chooser when all begins anew."""
    page = tab.open()
    choose_two(page, tmp_path, seed=160)
    before = page.url
    page.focus("#go")
    page.keyboard.press("Enter")
    page.wait_for_selector("#stage-name:has-text('network')")
    assert page.evaluate(FOCUS) == "cancel"
    cancelled(page, lambda: page.keyboard.press("Enter"))
    held_network.set()
    page.wait_for_selector("#problem:has-text('cancelled')")
    assert page.evaluate(FOCUS) == "go"
    page.keyboard.press("Enter")
    made(page, before)
    page.wait_for_selector("#stage:focus")
    page.focus("#clear")
    page.keyboard.press("Enter")
    assert page.evaluate(FOCUS) == "files"


def test_a_check_that_is_under_way_is_not_given_up_for_another(tab: Tab) -> None:
    """Nor is what waits for it: who asks for the sample while the page still loads its lists gets it."""
    page = tab.page
    lists: list[Any] = []
    checks: list[Any] = []
    page.route("**/scenes?*", lambda route: route.continue_() if lists else lists.append(route))
    page.route("**/check", lambda route: route.continue_() if checks else checks.append(route))
    page.goto(tab.address)
    with page.expect_request("**/check"):
        page.click("#sample")
    until(page, lambda: lists and checks)
    lists[0].continue_()
    page.wait_for_selector("#main[aria-busy=false]")
    before = page.url
    checks[0].continue_()
    made(page, before)
