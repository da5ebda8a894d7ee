"""The page's messages when something is wrong, and that it continues from there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from browser_tab import Tab
from http_requests import camera_object, photograph
from page_service import broken_answers, choose, choose_two, document_of, made, serving, stored_cloud, write_scene

from gapmes.service.captures.select import DEFAULT_CONTEXT
from gapmes.service.settings import Settings


def bent(change: Any) -> Any:
    cameras = camera_object(2)
    change(cameras)
    return cameras


MIRRORED = bent(lambda c: c["views"][1]["c2w"][0].__setitem__(0, -1.0))
SAME_PLACE = bent(lambda c: c["views"][1].__setitem__("c2w", c["views"][0]["c2w"]))
SWAPPED = bent(lambda c: c.update(near=10.0, far=1.0))
FISHEYE = {
    "camera_model": "OPENCV_FISHEYE",
    "frames": [{"file_path": "0.png"}, {"file_path": "1.png"}],
}


@pytest.mark.parametrize(
    ("images", "cameras", "told"),
    [
        ([photograph(0), photograph(1)], MIRRORED, r"det\(R\) = -1"),
        ([photograph(0), photograph(1)], SAME_PLACE, r"^No baseline"),
        ([photograph(0), photograph(1)], SWAPPED, "near = 10, far = 1"),
        ([photograph(0), photograph(1)], FISHEYE, "FISHEYE"),
        ([photograph(0), photograph(1)], "{no json", "JSON"),
        ([photograph(0), photograph(1)], {"views": []}, "non-empty list of views"),
        ([photograph(0), b"\x89PNG\r\n\x1a\n broken"], camera_object(2), r"^Image unreadable \(1\.png\)"),
        (
            [photograph(0), photograph(1), photograph(2)],
            camera_object(2),
            "2 cameras for 3 images.*\n.*to which",
        ),
        (
            [photograph(0), photograph(1)[:-200]],
            camera_object(2),
            r"^Image unreadable \(1\.png\).*\n.*damaged",
        ),
        ([photograph(0), photograph(1, 16, 16)], camera_object(2), r"^Image invalid \(1\.png\).*16"),
    ],
)
def test_every_refusal_is_shown_with_what_helps(
    tab: Any, tmp_path: Path, images: list[bytes], cameras: Any, told: str
) -> None:
    page = tab.open()
    page.set_input_files("#files", write_scene(tmp_path, images, cameras))
    page.wait_for_selector("#problem strong")
    assert re.search(told, page.inner_text("#problem")), page.inner_text("#problem")
    assert page.is_disabled("#go")
    choose(page, write_scene(tmp_path, [photograph(0), photograph(1)], camera_object(2)))
    if len(images) == 2:  # files of the same names take the place of the wrong ones
        page.wait_for_selector("#go:not([disabled])")
        assert page.inner_text("#problem") == ""


def test_what_is_missing_is_said(tab: Any, tmp_path: Path) -> None:
    page = tab.open()
    files = write_scene(tmp_path, [photograph(0), photograph(1)], camera_object(2))
    page.set_input_files("#files", files[:2])
    page.wait_for_selector("#understood:has-text('2 photographs. Add their camera file')")
    assert "the program COLMAP computes it" in page.inner_text("#understood")
    page.click("#clear")
    page.set_input_files("#files", files[:1])
    page.wait_for_selector("#understood:has-text('1 photograph. Add their camera file')")
    page.click("#clear")
    page.set_input_files("#files", files[1:])
    page.wait_for_selector("#understood:has-text('1 photograph so far. Add 1 or more')")
    page.set_input_files("#files", files[:1])
    page.wait_for_selector("#go:not([disabled])")
    page.click("#clear")
    page.set_input_files("#files", files[2:])
    page.wait_for_selector("#understood:has-text('0 photographs so far. Add 2 or more')")


def test_screen_readers_hear_what_is_missing_and_what_is_understood(tab: Any, tmp_path: Path) -> None:
    """In a status that is there before its words: one that comes with them need not be read."""
    page = tab.open()
    files = write_scene(tmp_path, [photograph(0), photograph(1)], camera_object(2))
    status = page.query_selector("#understood [role=status]")
    for chosen, told in ((files[:2], "Add their camera file"), (files[2:], "Cameras paired by order")):
        page.set_input_files("#files", chosen)
        page.wait_for_function("([status, told]) => status.textContent.includes(told)", arg=[status, told])
    assert status.evaluate("status => status.isConnected")


def test_a_file_that_no_camera_names_is_told(tab: Any, tmp_path: Path) -> None:
    page = tab.open()
    cameras = camera_object(4)
    for index, view in enumerate(cameras["views"]):
        view["image"] = f"{index}.png"
    files = write_scene(tmp_path, [photograph(0), photograph(1)], cameras)
    files[1] = files[1].rename(tmp_path / "notes.png")
    page.set_input_files("#files", files)
    page.wait_for_selector("#problem:has-text('4 cameras for 2 images, and none of them names')")
    assert "(notes.png)" in page.inner_text("#problem")
    assert "the name that the camera file has for it" in page.inner_text("#problem")


def test_the_files_of_a_model_go_in_as_one_zip(tab: Any, tmp_path: Path) -> None:
    page = tab.open()
    files = write_scene(tmp_path, [photograph(0), photograph(1)], {})[:2]
    for name in ("cameras.txt", "images.txt"):
        files.append(tmp_path / name)
        files[-1].write_text("# a list\n")
    page.set_input_files("#files", files)
    page.wait_for_selector("#problem:has-text('2 beside the photographs, need one: cameras.txt, images.txt')")
    assert "one zip" in page.inner_text("#problem")


@pytest.mark.parametrize("other", ["more.zip", "cameras.json"])
def test_a_zip_comes_alone(tab: Any, tmp_path: Path, other: str) -> None:
    """The page says so itself, since the words of the service are those of a form."""
    page = tab.open()
    files = [tmp_path / "capture.zip", tmp_path / other]
    for file in files:
        file.write_bytes(b"")
    page.set_input_files("#files", files)
    page.wait_for_selector("#problem:has-text('2, need one:')")
    assert "the cameras of a zip belong inside it" in page.inner_text("#problem")


def test_sixty_photographs_at_once(tab: Any, tmp_path: Path) -> None:
    """More than a scene takes: the best few are used, as many as of a zip, and nothing is refused."""
    page = tab.open()
    cameras = camera_object(60)
    for index, view in enumerate(cameras["views"]):
        view["image"] = f"{index}.png"
        view["c2w"][0][3] = 0.05 * index
    page.set_input_files("#files", write_scene(tmp_path, [photograph(k) for k in range(60)], cameras))
    page.wait_for_selector("#choice:has-text('60 photographs')")
    page.wait_for_selector(f".cards li >> nth={DEFAULT_CONTEXT - 1}")
    assert page.input_value("#context") == str(DEFAULT_CONTEXT)
    page.select_option("#context", "")
    page.wait_for_selector("#understood:has-text('Choose how many')")
    assert page.is_disabled("#go")
    page.select_option("#context", "3")
    page.wait_for_selector("#go:not([disabled])")
    assert page.locator(".cards li").count() == 3
    before = page.url
    page.click("#go")
    scene = made(page, before)
    assert len(document_of(tab.address, scene)["view_cameras"]) == 3


def test_a_refused_file_of_gaussians_leaves_the_way_free(tab: Any, tmp_path: Path) -> None:
    page = tab.open()
    mesh = tmp_path / "mesh.ply"
    mesh.write_bytes(b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n")
    page.set_input_files("#files", mesh)
    page.wait_for_selector("#problem:has-text('properties are missing')")
    assert "Loading" not in page.inner_text("#understood")
    choose_two(page, tmp_path, seed=0)
    assert page.inner_text("#problem") == ""
    page.set_input_files("#files", mesh)
    page.wait_for_selector("#problem:has-text('2 photographs beside mesh.ply')")
    assert page.is_disabled("#go")


def test_more_than_can_be_sent_one_by_one(tab: Any, tmp_path: Path) -> None:
    page = tab.open()
    page.set_input_files("#files", write_scene(tmp_path, [photograph(0)] * 61, camera_object(61)))
    page.wait_for_selector("#problem:has-text('one zip')")
    assert page.is_disabled("#go")


@pytest.mark.parametrize("cut", [True, False])
def test_an_answer_that_breaks_off_is_told_and_the_page_goes_on(tab: Any, *, cut: bool) -> None:
    """By a line that breaks within it, or a proxy that answers with a page of its own."""
    first, second = (stored_cloud(tab.address, seed) for seed in (1, 2))
    page = tab.page
    with broken_answers() as nowhere:

        def breaking(route: Any) -> None:
            if cut:
                route.continue_(url=nowhere)
            else:
                route.fulfill(status=200, content_type="text/html", body="<p>Log in first")

        page.route("**/scenes?*", breaking)
        tab.open()
        page.wait_for_selector("#shelf-problem:has-text('was cut off')")
        page.unroute("**/scenes?*")
        tab.open(f"/?scene={second}")
        page.route(f"**/scenes/{first}", breaking)
        page.click(f"li[data-id='{first}'] button >> nth=0")
        page.wait_for_selector("#shelf-problem:has-text('was cut off')")
        page.unroute(f"**/scenes/{first}")
        page.click(f"li[data-id='{first}'] button >> nth=0")
        page.wait_for_url(lambda url: url.endswith(first))
        page.route("**/readyz", breaking)
        page.reload()
        page.wait_for_selector("#state:has-text('was cut off')")
        page.unroute("**/readyz")
        page.wait_for_selector("#state:has-text('Network')")
        page.wait_for_selector("#picture[src^='blob:']")
        if cut:  # any bytes are a picture, until it is drawn
            page.click("#mode-server")
            page.route("**/render*", breaking)
            page.click("#nearer")
            page.wait_for_selector("#view-problem:has-text('was cut off')")


def test_with_a_full_disk_scenes_can_still_be_seen(browser: Any, standin_model: Path, tmp_path: Path) -> None:
    """The service is not ready then, which the page says, and shows what there is."""
    settings = Settings(model=standin_model, store=tmp_path / "scenes", threads=1)
    with serving(settings) as address:
        tab = Tab(browser, address)
        full = {"title": "Storage full", "status": 507, "detail": "the disk is full", "code": "storage_full"}
        tab.page.route("**/readyz", lambda route: route.fulfill(status=507, json=full))
        tab.page.goto(address)
        tab.page.wait_for_selector("#state:has-text('the disk is full')")
        tab.page.wait_for_selector("#mode-server[aria-pressed=true], #mode-webgl[aria-pressed=true]")
        tab.page.wait_for_selector("#model option", state="attached")
        tab.done()


def test_a_picture_that_is_refused_is_told_until_one_comes(tab: Any, tmp_path: Path) -> None:
    page = tab.open()
    choose_two(page, tmp_path, seed=90)
    before = page.url
    page.click("#go")
    made(page, before)
    page.click("#mode-server")
    busy = {"title": "Service busy", "status": 503, "detail": "32 pictures wait", "code": "service_busy"}
    page.route("**/render*", lambda route: route.fulfill(status=503, json=busy))
    page.click("#views button >> nth=1")
    page.wait_for_selector("#view-problem:has-text('32 pictures wait')")
    page.unroute("**/render*")
    page.click("#views button >> nth=0")
    page.wait_for_selector("#view-problem:empty", state="attached")
