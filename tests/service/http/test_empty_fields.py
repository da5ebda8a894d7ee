"""Empty fields of a form, as tools send them that fill it in from the OpenAPI document, count as missing."""

from __future__ import annotations

import json

from http_requests import assert_problem, camera_object, photograph
from starlette.testclient import TestClient

EMPTY = (None, "")
PHOTOGRAPHS = [("images", (f"{seed}.png", photograph(seed), "image/png")) for seed in (70, 71)]
CAMERAS = ("cameras", (None, json.dumps(camera_object(2))))


def test_an_empty_field_beside_photographs_is_none(client: TestClient) -> None:
    assert client.post("/reconstruct", files=[("images", EMPTY), *PHOTOGRAPHS, CAMERAS]).status_code in (200, 201)


def test_fields_that_are_all_empty_are_missing(client: TestClient) -> None:
    """No text fields instead of files, nor malformed JSON."""
    answer = client.post("/reconstruct", files=[("images", EMPTY), ("images", EMPTY), CAMERAS])
    assert assert_problem(answer, 422, "view_count", "images", cured=True)["detail"] == "0 images, need 2 to 6"
    answer = client.post("/reconstruct", files=[*PHOTOGRAPHS, ("cameras", EMPTY)])
    assert assert_problem(answer, 422, "invalid_input", "cameras", cured=True)["detail"] == "is missing"
