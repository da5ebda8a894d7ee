"""The frame in which WebGL draws: with a frame of the test's own, and with the viewer itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import httpx
import pytest
from browser_tab import Tab
from http_requests import camera_object, photograph
from page_service import opened, patient, stored_cloud, until, write_scene

from gapmes.service.http.page import STATIC

FRAME = """<!doctype html><script>
const scene = new URLSearchParams(location.search).get("scene");
const say = (message) => parent.postMessage({ ...message, scene }, location.origin);
</script>"""
HOUR_S = 3600
PATIENCE_MS = 30_000
NEARLY_MS = 25_000
HANDED = "[...document.getElementById('files').files].map(file => file.name)"


def in_frame(page: Any, scene: str, tell: str) -> None:
    """The frame of this scene says something, and the page has heard it."""
    (frame,) = [frame for frame in page.frames if f"/viewer?scene={scene}" in frame.url]
    page.evaluate("() => { window.heard = new Promise(done => addEventListener('message', done, { once: true })); }")
    frame.evaluate(f"say({tell})")
    page.evaluate("heard.then(() => null)")


def begun(page: Any, scene: str) -> None:
    """WebGL is chosen, and its frame is there. From now on time passes for the page when the test says so."""
    page.clock.pause_at(HOUR_S)
    with page.expect_event("framenavigated", lambda frame: f"/viewer?scene={scene}" in frame.url) as there:
        page.click("#mode-webgl")
    there.value.wait_for_load_state()


@pytest.fixture
def own_frame(tab: Tab) -> Any:
    """The page whose frame says what the test makes it say, and whose clock is the test's."""
    tab.page.clock.install(time=0)
    tab.page.route("**/viewer*", lambda route: route.fulfill(body=FRAME, content_type="text/html"))
    return tab.page


def test_a_file_that_comes_is_waited_for(tab: Tab, own_frame: Any) -> None:
    """Each piece of it begins the wait anew, and the share that has come is shown; without a sign the service draws."""
    scene = stored_cloud(tab.address, 40)
    page = opened(tab, scene)
    begun(page, scene)
    for came in (0, 23_000_000, 46_000_000):
        in_frame(page, scene, f"{{viewer: 'came', came: {came}, all: 92000000}}")
        page.clock.run_for(NEARLY_MS)
        assert page.get_attribute("#mode-webgl", "aria-pressed") == "true"
    assert "46 of 92 MB" in page.inner_text("#coming")
    assert page.evaluate("document.querySelector('#coming progress').position") == 0.5
    page.clock.run_for(PATIENCE_MS)
    page.wait_for_selector("#mode-server[aria-pressed=true]")
    assert "drew nothing in time" in page.inner_text("#mode-note")
    assert page.is_hidden("#coming")


@pytest.mark.parametrize("late", ["{viewer: 'drawn'}", "{viewer: 'failed', reason: 'it is gone'}"])
def test_what_the_last_scenes_frame_says_late_is_passed_over(tab: Tab, own_frame: Any, late: str) -> None:
    first, second = (stored_cloud(tab.address, seed) for seed in (41, 42))
    page = opened(tab, first)
    begun(page, first)
    held: list[Any] = []
    page.route(f"**/viewer?scene={second}", lambda route: held.append(route))
    page.click(f"li[data-id='{second}'] button >> nth=0")
    page.wait_for_url(f"**/?scene={second}")
    in_frame(page, first, late)
    assert page.get_attribute("#mode-webgl", "aria-pressed") == "true"
    assert page.get_attribute("#frame", "data-drawn") == ""
    assert page.inner_text("#mode-note") == ""
    assert page.is_hidden("#frame")
    until(page, lambda: held)
    held[0].abort()


def test_files_that_are_dropped_on_the_frame_are_taken(tab: Tab, own_frame: Any, tmp_path: Path) -> None:
    scene = stored_cloud(tab.address, 43)
    page = opened(tab, scene)
    begun(page, scene)
    in_frame(page, scene, "{viewer: 'drawn'}")
    page.wait_for_selector("#frame[data-drawn=yes]")
    files = write_scene(tmp_path, [photograph(0), photograph(1)], camera_object(2))
    box = page.locator("#stage").bounding_box()
    devtools = page.context.new_cdp_session(page)
    data = {"items": [], "files": [str(file) for file in files], "dragOperationsMask": 1}
    middle = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    for kind, (x, y) in (("dragEnter", (3, 3)), ("dragOver", (3, 3)), ("dragOver", middle), ("drop", middle)):
        devtools.send("Input.dispatchDragEvent", {"type": kind, "x": x, "y": y, "data": data})
    page.wait_for_selector("#go:not([disabled])")
    assert page.evaluate(HANDED) == [file.name for file in files]
    assert page.evaluate("getComputedStyle(document.getElementById('frame')).pointerEvents") == "auto"


def test_the_viewer_tells_how_much_has_come(tab: Tab) -> None:
    if not (STATIC / "viewer" / "index.js").is_file():
        pytest.skip("the WebGL viewer is not there: the package was installed without npm")
    scene = stored_cloud(tab.address, 44)
    patient(tab.page)
    page = opened(tab, scene)
    page.evaluate("() => { window.signs = []; addEventListener('message', ({ data }) => signs.push(data)); }")
    page.click("#mode-webgl")
    page.wait_for_selector("#frame[data-drawn=yes]", state="attached")
    signs = page.evaluate("signs.filter(({ viewer }) => viewer === 'came')")
    whole = len(httpx.get(f"{tab.address}/scenes/{scene}/viewer.ply", timeout=120).content)
    assert signs[-1] == {"viewer": "came", "came": whole, "all": whole, "scene": scene}
    assert page.is_hidden("#coming")
