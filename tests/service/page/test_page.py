"""The page from photographs to a scene: sample, own images, refusals, reload in the middle, deletion."""

from __future__ import annotations

import json
import re
import threading
import zipfile
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from http_requests import camera_object, photograph
from page_service import pixels_of, rendered, serving, write_scene
from standin_model import METADATA, write_standin

from gapmes.service.formats.registry import FORMATS
from gapmes.service.gaussians import Gaussians
from gapmes.service.reconstruct import Reconstructor
from gapmes.service.settings import Settings


def made(page: Any, before: str) -> str:
    """The id of the scene on show, once it is another one than at the address `before`."""
    page.wait_for_url(lambda url: url != before and re.search(r"/\?scene=[0-9a-f]{32}$", url))
    page.wait_for_selector("#picture[src^='blob:']")
    return page.url.rpartition("=")[2]


def test_sample_end_to_end_with_the_shipped_network(browser: Any, tmp_path: Path) -> None:
    """From one press to a scene that shows what `/render` draws, and everything beside it."""
    from conftest import Tab

    with serving(Settings(store=tmp_path / "scenes", threads=1)) as address:
        tab = Tab(browser, address)
        page = tab.open()
        before = page.url
        page.click("#sample")
        scene = made(page, before)
        document = httpx.get(f"{address}/scenes/{scene}").json()
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
        for title in ("What was left out", "How far to trust it", "Cameras and timings"):
            page.click(f"summary:has-text('{title}')")
        page.wait_for_selector("#about meter")
        text = page.inner_text("#about")
        assert f"{document['left_out'][0]['count']:,}" in text
        assert "network" in text
        assert page.locator("#about svg.plan").count() == 1
        page.screenshot(path=tmp_path / "sample.png", full_page=True)
        tab.context.close()
        assert tab.faults == []
        assert tab.elsewhere == []


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
        document = httpx.get(f"{tab.address}/scenes/{scene}").json()
        assert len(document["view_cameras"]) == 3
        page.click("#clear")
    shelf = page.locator("#scenes li")
    assert shelf.count() >= 2
    assert page.locator("#scenes li.chosen").get_attribute("data-id") == scene
    page.locator("#scenes li button >> nth=2").click()  # the second one's picture
    page.wait_for_url(lambda url: not url.endswith(scene))


