"""Paths and methods: what each path offers, HEAD wherever GET is, and the answer for unknown paths."""

from __future__ import annotations

import logging

import pytest
from http_requests import assert_problem, post
from starlette.testclient import TestClient

from gapmes.service.http import preview, render, scenes, viewer


@pytest.mark.parametrize(
    ("method", "path", "offered"),
    [
        ("GET", "/reconstruct", "POST"),
        ("PATCH", "/scenes", "GET, HEAD, POST"),
        ("PUT", "/scenes/abc", "GET, HEAD, DELETE"),
        ("PUT", "/jobs/abc", "GET, HEAD, DELETE"),
        ("POST", "/render", "GET, HEAD"),
        ("POST", "/openapi.json", "GET, HEAD"),
        ("BREW", "/scenes", "GET, HEAD, POST"),
        ("DELETE", "/", "GET, HEAD"),
    ],
)
def test_a_refused_method_comes_with_all_that_are_offered(
    client: TestClient, method: str, path: str, offered: str
) -> None:
    answer = client.request(method, path)
    assert_problem(answer, 405, "method_not_allowed")
    assert answer.headers["allow"] == offered


def test_the_head_of_everything_is_that_of_the_whole(client: TestClient) -> None:
    scene = post(client).json()
    job = post(client, prefer="respond-async").json()
    links = scene["links"]
    of_the_scene = [links["self"], *links["inputs"], *links["files"].values()]
    drawn = [*links["views"], links["preview"], links["sheet"], f"{links['self']}/viewer.ply"]
    paths = [*of_the_scene, *drawn, f"{links['self']}/viewer.json", *job["links"].values(), "/metrics", "/models"]
    paths += ["/", "/healthz", "/openapi.json", "/docs", "/static/docs/swagger-ui.css", "/static/js/main.js"]
    for path in paths:
        whole, head = client.get(path), client.head(path)
        assert (head.status_code, head.content) == (200, b""), path
        for name in ("content-type", "etag", "cache-control"):
            assert head.headers.get(name) == whole.headers.get(name), (path, name)
        if whole.headers.get("etag") is not None:
            headers = {"If-None-Match": whole.headers["etag"]}
            kept = client.get(path, headers=headers)
            assert (kept.status_code, client.head(path, headers=headers).status_code) == (304, 304), path
            assert kept.headers.get("cache-control") == whole.headers.get("cache-control"), path


def test_nothing_is_drawn_for_a_head(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    links = post(client).json()["links"]

    def drawn(*_: object, **__: object) -> None:
        raise AssertionError("this was drawn")

    for module, name in ((render, "draw"), (preview, "PictureSeries"), (viewer, "ply_bytes")):
        monkeypatch.setattr(module, name, drawn)
    for path in (*links["views"], links["preview"], links["sheet"], f"{links['self']}/viewer.ply"):
        head = client.head(path)
        assert head.status_code == 200, path
        assert "content-length" not in head.headers
    assert client.head(links["views"][0]).headers["x-gapmes-scene"] == links["self"].rpartition("/")[2]


def test_the_head_of_what_is_not_there_says_so(client: TestClient) -> None:
    none = "0" * 32
    paths = [f"/scenes/{none}", f"/scenes/{none}/inputs/0", f"/scenes/{none}/preview", f"/render?scene={none}"]
    for path in (*paths, f"/jobs/{none}", f"/jobs/{none}/events", f"/scenes/{none}/viewer.ply"):
        assert client.head(path).status_code == 404, path


@pytest.mark.parametrize("path", ["/reconstruct/", "/render/", "/check//"])
@pytest.mark.parametrize("method", ["GET", "POST"])
def test_a_slash_too_many_leads_nowhere(client: TestClient, method: str, path: str) -> None:
    """In particular to no other host."""
    answer = client.request(method, path, headers={"Host": "other.example"}, follow_redirects=False)
    body = assert_problem(answer, 404, "route_not_found", cured=True)
    assert body["cure"] == f"leave out the slash at the end: {path.rstrip('/')}"
    assert "location" not in answer.headers
    other = assert_problem(client.get("/nowhere/"), 404, "route_not_found")
    assert "openapi" in other["cure"]


@pytest.mark.parametrize("method", ["GET", "B" * 5000])
def test_of_a_long_path_the_beginning_is_told(
    client: TestClient, caplog: pytest.LogCaptureFixture, method: str
) -> None:
    with caplog.at_level(logging.INFO):
        answer = client.request(method, "/" + "a" * 50_000)
        refused = client.request("B" * 5000, "/scenes/" + "a" * 50_000)
        parameter = client.get("/render", params={"b" * 5000: "1"})
    assert_problem(answer, 404, "route_not_found")
    assert_problem(refused, 405, "method_not_allowed")
    assert_problem(parameter, 422, "parameter_invalid")
    for found in (answer, refused, parameter):
        assert len(found.content) < 1000
    lines = [record.getMessage() for record in caplog.records if record.name == "gapmes.access"]
    assert len(lines) == 3
    assert all(len(line) < 300 for line in lines)


@pytest.mark.parametrize("path", ["/scenes/a.b/c.ply", "/scenes/a/b.ply", "/scenes/.ply", "/scenes/" + "." * 30 + "/"])
def test_dots_and_slashes_of_an_id_are_those_of_an_unknown_scene(client: TestClient, path: str) -> None:
    assert_problem(client.get(path), 404, "scene_not_found", "scene", cured=True)


def test_no_pattern_of_a_route_tries_every_dot(client: TestClient) -> None:
    """60 kB of them took half a minute, in which nobody was answered."""
    for path in ("/scenes/" + "." * 60_000 + "/", "/scenes/" + "a." * 30_000 + "/"):
        assert_problem(client.get(path), 404, "scene_not_found", "scene")
    (pattern,) = {route.path_regex.pattern for route in scenes.router.routes if "extension" in route.path}
    assert pattern == r"^/scenes/(?P<scene_id>[^.]*)\.(?P<extension>[^/]+)$"
