"""The page from photographs to a scene: sample, own images, refusals, reload during a job, deletion."""

from __future__ import annotations

import json
import threading
import zipfile
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from browser_tab import Tab
from http_requests import camera_object, photograph
from page_service import (
    cancelled,
    choose_two,
    cloud,
    document_of,
    made,
    pixels_of,
    rendered,
    serving,
    stored_cloud,
    write_scene,
)
from standin_model import METADATA, write_standin

from gapmes.service.formats.registry import FORMATS
from gapmes.service.settings import Settings


def test_sample_end_to_end_with_the_shipped_network(browser: Any, tmp_path: Path) -> None:
    """From one press to a scene that shows what `/render` draws, and everything beside it."""
    with serving(Settings(store=tmp_path / "scenes", threads=1)) as address:
        tab = Tab(browser, address)
        page = tab.open()
        before = page.url
        page.click("#sample")
        scene = made(page, before)
        document = document_of(address, scene)
        assert document["check"]["input_views"][0]["psnr"] > 25
        page.wait_for_selector(".inputs canvas >> nth=3")
        shown = pixels_of(page, "#picture")
        assert (shown == rendered(address, scene=scene, view="0")).all()
        pictures = page.locator(".inputs img")
        assert pictures.count() == 6  # photograph, drawn again, depth; of two views
        photo, again = pixels_of(page, ".inputs img >> nth=0"), pixels_of(page, ".inputs img >> nth=1")
        error = np.mean((photo / 255.0 - again / 255.0) ** 2)
        assert -10 * np.log10(error) == pytest.approx(document["check"]["input_views"][0]["psnr"], abs=0.5)
        assert "expert 5" in page.inner_text("#about")
        for title in ("What was left out", "How far to trust the scene", "Cameras and timings"):
            page.click(f"summary:has-text('{title}')")
        page.wait_for_selector("#about meter")
        text = page.inner_text("#about")
        assert f"{document['left_out'][0]['count']:,}" in text
        assert "network" in text
        assert page.locator("#about svg.plan").count() == 1
        page.screenshot(path=tmp_path / "sample.png", full_page=True)
        tab.done()


def test_own_photographs(tab: Any, tmp_path: Path) -> None:
    """What was understood is shown before anything is computed; two scenes are on the shelf then."""
    page = tab.open()
    for seed in (10, 20):
        cameras = camera_object(3)
        files = write_scene(tmp_path / str(seed), [photograph(seed + k) for k in range(3)], cameras)
        page.set_input_files("#files", files)
        page.wait_for_selector(".cards li >> nth=2")
        assert "0: 0.png" in page.inner_text(".cards")
        assert "Depth from 1 to 10 (given)" in page.inner_text("#understood")
        assert page.locator("#understood svg circle").count() >= 3
        before = page.url
        page.click("#go")
        scene = made(page, before)
        document = document_of(tab.address, scene)
        assert len(document["view_cameras"]) == 3
        page.click("#clear")
    shelf = page.locator("#scenes li")
    assert shelf.count() >= 2
    assert page.locator("#scenes li.chosen").get_attribute("data-id") == scene
    page.locator("#scenes li button >> nth=2").click()  # the second one's picture
    page.wait_for_url(lambda url: not url.endswith(scene))


def test_a_file_of_gaussians_is_shown_as_it_is(tab: Any, tmp_path: Path) -> None:
    """A .splat from elsewhere: into the store, on the stage, on the shelf; one that is none is refused by name."""
    path = tmp_path / "cloud.splat"
    path.write_bytes(FORMATS["splat"].write(cloud(1)).data)
    page = tab.open()
    before = page.url
    page.set_input_files("#files", path)
    scene = made(page, before)
    page.wait_for_selector("#picture[src^='blob:']")
    assert (pixels_of(page, "#picture") == rendered(tab.address, scene=scene, view="0")).all()
    assert pixels_of(page, "#picture").max() > 100
    assert "from a .splat" in page.inner_text(f"li[data-id='{scene}']")


def test_a_zip_of_a_capture(tab: Any, tmp_path: Path) -> None:
    """Eight views in one file, and three of them chosen, which the page says."""
    cameras = camera_object(8)
    with zipfile.ZipFile(tmp_path / "capture.zip", "w") as bundle:
        for index, view in enumerate(cameras["views"]):
            view["image"] = f"images/{index}.png"
            bundle.writestr(view["image"], photograph(80 + index))
        bundle.writestr("cameras.json", json.dumps(cameras))
    page = tab.open()
    page.set_input_files("#files", tmp_path / "capture.zip")
    page.wait_for_selector(".cards li >> nth=2")
    assert "3 of 8 photographs" in page.inner_text("#understood")
    before = page.url
    page.click("#go")
    scene = made(page, before)
    assert len(document_of(tab.address, scene)["view_cameras"]) == 3


