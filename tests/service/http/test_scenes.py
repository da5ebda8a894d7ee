"""The store over HTTP: list, read, download, delete; invalid ids."""

from __future__ import annotations

import pytest
from http_requests import assert_problem, photograph, post, stored
from starlette.testclient import TestClient

from gapmes.service.settings import Settings

TRICKS = [
    "0" * 32,
    "nothing",
    "..",
    "..%2f..",
    "..%2F..%2Fetc%2Fpasswd",
    "%2e%2e",
    "%2e%2e%2f%2e%2e",
    "..%5c..",
    "a%00b",
    "ABCDEF0123456789ABCDEF0123456789",
    "%ff",
    "a" * 5000,
]


def test_list_is_newest_first_and_complete(client: TestClient) -> None:
    ids = [post(client, [photograph(20 + k), photograph(30 + k)]).json()["id"] for k in range(3)]
    listed = client.get("/scenes").json()["scenes"]
    ours = [scene for scene in listed if scene["id"] in ids]
    assert [scene["id"] for scene in ours] == ids[::-1]
    assert [scene["views"] for scene in ours] == [2, 2, 2]
    for scene in listed:
        assert client.get(scene["links"]["self"]).json()["id"] == scene["id"]
        assert scene["created"]


def test_ply_download(client: TestClient) -> None:
    scene = post(client).json()
    answer = client.get(scene["links"]["ply"])
    assert answer.headers["content-type"] == "application/octet-stream"
    assert f'filename="{scene["id"]}.ply"' in answer.headers["content-disposition"]
    assert answer.content.startswith(b"ply\n")


def test_delete(client: TestClient, settings: Settings) -> None:
    before = stored(settings)
    scene = post(client, [photograph(40), photograph(41)]).json()
    assert client.delete(scene["links"]["self"]).status_code == 204
    assert stored(settings) == before
    for answer in (
        client.get(scene["links"]["self"]),
        client.get(scene["links"]["ply"]),
        client.get(scene["links"]["views"][0]),
        client.delete(scene["links"]["self"]),
    ):
        assert_problem(answer, 404, "scene_not_found")


@pytest.mark.parametrize("scene_id", TRICKS)
def test_ids_that_are_none(client: TestClient, settings: Settings, scene_id: str) -> None:
    post(client)
    before = stored(settings)
    for answer in (
        client.get(f"/scenes/{scene_id}"),
        client.get(f"/scenes/{scene_id}.ply"),
        client.delete(f"/scenes/{scene_id}"),
    ):
        if answer.url.path.startswith("/scenes/"):
            assert_problem(answer, 404, "scene_not_found", "scene")
        else:  # the client resolved ".." itself and asked for another route
            assert answer.request.method != "DELETE" or answer.status_code == 405
    assert stored(settings) == before


def test_id_with_a_line_break(client: TestClient) -> None:
    for path in ("/scenes/" + "0" * 32 + "%0a", "/scenes/" + "0" * 32 + "%0a.ply"):
        answer = client.get(path)
        assert_problem(answer, 404, answer.json()["code"])
