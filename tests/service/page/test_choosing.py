"""The file chooser, and the description of a scene that was made from files."""

from __future__ import annotations

from pathlib import Path

import httpx
from browser_tab import Tab
from http_requests import camera_object, photograph
from page_service import choose, choose_two, document_of, made, write_scene

NAMES = "[...document.getElementById('files').files].map(file => file.name)"


def test_the_chooser_shows_all_that_is_chosen(tab: Tab, tmp_path: Path) -> None:
    page = tab.open()
    files = write_scene(tmp_path, [photograph(0), photograph(1)], camera_object(2))
    choose(page, files[:2])
    choose(page, files[2:])
    page.wait_for_selector("#go:not([disabled])")
    assert page.evaluate(NAMES) == ["0.png", "1.png", "cameras.json"]
    with page.expect_file_chooser():
        page.click("#files")
    page.dispatch_event("#files", "cancel")  # it was closed without a choice
    assert page.evaluate(NAMES) == ["0.png", "1.png", "cameras.json"]
    assert page.is_enabled("#go")
    page.click("#clear")
    assert page.evaluate(NAMES) == []


def test_what_the_budget_saved_is_told(tab: Tab, tmp_path: Path) -> None:
    page = tab.open()
    choose_two(page, tmp_path, seed=130)
    before = page.url
    page.click("#go")
    scene = made(page, before)
    document = document_of(tab.address, scene)
    page.route(f"**/scenes/{scene}", lambda route: route.fulfill(json=document))
    for saved, told in ((0, "The budget left out no Gaussian"), (430_032, "The file is 430,032 bytes smaller")):
        document["pruning"] |= {"bytes_saved": saved}
        tab.open(f"/?scene={scene}")
        page.click("summary:has-text('What was left out')")
        page.wait_for_selector(f"#about:has-text('{told}')")


def test_a_sharper_scene_is_offered_where_the_service_makes_one(tab: Tab) -> None:
    page = tab.open()
    answer = httpx.get(f"{tab.address}/models", timeout=120).json()
    assert answer["max_detail"] == 2
    page.click("summary:has-text('Options')")
    page.wait_for_selector("#detail")
    page.check("#detail")
    page.route("**/models", lambda route: route.fulfill(json=answer | {"max_detail": 1}))
    page.reload()
    page.wait_for_selector("#state:has-text('Network')")
    page.click("summary:has-text('Options')")
    page.wait_for_selector("#trust_poses")
    page.wait_for_selector("#detail", state="hidden")
    assert not page.is_checked("#detail")


def test_a_sharper_scene_is_made_when_asked_for(tab: Tab, tmp_path: Path) -> None:
    page = tab.open()
    choose_two(page, tmp_path, seed=140)
    page.click("summary:has-text('Options')")
    page.check("#detail")
    before = page.url
    page.click("#go")
    document = document_of(tab.address, made(page, before))
    assert document["detail"] == 2
    assert document["view_cameras"][0]["width"] == 2 * document["model"]["width"]
