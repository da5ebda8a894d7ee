"""`POST /check` and the page's view of a scene: the cameras as understood, the inputs, the viewer's files."""

from __future__ import annotations

import base64
import io
import json
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from http_requests import assert_problem, camera_object, photograph, post, stored
from PIL import Image
from starlette.testclient import TestClient

from gapmes.service.cameras.view_checks import MAX_VIEWS
from gapmes.service.formats.ply import read_ply
from gapmes.service.http import check
from gapmes.service.settings import Settings


def checked(client: TestClient, images: list[bytes], cameras: object, **fields: str) -> object:
    parts = [("images", (f"{index}.png", data, "image/png")) for index, data in enumerate(images)]
    files = [*parts, ("cameras", ("cameras.json", json.dumps(cameras).encode()))]
    return client.post("/check", files=files, data=fields)


def test_it_tells_what_was_understood_and_keeps_nothing(client: TestClient, settings: Settings) -> None:
    before = stored(settings)
    photo = photograph(5)
    answer = checked(client, [photo, photograph(6)], camera_object(2))
    assert answer.status_code == 200, answer.text
    body = answer.json()
    assert (body["near"], body["far"], body["depth_range_source"]) == (1.0, 10.0, "given")
    assert [image["name"] for image in body["images"]] == ["0.png", "1.png"]
    first = body["images"][0]
    assert (first["width"], first["height"]) == (96, 72)
    assert first["camera"]["c2w"] == np.eye(4).tolist()
    small = Image.open(io.BytesIO(base64.b64decode(first["thumbnail"])))
    truth = Image.open(io.BytesIO(photo)).convert("RGB").resize(small.size)
    assert np.abs(np.asarray(small, float) - np.asarray(truth, float)).mean() < 12  # measured 9.7: a JPEG of blocks
    assert stored(settings) == before


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda c: c.update(near=10.0, far=1.0), "depth_range_invalid"),
        (lambda c: c["views"][1].update(c2w=c["views"][0]["c2w"]), "no_baseline"),
        (lambda c: c["views"][1]["c2w"][0].__setitem__(0, 2.0), "pose_not_rotation"),
        (lambda c: c["views"][1].update(fx=-1.0), "intrinsics_implausible"),
        (lambda c: c["views"].pop(), "view_count"),
    ],
)
def test_it_refuses_what_a_reconstruction_would(client: TestClient, change: object, code: str) -> None:
    cameras = camera_object(2)
    change(cameras)
    assert_problem(checked(client, [photograph(5), photograph(6)], cameras), 422, code)


