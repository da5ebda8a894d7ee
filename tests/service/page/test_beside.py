"""The part beside the view: pictures of the inputs once they are seen, and the plan of the cameras."""

from __future__ import annotations

import json
import math
import re
from typing import Any

import httpx
import pytest
from browser_tab import Tab
from http_requests import camera_object
from page_service import cloud, document_of, opened, settled, until

from gapmes.service.formats.registry import FORMATS

COUNT = 40
NUMBERS = """() => [...document.querySelectorAll(".plan text")].map(text => {
  const { x, y, width, height } = text.getBBox();
  return [x, y, width, height];
})"""


@pytest.fixture(scope="module")
def many(address: str) -> str:
    """A loaded scene with many cameras of 800 px."""
    cameras = camera_object(COUNT, width=800, height=600)
    answer = httpx.post(
        f"{address}/scenes",
        files={
            "file": ("cloud.splat", FORMATS["splat"].write(cloud(50)).data),
            "cameras": ("cameras.json", json.dumps(cameras).encode()),
        },
        timeout=120,
    )
    assert answer.status_code == 201, answer.text
    return answer.json()["id"]


def test_of_many_inputs_those_that_are_seen_are_drawn(tab: Tab, many: str) -> None:
    """As wide as they are shown, in the columns that there is something for; the last ones once they are reached."""
    asked: list[str] = []
    tab.page.on("request", lambda request: "/render?" in request.url and asked.append(request.url))
    page = opened(tab, many)
    page.wait_for_selector(".inputs img[src^='blob:'] >> nth=1")
    shown = page.locator(".inputs img").first.bounding_box()["width"]
    assert page.locator("#about summary").first.inner_text() == "Views and their depth"
    assert page.locator(".inputs th").all_inner_texts() == ["drawn again", "depth"]
    first, last = page.locator(".inputs img").first, page.locator(".inputs img").last
    assert first.get_attribute("alt") == "View 0"
    assert last.get_attribute("src") is None
    last.scroll_into_view_if_needed()
    page.wait_for_selector(".inputs tr:last-child img[src^='blob:'] >> nth=1")
    of_rows = [url for url in asked if "height=72" not in url and "channel=rgb" not in url]  # in their order
    assert 2 <= len(of_rows) < COUNT
    assert {re.findall(r"&width=(\d+)", url)[0] for url in of_rows} == {str(math.ceil(shown))}


def test_numbers_of_a_plan_can_be_read(tab: Tab, many: str, scene: str) -> None:
    """In the colour of all text, and where cameras stand close together, beside each other."""
    page = opened(tab, scene)
    page.click("summary:has-text('Cameras and timings')")
    page.wait_for_selector(".plan text >> nth=1")
    colour = "e => getComputedStyle(e).fill"
    assert page.locator(".plan text").first.evaluate(colour) == page.evaluate("getComputedStyle(document.body).color")
    document = document_of(tab.address, scene)
    view = document["view_cameras"][0]
    document["view_cameras"] = [view, view, view]
    page.route(f"**/scenes/{scene}", lambda route: route.fulfill(json=document))
    page.reload()
    page.click("summary:has-text('Cameras and timings')")
    page.wait_for_selector(".plan text >> nth=2")
    boxes: list[Any] = page.evaluate(NUMBERS)
    for place, (x, y, width, height) in enumerate(boxes):
        for left, top, wide, _ in boxes[place + 1 :]:
            assert abs(top - y) >= 0.75 * height or x + width <= left or left + wide <= x


def test_how_much_of_a_photograph_is_used_is_told(tab: Tab, scene: str) -> None:
    """Below it, where the network saw its middle only."""
    document = document_of(tab.address, scene)
    document["crop"] = [{"kept_share": 1.0, "turned_degrees": 0}, {"kept_share": 0.56, "turned_degrees": 0}]
    tab.page.route(f"**/scenes/{scene}", lambda route: route.fulfill(json=document))
    page = opened(tab, scene)
    page.wait_for_selector(".inputs tr:last-child figcaption")
    told = page.locator(".inputs td:first-child figcaption").all_inner_texts()
    assert told == ["input 0", "input 1, its middle 56 %"]


def test_nothing_more_is_asked_for_a_scene_that_is_left(tab: Tab, many: str, scene: str) -> None:
    """Its picture that comes late is thrown away, before the browser looks for it in vain."""
    held: list[Any] = []
    said: list[str] = []
    tab.page.route(f"**/render?*{many}*&width=*", lambda route: held.append(route))
    tab.page.on("console", lambda message: said.append(message.text))
    page = opened(tab, many)
    until(page, lambda: held)
    page.click(f"li[data-id='{scene}'] button >> nth=0")
    page.wait_for_selector(f"li.chosen[data-id='{scene}']")
    with page.expect_event("requestfinished", lambda request: request.url == held[0].request.url):
        held[0].continue_()
    page.wait_for_selector(".inputs img[alt='Depth from view 1'][src]")  # pictures are loaded one after the other
    settled(page)
    assert len(held) == 1
    assert not [text for text in said if "ERR_FILE_NOT_FOUND" in text]
