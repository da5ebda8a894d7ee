"""A scene in every format over HTTP: the writers' bytes are served, with tags, and nothing is kept."""

from __future__ import annotations

import json
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from http_requests import assert_problem, photograph, post, stored
from starlette.testclient import TestClient

from gapmes.service.formats.dialect import STANDARD
from gapmes.service.formats.ply import inspect_ply
from gapmes.service.formats.registry import FORMATS, inspect_gaussians
from gapmes.service.http import files, scenes
from gapmes.service.settings import Settings

MADE = [name for name in FORMATS if name != "ply"]


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_is_linked_and_served(client: TestClient, settings: Settings, name: str) -> None:
    scene = post(client).json()
    before = stored(settings)
    answer = client.get(scene["links"]["files"][name])
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "application/octet-stream"
    assert f'filename="{scene["id"]}.{name}"' in answer.headers["content-disposition"]
    gaussians = inspect_ply(client.get(scene["links"]["ply"]).content, dialect=STANDARD).gaussians
    encoded = FORMATS[name].write(gaussians)
    assert answer.content == encoded.data
    assert len(inspect_gaussians(answer.content, format=name)[0].gaussians) == scene["gaussians"]["count"]
    if name != "ply":
        assert json.loads(answer.headers["x-gapmes-notes"]) == list(encoded.notes)
    assert stored(settings) == before


