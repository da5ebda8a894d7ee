"""Bad input of every kind: the right status, code, field and index, and a cure; the next request works, the store is
unchanged."""

from __future__ import annotations

import io
import json
import struct
import zlib
from collections.abc import Iterator
from functools import partial
from typing import Any

import http_requests
import numpy as np
import pytest
from http_requests import MAX_UPLOAD, camera_object, photograph, post, stored
from PIL import Image
from starlette.testclient import TestClient

from gapmes.service.settings import Settings

assert_problem = partial(http_requests.assert_problem, cured=True)


@pytest.fixture(autouse=True)
def unharmed(client: TestClient, settings: Settings) -> Iterator[None]:
    """Around every test here: a good request works afterwards and nothing was left in the store."""
    good = post(client)
    before = stored(settings)
    yield
    assert stored(settings) == before
    again = post(client)
    assert again.status_code == 200
    assert again.json()["id"] == good.json()["id"]


def bent(index: int, **changes: Any) -> dict[str, Any]:
    """Two good cameras, one of them with other values."""
    cameras = camera_object(2)
    cameras["views"][index].update(changes)
    return cameras


def pose(**changes: Any) -> list[list[Any]]:
    matrix = np.eye(4).tolist()
    matrix[0][3] = 0.2
    for place, value in changes.items():
        matrix[int(place[1])][int(place[2])] = value
    return matrix


