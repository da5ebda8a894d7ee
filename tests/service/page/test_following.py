"""The page follows a job: without a stream of its events, and while it is being cancelled."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import httpx
from browser_tab import Tab
from http_requests import photograph, post
from page_service import cancelled, choose_two, made, until

BUSY = {"title": "Service busy", "status": 503, "code": "service_busy", "detail": "2 requests are following jobs"}


def refused(route: Any) -> None:
    route.fulfill(status=503, json=BUSY, content_type="application/problem+json")


def test_a_job_in_the_queue_says_how_many_scenes_are_before_it(
    tab: Tab, tmp_path: Path, held_network: threading.Event
) -> None:
    """And says it again as their number changes, of which no event tells."""
    page = tab.open()
    others = []
    with httpx.Client(base_url=tab.address, timeout=120) as client:
        for seed in (210, 212, 214):
            answer = post(client, [photograph(seed), photograph(seed + 1)], prefer="respond-async")
            assert answer.status_code == 202
            others.append(tab.address + answer.json()["links"]["self"])
    choose_two(page, tmp_path, seed=200)
    before = page.url
    page.click("#go")
    page.wait_for_selector("#stage-name:text-is('waiting in the queue, 3 scenes before yours')")
    for left in ("2 scenes", "1 scene"):
        assert httpx.delete(others.pop(), timeout=120).json()["state"] == "cancelled"
        page.wait_for_selector(f"#stage-name:text-is('waiting in the queue, {left} before yours')")
    held_network.set()
    made(page, before)


def test_without_a_stream_the_job_itself_is_asked(tab: Tab, tmp_path: Path, held_network: threading.Event) -> None:
    """All streams are taken: the stages are those that the job tells, however long that lasts."""
    page = tab.open()
    asked: list[str] = []
    page.on("response", lambda response: asked.append(response.url) if "/jobs/" in response.url else None)
    page.route("**/events?*", refused)
    page.clock.install()
    choose_two(page, tmp_path, seed=150)
    before = page.url
    page.click("#go")
    page.wait_for_selector("#progress:not([hidden])")

    def followed_long() -> bool:
        page.clock.run_for(1600)
        often = len([url for url in asked if "/events" in url]) >= 25  # more than it tries where nobody answers
        return often and "network" in page.inner_text("#stage-name")

    until(page, followed_long)
    assert page.inner_text("#problem") == ""
    page.clock.resume()
    held_network.set()
    made(page, before)


def test_where_the_job_is_refused_too_its_words_are_shown(
    tab: Tab, tmp_path: Path, held_network: threading.Event
) -> None:
    page = tab.open()
    page.route("**/jobs/**", refused)
    choose_two(page, tmp_path, seed=160)
    before = page.url
    page.click("#go")
    page.wait_for_selector("#stage-name:has-text('2 requests are following jobs; retrying')")
    page.unroute("**/jobs/**")
    held_network.set()
    made(page, before)


def test_a_cancelled_job_is_ending_until_it_has_ended(tab: Tab, tmp_path: Path, held_network: threading.Event) -> None:
    page = tab.open()
    choose_two(page, tmp_path, seed=170)
    page.click("#go")
    page.wait_for_selector("#stage-name:has-text('network')")
    page.focus("#cancel")
    cancelled(page, lambda: page.keyboard.press("Enter"))
    page.wait_for_selector("#stage-name:has-text('cancelling after this stage')")
    assert page.get_attribute("#cancel", "aria-disabled") == "true"
    held_network.set()
    page.wait_for_selector("#problem:has-text('cancelled')")
    assert page.is_hidden("#cancel")
    assert page.evaluate("document.activeElement.id") == "go"
    held_network.clear()  # a job that ends has no such button any more
    page.click("#go")
    page.wait_for_selector("#cancel[aria-disabled=false]")


def test_a_service_that_is_back_is_told(tab: Tab, tmp_path: Path, held_network: threading.Event) -> None:
    """What was said of its absence goes, also of a job that waits in the queue and of which there is no news."""
    queued = {"state": "queued", "stage": None}
    page = tab.open()
    choose_two(page, tmp_path, seed=180)
    before = page.url
    page.route("**/jobs/**", lambda route: route.abort())
    page.click("#go")
    page.wait_for_selector("#stage-name:has-text('the service does not answer; retrying')")
    page.click("#cancel")
    page.wait_for_selector("#problem:has-text('the service does not answer')")
    page.route("**/events?*", lambda route: None)  # a stream without events
    page.route("**/jobs/*", lambda route: route.fulfill(json=queued))
    page.unroute("**/jobs/**")
    page.wait_for_selector("#stage-name:text('waiting in the queue')")
    page.wait_for_selector("#problem:empty", state="attached")
    page.unroute_all()
    page.reload()
    held_network.set()
    made(page, before)


def test_a_job_is_followed_for_as_long_as_the_service_is_away(
    tab: Tab, tmp_path: Path, held_network: threading.Event
) -> None:
    """Less and less often; the job goes on when it is back. All is counted by the page's clock, which does not stand
    still between the calls here."""
    page = tab.open()
    page.clock.install()
    choose_two(page, tmp_path, seed=190)
    before = page.url
    page.evaluate(
        """() => {
          const ask = window.fetch;
          [window.asked, window.open] = [0, 0];
          window.fetch = (url, ...more) => {
            window.asked += String(url).includes("/jobs/");
            window.open += 1;
            return ask(url, ...more).finally(() => { window.open -= 1; });
          };
        }"""
    )
    page.route("**/jobs/**", lambda route: route.abort())
    page.click("#go")

    def asked_by() -> tuple[int, float]:
        return tuple(page.evaluate("[window.asked, Date.now()]"))

    def wait(milliseconds: int, times: int) -> None:
        for _ in range(times):
            page.clock.run_for(milliseconds)
            until(page, lambda: page.evaluate("window.open") == 0)

    page.wait_for_selector("#stage-name:has-text('the service does not answer; retrying')")
    wait(12_100, times=9)  # as long as eight pauses: a try each
    asked, start = asked_by()
    wait(1_500, times=8)
    now_asked, end = asked_by()
    assert end - start >= 12_000
    # a try every 12 s, and every 3 s a question for the place in the queue
    assert 3 <= now_asked - asked <= (end - start) * (1 / 12_000 + 1 / 3_000) + 2
    assert "the service does not answer; retrying" in page.inner_text("#stage-name")
    assert page.inner_text("#problem") == ""
    page.unroute("**/jobs/**")
    held_network.set()
    page.clock.run_for(12_100)
    page.clock.resume()
    made(page, before)