def test_a_file_of_gaussians_is_shown_as_it_is(tab: Any, tmp_path: Path) -> None:
    """A .splat from elsewhere: into the store, on the stage, on the shelf; one that is none is refused by name."""
    gaussians = Gaussians.make(
        np.random.default_rng(1).normal(size=(500, 3)), np.full((500, 3), 0.05), [[1.0, 0, 0, 0]] * 500,
        np.full(500, 0.9), np.full((500, 1, 3), 0.5),
    )  # fmt: skip
    path = tmp_path / "cloud.splat"
    path.write_bytes(FORMATS["splat"].write(gaussians).data)
    page = tab.open()
    before = page.url
    page.set_input_files("#files", path)
    scene = made(page, before)
    page.wait_for_selector("#picture[src^='blob:']")
    assert (pixels_of(page, "#picture") == rendered(tab.address, scene=scene, view="0")).all()
    assert pixels_of(page, "#picture").max() > 100
    assert "from a .splat" in page.inner_text(f"li[data-id='{scene}']")
    (tmp_path / "mesh.ply").write_bytes(b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n")
    page.set_input_files("#files", tmp_path / "mesh.ply")
    page.wait_for_selector("#problem:has-text('properties are missing')")


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
        ([photograph(0), photograph(1)], SAME_PLACE, "baseline|same"),
        ([photograph(0), photograph(1)], SWAPPED, "near = 10, far = 1"),
        ([photograph(0), photograph(1)], FISHEYE, "FISHEYE"),
        ([photograph(0), photograph(1)], "{no json", "JSON"),
        ([photograph(0), photograph(1)], {"views": []}, "views"),
        ([photograph(0), b"\x89PNG\r\n\x1a\n broken"], camera_object(2), "image"),
        ([photograph(0), photograph(1), photograph(2)], camera_object(2), "2 cameras for 3 images"),
        ([photograph(0), photograph(1, 16, 16)], camera_object(2), "16"),
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
    page.set_input_files("#files", write_scene(tmp_path, [photograph(0), photograph(1)], camera_object(2)))
    if len(images) == 2:  # files of the same names take the place of the wrong ones
        page.wait_for_selector("#go:not([disabled])")
        assert page.inner_text("#problem") == ""


def test_what_is_missing_is_said(tab: Any, tmp_path: Path) -> None:
    page = tab.open()
    files = write_scene(tmp_path, [photograph(0), photograph(1)], camera_object(2))
    page.set_input_files("#files", files[:2])
    page.wait_for_selector("#understood:has-text('Add their camera file')")
    page.click("#clear")
    page.set_input_files("#files", files[1:])
    page.wait_for_selector("#understood:has-text('1 of 2 to 6 photographs')")
    page.set_input_files("#files", files[:1])
    page.wait_for_selector("#go:not([disabled])")


def test_sixty_photographs_at_once(tab: Any, tmp_path: Path) -> None:
    """They are refused by their number, with a way on: the best few of them."""
    page = tab.open()
    cameras = camera_object(60)
    for index, view in enumerate(cameras["views"]):
        view["image"] = f"{index}.png"
        view["c2w"][0][3] = 0.05 * index
    page.set_input_files("#files", write_scene(tmp_path, [photograph(k) for k in range(60)], cameras))
    page.wait_for_selector("#problem strong")
    assert "60" in page.inner_text("#problem")
    assert page.is_disabled("#go")
    page.select_option("#context", "3")
    page.wait_for_selector(".cards li >> nth=2")
    assert page.locator(".cards li").count() == 3
    before = page.url
    page.click("#go")
    scene = made(page, before)
    assert len(httpx.get(f"{tab.address}/scenes/{scene}").json()["view_cameras"]) == 3


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
    assert len(httpx.get(f"{tab.address}/scenes/{scene}").json()["view_cameras"]) == 3


@pytest.fixture
def held_network(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The network waits until the event is set."""
    go, run = threading.Event(), Reconstructor._run

    def held(self: Reconstructor, *arguments: Any) -> Any:
        assert go.wait(60)
        return run(self, *arguments)

    monkeypatch.setattr(Reconstructor, "_run", held)
    yield go
    go.set()


def test_reload_in_the_middle_of_a_job(tab: Any, tmp_path: Path, held_network: threading.Event) -> None:
    page = tab.open()
    page.set_input_files("#files", write_scene(tmp_path, [photograph(30), photograph(31)], camera_object(2)))
    page.wait_for_selector("#go:not([disabled])")
    before = page.url
    page.click("#go")
    page.wait_for_selector("#stage-name:has-text('network')")
    assert "/?job=" in page.url
    page.reload()
    page.wait_for_selector("#stage-name:has-text('network')")
    assert page.locator("#stages li").count() >= 2  # cameras and images are told again
    held_network.set()
    made(page, before)
    assert page.is_hidden("#progress")


def test_a_job_can_be_cancelled(tab: Any, tmp_path: Path, held_network: threading.Event) -> None:
    page = tab.open()
    page.set_input_files("#files", write_scene(tmp_path, [photograph(40), photograph(41)], camera_object(2)))
    page.wait_for_selector("#go:not([disabled])")
    page.click("#go")
    page.wait_for_selector("#stage-name:has-text('network')")
    page.click("#cancel")
    held_network.set()
    page.wait_for_selector("#problem:has-text('cancelled')")


def test_a_scene_is_deleted_once_that_is_confirmed(tab: Any, tmp_path: Path) -> None:
    page = tab.open()
    page.set_input_files("#files", write_scene(tmp_path, [photograph(50), photograph(51)], camera_object(2)))
    page.wait_for_selector("#go:not([disabled])")
    before = page.url
    page.click("#go")
    scene = made(page, before)
    page.once("dialog", lambda dialog: dialog.dismiss())
    page.click("#remove")
    assert httpx.get(f"{tab.address}/scenes/{scene}").status_code == 200
    page.once("dialog", lambda dialog: dialog.accept())
    page.click("#remove")
    page.wait_for_url(lambda url: scene not in url)
    assert httpx.get(f"{tab.address}/scenes/{scene}").status_code == 404
    assert page.locator(f"li[data-id='{scene}']").count() == 0


def test_a_link_that_leads_nowhere(tab: Any) -> None:
    page = tab.open(f"/?scene={'0' * 32}")
    page.wait_for_selector("#view-problem:has-text('no scene')")


def test_a_key_is_asked_for_and_goes_with_everything(browser: Any, standin_model: Path, tmp_path: Path) -> None:
    from conftest import Tab

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
        tab.context.close()
        assert tab.faults == []


def test_the_network_can_be_chosen(browser: Any, standin_model: Path, tmp_path: Path) -> None:
    from conftest import Tab

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
        assert httpx.get(f"{address}/scenes/{scene}").json()["model"]["preset"] == "second"
        tab.context.close()
