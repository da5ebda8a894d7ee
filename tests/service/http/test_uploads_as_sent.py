"""Bodies and parts that clients send otherwise than curl does: compressed ones, names in another form, inputs of a page
where no file was chosen."""

from __future__ import annotations

import gzip
import json

import pytest
from format_cases import moderate
from http_requests import assert_problem, camera_object, photograph
from starlette.testclient import TestClient

from gapmes.service.formats.ply import ply_bytes

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


def body(*parts: tuple[str, bytes]) -> bytes:
    heads = [f"--x\r\nContent-Disposition: form-data; {head}\r\n\r\n".encode() for head, _ in parts]
    return b"".join(head + data + b"\r\n" for head, (_, data) in zip(heads, parts, strict=True)) + b"--x--\r\n"


def test_a_file_input_where_none_was_chosen_is_no_part(client: TestClient) -> None:
    """A browser sends it with an empty file name and nothing in it."""
    headers, none = {"Content-Type": FORM}, 'name="{}"; filename=""\r\nContent-Type: application/octet-stream'
    scene = ('name="file"; filename="scene.ply"', ply_bytes(moderate(20, 0, 0)))
    answer = client.post("/scenes", content=body(scene, (none.format("cameras"), b"")), headers=headers)
    assert answer.json()["depth_range_source"] == "framing"
    client.delete(answer.headers["location"])
    photographs = [(f'name="images"; filename="{i}.png"', photograph(i)) for i in range(2)]
    parts = [*photographs, ('name="cameras"', json.dumps(camera_object(2)).encode()), (none.format("capture"), b"")]
    assert client.post("/check", content=body(*parts), headers=headers).status_code == 200
    answer = client.post("/scenes", content=body((none.format("file"), b"")), headers=headers)
    assert assert_problem(answer, 422, "invalid_input", "file")["detail"] == "is missing"
    named = ('name="cameras"; filename="cameras.json"', b"")  # a file that was chosen and is empty
    assert_problem(client.post("/scenes", content=body(scene, named), headers=headers), 400, "malformed_request")
