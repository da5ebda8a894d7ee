"""`GET /render`: views, cameras, sizes, channels, formats, and refusals of invalid combinations."""

from __future__ import annotations

import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from http_requests import assert_problem, camera_object, photograph, post, wait_until_ready
from PIL import Image
from starlette.testclient import TestClient

from gapmes.service.app import create_app
from gapmes.service.pictures.picture import MAX_SIDE, check_format, encode
from gapmes.service.settings import Settings
from gapmes.service.splat import Render


@pytest.fixture(scope="module")
def scene(client: TestClient) -> dict[str, Any]:
    return post(client, [photograph(7), photograph(8)]).json()


def picture(answer: Any) -> np.ndarray:
    assert answer.status_code == 200, answer.text
    return np.asarray(Image.open(io.BytesIO(answer.content)))


def test_default_is_view_0_of_the_newest_at_the_fitted_size(client: TestClient, scene: dict[str, Any]) -> None:
    answer = client.get("/render")
    fitted = scene["view_cameras"][0]
    assert picture(answer).shape == (fitted["height"], fitted["width"], 3)
    assert answer.headers["content-type"] == "image/png"
    assert answer.headers["x-gapmes-scene"] == scene["id"]
    assert json.loads(answer.headers["x-gapmes-stats"])["count"] > 0
    assert answer.content == client.get("/render", params={"scene": scene["id"], "view": "0"}).content


def test_view_and_camera_are_the_same_picture(client: TestClient, scene: dict[str, Any]) -> None:
    for view in (0, 1):
        by_view = client.get("/render", params={"view": view})
        by_camera = client.get("/render", params={"camera": json.dumps(scene["view_cameras"][view])})
        assert by_view.content == by_camera.content
    assert client.get("/render?view=0.5").content != client.get("/render?view=0").content


def test_a_radius_cuts_splats(client: TestClient, scene: dict[str, Any]) -> None:
    whole, same, cut = (client.get("/render" + query) for query in ("", "?cut_radius=6", "?cut_radius=1.5"))
    assert (picture(same) == picture(whole)).all()
    assert (picture(cut) != picture(whole)).any()
    assert len({answer.headers["etag"] for answer in (whole, same, cut)}) == 3
    assert_problem(client.get("/render?cut_radius=0.5"), 422, "parameter_invalid", "cut_radius")


def test_camera_in_other_axes(client: TestClient, scene: dict[str, Any]) -> None:
    camera = dict(scene["view_cameras"][1])
    pose = np.array(camera.pop("c2w")) @ np.diag([1.0, -1.0, -1.0, 1.0])
    camera |= {"axes": "opengl", "pose": "w2c", "w2c": np.linalg.inv(pose).tolist()}
    assert client.get("/render", params={"camera": json.dumps(camera)}).content == client.get("/render?view=1").content


def test_size(client: TestClient, scene: dict[str, Any]) -> None:
    fitted = scene["view_cameras"][0]
    aspect = fitted["height"] / fitted["width"]
    assert picture(client.get("/render?width=40")).shape == (round(40 * aspect), 40, 3)
    assert picture(client.get("/render?height=30")).shape == (30, round(30 / aspect), 3)
    assert picture(client.get("/render?width=50&height=20")).shape == (20, 50, 3)


@pytest.mark.parametrize(("name", "mode"), [("png", "PNG"), ("webp", "WEBP"), ("jpeg", "JPEG")])
@pytest.mark.parametrize("channel", ["rgb", "alpha", "depth"])
def test_formats_and_channels(client: TestClient, scene: dict[str, Any], name: str, mode: str, channel: str) -> None:
    answer = client.get("/render", params={"format": name, "channel": channel})
    if name == "jpeg" and channel != "rgb":  # its levels mean something and JPEG would change them
        assert "webp" in assert_problem(answer, 422, "invalid_input", "format")["cure"]
        return
    assert answer.status_code == 200
    assert answer.headers["content-type"] == f"image/{name}"
    assert Image.open(io.BytesIO(answer.content)).format == mode
    assert ("x-gapmes-depth-max" in answer.headers) == (channel == "depth")


def test_depth_levels_mean_what_the_headers_say(client: TestClient, scene: dict[str, Any]) -> None:
    answer = client.get("/render?channel=depth")
    levels = picture(answer)
    low, high = (float(answer.headers[f"x-gapmes-depth-{end}"]) for end in ("min", "max"))
    assert levels.dtype == np.uint16 or levels.dtype == np.int32
    assert levels.max() == 65535 or low == high
    assert 0.5 * scene["near"] < low <= high < 2 * scene["far"]
    scale, offset = (float(answer.headers[f"x-gapmes-depth-{name}"]) for name in ("scale", "offset"))
    assert offset + scale == pytest.approx(low)
    assert offset + 65535 * scale == pytest.approx(high)


