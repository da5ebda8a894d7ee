"""Options beside photographs that are chosen: whoever sets one goes on at once, while the page looks again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from browser_tab import Tab
from page_service import choose_two, document_of, made, until


class Gate:
    """Checks are held back from now on until it opens; one that the page gives up at once may never come here."""

    def __init__(self, page: Any) -> None:
        self.held: list[Any] = []
        self._is_open = False
        page.route("**/check", self._come)

    def _come(self, route: Any) -> None:
        if self._is_open:
            route.continue_()
        else:
            self.held.append(route)

    def open(self) -> None:
        self._is_open = True
        for route in self.held:
            route.continue_()


def with_options(tab: Tab, tmp_path: Path, *, seed: int) -> Any:
    """The page with two photographs chosen and its options unfolded."""
    page = tab.open()
    choose_two(page, tmp_path, seed=seed)
    page.click("summary:has-text('Options')")
    return page


def test_a_press_after_an_option_is_not_lost(tab: Tab, tmp_path: Path) -> None:
    """The field is left as the button goes down: nothing may move away from below the pointer."""
    page = with_options(tab, tmp_path, seed=200)
    checks = Gate(page)
    page.fill("#near", "0.5")
    page.check("#trust_poses")
    assert page.is_checked("#trust_poses")
    assert page.locator(".cards li").count() == 2
    assert page.get_attribute("#understood", "aria-busy") == "true"
    checks.open()
    page.wait_for_selector("#understood:not([aria-busy])")
    assert "Depth from 0.5" in page.inner_text("#understood")


def test_reconstruct_waits_for_the_check(tab: Tab, tmp_path: Path) -> None:
    """Pressed straight after an option, by Enter too, it begins as soon as the check has ended well, and once."""
    page = with_options(tab, tmp_path, seed=202)
    sent: list[str] = []
    page.on("request", lambda request: request.url.endswith("/reconstruct") and sent.append(request.url))
    checks = Gate(page)
    page.fill("#near", "0.5")
    page.press("#near", "Enter")
    page.click("#go")
    until(page, lambda: checks.held)
    assert sent == []
    before = page.url
    checks.open()
    document = document_of(tab.address, made(page, before))
    assert document["near"] == 0.5
    assert len(sent) == 1


def test_a_refused_option_is_called_as_it_is_on_the_page(tab: Tab, tmp_path: Path) -> None:
    page = with_options(tab, tmp_path, seed=206)
    page.fill("#max_error", "5")
    page.click("#go")
    page.wait_for_selector("#problem:has-text('(Largest change of a colour for which')")
    assert "is 5, need 0 to 1" in page.inner_text("#problem")


def test_an_option_that_is_refused_ends_the_wait(tab: Tab, tmp_path: Path) -> None:
    page = with_options(tab, tmp_path, seed=204)
    page.fill("#near", "20")
    page.click("#go")
    page.wait_for_selector("#problem:has-text('near = 20')")
    assert page.is_disabled("#go")
    assert page.inner_text("#understood") == ""
    page.fill("#near", "0.5")
    page.press("#near", "Tab")
    page.wait_for_selector("#go:not([disabled])")
