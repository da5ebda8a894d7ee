"""The files of a new scene: the kind of each, removing one, and files that cannot be used as they are."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from browser_tab import Tab
from http_requests import camera_object, photograph
from page_service import choose, choose_two, cloud, document_of, made, write_scene

from gapmes.service.formats.registry import FORMATS


def listed(page: Any) -> list[str]:
    return page.locator("#chosen-files button").evaluate_all(
        "all => all.map(one => one.getAttribute('aria-label').replace('Remove ', ''))"
    )


def test_one_file_of_gaussians_at_a_time(tab: Tab, tmp_path: Path) -> None:
    """None of several vanishes without a word; what is left when the others are taken out is loaded."""
    for seed in (31, 32):
        (tmp_path / f"{seed}.splat").write_bytes(FORMATS["splat"].write(cloud(seed)).data)
    page = tab.open()
    before = page.url
    page.set_input_files("#files", [tmp_path / "31.splat", tmp_path / "32.splat"])
    page.wait_for_selector("#problem:has-text('2 at once, need one: 31.splat, 32.splat')")
    assert page.is_disabled("#go")
    page.click("[aria-label='Remove 31.splat']")
    scene = made(page, before)
    assert "from a .splat" in page.inner_text(f"li[data-id='{scene}']")


@pytest.mark.parametrize(
    ("name", "told"),
    [
        (".DS_Store", "ignored"),
        ("a.pdf", "ignored"),
        ("2.HEIC", "convert it to JPEG"),
        ("images.bin", "zip of its folder"),
    ],
)
def test_a_stray_file_spoils_nothing_and_can_be_taken_out(tab: Tab, tmp_path: Path, name: str, told: str) -> None:
    page = tab.open()
    files = write_scene(tmp_path, [photograph(0), photograph(1)], camera_object(2))
    files.append(tmp_path / name)
    files[-1].write_bytes(b"\0\1")
    page.set_input_files("#files", files)
    page.wait_for_selector("#go:not([disabled])")
    assert told in page.inner_text(f"#chosen-files li:has-text('{name}')")
    assert "4 files, 1 of them ignored" in page.inner_text("#so-far")
    page.click(f"[aria-label='Remove {name}']")
    page.wait_for_selector("#go:not([disabled])")
    assert listed(page) == ["0.png", "1.png", "cameras.json"]
    page.click("#clear")
    page.set_input_files("#files", files[-1])
    page.wait_for_selector(f"#problem:has-text('{name}: none can be used')")


def test_a_number_that_the_browser_has_kept_takes_no_photograph_away(tab: Tab, tmp_path: Path) -> None:
    """On the way back to the page it sets what was chosen before, also where that is out of sight."""
    page = tab.open()
    page.evaluate("document.getElementById('context').value = '2'")
    cameras = camera_object(3)
    page.set_input_files("#files", write_scene(tmp_path, [photograph(k) for k in range(3)], cameras))
    page.wait_for_selector(".cards li >> nth=2")
    assert page.input_value("#context") == ""


def test_files_are_taken_out_by_keys(tab: Tab, tmp_path: Path) -> None:
    """The focus stays in the list as long as there is one."""
    page = tab.open()
    choose_two(page, tmp_path, seed=33)
    page.focus("[aria-label='Remove 1.png']")
    for left in (["0.png", "cameras.json"], ["0.png"]):
        page.keyboard.press("Enter")
        assert listed(page) == left
        assert page.evaluate("document.activeElement.getAttribute('aria-label')") == f"Remove {left[-1]}"
    page.keyboard.press("Enter")
    assert page.evaluate("document.activeElement.id") == "files"
    assert page.is_hidden("#chosen")
    assert page.is_hidden("#clear")


def test_another_photograph_of_the_same_name_is_told(tab: Tab, tmp_path: Path) -> None:
    page = tab.open()
    choose_two(page, tmp_path / "one", seed=34)
    assert page.is_hidden("#replaced")
    choose(page, [tmp_path / "one" / "0.png"])
    page.wait_for_selector("#go:not([disabled])")
    assert page.is_hidden("#replaced")
    choose(page, write_scene(tmp_path / "other", [photograph(36)], {})[:1])
    page.wait_for_selector("#replaced:has-text('0.png replaces another file of that name')")
    page.wait_for_selector("#go:not([disabled])")
    assert listed(page) == ["0.png", "1.png", "cameras.json"]  # in its place: cameras may be paired by order


def test_a_file_that_can_no_longer_be_read_is_named(tab: Tab, tmp_path: Path) -> None:
    page = tab.open()
    choose_two(page, tmp_path, seed=37)
    (tmp_path / "1.png").unlink()
    page.click("#go")
    page.wait_for_selector("#problem:has-text('1.png can no longer be read')")
    assert "choose it again" in page.inner_text("#problem")
    assert page.is_hidden("#progress")


def test_rows_that_cannot_be_read_are_left_out_when_asked_for(tab: Tab, tmp_path: Path) -> None:
    """A refused file stays, and is loaded once an option changes that may help."""
    data = FORMATS["ply"].write(cloud(38)).data
    start = data.index(b"end_header\n") + len(b"end_header\n")
    values = np.frombuffer(data[start:], "<f4").copy()
    values[7 * (len(values) // 500)] = np.nan
    (tmp_path / "nan.ply").write_bytes(data[:start] + values.tobytes())
    page = tab.open()
    before = page.url
    page.set_input_files("#files", tmp_path / "nan.ply")
    page.wait_for_selector("#problem:has-text('1 of 500 values')")
    assert 'tick "Leave out rows that cannot be read"' in page.inner_text("#problem")
    assert listed(page) == ["nan.ply"]
    assert page.inner_text("#go") == "Load"
    page.click("#drop_invalid")  # `check` would look again, when the scene may be there and the box empty
    scene = made(page, before)
    assert document_of(tab.address, scene)["gaussians"]["count"] == 499
    assert page.is_hidden("#chosen")
    assert not page.is_checked("#drop_invalid")


def test_axes_of_a_spz_can_be_told(tab: Tab, tmp_path: Path) -> None:
    data = FORMATS["spz"].write(cloud(39)).data
    (tmp_path / "a.spz").write_bytes(data)
    page = tab.open()
    page.click("summary:has-text('Options')")
    page.select_option("#axes", "rdf")
    assert page.inner_text("#options summary") == "Options: axes rdf"
    before = page.url
    page.set_input_files("#files", tmp_path / "a.spz")
    scene = made(page, before)
    again = httpx.post(f"{tab.address}/scenes", files={"file": ("a.spz", data)}, data={"axes": "rdf"}, timeout=60)
    assert again.status_code == 200  # it is there already
    assert again.json()["id"] == scene


def test_of_a_zip_of_many_it_is_asked_how_many_are_used(tab: Tab, tmp_path: Path) -> None:
    cameras = camera_object(8)
    with zipfile.ZipFile(tmp_path / "capture.zip", "w") as bundle:
        for index, view in enumerate(cameras["views"]):
            view["image"] = f"images/{index}.png"
            bundle.writestr(view["image"], photograph(180 + index))
        bundle.writestr("cameras.json", json.dumps(cameras))
    page = tab.open()
    page.set_input_files("#files", tmp_path / "capture.zip")
    page.wait_for_selector("#choice:has-text('8 photographs')")
    assert page.input_value("#context") == "3"
    page.select_option("#context", "4")
    page.wait_for_selector(".cards li >> nth=3")
    assert page.is_visible("#choice")
    before = page.url
    page.click("#go")
    scene = made(page, before)
    assert len(document_of(tab.address, scene)["view_cameras"]) == 4


def test_what_is_set_is_told_and_ends_with_the_try(tab: Tab, tmp_path: Path) -> None:
    """Options that are folded away spoil neither the next files nor the sample."""
    page = tab.open()
    page.click("summary:has-text('Options')")
    for name, value in (("near", "0.5"), ("far", "20")):
        page.fill(f"#{name}", value)
    page.check("#trust_poses")
    assert page.inner_text("#options summary") == "Options: near 0.5, far 20, poses trusted"
    choose_two(page, tmp_path, seed=40)
    assert "Depth from 0.5 to 20 (given)" in page.inner_text("#understood")
    page.click("#clear")
    assert page.inner_text("#options summary") == "Options"
    page.fill("#near", "0.5")
    page.fill("#far", "20")
    before = page.url
    page.click("#sample")
    document = document_of(tab.address, made(page, before))
    assert document["near"] != 0.5
    assert page.input_value("#far") == ""


DROPPED = """([text]) => {
  const data = new DataTransfer();
  data.setData("text/plain", text);
  for (const kind of ["dragover", "drop"]) {
    document.body.dispatchEvent(new DragEvent(kind, { dataTransfer: data, bubbles: true, cancelable: true }));
    if (kind === "dragover" && document.querySelector("#drop.over")) throw Error("text is no file");
  }
}"""


def test_what_is_dropped_and_is_no_file_is_told(tab: Tab, tmp_path: Path) -> None:
    """For example a picture of another page, or a text; what is chosen stays."""
    page = tab.open()
    choose_two(page, tmp_path, seed=41)
    page.evaluate(DROPPED, ["hello"])
    assert "what was dropped is not a file" in page.inner_text("#problem")
    assert page.is_enabled("#go")
    assert len(listed(page)) == 3