def test_depth_at_a_given_scale(client: TestClient, scene: dict[str, Any]) -> None:
    fine = client.get("/render?channel=depth")
    scale, offset = (float(fine.headers[f"x-gapmes-depth-{name}"]) for name in ("scale", "offset"))
    depths = offset + scale * picture(fine).astype(np.float64)
    answer = client.get("/render?channel=depth&depth_scale=0.01")
    levels = picture(answer).astype(np.float64)
    assert (answer.headers["x-gapmes-depth-scale"], answer.headers["x-gapmes-depth-offset"]) == ("0.01", "0.0")
    there = picture(fine) > 0
    assert np.abs(0.01 * levels - depths)[there].max() <= 0.5001 * (0.01 + scale)
    with Image.open(io.BytesIO(answer.content)) as image:
        assert image.text["gapmes:depth_scale"] == "0.01"
        assert image.text["gapmes:depth_max"] == answer.headers["x-gapmes-depth-max"]
    body = assert_problem(client.get("/render?channel=depth&depth_scale=1e-6"), 422, "invalid_input", "depth_scale")
    assert "65535" in body["detail"]
    assert_problem(client.get("/render?channel=depth&depth_scale=1e9"), 422, "invalid_input", "depth_scale")
    assert_problem(client.get("/render?depth_scale=0.01"), 422, "invalid_input", "depth_scale")
    assert_problem(client.get("/render?channel=depth&depth_scale=0"), 422, "parameter_invalid", "depth_scale")
    body = assert_problem(client.get("/render?channel=depth&depth_scale=inf"), 422, "invalid_input", "depth_scale")
    assert body["detail"] == "is inf, need a finite number above 0"


def test_alpha_and_depth_are_exact_in_webp(client: TestClient, scene: dict[str, Any]) -> None:
    camera = dict(scene["view_cameras"][0])
    camera["c2w"] = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -20], [0, 0, 0, 1]]  # far back, so that the rim is in view
    query = {"camera": json.dumps(camera), "width": "200"}
    png, webp = (client.get("/render", params=query | {"channel": "alpha", "format": f}) for f in ("png", "webp"))
    assert len(np.unique(picture(png))) > 2  # levels between nothing and everything
    np.testing.assert_array_equal(picture(webp), np.repeat(picture(png)[:, :, None], 3, axis=2))
    png, webp = (client.get("/render", params=query | {"channel": "depth", "format": f}) for f in ("png", "webp"))
    assert webp.headers["x-gapmes-depth-max"] == png.headers["x-gapmes-depth-max"]
    fine, coarse = picture(png).astype(np.float64), picture(webp)[:, :, 0]
    np.testing.assert_array_equal(coarse == 0, fine == 0)  # level 0 is nothing there, and no other pixel has it
    expected = np.where(fine == 0, 0, 1 + (fine - 1) * 254 / 65534)
    assert np.abs(coarse - expected).max() <= 0.5 + 254 / 65534


@pytest.mark.parametrize(
    ("name", "query", "field", "limit"),
    [
        ("webp", "width=20000&height=100", "width", 16383),
        ("webp", "width=100&height=16384", "height", 16383),
        ("jpeg", "width=65535&height=100", "width", 65500),
        ("jpeg", "width=100&height=65501", "height", 65500),
    ],
)
def test_sides_that_a_format_cannot_have(
    client: TestClient, scene: dict[str, Any], name: str, query: str, field: str, limit: int
) -> None:
    body = assert_problem(client.get(f"/render?{query}&format={name}"), 422, "invalid_input", field)
    assert str(limit) in body["detail"]
    assert re.search(r"\d+", query.split(field + "=")[1])[0] in body["detail"]


@pytest.mark.parametrize("name", ["webp", "jpeg"])
def test_the_longest_side_of_a_format_can_be_written(name: Any) -> None:
    width, height = MAX_SIDE[name], 1
    check_format(width, height, "rgb", name)
    drawn = Render(np.zeros((height, width, 3), np.float32), *np.zeros((2, height, width), np.float32), {})
    assert Image.open(io.BytesIO(encode(drawn, "rgb", name).data)).size == (width, height)


