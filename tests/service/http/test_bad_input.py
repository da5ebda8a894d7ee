"""Bad input of every kind: the right status, code, field, index and cure; the next request works, and the store is
unchanged."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import partial
from typing import Any

import http_requests
import pytest
from http_requests import MAX_UPLOAD, camera_object, photograph, post
from starlette.testclient import TestClient

assert_problem = partial(http_requests.assert_problem, cured=True)
pytestmark = pytest.mark.usefixtures("unharmed")


@pytest.mark.parametrize("count", [0, 1, 7])
def test_wrong_number_of_images(client: TestClient, count: int) -> None:
    images = [photograph(seed) for seed in range(count)]
    body = assert_problem(post(client, images, camera_object(max(count, 1))), 422, "view_count", "images")
    assert str(count) in body["detail"]
    assert body["cure"]


@pytest.mark.parametrize(
    ("count", "words"),
    [(61, "61 images, need at most 60 images"), (70, "more than 64 files, need at most 60 images")],
)
@pytest.mark.parametrize("choice", [{}, {"context": "3"}])
def test_far_too_many_images(client: TestClient, count: int, words: str, choice: dict[str, str]) -> None:
    """Counted by us or, if there are even more, by the parser, which stops reading."""
    images = [photograph(0, 32, 32)] * count
    body = assert_problem(post(client, images, camera_object(2), **choice), 422, "view_count", "images")
    assert body["detail"] == words
    assert body["cure"].startswith("send a `capture`: one zip")


def test_as_many_images_as_may_be_chosen_from(client: TestClient) -> None:
    """60 images are not too many, but there are only two cameras."""
    images = [photograph(0, 32, 32)] * 60
    body = assert_problem(post(client, images, camera_object(2), context="3"), 422, "view_count", "cameras")
    assert body["detail"] == "2 cameras for 60 images"


def test_far_too_many_views(client: TestClient) -> None:
    body = assert_problem(post(client, views=",".join(["0"] * 65)), 422, "invalid_input", "views")
    assert body["detail"] == "65 views, need at most 64"


@pytest.mark.parametrize("name", ["views", "near", "select", "max_error", "model", "unknown"])
def test_text_that_is_too_long_is_read_no_further(client: TestClient, name: str) -> None:
    """Nothing is built from it, such as a name for each comma."""
    body = assert_problem(post(client, **{name: "0," * 9000}), 413, "upload_too_large", name)
    assert body["detail"] == "is a text field of more than 16384 bytes"
    assert post(client, **{name: "0," * 5000}).json()["code"] != "upload_too_large"


def test_cameras_in_a_text_field_may_be_longer(client: TestClient) -> None:
    cameras = ("cameras", (None, json.dumps(camera_object(2) | {"note": "x" * 100_000})))
    images = [("images", ("a.png", photograph(seed), "image/png")) for seed in (0, 1)]
    assert client.post("/reconstruct", files=[*images, cameras]).status_code == 200


def test_images_without_cameras(client: TestClient) -> None:
    body = assert_problem(post(client, cameras=""), 422, "invalid_input", "cameras")
    assert "cameras.json" in body["cure"]


def test_cameras_without_images(client: TestClient) -> None:
    assert_problem(post(client, [], camera_object(2)), 422, "view_count", "images")


@pytest.mark.parametrize(("count", "said"), [(1, "1 camera"), (3, "3 cameras")])
def test_other_numbers_of_cameras_and_images(client: TestClient, count: int, said: str) -> None:
    body = assert_problem(post(client, cameras=camera_object(count)), 422, "view_count", "cameras")
    assert body["detail"] == f"{said} for 2 images"


def test_a_file_that_no_camera_names_is_told_where_others_have_one(client: TestClient) -> None:
    """Not the numbers alone, which say nothing of what is wrong; nor a file where all names are of another kind."""
    cameras = camera_object(8)
    for index, view in enumerate(cameras["views"]):
        view["image"] = f"images/{index}.png"
    images = [photograph(seed) for seed in (0, 1)]
    for names, index, words in (
        (["0.png", "notes.png"], 1, ", and none of them names 'notes.png'"),
        (["blob", "1.png"], 0, ", and none of them names 'blob'"),
    ):
        body = assert_problem(post(client, images, cameras, names=names), 422, "view_count", "images", index)
        assert body["detail"] == f"8 cameras for 2 images{words}"
        assert body["cure"].startswith("leave it out")
    body = assert_problem(post(client, images, cameras, names=["a.png", "b.png"]), 422, "view_count", "cameras")
    assert body["detail"] == "8 cameras for 2 images"
    cameras["views"][5]["image"] = "right/1.png"
    answer = post(client, images, cameras, names=["0.png", "1.png"])
    assert assert_problem(answer, 422, "view_count", "images", 1)["detail"].endswith("and 2 of them name '1.png'")


def test_a_field_that_is_given_twice(client: TestClient) -> None:
    """Of cameras it is likely a model of several files."""
    parts: list[Any] = [("images", (f"{seed}.png", photograph(seed), "image/png")) for seed in (0, 1)]
    parts += [("cameras", ("cameras.txt", b"# a list")), ("cameras", ("images.txt", b"# a list"))]
    body = assert_problem(client.post("/reconstruct", files=parts), 422, "invalid_input", "cameras")
    assert body["detail"] == "is given 2 times, need once"
    assert "a COLMAP model of several files goes in as one zip" in body["cure"]
    parts = [("near", (None, "1")), ("near", (None, "2"))]
    body = assert_problem(client.post("/reconstruct", files=parts), 422, "invalid_input", "near")
    assert body["cure"] == "send it once"


@pytest.mark.parametrize(
    ("name", "value", "detail"),
    [
        ("stride", "3", "'3' is none of (1, 2, 4)"),
        ("trust_poses", "maybe", "'maybe' is neither true nor false"),
        ("certify", "few", "'few' is not a whole number"),
        ("min_opacity", "low", "'low' is not a number"),
        ("min_opacity", "inf", "inf is not finite"),
        ("max_error", "2", "is 2, need 0 to 1"),
        ("max_error", "1/25_5", "'1/25_5' is not a budget"),
        ("min_opacity", "0_0.5", "'0_0.5' is not a number"),
        ("min_opacity", "٠", "'٠' is not a number"),
        ("certify", "١", "'١' is not a whole number"),
    ],
)
def test_fields_with_values_that_are_none(client: TestClient, name: str, value: str, detail: str) -> None:
    body = assert_problem(post(client, **{name: value}), 422, "invalid_input", name)
    assert body["detail"] == detail


def test_unknown_field(client: TestClient) -> None:
    body = assert_problem(post(client, max_eror="1"), 422, "invalid_input", "max_eror")
    assert "near" in body["cure"]


def test_field_given_twice(client: TestClient) -> None:
    good = post(client).request
    name = good.headers["content-type"].split("boundary=")[1]
    part = f'--{name}\r\nContent-Disposition: form-data; name="near"\r\n\r\n1\r\n'.encode()
    answer = client.post(
        "/reconstruct", content=part * 2 + good.read(), headers={"content-type": good.headers["content-type"]}
    )
    assert_problem(answer, 422, "invalid_input", "near", cured=False)  # the detail has it: need once


def test_image_as_a_text_field(client: TestClient) -> None:
    parts = [("images", (None, "hello")), ("images", (None, "you"))]
    assert_problem(client.post("/reconstruct", files=parts), 422, "invalid_input", "images", 0)


@pytest.mark.parametrize("view", ["99", "abc", "-1", "1.5", "nan", "orbit:", "orbit:nan", ""])
def test_view_to_render_that_does_not_exist(client: TestClient, view: str) -> None:
    assert_problem(post(client, [photograph(5), photograph(6)], views=f"0,{view}"), 422, "view_unknown", "views")


def test_oversized_body(client: TestClient) -> None:
    body = assert_problem(post(client, [photograph(0), bytes(MAX_UPLOAD)]), 413, "upload_too_large", "body")
    assert str(MAX_UPLOAD) in body["detail"]


def test_oversized_body_of_undeclared_length(client: TestClient) -> None:
    good = post(client).request

    def chunks() -> Iterator[bytes]:
        yield good.read()[:-10]
        for _ in range(40):
            yield bytes(100_000)

    headers = {"content-type": good.headers["content-type"]}
    assert_problem(client.post("/reconstruct", content=chunks(), headers=headers), 413, "upload_too_large", "body")


def test_oversized_cameras(client: TestClient) -> None:
    cameras = camera_object(2) | {"note": "x" * 1_100_000}
    assert_problem(post(client, cameras=cameras), 413, "upload_too_large", "cameras")


@pytest.mark.parametrize("path", ["/reconstruct", "/scenes"])
def test_a_field_of_cameras_has_its_bytes_counted(client: TestClient, path: str) -> None:
    text = json.dumps(camera_object(2) | {"note": "é" * 600_000}, ensure_ascii=False)
    parts = [("cameras", (None, text)), ("images", ("0.png", photograph(0))), ("images", ("1.png", photograph(1)))]
    file = ("file", ("scene.ply", b"ply"))
    answer = client.post(path, files=[parts[0], file] if path == "/scenes" else parts)
    problem = assert_problem(answer, 413, "upload_too_large", "cameras")
    assert f"{len(text.encode())} bytes" in problem["detail"]


@pytest.mark.parametrize(
    ("kind", "body"),
    [
        ("multipart/form-data", b"--x\r\n"),
        ("multipart/form-data; boundary=x", b"no boundary in here"),
        ("multipart/form-data; boundary=x", b"--x\r\nContent-Disposition: form-data\r\n\r\n1\r\n--x--\r\n"),
        ("multipart/form-data; boundary=x", b"--x\r\nbroken header\r\n\r\n"),
    ],
)
def test_malformed_multipart(client: TestClient, kind: str, body: bytes) -> None:
    answer = client.post("/reconstruct", content=body, headers={"content-type": kind})
    assert_problem(answer, 400, "malformed_request", "body")


def test_multipart_that_ends_early(client: TestClient) -> None:
    good = post(client).request
    headers = {"content-type": good.headers["content-type"]}
    for length in (0, 100, 1000, len(good.read()) - 60, len(good.read()) - 4, len(good.read()) - 3):
        answer = client.post("/reconstruct", content=good.read()[:length], headers=headers)
        body = assert_problem(answer, 400, "malformed_request", "body")
        assert body["detail"] == "the multipart body cannot be read: it ends before its closing boundary"
    whole = client.post("/reconstruct", content=good.read()[:-2], headers=headers)  # of the last line's end
    assert whole.status_code == 200


def test_a_form_that_ends_behind_a_field_is_not_taken_without_it(client: TestClient) -> None:
    good = post(client).request
    name = good.headers["content-type"].split("boundary=")[1]
    for field in ("near", "max_eror"):
        part = f'--{name}\r\nContent-Disposition: form-data; name="{field}"\r\n\r\n0.5'.encode()
        cut = good.read().removesuffix(f"--{name}--\r\n".encode()) + part
        answer = client.post("/reconstruct", content=cut, headers={"content-type": good.headers["content-type"]})
        assert_problem(answer, 400, "malformed_request", "body")


@pytest.mark.parametrize("kind", ["application/json", "text/plain", ""])
def test_other_media_type(client: TestClient, kind: str) -> None:
    answer = client.post("/reconstruct", content=b"{}", headers={"content-type": kind})
    body = assert_problem(answer, 415, "unsupported_media_type", "body")
    assert "curl" in body["cure"]


def test_nothing_acceptable(client: TestClient) -> None:
    answer = post(client, accept="image/png")
    assert_problem(answer, 406, "not_acceptable", "Accept", cured=False)  # the detail lists what is
