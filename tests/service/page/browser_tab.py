"""Chromium, and a page in it that records errors."""

from __future__ import annotations

import shutil
from typing import Any

# the first has no window of its own to keep and draws no page with WebGL: two fifths of the others' processor time
_COMMANDS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
CHROMIUM = next(filter(None, map(shutil.which, _COMMANDS)), None)
DESKTOP = {"width": 1280, "height": 900}
PHONE = {"width": 390, "height": 844}
PATIENCE_MS = 120_000  # of every wait, for a busy machine
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def launched(playwright: Any, *flags: str) -> Any:
    return playwright.chromium.launch(executable_path=CHROMIUM, args=[*FLAGS, *flags])


class Tab:
    """A page in its own tab, and the errors that occurred in it."""

    def __init__(self, browser: Any, address: str, **options: Any) -> None:
        self.address = address
        self.context = browser.new_context(**{"viewport": DESKTOP, **options})
        self.context.set_default_timeout(PATIENCE_MS)
        self.page = self.context.new_page()
        self.faults: list[str] = []
        self.elsewhere: list[str] = []
        self.page.on("pageerror", lambda error: self.faults.append(str(error)))
        self.page.on("console", self._said)
        self.page.on("request", self._asked)

    def _said(self, message: Any) -> None:
        # a refusal of the service is also an error on the console
        if message.type == "error" and "Failed to load resource" not in message.text:
            self.faults.append(message.text)

    def _asked(self, request: Any) -> None:
        if not request.url.startswith((self.address, "blob:", "data:")):
            self.elsewhere.append(request.url)

    def done(self) -> None:
        """Nothing was thrown, nothing broke the policy, no other host was asked."""
        self.context.close()
        assert self.faults == []
        assert self.elsewhere == []

    def open(self, path: str = "/") -> Any:
        self.page.goto(self.address + path)
        self.page.wait_for_selector("#state:has-text('Network')")
        self.page.wait_for_selector("#main[aria-busy=false]")
        return self.page