def test_photographs_with_a_zipped_model_of_their_cameras(tab: Any, tmp_path: Path) -> None:
    """A COLMAP model comes as a zip beside the photographs."""
    poses = [(0.0, "0.png"), (-0.2, "1.png")]  # world to camera: the second camera stands 0.2 to the right
    lines = "".join(f"{k} 1 0 0 0 {x} 0 0 1 {name}\n\n" for k, (x, name) in enumerate(poses, 1))
    with zipfile.ZipFile(tmp_path / "model.zip", "w") as bundle:
        bundle.writestr("sparse/0/cameras.txt", "1 PINHOLE 96 72 80 80 48 36\n")
        bundle.writestr("sparse/0/images.txt", lines)
        bundle.writestr("sparse/0/points3D.txt", "")
    photos = write_scene(tmp_path, [photograph(95), photograph(96)], {})[:2]
    page = tab.open()
    page.set_input_files("#files", [*photos, tmp_path / "model.zip"])
    page.wait_for_selector(".cards li >> nth=1")
    assert page.inner_text("#problem") == ""


def test_back_leads_out_of_a_scene_and_starting_over_starts_nothing(tab: Any, tmp_path: Path) -> None:
    """Steps of the history are scenes, not jobs. "Try the sample", once cancelled, does not send what comes later."""
    stored_cloud(tab.address, 98)  # to be shown first
    page = tab.open()
    first = page.url
    sent: list[str] = []
    page.on("request", lambda request: request.url.endswith("/reconstruct") and sent.append(request.url))
    held: list[Any] = []
    page.route("**/check", lambda route: route.continue_() if held else held.append(route))  # the first one waits
    with page.expect_request("**/check"):
        page.click("#sample")
    page.click("#clear")
    choose_two(page, tmp_path, seed=97)
    held[0].continue_()  # the answer for the sample comes late
    assert page.url == first
    page.click("#go")
    scene = made(page, first)
    page.wait_for_selector("#progress", state="hidden")
    assert len(sent) == 1
    page.go_back()
    page.wait_for_url(lambda url: scene not in url and "job" not in url)
    page.go_forward()
    page.wait_for_url(lambda url: url.endswith(scene))


def test_reload_in_the_middle_of_a_job(tab: Any, tmp_path: Path, held_network: threading.Event) -> None:
    page = tab.open()
    choose_two(page, tmp_path, seed=30)
    before = page.url
    page.click("#go")
    page.wait_for_selector("#stage-name:has-text('network')")
    assert "/?job=" in page.url
    assert page.is_disabled("#go")
    assert page.is_disabled("#sample")
    page.reload()
    page.wait_for_selector("#stage-name:has-text('network')")
    page.wait_for_selector("#stages li >> nth=1")  # cameras and images are told again
    held_network.set()
    made(page, before)
    assert page.is_hidden("#progress")


def test_a_job_can_be_cancelled(tab: Any, tmp_path: Path, held_network: threading.Event) -> None:
    page = tab.open()
    choose_two(page, tmp_path, seed=40)
    page.click("#go")
    page.wait_for_selector("#stage-name:has-text('network')")
    cancelled(page, lambda: page.click("#cancel"))
    held_network.set()
    page.wait_for_selector("#problem:has-text('cancelled')")


def test_a_scene_is_deleted_once_that_is_confirmed(tab: Any, tmp_path: Path) -> None:
    page = tab.open()
    choose_two(page, tmp_path, seed=50)
    before = page.url
    page.click("#go")
    scene = made(page, before)
    page.once("dialog", lambda dialog: dialog.dismiss())
    page.click("#remove")
    assert httpx.get(f"{tab.address}/scenes/{scene}", timeout=120).status_code == 200
    page.once("dialog", lambda dialog: dialog.accept())
    page.click("#remove")
    page.wait_for_url(lambda url: scene not in url)
    assert httpx.get(f"{tab.address}/scenes/{scene}", timeout=120).status_code == 404
    assert page.locator(f"li[data-id='{scene}']").count() == 0


def test_the_network_can_be_chosen(browser: Any, standin_model: Path, tmp_path: Path) -> None:
    other = write_standin(tmp_path / "other.onnx", METADATA | {"preset": "second"})
    models = f"other={other}"
    settings = Settings(model=standin_model, models=models, store=tmp_path / "scenes", threads=1)
    with serving(settings) as address:
        tab = Tab(browser, address)
        page = tab.open()
        page.click("summary:has-text('Options')")
        page.select_option("#model", "other")
        before = page.url
        page.click("#sample")
        scene = made(page, before)
        assert document_of(address, scene)["model"]["preset"] == "second"
        tab.done()
