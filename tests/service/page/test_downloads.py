"""Files of a scene that the page downloads: a refusal is told there, and so is what a format could not hold."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from browser_tab import Tab
from page_service import cloud

from gapmes.service.formats.registry import FORMATS

TOLD = "#download-told"


@pytest.fixture
def far(tab: Tab) -> tuple[Any, str]:
    """The page with a scene far from the world's origin, as positions of a map have it, and its path."""
    gaussians = cloud(71)
    gaussians = replace(gaussians, means=gaussians.means + np.array([532_000.0, 5_410_000.0, 310.0]))
    file = {"file": ("far.ply", FORMATS["ply"].write(gaussians).data)}
    scene = httpx.post(f"{tab.address}/scenes", files=file, timeout=120).json()
    page = tab.open(f"/?scene={scene['id']}")
    page.wait_for_selector("#downloads")
    return page, f"{tab.address}{scene['links']['self']}"


def link(page: Any, extension: str) -> Any:
    return page.locator(f"#downloads a[href$='{extension}']")


def test_what_a_format_cannot_hold_is_told_beside_the_file(far: tuple[Any, str]) -> None:
    page, path = far
    answer = httpx.get(f"{path}.splat", timeout=120)
    notes = json.loads(answer.headers["x-gapmes-notes"])
    assert any("positions" in note for note in notes)
    with page.expect_download() as download:
        link(page, ".splat").click()
    assert Path(download.value.path()).read_bytes() == answer.content
    page.wait_for_selector(f"{TOLD} .warning")
    assert page.inner_text(TOLD) == f".splat: {'; '.join(notes)}"
    with page.expect_download() as download:
        link(page, "/sheet").click()  # a file without notes takes those of the one before away
    assert download.value.suggested_filename.endswith(".png")
    assert page.inner_text(TOLD) == ""


def test_a_format_that_refuses_a_scene_is_told_with_its_cure(far: tuple[Any, str]) -> None:
    page, path = far
    problem = httpx.get(f"{path}.spz", timeout=120).json()
    link(page, ".spz").click()
    page.wait_for_selector(f"{TOLD} .problem")
    told = page.inner_text(TOLD)
    assert problem["detail"] in told
    assert f"What helps: {problem['cure']}" in told
    assert page.locator("#downloads [aria-busy]").count() == 0


def test_a_ply_is_left_to_the_browser_once_it_is_known_to_be_there(far: tuple[Any, str]) -> None:
    page, path = far
    with page.expect_download() as download:
        link(page, ".ply").first.click()
    assert Path(download.value.path()).read_bytes() == httpx.get(f"{path}.ply", timeout=120).content
    assert not download.value.url.startswith("blob:")  # it never was in the page's memory
    httpx.delete(path, timeout=120)
    link(page, ".ply").first.click()
    page.wait_for_selector(f"{TOLD}:has-text('Scene not found')")
