"""Poses that are slightly wrong: told in the page's words, and corrected by its option."""

from __future__ import annotations

from pathlib import Path

from browser_tab import Tab
from page_service import document_of, made, write_scene
from sample_photographs import FAR, NEAR, sample_cameras
from wrong_cameras import turned_camera

from gapmes.service.cameras.camera_file import camera_document
from gapmes.service.shipped import sample_folder

UP = (1.0, 0.0, 0.0)


def two_views_of_the_sample(folder: Path) -> list[Path]:
    """With the second camera turned by 0.7 degrees."""
    images = [(sample_folder() / f"images/{index:03d}.png").read_bytes() for index in (1, 3)]
    first, second = sample_cameras((1, 3))
    views = [camera_document(camera) for camera in (first, turned_camera(second, UP, 0.7))]
    return write_scene(folder, images, {"near": NEAR, "far": FAR, "views": views})


def test_they_are_told_and_corrected(tab: Tab, tmp_path: Path) -> None:
    page = tab.open()
    told = {}
    for corrected in (False, True):
        page.set_input_files("#files", two_views_of_the_sample(tmp_path / str(corrected)))
        page.wait_for_selector(".cards li >> nth=1")
        if corrected:
            page.click("summary:has-text('Options')")
            page.check("#refine_poses")
            assert "poses corrected" in page.inner_text("#options summary")
        before = page.url
        page.click("#go")
        scene = made(page, before)
        page.wait_for_selector("#about .warning")
        told[corrected] = page.inner_text("#about")
        document = document_of(tab.address, scene)
        assert [warning["code"] for warning in document["warnings"]] == [
            "poses_refined" if corrected else "poses_inexact"
        ]
    assert 'or tick "Correct poses …" under Options' in told[False]
    assert "since they were corrected: view 1 was turned by 0." in told[True]
    assert not any("refine_poses" in text for text in told.values())
