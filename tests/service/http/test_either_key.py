"""The key in either of its headers, whatever the other one holds."""

from __future__ import annotations

import pytest
from starlette.responses import PlainTextResponse
from starlette.testclient import TestClient

from gapmes.service.http.access import KeyNeeded

ANSWER = PlainTextResponse("in")


@pytest.mark.parametrize(
    ("authorization", "key", "status"),
    [
        ("Bearer right", "wrong", 200),
        ("Bearer of-the-proxy", "right", 200),
        ("Basic dTpw", "right", 200),
        ("Basic right", "", 401),
        ("Bearer wrong", "wrong", 401),
        ("", "", 401),
    ],
)
def test_one_right_header_suffices(authorization: str, key: str, status: int) -> None:
    client = TestClient(KeyNeeded(ANSWER, "right"))
    answer = client.get("/scenes", headers={"Authorization": authorization, "X-API-Key": key})
    assert answer.status_code == status
