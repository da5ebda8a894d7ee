"""Keyboard and focus: the browser keeps its own keys, and the focus is never lost to the top of the page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from browser_tab import Tab
from http_requests import camera_object, photograph
from page_service import opened, settled, stored_cloud, write_scene

FOCUS = "document.activeElement.id || document.activeElement.tagName"


def pressed(page: Any, key: str, **modifiers: bool) -> bool:
    """Whether the page keeps a key that is pressed in the picture from the browser."""
    code = """([key, modifiers]) => !document.getElementById("stage").dispatchEvent(
      new KeyboardEvent("keydown", { key, bubbles: true, cancelable: true, ...modifiers }))"""
    return page.evaluate(code, [key, modifiers])


@pytest.mark.parametrize("modifier", ["ctrlKey", "metaKey", "altKey"])
def test_shortcuts_of_the_browser_stay_its_own(tab: Tab, modifier: str) -> None:
    stored_cloud(tab.address, 21)
    page = tab.open()
    page.click("#mode-server")
    for key in ("+", "-", "ArrowLeft", "ArrowRight"):
        assert not pressed(page, key, **{modifier: True}), key
        assert pressed(page, key), key
    assert pressed(page, "+", shiftKey=True)


def test_only_the_first_button_turns(tab: Tab) -> None:
    stored_cloud(tab.address, 21)
    page = tab.open()
    page.click("#mode-server")
    box = page.locator("#stage").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    for button, turned in (("right", False), ("middle", False), ("left", True)):
        page.mouse.move(x, y)
        page.mouse.down(button=button)
        page.mouse.move(x - 30, y)
        page.mouse.up(button=button)
        settled(page)
        assert ("turned" in page.inner_text("#caption")) == turned, button


def test_the_wheel_with_ctrl_stays_the_browsers(tab: Tab, scene: str) -> None:
    """It zooms the page, as a pinch on a trackpad does; without Ctrl it moves the camera closer."""
    page = opened(tab, scene)
    wheel = """([ctrlKey]) => document.getElementById("stage").dispatchEvent(
      new WheelEvent("wheel", { deltaY: -100, ctrlKey, bubbles: true, cancelable: true }))"""
    assert page.evaluate(wheel, [True])  # nobody took it
    settled(page)
    assert "turned" not in page.inner_text("#caption")
    assert not page.evaluate(wheel, [False])
    settled(page)
    assert "turned" in page.inner_text("#caption")


def test_how_many_are_used_can_be_chosen_by_keys(tab: Tab, tmp_path: Path) -> None:
    page = tab.open()
    cameras = camera_object(8)
    for index, view in enumerate(cameras["views"]):
        view["image"] = f"{index}.png"
    page.set_input_files("#files", write_scene(tmp_path, [photograph(k) for k in range(8)], cameras))
    page.focus("#context")
    for number in (4, 5):
        page.keyboard.press("ArrowDown")
        page.wait_for_selector(f".cards li >> nth={number - 1}")
        assert page.evaluate(FOCUS) == "context"
        assert page.input_value("#context") == str(number)
    page.click("#clear")
    assert page.is_hidden("#choice")
    assert page.input_value("#context") == ""


@pytest.mark.parametrize("part", ["#views button", "#about summary", "#downloads a"])
def test_a_focus_in_what_another_scene_replaces_goes_to_the_picture(tab: Tab, part: str) -> None:
    """By a step of the history, as where a job ends; elsewhere it stays."""
    first, second = (stored_cloud(tab.address, seed) for seed in (24, 25))
    page = tab.open(f"/?scene={first}")
    page.click(f"#scenes li[data-id='{second}'] button >> nth=0")
    page.wait_for_selector(f"#scenes li.chosen[data-id='{second}']")
    page.focus(f"{part} >> nth=0")
    page.go_back()
    page.wait_for_selector(f"#scenes li.chosen[data-id='{first}']")
    assert page.evaluate(FOCUS) == "stage"
    page.focus("#channel")
    page.go_forward()
    page.wait_for_selector(f"#scenes li.chosen[data-id='{second}']")
    assert page.evaluate(FOCUS) == "channel"


def test_deleting_from_the_list_leaves_the_focus_in_it(tab: Tab) -> None:
    """On the entry that has the row then; where none is left, on the chooser."""
    for seed in (22, 23):
        stored_cloud(tab.address, seed)
    page = tab.open()
    page.on("dialog", lambda dialog: dialog.accept())
    rows = page.locator("#scenes li")
    for left in range(rows.count() - 1, -1, -1):
        gone = rows.nth(0).get_attribute("data-id")
        rows.nth(0).locator(".quiet").focus()
        page.keyboard.press("Enter")
        page.wait_for_selector(f"li[data-id='{gone}']", state="detached")
        assert rows.count() == left
        if left:
            kept = rows.nth(0).get_attribute("data-id")
            assert page.evaluate("document.activeElement.closest('li')?.dataset.id") == kept
            assert page.evaluate("document.activeElement.textContent") == "Delete"
        else:
            assert page.evaluate(FOCUS) == "files"
