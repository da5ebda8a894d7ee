"""The list of scenes: it keeps its length, marks the current scene, and shows its own errors."""

from __future__ import annotations

from itertools import count
from pathlib import Path
from typing import Any

import httpx
import pytest
from browser_tab import PHONE, Tab
from page_service import choose, cloud, settled, stored_cloud, until

from gapmes.service.formats.registry import FORMATS

SEEDS = count(200)
BUSY = {"title": "Service busy", "status": 503, "code": "service_busy", "detail": "try later"}
FOCUSED = "document.activeElement.closest('li')?.dataset.id"

SEEN = """() => new Promise(done => new IntersectionObserver((entries) => {
  if (entries.at(-1).isIntersecting) done();
}, { threshold: 0.99 }).observe(document.getElementById("stage")))"""


def stored(address: str, need: int) -> None:
    """At least so many scenes are in the store."""
    for _ in range(len(httpx.get(f"{address}/scenes", timeout=120).json()["scenes"]), need):
        stored_cloud(address, next(SEEDS))


def two_scenes(tab: Tab) -> Any:
    """The page with two scenes or more listed, the newest on show."""
    stored(tab.address, 2)
    page = tab.open()
    page.on("dialog", lambda dialog: dialog.accept())
    page.wait_for_selector("#picture[src^='blob:']")
    return page


def whole_list(tab: Tab) -> Any:
    """The page with fourteen scenes or more listed, which are more than one page."""
    stored(tab.address, 14)
    page = tab.open()
    page.on("dialog", lambda dialog: dialog.accept())
    page.wait_for_selector("#scenes li >> nth=11")
    page.click("#more")
    page.wait_for_selector("#scenes li >> nth=13")
    return page


def test_older_scenes_stay_listed(tab: Tab, tmp_path: Path) -> None:
    """At steps of the history, when one is deleted, and when another one comes."""
    page = whole_list(tab)
    rows = page.locator("#scenes li")
    ids = rows.evaluate_all("all => all.map(row => row.dataset.id)")
    assert page.evaluate(FOCUSED) == ids[12]  # the first of those that came
    lists: list[str] = []
    page.on("request", lambda request: "/scenes?" in request.url and lists.append(request.url))
    for place in (13, 12):
        rows.nth(place).locator("button").first.click()
        page.wait_for_url(f"**/?scene={ids[place]}")
    page.go_back()
    page.wait_for_selector(f"li.chosen[data-id='{ids[13]}']")
    rows.nth(12).locator(".quiet").click()
    page.wait_for_selector(f"li[data-id='{ids[12]}']", state="detached")
    assert rows.evaluate_all("all => all.map(row => row.dataset.id)") == [*ids[:12], *ids[13:]]
    assert lists == []
    kept = rows.nth(0).element_handle()
    file = tmp_path / "cloud.splat"
    file.write_bytes(FORMATS["splat"].write(cloud(199)).data)
    choose(page, [file])
    page.wait_for_selector(f"#scenes li:first-child:not([data-id='{ids[0]}'])")
    assert rows.count() == len(ids) - 1
    assert page.evaluate("row => row.isConnected", kept)  # with its picture
    page.wait_for_selector("#more")


def test_the_list_is_read_again_when_its_tab_is_looked_at(tab: Tab) -> None:
    """Scenes come and go by other tabs and other users."""
    stored(tab.address, 2)
    page = tab.open()
    gone = page.locator("#scenes li").nth(1).get_attribute("data-id")
    assert httpx.delete(f"{tab.address}/scenes/{gone}", timeout=120).status_code == 204
    come = stored_cloud(tab.address, next(SEEDS))
    page.evaluate("document.dispatchEvent(new Event('visibilitychange'))")
    page.wait_for_selector(f"#scenes li:first-child[data-id='{come}']")
    assert page.locator(f"li[data-id='{gone}']").count() == 0
    page.route("**/scenes?*", lambda route: route.abort())
    with page.expect_event("requestfailed"):
        page.evaluate("document.dispatchEvent(new Event('visibilitychange'))")
    assert page.locator("#scenes li").first.get_attribute("data-id") == come


