"""Forms of POST /scenes: an unknown field is answered with the known ones, and an empty camera file is not left out."""

from __future__ import annotations

from typing import Any

from format_cases import moderate
from http_requests import assert_problem, stored
from starlette.testclient import TestClient

from gapmes.service.formats.ply import ply_bytes
from gapmes.service.settings import Settings

FILE: tuple[str, Any] = ("file", ("scene.ply", ply_bytes(moderate(20, 0, 0))))


def test_an_unknown_field_is_answered_with_those_of_the_form(client: TestClient) -> None:
    """`file` and `cameras` are no query parameters."""
    answer = client.post("/scenes", files=[FILE, ("camera", (None, "{}"))])
    problem = assert_problem(answer, 422, "parameter_invalid", "camera", cured=True)
    assert problem["detail"] == "is not a field of this route"
    assert problem["cure"].startswith("fields: file, cameras, format, opacity, ")


def test_an_empty_camera_file_is_refused(client: TestClient, settings: Settings) -> None:
    before = stored(settings)
    answer = client.post("/scenes", files=[FILE, ("cameras", ("cameras.json", b""))])
    assert_problem(answer, 400, "malformed_request", "cameras", cured=True)
    assert stored(settings) == before


def test_an_empty_text_field_is_none(client: TestClient) -> None:
    answer = client.post("/scenes", files=[FILE, ("cameras", (None, "")), ("near", (None, ""))])
    assert answer.json()["depth_range_source"] == "framing"
    client.delete(answer.headers["location"])