def test_those_who_wait_for_their_turn_keep_no_upload_out(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    going, runtime = threading.Event(), client.app.state.runtime
    understood = check._understood
    monkeypatch.setattr(check, "_understood", lambda *given: going.wait(120) and understood(*given))
    monkeypatch.setattr(runtime.uploads, "most", 1)
    with ThreadPoolExecutor(2) as pool:
        waiting = []
        try:
            for count in (1, 2):
                waiting.append(pool.submit(checked, client, [photograph(5), photograph(6)], camera_object(2)))
                deadline = time.monotonic() + 60
                while runtime.looks.limit.taken < count or runtime.uploads.taken:
                    assert time.monotonic() < deadline, "it keeps its place among the uploads"
                    time.sleep(0.01)
            assert post(client).status_code in (200, 201)
        finally:
            going.set()
        assert [answer.result().status_code for answer in waiting] == [200, 200]


@pytest.mark.parametrize("detail", ["1", "2"])
def test_it_tells_as_a_reconstruction_does_where_photographs_lack_detail(client: TestClient, detail: str) -> None:
    images = [photograph(5), photograph(6)]
    answers = checked(client, images, camera_object(2), detail=detail), post(client, images, detail=detail)
    told = [
        [warning for warning in answer.json()["warnings"] if warning["code"] == "detail_beyond_photograph"]
        for answer in answers
    ]
    assert told[0] == told[1]
    assert len(told[0]) == (2 if detail == "2" else 0)


def test_it_warns_of_a_wide_range_as_a_reconstruction_does(client: TestClient) -> None:
    """With the steps of 64 planes where the network's file does not state their number. Half a step at depth 1 is then
    1 / (1 + 2 * 63) of it, but for the far plane."""
    images, cameras = [photograph(5), photograph(6)], {**camera_object(2), "far": 20000.0}
    asked, done = checked(client, images, cameras), post(client, images, cameras)
    (told,) = [warning for warning in asked.json()["warnings"] if warning["code"] == "depth_range_wide"]
    assert "far / near = 2e+04" in told["message"]
    assert "half a step with 64 planes, by depth: 1: 0.79 %" in told["message"]
    assert told in done.json()["warnings"]


def test_a_photograph_that_cannot_be_decoded_is_named(client: TestClient) -> None:
    broken = photograph(6)[:200]
    assert_problem(checked(client, [photograph(5), broken], camera_object(2)), 415, "image_unreadable", index=1)


def masked(seed: int, kept: slice, size: tuple[int, int] = (96, 72)) -> bytes:
    """A photograph of which these columns are opaque."""
    picture = Image.open(io.BytesIO(photograph(seed, *size))).convert("RGBA")
    alpha = np.zeros(size[::-1], np.uint8)
    alpha[:, kept] = 255
    picture.putalpha(Image.fromarray(alpha))
    buffer = io.BytesIO()
    picture.save(buffer, "PNG")
    return buffer.getvalue()


def transforms_form(images: list[bytes], size: tuple[int, int], **lens: float) -> list:
    """The cameras of `camera_object` as a transforms.json, which may tell of a lens, with the images as parts."""
    intrinsics = {"w": size[0], "h": size[1], "fl_x": 80.0, "fl_y": 80.0, "cx": size[0] / 2, "cy": size[1] / 2}
    frames = [
        {"file_path": f"{index}.png", "transform_matrix": (np.array(view["c2w"]) @ np.diag([1, -1, -1, 1])).tolist()}
        for index, view in enumerate(camera_object(len(images))["views"])
    ]
    document = json.dumps({**intrinsics, **lens, "frames": frames})
    parts = [("images", (f"{index}.png", data, "image/png")) for index, data in enumerate(images)]
    return [*parts, ("cameras", (None, document)), ("near", (None, "1")), ("far", (None, "10"))]


@pytest.mark.parametrize("lens", [{}, {"k1": -0.05}])
@pytest.mark.parametrize(
    ("second", "size", "words"),
    [
        (photograph(6, 72, 96), (96, 72), "the photograph is 72 x 96 px, its camera 96 x 72 px: the aspects differ"),
        (photograph(6, 96, 96), (96, 72), "the photograph is 96 x 96 px, its camera 96 x 72 px: the aspects differ"),
        (photograph(6, 24, 18), (96, 72), "is 24 x 18 px, need at least 32 x 32"),
        (masked(6, slice(0, 0)), (96, 72), "the mask leaves no pixel"),
        (masked(6, slice(0, 30), (240, 48)), (240, 48), "the mask keeps 0 of 128 x 48 px, the middle"),
    ],
)
def test_photographs_are_refused_as_a_reconstruction_refuses_them(
    client: TestClient, second: bytes, size: tuple[int, int], words: str, lens: dict[str, float]
) -> None:
    """With the same words, through a lens that bends rays too."""
    parts = transforms_form([photograph(5, *size), second], size, **lens)
    asked, done = (
        assert_problem(client.post(route, files=parts), 422, "image_invalid", "images", 1)
        for route in ("/check", "/reconstruct")
    )
    assert words in asked["detail"]
    assert asked == done


@pytest.mark.parametrize("second", [photograph(14), masked(14, slice(20, 70))])
def test_it_warns_of_photographs_as_a_reconstruction_does(client: TestClient, second: bytes) -> None:
    parts = transforms_form([photograph(13), second], (96, 72), k1=-0.05)
    asked, done = (client.post(route, files=parts).json()["warnings"] for route in ("/check", "/reconstruct"))
    told = [warning for warning in asked if warning["code"] == "undistorted"]
    assert [warning["index"] for warning in told] == [0, 1]
    assert all(warning in done for warning in told)


def test_it_warns_of_bars_as_a_reconstruction_does(client: TestClient) -> None:
    pixels = np.array(Image.open(io.BytesIO(photograph(14))).convert("RGB"))
    pixels[:10] = pixels[-10:] = 0
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG")
    parts = transforms_form([photograph(13), buffer.getvalue()], (96, 72))
    asked, done = (client.post(route, files=parts).json()["warnings"] for route in ("/check", "/reconstruct"))
    (told,) = [warning for warning in asked if warning["code"] == "border_left_out"]
    assert told["index"] == 1
    assert "11 px at the top and 11 px at the bottom" in told["message"]
    assert told in done


@pytest.fixture(scope="module")
def scene(client: TestClient) -> dict:
    """Without fading, which drops some of what two photographs of noise do not agree on: every Gaussian is here."""
    answer = post(client, [photograph(7), masked(8, slice(0, 48))], fade="0")
    assert answer.status_code in (200, 201), answer.text
    return answer.json()


def test_inputs_are_what_the_network_saw(client: TestClient, scene: dict) -> None:
    """The photograph of 96 x 72 px on the network's 64 x 48; what a mask leaves out is transparent."""
    assert len(scene["links"]["inputs"]) == 2
    pictures = [Image.open(io.BytesIO(client.get(link).content)) for link in scene["links"]["inputs"]]
    assert [picture.mode for picture in pictures] == ["RGB", "RGBA"]
    assert pictures[0].size == (64, 48)
    truth = Image.open(io.BytesIO(photograph(7))).convert("RGB").resize((64, 48), Image.Resampling.BOX)
    assert np.abs(np.asarray(pictures[0], float) - np.asarray(truth, float)).mean() < 10  # measured 8.5: another filter
    alpha = np.asarray(pictures[1])[:, :, 3]
    assert (alpha[:, :30] == 255).all()
    assert (alpha[:, 34:] == 0).all()
    for index in (2, MAX_VIEWS - 1):  # which another scene may have
        assert_problem(client.get(f"/scenes/{scene['id']}/inputs/{index}"), 404, "scene_not_found")
    assert_problem(client.get(f"/scenes/{scene['id']}/inputs/{MAX_VIEWS}"), 422, "parameter_invalid")
    assert_problem(client.get(f"/scenes/{'0' * 32}/inputs/0"), 404, "scene_not_found")


def test_routing_maps_have_a_digit_per_patch(client: TestClient, scene: dict) -> None:
    """The stand-in's fixed rule: expert 1 weighs most, and of the tasks the first."""
    assert scene["routing"]["maps"] == {"experts": ["1" * 12] * 2, "tasks": ["0" * 12] * 2}


def test_the_viewer_gets_the_scene_about_its_pivot(client: TestClient, scene: dict) -> None:
    answer = client.get(f"/scenes/{scene['id']}/viewer.ply")
    gaussians = read_ply(answer.content)
    world = read_ply(client.get(scene["links"]["ply"]).content)
    assert len(gaussians) == len(world)
    assert np.abs(np.median(gaussians.means, axis=0))[1:].max() < 1e-6  # the wall stands in the pivot; half is masked
    ratio = world.scales / gaussians.scales
    assert np.allclose(ratio, np.sqrt(10.0), rtol=1e-5)  # the pivot's depth is the unit
    kept = client.get(f"/scenes/{scene['id']}/viewer.ply", headers={"If-None-Match": answer.headers["etag"]})
    assert kept.status_code == 304
    settings = client.get(f"/scenes/{scene['id']}/viewer.json").json()
    start = settings["cameras"][0]["initial"]
    assert start["position"][2] == pytest.approx(-1.0, abs=0.01)
    assert start["fov"] == pytest.approx(2 * np.degrees(np.arctan(0.5 * 72 / 80)), abs=0.01)


def test_views_that_are_asked_for_are_checked_too(client: TestClient) -> None:
    parts = [("images", (f"{index}.png", photograph(index), "image/png")) for index in range(2)]
    parts.append(("cameras", ("cameras.json", json.dumps(camera_object(2)).encode(), "application/json")))
    asked, done = (
        assert_problem(client.post(route, files=[*parts, ("views", (None, "0,7"))]), 422, "view_unknown", "views")
        for route in ("/check", "/reconstruct")
    )
    assert asked == done


def test_a_photograph_that_exif_turns_is_shown_as_it_will_be_used(client: TestClient) -> None:
    picture = Image.open(io.BytesIO(photograph(5, 72, 96)))
    exif = Image.Exif()
    exif[0x0112] = 6
    stored_on_its_side = io.BytesIO()
    picture.rotate(90, expand=True).save(stored_on_its_side, "PNG", exif=exif)
    cameras = camera_object(2, width=72, height=96)
    body = checked(client, [stored_on_its_side.getvalue(), photograph(6, 72, 96)], cameras).json()
    first = body["images"][0]
    assert (first["width"], first["height"]) == (72, 96)
    small = np.asarray(Image.open(io.BytesIO(base64.b64decode(first["thumbnail"]))), float)
    assert np.abs(small - np.asarray(picture, float)).mean() < 12  # a JPEG of blocks


@pytest.mark.parametrize("lens", [{}, {"k1": -0.05}])
def test_it_is_so_through_a_lens_too(client: TestClient, lens: dict[str, float]) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6
    on_its_side = io.BytesIO()
    Image.open(io.BytesIO(photograph(5, 72, 96))).rotate(90, expand=True).save(on_its_side, "PNG", exif=exif)
    form = transforms_form([on_its_side.getvalue(), photograph(6, 72, 96)], (72, 96), **lens)
    first = client.post("/check", files=form).json()["images"][0]
    assert (first["width"], first["height"]) == (72, 96)


def test_a_range_that_photographs_have_not_narrowed_is_called_one_of_cameras(client: TestClient) -> None:
    cameras = camera_object(2)
    del cameras["near"], cameras["far"]
    assert checked(client, [photograph(5), photograph(6)], cameras).json()["depth_range_source"] == "cameras"
