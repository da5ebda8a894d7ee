"""Bad photographs and cameras over HTTP: status, code, field, index and cure; the next request works."""

from __future__ import annotations

import io
import json
import struct
import zlib
from functools import partial
from typing import Any

import http_requests
import numpy as np
import pytest
from http_requests import camera_object, photograph, post
from PIL import Image
from starlette.testclient import TestClient

assert_problem = partial(http_requests.assert_problem, cured=True)


assert_problem = partial(http_requests.assert_problem, cured=True)
pytestmark = pytest.mark.usefixtures("unharmed")


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


@pytest.mark.parametrize(
    "part",
    [
        b"# Image list with two lines of data per image:\n1 1 0 0 0 0 0 0 1 a.jpg\n",
        b"# Camera list\n1 PINHOLE 64 48 60 60 32 24\n",
        b"\x02\0\0\0\0\0\0\0\x81\xff",
    ],
    ids=["images.txt", "cameras.txt", "images.bin"],
)
def test_one_file_of_a_colmap_model_is_told_what_is_taken(client: TestClient, part: bytes) -> None:
    files = [("images", ("0.png", photograph(0))), ("images", ("1.png", photograph(1)))]
    for path in ("/reconstruct", "/check"):
        answer = client.post(path, files=[*files, ("cameras", ("images.txt", part))])
        cure = assert_problem(answer, 400, "malformed_request", "cameras", cured=True)["cure"]
        assert "a zipped COLMAP model" in cure
    broken = client.post("/check", files=[*files, ("cameras", ("cameras.json", b'{"views": ['))])
    assert "has an example" in assert_problem(broken, 400, "malformed_request", "cameras", cured=True)["cure"]


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