def test_a_scene_that_is_deleted_while_the_list_is_read_stays_away(tab: Tab) -> None:
    stored(tab.address, 2)
    page = tab.open()
    page.on("dialog", lambda dialog: dialog.accept())
    gone = page.locator("#scenes li").nth(1).get_attribute("data-id")
    held: list[Any] = []

    def late(route: Any) -> None:
        if held:
            route.continue_()
        else:
            held.extend((route, route.fetch()))

    page.route("**/scenes?*", late)
    page.evaluate("document.dispatchEvent(new Event('visibilitychange'))")
    until(page, lambda: len(held) == 2)
    page.click(f"li[data-id='{gone}'] .quiet")
    page.wait_for_selector(f"li[data-id='{gone}']", state="detached")
    route, answer = held
    with page.expect_event("requestfinished", lambda request: request == route.request):
        route.fulfill(response=answer)
    page.evaluate("() => fetch('/healthz').then(answer => answer.text())")  # what came before it has been read
    assert page.locator(f"li[data-id='{gone}']").count() == 0


def test_a_scene_is_deleted_also_where_the_list_cannot_be_read(tab: Tab) -> None:
    """It leaves the stage, and the list's problem is told."""
    stored(tab.address, 2)
    page = tab.open()
    page.on("dialog", lambda dialog: dialog.accept())
    gone, following = (page.locator("#scenes li").nth(place).get_attribute("data-id") for place in (0, 1))
    held: list[Any] = []
    page.route("**/scenes?*", lambda route: route.abort() if held else held.append(route))
    page.evaluate("document.dispatchEvent(new Event('visibilitychange'))")
    until(page, lambda: held)
    page.click("#remove")
    page.wait_for_url(f"**/?scene={following}")
    page.wait_for_selector(f"li.chosen[data-id='{following}']")
    assert "does not answer" in page.inner_text("#shelf-problem")
    assert page.locator(f"li[data-id='{gone}']").count() == 0
    held[0].abort()


def test_the_scene_on_show_is_told(tab: Tab) -> None:
    page = whole_list(tab)
    for place in (0, 13):
        row = page.locator("#scenes li").nth(place)
        row.locator("button").first.click()
        scene = row.get_attribute("data-id")
        page.wait_for_url(f"**/?scene={scene}")
        page.wait_for_selector(f"li.chosen[data-id='{scene}']")
        current = page.locator("#scenes [aria-current=true]")
        assert current.count() == 1
        assert current.evaluate("button => button.closest('li').dataset.id") == scene
        assert scene[:8] in page.title()
        assert current.get_attribute("aria-label") == f"Show scene {scene[:8]} of {row.locator('time').inner_text()}"


def test_a_scene_that_was_deleted_elsewhere_leaves_the_list(tab: Tab) -> None:
    page = whole_list(tab)
    row = page.locator("#scenes li").nth(13)
    gone = row.get_attribute("data-id")
    assert httpx.delete(f"{tab.address}/scenes/{gone}", timeout=120).status_code == 204
    row.locator("button").first.click()
    page.wait_for_selector(f"li[data-id='{gone}']", state="detached")
    problem = page.locator("#shelf-problem")
    assert f"no scene '{gone}'" in problem.inner_text()
    place, window = problem.bounding_box(), page.viewport_size
    assert 0 <= place["y"] < window["height"] - place["height"]  # where the list is looked at
    page.locator("#scenes li").nth(0).locator("button").first.click()
    page.wait_for_selector("#shelf-problem:empty", state="attached")


def test_deleting_all_that_is_listed_brings_the_next(tab: Tab) -> None:
    stored(tab.address, 13)
    page = tab.open()
    page.on("dialog", lambda dialog: dialog.accept())
    page.wait_for_selector("#scenes li >> nth=11")
    rows = page.locator("#scenes li")
    for left in range(11, -1, -1):
        gone = rows.nth(0).get_attribute("data-id")
        rows.nth(0).locator(".quiet").click()
        page.wait_for_selector(f"li[data-id='{gone}']", state="detached")
        if left:
            assert rows.count() == left
    page.wait_for_selector("#scenes li")
    page.wait_for_url(f"**/?scene={rows.nth(0).get_attribute('data-id')}")


