"""Cures in the page's own words: never in those of requests, options or settings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import httpx
import pytest
from browser_tab import Tab
from http_requests import camera_object, photograph
from page_service import write_scene

from gapmes.service.errors import (
    DeadlineExceeded,
    JobCancelled,
    ModelNotReady,
    OverlapError,
    UploadTooLarge,
    ViewCountError,
)
from gapmes.service.formats.reading import DROP_CURE, FormatError
from gapmes.service.problem_document import of_error

APART = camera_object(2)
APART["views"][1]["c2w"][0][3] = 100.0


@pytest.mark.parametrize(
    ("name", "cameras", "helps"),
    [
        ("cameras.json", {}, "choose a camera file: cameras.json, transforms.json"),
        ("cameras.json", [], "choose a camera file: cameras.json, transforms.json"),
        ("package.json", {"name": "page", "version": "1.0.0"}, "choose a camera file: cameras.json"),
        ("transforms.json", {"frames": []}, "choose a camera file: cameras.json"),
        ("transforms.json", {"frames": [{}, {}]}, "give fl_x, the focal length in px, at the top of the file"),
        ("readme.txt", "# Read me", "choose a camera file: cameras.json"),
        ("cameras.json", APART, 'as they are, tick "Only warn if …" under Options'),
    ],
)
def test_of_a_wrong_camera_file(tab: Tab, tmp_path: Path, name: str, cameras: Any, helps: str) -> None:
    page = tab.open()
    files = write_scene(tmp_path, [photograph(0), photograph(1)], cameras)
    files[-1] = files[-1].rename(tmp_path / name)
    page.set_input_files("#files", files)
    page.wait_for_selector("#problem strong")
    told = page.inner_text("#problem")
    assert helps in told.partition("What helps: ")[2]
    assert "GET /" not in told
    assert "trust_poses" not in told


@pytest.mark.parametrize(
    ("error", "helps"),
    [
        (UploadTooLarge("9 bytes", cure="send smaller photographs. Or raise GAPMES_MAX_UPLOAD_BYTES"), "smaller photo"),
        (UploadTooLarge("9 bytes", cure="choose fewer with `select` or `context`"), "send smaller photographs, or"),
        (DeadlineExceeded("9 s", cure="use fewer views, or raise GAPMES_RECONSTRUCT_SECONDS"), "use fewer views"),
        (JobCancelled("the job was cancelled", cure="ask for it again"), "reconstruct it again"),
        (ModelNotReady("stage 'network'", cure="poll /readyz until it answers 200"), "the top of the page names"),
        (ViewCountError("1 image", field="images", cure="send a `capture`"), "choose 2 to 6 photographs"),
        (FormatError("2 rows are invalid", field="ply", cure=DROP_CURE), "write the file again"),
        (OverlapError("0 %", field="cameras", cure="near?; if they are right, set trust_poses"), "near?; if they are"),
    ],
)
def test_of_what_else_is_refused(tab: Tab, tmp_path: Path, error: Any, helps: str) -> None:
    document = of_error(error)
    page = tab.open()
    page.route("**/check", lambda route: route.fulfill(status=document["status"], body=json.dumps(document)))
    page.set_input_files("#files", write_scene(tmp_path, [photograph(0), photograph(1)], camera_object(2)))
    page.wait_for_selector("#problem strong")
    told = page.inner_text("#problem").partition("What helps: ")[2]
    assert helps in told
    for theirs in ("GAPMES_", "`", "--", "trust_poses", "drop_invalid", "/readyz"):
        assert theirs not in told


@pytest.mark.parametrize("answer", [{"message": "no upstream"}, [], None, "broken", {"title": 3}])
def test_an_answer_that_is_no_problem_document_is_told_by_its_status(tab: Tab, tmp_path: Path, answer: Any) -> None:
    """For example that of a proxy."""
    page = tab.open()
    page.route("**/check", lambda route: route.fulfill(status=502, json=answer))
    page.set_input_files("#files", write_scene(tmp_path, [photograph(0), photograph(1)], camera_object(2)))
    page.wait_for_selector("#problem:has-text('the service answered 502')")
    assert "undefined" not in page.inner_text("#problem")


def test_warnings_name_their_view_once(tab: Tab, tmp_path: Path) -> None:
    page = tab.open()
    given = [
        {"code": "exif_orientation_ignored", "field": "images", "index": 1, "message": "EXIF is not applied"},
        {"code": "little_overlap", "field": "cameras", "index": 0, "message": "view 0 shares little (set trust_poses)"},
        {"code": "depth_range_wide", "field": "far", "message": "far is wide"},
    ]

    files = write_scene(tmp_path, [photograph(0), photograph(1)], camera_object(2))
    parts = [("images", (path.name, path.read_bytes())) for path in files[:2]]
    answer = httpx.post(
        f"{tab.address}/check", files=[*parts, ("cameras", (files[2].name, files[2].read_bytes()))], timeout=120
    )
    page.route("**/check", lambda route: route.fulfill(json={**answer.json(), "warnings": given}))
    page.set_input_files("#files", files)
    page.wait_for_selector("#understood .warning >> nth=2")
    assert page.locator("#understood .warning").all_inner_texts() == [
        "Note: view 1: EXIF is not applied",
        'Note: view 0 shares little (tick "Only warn if …" under Options)',
        "Note: far is wide",
    ]
