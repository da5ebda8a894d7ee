"""A service with an API key: the page asks for it, sends it with everything, and asks again where it is refused."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from browser_tab import Tab
from http_requests import photograph, post
from page_service import made, serving, until

from gapmes.service.settings import Settings


@pytest.fixture
def locked(browser: Any, standin_model: Path, tmp_path: Path) -> Iterator[Any]:
    """The page of a service whose key is "open sesame"."""
    settings = Settings(model=standin_model, store=tmp_path / "scenes", threads=1, api_key="open sesame")
    with serving(settings) as address:
        tab = Tab(browser, address)
        yield tab.open()
        tab.done()


def test_a_key_is_asked_for_and_goes_with_everything(locked: Any) -> None:
    locked.fill("#key", "open sesame")
    locked.click("#key-form button")
    before = locked.url
    locked.click("#sample")
    made(locked, before)
    locked.wait_for_selector(".inputs img[src^='blob:'] >> nth=3")
    with locked.expect_download() as download:
        locked.click("#downloads a:has-text('.ply')")
    assert Path(download.value.path()).read_bytes()[:4] == b"ply\n"


def test_a_wrong_key_is_told_and_asked_for_again(locked: Any) -> None:
    for key in ("wrong", "open sesame"):
        locked.wait_for_selector("#view-problem:has-text('needs a key')")
        assert "Bearer" not in locked.inner_text("#view-problem")  # which is for those who write requests
        locked.wait_for_selector("#key:focus")
        assert ("does not take this one" in locked.inner_text("#key-problem")) == (key == "open sesame")
        locked.fill("#key", key)
        locked.press("#key", "Enter")
    locked.wait_for_selector("#view-problem:empty", state="attached")
    assert locked.is_hidden("#key-form")
    assert locked.evaluate("document.activeElement.id") == "stage"


def test_a_job_in_the_address_is_followed_once_the_key_is_there(
    browser: Any, standin_model: Path, tmp_path: Path, held_network: threading.Event
) -> None:
    """And stays in the address before."""
    settings = Settings(model=standin_model, store=tmp_path / "scenes", threads=1, api_key="open sesame")
    with serving(settings) as address:
        key = {"Authorization": "Bearer open sesame"}
        with httpx.Client(base_url=address, timeout=120, headers=key) as client:
            answer = post(client, [photograph(220), photograph(221)], prefer="respond-async")
        job = answer.json()["links"]["self"].rpartition("/")[2]
        tab = Tab(browser, address)
        page = tab.open(f"/?job={job}")
        page.wait_for_selector("#key:focus")
        page.wait_for_selector("#progress[hidden]", state="attached")
        assert page.url == f"{address}/?job={job}"
        assert page.inner_text("#problem") == ""
        before = page.url
        page.fill("#key", "open sesame")
        page.press("#key", "Enter")
        page.wait_for_selector("#progress:not([hidden])")
        held_network.set()
        made(page, before)
        tab.done()


HELD = """() => {
  const json = Response.prototype.json;
  const held = new Promise((go) => { window.go = go; });
  Response.prototype.json = async function () {
    if (this.status === 401 && this.url.includes("/scenes")) {
      window.reading = true;
      await held;
    }
    return json.call(this);
  };
}"""


def test_a_refusal_that_is_read_while_another_key_is_given_asks_for_none(locked: Any) -> None:
    """Of two requests with the wrong key, the first has brought the form; the body of the other's answer is slow."""
    locked.wait_for_selector("#key:focus")
    locked.evaluate(HELD)
    locked.fill("#key", "wrong")
    locked.press("#key", "Enter")
    until(locked, lambda: locked.evaluate("window.reading"))
    locked.fill("#key", "open sesame")
    locked.press("#key", "Enter")
    locked.evaluate("async () => { window.go(); await new Promise((read) => setTimeout(read)); }")
    locked.wait_for_selector("#view-problem:empty", state="attached")
    assert locked.is_hidden("#key-form")
    assert locked.text_content("#key-problem") == ""


def test_a_key_that_no_header_can_hold_is_not_taken(locked: Any) -> None:
    locked.fill("#key", "“open sesame”")
    locked.click("#key-form button")
    locked.wait_for_selector("#key-problem:has-text('character 1 of 13 is not printable ASCII')")
    assert locked.is_visible("#key")
    locked.fill("#key", "open sesame")
    locked.click("#key-form button")
    locked.wait_for_selector("#view-problem:empty", state="attached")
    assert locked.is_hidden("#key-form")


def test_an_answer_to_the_last_key_is_passed_over(locked: Any) -> None:
    """It comes when the right one is there already, with which the page asks for the same again."""
    held: list[Any] = []
    locked.route(
        "**/scenes?*",
        lambda route: held.append(route) if route.request.headers["x-api-key"] == "wrong" else route.continue_(),
    )
    for key in ("wrong", "open sesame"):
        locked.wait_for_selector("#key:focus")
        locked.fill("#key", key)
        locked.press("#key", "Enter")
        until(locked, lambda: held)
    locked.wait_for_selector("#empty:visible")
    with locked.expect_response(lambda answer: "/scenes?" in answer.url and answer.status == 200):
        held[0].continue_()
    assert locked.is_hidden("#key-form")
    assert locked.inner_text("#view-problem") == ""