@pytest.mark.parametrize("elsewhere", [True, False])
def test_the_next_scene_may_go_before_it_is_shown(tab: Tab, *, elsewhere: bool) -> None:
    """It was to take the place of the one that was deleted."""
    stored(tab.address, 3)
    page = tab.open()
    page.on("dialog", lambda dialog: dialog.accept())
    ids = page.locator("#scenes li").evaluate_all("all => all.map(row => row.dataset.id)")
    held: list[Any] = []
    page.route(
        f"**/scenes/{ids[1]}",
        lambda route: held.append(route) if route.request.method == "GET" else route.continue_(),
    )
    page.click(f"li[data-id='{ids[0]}'] .quiet")
    until(page, lambda: held)
    if elsewhere:
        assert httpx.delete(f"{tab.address}/scenes/{ids[1]}", timeout=120).status_code == 204
        held[0].continue_()
    else:
        page.click(f"li[data-id='{ids[1]}'] .quiet")
    page.wait_for_selector(f"li[data-id='{ids[1]}']", state="detached")
    page.wait_for_url(f"**/?scene={ids[2]}")
    page.wait_for_selector(f"li.chosen[data-id='{ids[2]}']")
    if not elsewhere:
        held[0].continue_()
    page.wait_for_selector("#picture[src^='blob:']")
    assert page.inner_text("#view-problem") == ""


def test_on_a_phone_a_scene_that_is_chosen_comes_into_view(browser: Any, address: str) -> None:
    stored(address, 12)
    tab = Tab(browser, address, viewport=PHONE, has_touch=True, is_mobile=True)
    page = tab.open()
    row = page.locator("#scenes li").nth(11)
    row.locator("button").first.tap()
    page.wait_for_selector(f"li.chosen[data-id='{row.get_attribute('data-id')}']")
    page.evaluate(SEEN)
    assert page.locator("#stage").bounding_box()["y"] < PHONE["height"] / 2
    tab.done()


@pytest.mark.parametrize("status", [404, 422])
def test_a_scene_that_cannot_be_shown_is_passed_over_for_the_one_after_it(tab: Tab, status: int) -> None:
    """It is the newest: deleted elsewhere, or damaged. The one on show is deleted."""
    stored(tab.address, 3)
    ids = [row["id"] for row in httpx.get(f"{tab.address}/scenes", timeout=120).json()["scenes"]]
    page = tab.open(f"/?scene={ids[1]}")
    page.on("dialog", lambda dialog: dialog.accept())
    page.wait_for_selector(f"li.chosen[data-id='{ids[1]}']")
    if status == 404:
        assert httpx.delete(f"{tab.address}/scenes/{ids[0]}", timeout=120).status_code == 204
    else:
        damaged = {"title": "Scene damaged", "status": 422, "code": "scene_damaged", "detail": "it is damaged"}
        page.route(f"**/scenes/{ids[0]}", lambda route: route.fulfill(status=422, json=damaged))
    page.click("#remove")
    page.wait_for_url(f"**/?scene={ids[2]}")
    page.wait_for_selector(f"li.chosen[data-id='{ids[2]}']")
    assert page.locator(f"li[data-id='{ids[0]}']").count() == (status == 422)
    assert page.inner_text("#view-problem") == ""


def test_where_no_scene_can_be_shown_why_is_told(tab: Tab) -> None:
    page = two_scenes(tab)
    page.route(
        "**/scenes/*",
        lambda route: route.fulfill(status=503, json=BUSY) if route.request.method == "GET" else route.continue_(),
    )
    page.click("#remove")
    page.wait_for_selector("#view-problem:has-text('try later')")
    assert page.url == f"{tab.address}/"
    assert page.is_hidden("#controls")
    assert page.is_hidden("#empty")  # there are scenes


def test_what_a_list_was_refused_by_goes_once_it_is_read(tab: Tab) -> None:
    """And takes nothing else that was said there along."""
    page = two_scenes(tab)
    page.route("**/scenes?*", lambda route: route.fulfill(status=503, json=BUSY))
    page.evaluate("dispatchEvent(new PopStateEvent('popstate'))")
    shown = page.get_attribute("li.chosen", "data-id")
    page.evaluate("document.getElementById('scenes').replaceChildren()")
    page.evaluate("dispatchEvent(new PopStateEvent('popstate'))")
    page.wait_for_selector("#shelf-problem:has-text('try later')")
    page.unroute("**/scenes?*")
    page.evaluate("document.dispatchEvent(new Event('visibilitychange'))")
    page.wait_for_selector(f"li[data-id='{shown}']")
    page.wait_for_selector("#shelf-problem:empty", state="attached")
    refused = {"title": "Forbidden", "status": 403, "code": "http_403", "detail": "not this one"}
    page.route("**/scenes/*", lambda route: route.fulfill(status=403, json=refused))
    page.click(f"li[data-id='{shown}'] .quiet")
    page.wait_for_selector("#shelf-problem:has-text('not this one')")
    with page.expect_response("**/scenes?*"):
        page.evaluate("document.dispatchEvent(new Event('visibilitychange'))")
    settled(page)
    assert "not this one" in page.inner_text("#shelf-problem")