def bomb(width: int, height: int) -> bytes:
    """A PNG of a few kilobytes that claims width x height pixels and holds ten million bytes of zeros."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)
    rows = zlib.compress(bytes(10_000_000), 9)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


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
    """Counted by us, or, where there are more, by the parser, which reads no further."""
    images = [photograph(0, 32, 32)] * count
    body = assert_problem(post(client, images, camera_object(2), **choice), 422, "view_count", "images")
    assert body["detail"] == words
    assert body["cure"].startswith("send a `capture`: one zip")


def test_as_many_images_as_may_be_chosen_from(client: TestClient) -> None:
    """Of 60, which is not too many, the cameras are two."""
    images = [photograph(0, 32, 32)] * 60
    body = assert_problem(post(client, images, camera_object(2), context="3"), 422, "view_count", "cameras")
    assert body["detail"] == "2 cameras for 60 images"


def test_far_too_many_views(client: TestClient) -> None:
    body = assert_problem(post(client, views=",".join(["0"] * 65)), 422, "invalid_input", "views")
    assert body["detail"] == "65 views, need at most 64"


@pytest.mark.parametrize("name", ["views", "near", "select", "max_error", "model", "unknown"])
def test_text_that_is_too_long_is_read_no_further(client: TestClient, name: str) -> None:
    """So that nothing is made of it: a name for each comma, say."""
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


def test_text_named_png(client: TestClient) -> None:
    assert_problem(post(client, [photograph(0), b"this is text"]), 415, "image_unreadable", "images", 1)


def test_empty_and_truncated_image(client: TestClient) -> None:
    assert_problem(post(client, [b"", photograph(0)]), 415, "image_unreadable", "images", 0)
    assert_problem(post(client, [photograph(1), photograph(0)[:300]]), 415, "image_unreadable", "images", 1)


@pytest.mark.parametrize("size", [(10_000, 10_000), (60_000, 60_000), (2**31 - 1, 2**31 - 1)])
def test_decompression_bomb(client: TestClient, size: tuple[int, int]) -> None:
    data = bomb(*size)
    assert len(data) < 100_000
    body = assert_problem(post(client, [photograph(0), data]), 413, "image_too_large", "images", 1)
    assert body["cure"]


def test_real_image_of_ten_thousand_pixels_a_side(client: TestClient) -> None:
    buffer = io.BytesIO()
    Image.new("1", (10_000, 10_000)).save(buffer, "PNG")
    cameras = camera_object(2, width=10_000, height=10_000)
    for view in cameras["views"]:
        view |= {"fx": 8000.0, "fy": 8000.0}
    body = assert_problem(post(client, [buffer.getvalue()] * 2, cameras), 413, "image_too_large", "images", 0)
    assert "100000000" in body["detail"]


def test_image_of_one_pixel(client: TestClient) -> None:
    body = assert_problem(post(client, [photograph(0), photograph(1, 1, 1)]), 422, "image_invalid", "images", 1)
    assert "1 x 1" in body["detail"]


def test_image_of_another_shape_than_its_camera(client: TestClient) -> None:
    body = assert_problem(post(client, [photograph(0), photograph(1, 72, 96)]), 422, "image_invalid", "images", 1)
    assert "72 x 96" in body["detail"]
    assert "96 x 72" in body["detail"]


@pytest.mark.parametrize("value", [float("nan"), float("inf"), None, "NaN"])
def test_pose_that_is_not_finite(client: TestClient, value: Any) -> None:
    body = assert_problem(post(client, cameras=bent(1, c2w=pose(m03=value))), 422, "pose_not_rotation", "views.c2w", 1)
    assert "NaN" in body["detail"]


@pytest.mark.parametrize("value", ["left", [], {}, 10**400])
def test_pose_that_is_no_number(client: TestClient, value: Any) -> None:
    text = json.dumps(bent(1, c2w=pose(m03="@"))).replace(
        '"@"', str(10**400) if value == 10**400 else json.dumps(value)
    )
    assert_problem(post(client, cameras=text), 422, "pose_not_rotation", "views.c2w", 1)


@pytest.mark.parametrize("matrix", [[[1, 0], [0, 1]], [], [1.0] * 16])
def test_pose_of_another_shape(client: TestClient, matrix: list[Any]) -> None:
    body = assert_problem(post(client, cameras=bent(1, c2w=matrix)), 422, "pose_not_rotation", "views.c2w", 1)
    assert "need (4, 4)" in body["detail"]


def test_mirrored_rotation(client: TestClient) -> None:
    body = assert_problem(post(client, cameras=bent(1, c2w=pose(m00=-1))), 422, "pose_not_rotation", "views.c2w", 1)
    assert "-1" in body["detail"]
    assert "left-handed" in body["cure"]


def test_identical_poses(client: TestClient) -> None:
    cameras = bent(1, c2w=np.eye(4).tolist())
    assert_problem(post(client, cameras=cameras), 422, "no_baseline")


def test_normalised_intrinsics(client: TestClient) -> None:
    body = assert_problem(post(client, cameras=bent(0, fx=0.8)), 422, "intrinsics_implausible", "views.fx", 0)
    assert "normalised" in body["cure"]


@pytest.mark.parametrize(("near", "far"), [("5", "5"), ("6", "2"), ("0", "5"), ("-1", "5"), ("nan", "5"), ("1", "inf")])
def test_depth_range_that_is_none(client: TestClient, near: str, far: str) -> None:
    assert_problem(post(client, near=near, far=far), 422, "depth_range_invalid")


@pytest.mark.parametrize("near", ["close", "1_0", "١", "１", "1,0"])
def test_depth_that_is_no_number(client: TestClient, near: str) -> None:
    assert_problem(post(client, near=near), 422, "depth_range_invalid", "near")


def test_views_that_share_nothing(client: TestClient) -> None:
    away = [[-1, 0, 0, 0.2], [0, 1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]]
    assert_problem(post(client, cameras=bent(1, c2w=away)), 422, "views_do_not_overlap")


@pytest.mark.parametrize("text", ["{", "[1, 2", "nonsense", '{"views": [}', "[" * 100_000])
def test_malformed_json(client: TestClient, text: str) -> None:
    assert_problem(post(client, cameras=text), 400, "malformed_request", "cameras")


@pytest.mark.parametrize("cameras", [[], 3, "null", {}, {"views": {}}, {"views": []}, {"views": [1, 2]}])
def test_json_that_is_no_camera_file(client: TestClient, cameras: Any) -> None:
    assert_problem(post(client, cameras=json.dumps(cameras)), 422, "camera_invalid")


@pytest.mark.parametrize("name", ["width", "height", "fx", "fy", "cx", "cy"])
@pytest.mark.parametrize("value", ["wide", None, [], float("nan"), float("inf"), -1e308, 1e308, 0.5, True])
def test_odd_intrinsics(client: TestClient, name: str, value: Any) -> None:
    answer = post(client, cameras=bent(1, **{name: value}))
    if name in ("cx", "cy") and value == 0.5:  # odd, but possible
        assert answer.status_code == 201
        assert client.delete(answer.headers["location"]).status_code == 204
        return
    assert answer.status_code == 422, answer.text
    assert_problem(answer, 422, answer.json()["code"], index=1)


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