def test_a_crop_with_a_principal_point_far_outside_is_drawn(client: TestClient) -> None:
    """1000 x 300 with cx = 1900 is plausible; of the middle that a scene has of it, the same point is not."""
    cameras = camera_object(2, width=1000, height=300)
    for view in cameras["views"]:
        view |= {"fx": 1000.0, "fy": 1000.0, "cx": 1900.0}
    images = [photograph(60, 1000, 300), photograph(61, 1000, 300)]
    answer = post(client, images, cameras, accept="application/zip", views="0,0.5", trust_poses="true")
    assert answer.status_code == 201, answer.text
    body = client.get(answer.headers["location"]).json()
    fitted = body["view_cameras"][0]
    assert fitted["cx"] > 2 * fitted["width"]
    for link in body["links"]["views"]:
        assert client.get(link).status_code == 200
    client.delete(answer.headers["location"])


def test_background_shows_where_nothing_is(client: TestClient, scene: dict[str, Any]) -> None:
    away = dict(scene["view_cameras"][0])
    away["c2w"] = [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]]
    for text, colour in (
        ("ff8000", (255, 128, 0)),
        ("#0000FF", (0, 0, 255)),
        ("white", (255,) * 3),
        ("black", (0,) * 3),
    ):
        image = picture(client.get("/render", params={"camera": json.dumps(away), "background": text}))
        assert (image == colour).all()


@pytest.mark.parametrize("view", ["99", "abc", "-1", "1.5", "nan", "inf", "1e9", "orbit:", "orbit:nan", "0,1", "", "٣"])
def test_unknown_view(client: TestClient, scene: dict[str, Any], view: str) -> None:
    body = assert_problem(client.get("/render", params={"view": view}), 422, "view_unknown", "view")
    if view == "99":
        assert "2" in body["detail"] + body.get("cure", "")


@pytest.mark.parametrize(
    ("query", "field"),
    [
        ("width=0", "width"),
        ("width=-5", "width"),
        ("width=abc", "width"),
        ("width=6_4", "width"),
        ("stop=0.0_1", "stop"),
        ("height=99999999999999999999", "height"),
        ("channel=red", "channel"),
        ("format=gif", "format"),
        ("veiw=1", "veiw"),
        ("view=" + "1" * 1000, "view"),
    ],
)
def test_bad_parameters(client: TestClient, scene: dict[str, Any], query: str, field: str) -> None:
    body = assert_problem(client.get(f"/render?{query}"), 422, "parameter_invalid", field)
    assert body["errors"][0]["field"] == field


def test_other_refusals(client: TestClient, scene: dict[str, Any]) -> None:
    assert_problem(client.get("/render?width=60000&height=60000"), 422, "invalid_input", "width")
    assert_problem(client.get("/render?background=reddish"), 422, "view_unknown", "background")
    assert_problem(client.get("/render?view=0&camera={}"), 422, "view_unknown", "camera")
    assert_problem(client.get("/render?camera={"), 400, "malformed_request", "camera")
    assert_problem(client.get("/render?camera=[]"), 422, "camera_invalid", "camera")
    mirrored = camera_object(1)["views"][0] | {"c2w": np.diag([-1.0, 1, 1, 1]).tolist()}
    assert_problem(client.get("/render", params={"camera": json.dumps(mirrored)}), 422, "pose_not_rotation")
    assert client.get("/render").status_code == 200


@pytest.mark.parametrize(
    "scene_id", ["0" * 32, "nothing", "..", "../..", "..%2f..", "%2e%2e%2f", "a" * 300, "", "\x00"]
)
def test_unknown_scene(client: TestClient, scene: dict[str, Any], scene_id: str) -> None:
    answer = client.get("/render", params={"scene": scene_id})
    code = "parameter_invalid" if len(scene_id) > 200 else "scene_not_found"
    assert_problem(answer, 422 if len(scene_id) > 200 else 404, code, "scene")


def test_a_wrong_parameter_is_told_with_what_was_sent(client: TestClient) -> None:
    body = assert_problem(client.get("/render?width=-1"), 422, "parameter_invalid", "width")
    assert "is '-1': input should be greater than or equal to 1" in body["detail"]
    body = assert_problem(client.get("/render?format=jpg"), 422, "parameter_invalid", "format")
    assert "is 'jpg'" in body["detail"]
    assert "'jpeg'" in body["detail"]
    body = assert_problem(client.get("/render?typo=1"), 422, "parameter_invalid", "typo")
    assert body["detail"] == "is not a parameter of this route"
    assert "view, camera, scene" in body["cure"]


def test_a_picture_that_takes_too_long_is_ended(standin_model: Path, tmp_path: Path) -> None:
    limited = Settings(model=standin_model, store=tmp_path / "scenes", threads=1, picture_seconds=1e-9)
    with TestClient(create_app(limited), raise_server_exceptions=False) as other:
        wait_until_ready(other)
        assert post(other).status_code == 201
        body = assert_problem(other.get("/render"), 504, "deadline_exceeded")
        assert "within 1e-09 s" in body["detail"]
