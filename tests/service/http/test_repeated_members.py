"""JSON of requests: a member that an object has twice is refused, as repeated parameters and fields are."""

from __future__ import annotations

import json

import pytest
from http_requests import assert_problem, camera_object, photograph
from starlette.testclient import TestClient

from gapmes.service.errors import MalformedRequest
from gapmes.service.http.limits import parse_json


def test_of_a_camera_file(client: TestClient) -> None:
    text = json.dumps(camera_object(2))
    twice = text.replace('"fx"', '"fx": 1.0, "fx"', 1)
    assert twice != text
    files = [("images", ("a.png", photograph(0))), ("images", ("b.png", photograph(1)))]
    answer = client.post("/check", files=files, data={"cameras": twice})
    problem = assert_problem(answer, 400, "malformed_request", "cameras", cured=True)
    assert problem["detail"] == "has 'fx' 2 times in one object, need it once"


def test_of_a_single_camera() -> None:
    with pytest.raises(MalformedRequest, match="has 'cx' 2 times in one object") as caught:
        parse_json('{"fx": 30.0, "cx": 1.0, "cx": 16.0}', "camera")
    assert (caught.value.field, caught.value.cure) == ("camera", "keep the one that is meant")
