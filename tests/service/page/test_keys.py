"""A service with an API key: the page asks for it, sends it with everything, and asks again where it is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from browser_tab import Tab
from page_service import made, serving, until

from gapmes.service.settings import Settings


def test_a_key_is_asked_for_and_goes_with_everything(browser: Any, standin_model: Path, tmp_path: Path) -> None:
    settings = Settings(model=standin_model, store=tmp_path / "scenes", threads=1, api_key="open sesame")
    with serving(settings) as address:
        tab = Tab(browser, address)
        page = tab.open()
        page.fill("#key", "open sesame")
        page.click("#key-form button")
        before = page.url
        page.click("#sample")
        made(page, before)
        page.wait_for_selector(".inputs img[src^='blob:'] >> nth=3")
        with page.expect_download() as download:
            page.click("#downloads a:has-text('.ply')")
        assert Path(download.value.path()).read_bytes()[:4] == b"ply\n"
        tab.done()


def test_a_wrong_key_is_told_and_asked_for_again(browser: Any, standin_model: Path, tmp_path: Path) -> None:
    settings = Settings(model=standin_model, store=tmp_path / "scenes", threads=1, api_key="open sesame")
    with serving(settings) as address:
        tab = Tab(browser, address)
        page = tab.open()
        for key in ("wrong", "open sesame"):
            page.wait_for_selector("#view-problem:has-text('needs a key')")
            assert "Bearer" not in page.inner_text("#view-problem")  # which is for those who write requests
            page.wait_for_selector("#key:focus")
            assert ("does not take this one" in page.inner_text("#key-problem")) == (key == "open sesame")
            page.fill("#key", key)
            page.press("#key", "Enter")
        page.wait_for_selector("#view-problem:empty", state="attached")
        assert page.is_hidden("#key-form")
        assert page.evaluate("document.activeElement.id") == "stage"
        tab.done()


def test_a_key_that_no_header_can_hold_is_not_taken(browser: Any, standin_model: Path, tmp_path: Path) -> None:
    settings = Settings(model=standin_model, store=tmp_path / "scenes", threads=1, api_key="open sesame")
    with serving(settings) as address:
        tab = Tab(browser, address)
        page = tab.open()
        page.fill("#key", "“open sesame”")
        page.click("#key-form button")
        page.wait_for_selector("#key-problem:has-text('character 1 of 13 is not printable ASCII')")
        assert page.is_visible("#key")
        page.fill("#key", "open sesame")
        page.click("#key-form button")
        page.wait_for_selector("#view-problem:empty", state="attached")
        assert page.is_hidden("#key-form")
        tab.done()


def test_an_answer_to_the_last_key_is_passed_over(browser: Any, standin_model: Path, tmp_path: Path) -> None:
    """It comes when the right one is there already, with which the page asks for the same again."""
    settings = Settings(model=standin_model, store=tmp_path / "scenes", threads=1, api_key="open sesame")
    with serving(settings) as address:
        tab = Tab(browser, address)
        page = tab.open()
        held: list[Any] = []
        page.route(
            "**/scenes?*",
            lambda route: held.append(route) if route.request.headers["x-api-key"] == "wrong" else route.continue_(),
        )
        for key in ("wrong", "open sesame"):
            page.wait_for_selector("#key:focus")
            page.fill("#key", key)
            page.press("#key", "Enter")
            until(page, lambda: held)
        page.wait_for_selector("#empty:visible")
        with page.expect_response(lambda answer: "/scenes?" in answer.url and answer.status == 200):
            held[0].continue_()
        assert page.is_hidden("#key-form")
        assert page.inner_text("#view-problem") == ""
        tab.done()
