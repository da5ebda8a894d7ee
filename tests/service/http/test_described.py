"""The OpenAPI schema describes headers and HEAD as they are answered, and docs/http.md names all that it has."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from http_requests import photograph, post
from starlette.testclient import TestClient

from gapmes.service.http.described import ANSWERED, ASKED

TEXT = (Path(__file__).parents[3] / "docs" / "http.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def paths(client: TestClient) -> dict[str, Any]:
    return client.get("/openapi.json").json()["paths"]


def told(paths: dict[str, Any], path: str, method: str, status: int) -> dict[str, Any]:
    responses = paths[path][method]["responses"]
    return (responses.get(str(status)) or responses[f"{status // 100}XX"])["headers"]


def is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def test_headers_of_answers_are_told(client: TestClient, paths: dict[str, Any]) -> None:
    images = [photograph(900), photograph(901)]
    made, kept, job = post(client, images), post(client, images), post(client, images, prefer="respond-async")
    link, file = made.headers["location"], "/scenes/{scene_id}.{extension}"
    etag = client.get(f"{link}.ply").headers["etag"]
    query = f"scene={link.removeprefix('/scenes/')}"
    answers = [
        ("/reconstruct", made),
        ("/reconstruct", kept),
        ("/reconstruct", job),
        ("/reconstruct", post(client, images, accept="application/zip")),
        ("/reconstruct", post(client, images, accept="application/octet-stream")),
        ("/reconstruct", post(client, [photograph(902), photograph(903)], accept="application/octet-stream")),
        ("/reconstruct", client.post("/reconstruct")),
        (file, client.get(f"{link}.ply")),
        (file, client.get(f"{link}.ply", headers={"Range": "bytes=0-9"})),
        (file, client.get(f"{link}.ply", headers={"Range": "bytes=99999999999-"})),
        (file, client.get(f"{link}.ply", headers={"If-None-Match": etag})),
        (file, client.get(f"{link}.splat")),
        (file, client.head(f"{link}.ply")),
        ("/render", client.get(f"/render?{query}&channel=depth")),
        ("/render", client.head(f"/render?{query}")),
        ("/scenes/{scene_id}/preview", client.get(f"{link}/preview?frames=2")),
        ("/jobs/{job_id}/events", client.get(f"{job.headers['location']}/events")),
        ("/scenes/{scene_id}", client.delete(link)),
        ("/scenes/{scene_id}", client.get(link)),
        ("/check", client.post("/check")),
    ]
    seen: set[str] = set()
    missing: dict[tuple[str, int], set[str]] = {}
    for path, answer in answers:
        has = {name for name in ANSWERED if name.lower() in answer.headers}
        may = told(paths, path, answer.request.method.lower(), answer.status_code)
        assert has <= set(may), (path, answer)
        for name in has:
            assert (may[name]["schema"]["type"] == "number") == is_number(answer.headers[name]), name
        if answer.is_success:
            of_these = path, answer.status_code
            missing[of_these] = missing.get(of_these, set(may)) - has
        seen |= has
    assert not any(missing.values()), missing  # what is told of an answer that succeeds is in one of them
    assert set(ANSWERED) - seen == {"Allow", "Retry-After", "WWW-Authenticate"}
    assert {answer.status_code for _, answer in answers} >= {200, 201, 202, 204, 206, 304, 404, 415, 416}


def test_a_refusal_tells_its_problem_and_a_busy_service_when_to_ask_again(paths: dict[str, Any]) -> None:
    for path, methods in paths.items():
        for method in methods:
            assert set(told(paths, path, method, 503)) == {"X-Gapmes-Problem", "Retry-After", "X-Request-ID"}
            assert set(told(paths, path, method, 418)) >= {"X-Gapmes-Problem", "X-Request-ID"}


def test_headers_of_requests_are_told(paths: dict[str, Any]) -> None:
    found = {
        (path, parameter["name"])
        for path, methods in paths.items()
        for operation in methods.values()
        for parameter in operation.get("parameters", ())
        if parameter["in"] == "header" and parameter["name"] in ASKED and not parameter["required"]
    }
    file = "/scenes/{scene_id}.{extension}"
    drawn = ("/render", "/scenes/{scene_id}/preview", "/scenes/{scene_id}/sheet")
    assert found == {
        ("/reconstruct", "Prefer"),
        *((file, name) for name in ("Range", "If-Range", "If-None-Match")),
        *((path, "If-None-Match") for path in drawn),
    }


def test_head_is_told_wherever_get_is(client: TestClient, paths: dict[str, Any]) -> None:
    """And answered there."""
    assert "`HEAD` is answered wherever `GET` is" in TEXT
    for path, methods in paths.items():
        assert ("head" in methods) == ("get" in methods)
        if "get" in methods:
            assert "content" not in methods["head"]["responses"]["200"]
            assert client.head(path).status_code != 405
    operations = [operation["operationId"] for methods in paths.values() for operation in methods.values()]
    assert len(set(operations)) == len(operations)
