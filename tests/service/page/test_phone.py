"""The page on a phone: its width and colours, touch, and the way to what is far below."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser_tab import PHONE, Tab
from http_requests import camera_object, photograph
from page_service import opened, pixels_of, settled, write_scene


@pytest.fixture
def phone(browser: Any, address: str) -> Iterator[Tab]:
    tab = Tab(browser, address, viewport=PHONE, is_mobile=True, has_touch=True, color_scheme="dark")
    yield tab
    tab.done()


def test_a_phone_in_the_dark(phone: Tab, scene: str, tmp_path: Path) -> None:
    """Nothing is wider than the screen, buttons are large enough for a finger, the page is dark."""
    page = opened(phone, scene)
    for title in ("How far to trust the scene", "Cameras and timings", "Options"):
        page.click(f"summary:has-text('{title}')")
    page.set_input_files("#files", write_scene(tmp_path, [photograph(0), photograph(1)], camera_object(2)))
    page.wait_for_selector(".cards li")
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    heights = page.locator("button:visible:not(.quiet)").evaluate_all("all => all.map(b => b.offsetHeight)")
    assert min(heights) >= 32
    background, colour = page.evaluate(
        "[getComputedStyle(document.body).color, matchMedia('(prefers-color-scheme: dark)').matches]"
    )
    assert colour is True
    assert min(int(part) for part in re.findall(r"\d+", background)[:3]) > 180  # light letters


@pytest.mark.parametrize("width", [320, PHONE["width"], 900])  # 900: two columns, the narrower of which has the fields
def test_what_an_empty_field_says_can_be_read_whole(browser: Any, address: str, width: int) -> None:
    tab = Tab(browser, address, viewport={**PHONE, "width": width})
    page = tab.open()
    page.click("summary:has-text('Options')")
    code = """fields => fields.map(field => {
      const style = getComputedStyle(field), text = document.createElement("canvas").getContext("2d");
      text.font = style.font;
      const room = field.clientWidth - parseFloat(style.paddingLeft) - parseFloat(style.paddingRight);
      return [field.id, text.measureText(field.placeholder).width <= room];
    })"""
    found = dict(page.locator("input[placeholder]:visible").evaluate_all(code))
    assert {name for name, whole in found.items() if not whole} == set()
    assert {"near", "far"} <= set(found)
    tab.done()


def test_a_phone_has_a_short_way_to_a_new_scene(phone: Tab, scene: str) -> None:
    page = opened(phone, scene)
    before = page.url
    page.tap("#to-making")
    page.wait_for_selector("#files:focus")
    assert page.evaluate("document.getElementById('files').getBoundingClientRect().top < innerHeight")
    assert page.url == before


def test_fingers_turn_and_come_nearer(phone: Tab, scene: str) -> None:
    """One finger turns both ways and does not scroll the page, two change the distance, and so do the buttons."""
    page = opened(phone, scene)
    settled(page)
    box = page.locator("#stage").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    touch = phone.context.new_cdp_session(page)

    def fingers(kind: str, *places: tuple[float, float]) -> None:
        points = [{"x": px, "y": py, "id": number} for number, (px, py) in enumerate(places)]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    before = page.evaluate("scrollY")
    fingers("touchStart", (x, y))
    for step in range(1, 11):
        fingers("touchMove", (x - 3 * step, y + 4 * step))
    fingers("touchEnd")
    settled(page)
    assert "turned by 9° and 12°" in page.inner_text("#caption")
    assert page.evaluate("scrollY") == before
    turned_only = pixels_of(page, "#picture")
    fingers("touchStart", (x - 20, y), (x + 20, y))
    for step in range(1, 6):
        fingers("touchMove", (x - 20 - 4 * step, y), (x + 20 + 4 * step, y))
    fingers("touchEnd")
    settled(page)
    nearer = pixels_of(page, "#picture")
    assert "turned by 9° and 12°" in page.inner_text("#caption")
    assert np.abs(nearer.astype(int) - turned_only).mean() > 5
    for _ in range(4):
        page.tap("#farther")
    settled(page)
    assert np.abs(pixels_of(page, "#picture").astype(int) - nearer).mean() > 5


@pytest.mark.parametrize("name", ["a" * 200 + ".jpg", "Photograph" * 18 + ".png"])
def test_long_names_are_not_wider_than_the_screen(phone: Tab, scene: str, tmp_path: Path, name: str) -> None:
    """In what was understood of the files, in warnings, and while a file is loaded."""
    page = opened(phone, scene)
    cameras = camera_object(2)
    for view, other in zip(cameras["views"], ("x.jpg", "y.jpg"), strict=True):
        view["image"] = other
    paths = write_scene(tmp_path, [photograph(0), photograph(1)], cameras)
    paths[0] = paths[0].rename(tmp_path / name)
    page.set_input_files("#files", paths)
    page.wait_for_selector(f"#understood .warning:has-text('{name[:20]}')")
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    code = """text => {
      document.getElementById("stage-name").textContent = text;
      document.getElementById("progress").hidden = false;
    }"""
    page.evaluate(code, f"Loading {name} …")
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