@pytest.mark.parametrize("name", FORMATS)
def test_a_tag_is_answered_by_304_and_head_makes_nothing(
    client: TestClient, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    scene = post(client).json()
    url = scene["links"]["files"][name]
    etag = client.get(url).headers["etag"]
    others = {client.head(scene["links"]["files"][other]).headers["etag"] for other in FORMATS if other != name}
    assert etag not in others
    monkeypatch.setattr(scenes, "FORMATS", dict.fromkeys(FORMATS))  # whoever converts now fails
    head = client.head(url)
    assert (head.status_code, head.content, head.headers["etag"]) == (200, b"", etag)
    assert ("content-length" in head.headers) == (name == "ply")
    again = client.get(url, headers={"If-None-Match": f'"x", W/{etag}'})
    assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", etag)


@pytest.mark.parametrize("name", [*MADE, "viewer.ply"])
def test_what_is_made_has_another_tag_in_another_release(
    client: TestClient, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """Which may write it otherwise: a browser must not keep what the last one wrote."""
    links = post(client).json()["links"]
    url = links["files"].get(name, f"{links['self']}/{name}")
    before = client.head(url).headers["etag"]
    monkeypatch.setattr(files, "DRAWING_REVISION", files.DRAWING_REVISION + 1)
    assert client.get(url, headers={"If-None-Match": before}).status_code == 200


def test_ranges_are_of_the_ply_alone(client: TestClient) -> None:
    """What is made for an answer has no ranges: a client that asks for one gets all of it (RFC 9110 section 14.2)."""
    scene = post(client).json()
    part = client.get(scene["links"]["ply"], headers={"Range": "bytes=0-3"})
    assert (part.status_code, part.content) == (206, b"ply\n")
    for name in MADE:
        whole = client.get(scene["links"]["files"][name], headers={"Range": "bytes=0-3"})
        assert (whole.status_code, whole.headers["accept-ranges"]) == (200, "none")
        assert len(whole.content) > 4


@pytest.mark.parametrize("asked", ["bytes=0-9", "bytes=99999999-"])
def test_head_tells_of_the_whole_file_whatever_range_it_brings(client: TestClient, asked: str) -> None:
    url = post(client).json()["links"]["ply"]
    whole, part = client.head(url), client.head(url, headers={"Range": asked})
    assert part.status_code == 200
    assert "content-range" not in part.headers
    assert part.headers["content-length"] == whole.headers["content-length"] == str(len(client.get(url).content))


@pytest.mark.parametrize(
    ("asked", "first", "last"),
    [
        ("bytes=0-0,99999999999-", 0, 0),
        ("bytes=99999999999-99999999999, 10-19", 10, 19),
        ("bytes=-0, 3-5", 3, 5),
        ("bytes=7-" + "9" * 5000, 7, None),
        ("bytes=" + "9" * 5000 + "-, -4", -4, None),
        ("bytes=-" + "9" * 30, 0, None),
    ],
)
def test_of_several_parts_those_that_there_are_are_sent(
    client: TestClient, asked: str, first: int, last: int | None
) -> None:
    link = post(client).json()["links"]["ply"]
    whole = client.get(link).content
    answer = client.get(link, headers={"Range": asked})
    begin, end = first % len(whole), len(whole) - 1 if last is None else last
    assert (answer.status_code, answer.content) == (206, whole[begin : end + 1])
    assert answer.headers["content-range"] == f"bytes {begin}-{end}/{len(whole)}"


@pytest.mark.parametrize(
    "asked", ["bytes=99999999999-", "bytes=-0", "bytes=99999999999-, -0", "bytes=" + "9" * 5000 + "-"]
)
def test_where_there_is_no_part_of_all_that_is_said(client: TestClient, asked: str) -> None:
    link = post(client).json()["links"]["ply"]
    assert_problem(client.get(link, headers={"Range": asked}), 416, "range_not_satisfiable", "Range")


def test_several_parts_come_one_behind_the_other(client: TestClient) -> None:
    link = post(client).json()["links"]["ply"]
    whole = client.get(link).content
    answer = client.get(link, headers={"Range": "bytes=0-3, 99999999999-, 10-13"})
    assert answer.status_code == 206
    assert answer.headers["content-type"].startswith("multipart/byteranges")
    assert whole[:4] in answer.content
    assert whole[10:14] in answer.content


@pytest.mark.parametrize("extension", ["obj", "compressed", "PLY", "ply.gz", "sog", ".ply", "spz%20"])
def test_another_extension_is_named_with_those_that_there_are(client: TestClient, extension: str) -> None:
    scene = post(client).json()
    body = assert_problem(client.get(f"/scenes/{scene['id']}.{extension}"), 404, "format_unknown", "extension")
    assert body["cure"] == "one of ply, compressed.ply, splat, spz"
    assert_problem(client.get(f"/scenes/{'0' * 32}.{extension}"), 404, "scene_not_found", "scene")


def test_a_scene_that_goes_while_it_is_converted_is_not_found(
    client: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = post(client, [photograph(50), photograph(51)]).json()
    first = scenes._stored

    def and_gone(*arguments: object) -> tuple[str, int]:
        found = first(*arguments)  # type: ignore[arg-type]
        client.app.state.runtime.store.delete(scene["id"])  # type: ignore[attr-defined]
        return found

    monkeypatch.setattr(scenes, "_stored", and_gone)
    assert_problem(client.get(scene["links"]["files"]["splat"]), 404, "scene_not_found", "scene")


def test_conversions_wait_for_their_turn(client: TestClient, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """One after the other, in as many slots as there are."""
    scene = post(client).json()
    at_once, most, lock = 0, 0, threading.Lock()
    real = FORMATS["splat"].write

    def counted(gaussians: object) -> object:
        nonlocal at_once, most
        with lock:
            at_once, most = at_once + 1, max(most, at_once + 1)
        time.sleep(0.05)  # so that two would meet
        found = real(gaussians)  # type: ignore[arg-type]
        with lock:
            at_once -= 1
        return found

    monkeypatch.setitem(scenes.FORMATS, "splat", replace(FORMATS["splat"], write=counted))
    answers: list[int] = []
    threads = [
        threading.Thread(target=lambda: answers.append(client.get(scene["links"]["files"]["splat"]).status_code))
        for _ in range(6)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert answers == [200] * 6
    assert most == 1


def test_gaussians_of_a_format_are_those_of_the_scene(client: TestClient) -> None:
    scene = post(client).json()
    ply = inspect_ply(client.get(scene["links"]["ply"]).content, dialect=STANDARD).gaussians
    spz = inspect_gaussians(client.get(scene["links"]["files"]["spz"]).content)[0].gaussians
    assert np.abs(ply.means - spz.means).max() < 0.01 * np.ptp(ply.means)
    assert np.abs(ply.opacities - spz.opacities).max() <= 1 / 510 + 1e-6
