"""Bodies and parts that clients send otherwise than curl does: compressed ones, and names in another form."""

from __future__ import annotations

import gzip

import pytest
from http_requests import assert_problem
from starlette.testclient import TestClient

FORM = "multipart/form-data; boundary=x"
RAW = "application/octet-stream"


@pytest.mark.parametrize("coding", ["gzip", "br", "GZIP, identity"])
@pytest.mark.parametrize(
    ("path", "kind"), [("/reconstruct", FORM), ("/check", FORM), ("/scenes", FORM), ("/scenes", RAW)]
)
def test_a_compressed_body_is_refused_as_such(client: TestClient, path: str, kind: str, coding: str) -> None:
    """Its bytes would be called no form, or a .spz, which is compressed itself."""
    headers = {"Content-Type": kind, "Content-Encoding": coding}
    answer = client.post(path, content=gzip.compress(b"ply\n"), headers=headers)
    problem = assert_problem(answer, 415, "unsupported_media_type", "Content-Encoding", cured=True)
    assert coding in problem["detail"]


def test_identity_is_no_encoding(client: TestClient) -> None:
    headers = {"Content-Type": FORM, "Content-Encoding": "identity"}
    assert_problem(client.post("/check", content=b"--x--\r\n", headers=headers), 422, "view_count", "images")


@pytest.mark.parametrize(
    ("path", "field"), [("/reconstruct", "images"), ("/check", "images"), ("/check", "capture"), ("/scenes", "file")]
)
def test_a_part_with_a_name_of_another_form_is_told_the_right_one(client: TestClient, path: str, field: str) -> None:
    """RFC 7578 forbids `filename*`, which some clients send for names beyond ASCII; the parser takes it for none."""
    part = (
        f"--x\r\nContent-Disposition: form-data; name=\"{field}\"; filename*=UTF-8''%e2%82%ac.png\r\n\r\n1\r\n--x--\r\n"
    )
    answer = client.post(path, content=part.encode(), headers={"Content-Type": FORM})
    problem = assert_problem(answer, 422, "invalid_input", field)
    assert "with `filename=` in its Content-Disposition" in problem["cure"]
