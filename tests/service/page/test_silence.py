"""A service that does not answer, or answers with what is not its own, leaves nobody without a word."""

from __future__ import annotations

from typing import Any

import pytest
from browser_tab import Tab
from page_service import stored_cloud, until


def test_a_picture_that_does_not_come_is_told_until_it_does(tab: Tab) -> None:
    scene = stored_cloud(tab.address, 31)
    tab.page.clock.install()
    page = tab.open(f"/?scene={scene}")
    page.click("#mode-server")
    page.wait_for_selector("#stage[aria-busy='false']")
    held: list[Any] = []
    page.route("**/render?**", lambda route: held.append(route))
    page.click("#views button >> nth=0")
    until(page, lambda: held)
    page.clock.fast_forward(1_000)
    assert page.inner_text("#silence") == ""
    page.clock.fast_forward(9_000)
    until(page, lambda: "has not answered for 10 seconds" in page.inner_text("#silence"))
    page.unroute("**/render?**")  # lets what is held go on
    until(page, lambda: page.inner_text("#silence") == "")


def test_models_that_are_not_told_are_said_beside_the_scene(tab: Tab) -> None:
    scene = stored_cloud(tab.address, 32)
    tab.page.route("**/models", lambda route: route.fulfill(status=500, body="<html>"))
    page = tab.open()
    page.wait_for_selector("#view-problem:has-text('the service answered 500')")
    page.wait_for_selector(f"#scenes li.chosen[data-id='{scene}']")


@pytest.mark.parametrize(("status", "cure"), [(413, "send smaller photographs"), (502, "try again in a moment")])
def test_what_a_proxy_answers_has_a_cure(tab: Tab, status: int, cure: str) -> None:
    tab.page.route("**/models", lambda route: route.fulfill(status=status, body="<html>"))
    page = tab.open()
    page.wait_for_selector(f"#view-problem:has-text('the service answered {status}')")
    assert f"What helps: {cure}" in page.inner_text("#view-problem")
